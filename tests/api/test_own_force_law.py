"""A user's own force law: the lift of a plate, from the page about such laws."""

import dataclasses
import sys

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_documented_programs import configs, here, programs, run

import evo_cpg as evo
from creatures import box_chain, coast, in_water, quick_jit, random_state
from evo_cpg.analysis.energy import ledger
from evo_cpg.cli.exchange import export
from evo_cpg.creature.creature import Actuator, Body, Creature, Material
from evo_cpg.creature.shapes import Box
from evo_cpg.io.errors import ConfigError
from evo_cpg.io.lint import lint
from evo_cpg.io.load import load_config
from evo_cpg.io.parameters import parametrise
from evo_cpg.native.engine import EngineWarning
from evo_cpg.physics.step.statics import FrictionState, static_forces
from evo_cpg.physics.tree.kinematics import kinematics
from evo_cpg.physics.tree.state import resting_state
from evo_cpg.physics.water.fluid import Drag
from evo_cpg.simulation.observers import EachPhysicsStep
from evo_cpg.simulation.rollout import rollout

__all__ = ["here"]

WATER, SPAN, CHORD, THICKNESS, DENSITY, G = 1000.0, 0.5, 0.2, 0.02, 1500.0, 9.81
AREA, SLOPE, FORM = SPAN * CHORD, 6.283, 1.0


class Leash(evo.ForceLaw):
    """Example of `ForceLaw`."""

    body: str = eqx.field(static=True)
    stiffness: float = 10.0

    def wrench(self, bodies):
        i = bodies.index(self.body)
        pull = -self.stiffness * bodies.kin.origin[:, i]
        turned = (bodies.kin.rotation[:, :, i] * pull[:, None]).sum(0)
        return bodies.wrench_on(self.body, turned)


# More laws for the module of the page.
SWIM = """
class {name}(PlateLift):
    def wrench(self, bodies):
        {line}
"""


@pytest.fixture(scope="module")
def plate_lift():
    """Return the class of the page."""
    names: dict = {}
    run(programs("docs/own.md")[2], names)
    return names["PlateLift"]


@pytest.fixture
def plate(plate_lift, x64):
    """Return a heavy plate in water, with form drag and lift."""
    shape = Box((CHORD, SPAN, THICKNESS))
    creature = Creature("plate", (Body("wing", shape, Material(DENSITY)),))
    world = in_water(creature, gravity=G, form_drag=FORM, skin_drag=0.0)
    return dataclasses.replace(world, forces=(*world.forces, plate_lift("wing", AREA)))


def acting(world, velocity):
    """Return the lift's wrench and derivative at a velocity ``(6, 1, n)`` of the plate."""
    state = resting_state(world.tree, velocity.shape[2:], jnp.float64)
    law = world.forces[-1]

    def both(velocity):
        moving = world.bodies(kinematics(world.tree, state), 0.01).moving(velocity)
        return law.wrench(moving), law.derivative(moving)

    return map(np.asarray, quick_jit(both)(jnp.asarray(velocity)))


def test_lift_equals_the_thin_plate_formula(plate):
    """Lift is 1/2 rho A s sin(alpha) v^2, normal to the motion and to the span, at 5 degrees."""
    speed, angle = 2.0, np.deg2rad(5.0)
    velocity = np.zeros((6, 1, 1))
    velocity[3], velocity[5] = speed * np.cos(angle), -speed * np.sin(angle)
    wrench, _ = acting(plate, velocity)
    lift = 0.5 * WATER * AREA * SLOPE * np.sin(angle) * speed**2
    expected = [0, 0, 0, lift * np.sin(angle), 0, lift * np.cos(angle)]
    np.testing.assert_allclose(wrench[:, 0, 0], expected, rtol=1e-12, atol=1e-9)


def test_derivative_of_a_law_equals_finite_differences(plate):
    velocity = np.random.default_rng(3).normal(size=(6, 1, 5))
    _, derivative = acting(plate, velocity)
    # One program evaluates the changes of all six components, ahead and behind.
    change = 1e-6 * np.eye(6)[:, None, :, None]
    shifted = np.concatenate([velocity[:, :, None] + change, velocity[:, :, None] - change], 2)
    wrench, _ = acting(plate, shifted.reshape(6, 1, -1))
    ahead, behind = np.split(wrench.reshape(shifted.shape), 2, axis=2)
    slopes = (ahead - behind) / 2e-6
    for column in range(6):
        slope = slopes[:, :, column]
        np.testing.assert_allclose(derivative[:, column], slope, rtol=1e-6, atol=1e-4)
    assert np.abs(derivative - derivative.swapaxes(0, 1)).max() > 1.0


def test_a_plate_glides_at_its_closed_form_speed(plate):
    """Lift drives a level plate forward against form drag k_x. Both carry its weight.

    ``a v_z^2 = k_x v_x^2`` and ``w = a v_x |v_z| + k_z v_z^2``, with ``k = rho C_d A_front``.
    """
    lift, volume = 0.5 * WATER * AREA * SLOPE, AREA * THICKNESS
    ahead, below = WATER * FORM * SPAN * THICKNESS, WATER * FORM * AREA
    ratio = np.sqrt(lift / ahead)
    sink = np.sqrt((DENSITY - WATER) * volume * G / (lift * ratio + below))
    motion = coast(plate, resting_state(plate.tree, dtype=jnp.float64), 20.0, 1 / 60)
    expected = [0, 0, 0, ratio * sink, 0, -sink]
    np.testing.assert_allclose(motion.velocity[-1], expected, rtol=1e-6, atol=1e-9)


def test_a_law_with_a_skew_derivative_is_of_second_order(plate):
    """Half the step gives a quarter of the error, although the solver's matrices are symmetric."""
    state = resting_state(plate.tree, dtype=jnp.float64)
    state = dataclasses.replace(state, velocity=jnp.array([0.0, 0, 0, 0.3, 0.0, -0.2]))
    ends = [coast(plate, state, 0.4, 0.4 / n).velocity[-1] for n in (40, 80, 640)]
    errors = [np.abs(end - ends[-1]).max() for end in ends[:2]]
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.15)


def test_a_wrench_does_the_work_of_its_force_and_moment(x64):
    """Power is F . v + M . w at the centre of mass, which is not the joint, in any current."""
    rng = np.random.default_rng(5)
    current = (0.3, -0.2, 0.1)
    world = in_water(box_chain(3, "yz", Actuator(1.0)), current=current)
    state = random_state(world.tree, rng, (4,))
    force, moment = jnp.asarray(rng.normal(size=(2, 3, 4)))

    @quick_jit
    def acting(state):
        bodies = world.bodies(kinematics(world.tree, state), 0.01)
        return (
            bodies.kin.rotation,
            bodies.velocity,
            bodies.wrench_on("b1", force, moment),
            bodies.through_water,
        )

    rotations, velocity, wrench, through_water = map(np.asarray, acting(state))
    i = world.tree.names.index("b1")
    assert not np.delete(np.asarray(wrench), i, 1).any()
    spin, rotation = velocity[:3, i], rotations[:, :, i]
    through = through_water[:, i] + np.einsum("jin,j->in", rotation, current)
    power = (force * through + moment * spin).sum(0)
    np.testing.assert_allclose((wrench * velocity).sum((0, 1)), power, rtol=1e-10)


def test_a_law_acts_on_a_creature_at_rest(plate):
    """A leash of 40 N/m to the world's origin pulls at 0.2 m, against weight and buoyancy."""
    stiffness = 40.0
    leash = dataclasses.replace(plate, forces=(*plate.forces, Leash("wing", stiffness)))
    base = resting_state(plate.tree, dtype=jnp.float64)
    offset = jnp.array([0.2, 0.0, -0.1, 0.3, 0.0, 0.0])
    none = jnp.zeros((3, 0))
    friction = FrictionState(none, none, none, none[0])
    force, _ = quick_jit(lambda x: static_forces(leash, 0.01, base, friction, x))(offset)
    apparent = (DENSITY - WATER) * AREA * THICKNESS * G
    expected = [-stiffness * 0.2, 0.0, stiffness * 0.1 - apparent, 0.0, 0.0, 0.0]
    np.testing.assert_allclose(force, expected, atol=1e-9)


@pytest.fixture
def glider(here, monkeypatch):
    """Write the files of the page to the working folder."""
    wriggler, _, plate, _ = programs("docs/own.md")
    (here / "wriggler.py").write_text(wriggler)
    (here / "plate.py").write_text(
        plate
        + SWIM.format(name="Wrong", line="return bodies.velocity[3:]")
        + SWIM.format(name="Broken", line="return jnp.stack([0.0, bodies.velocity])")
        + SWIM.format(name="Slow", line="return bodies.velocity / jnp.abs(bodies.velocity)")
        + SWIM.format(
            name="Kinked",
            line="return bodies.velocity * jnp.linalg.norm(bodies.velocity, axis=0)[None]",
        )
        + SWIM.format(
            name="Strange",
            line="return super().wrench(bodies) + 0 * jnp.fft.fft(bodies.velocity, axis=0).real",
        )
    )
    (here / "glider.yaml").write_text(configs("docs/own.md")[1])
    for name in ("wriggler", "plate"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    yield here
    for name in ("wriggler", "plate"):
        sys.modules.pop(name, None)


@pytest.mark.slow
def test_a_force_law_trains_replays_and_balances_energy(glider):
    """Lift changes the swimming of a fluke, the replay is exact, and energy is balanced."""
    with_lift = evo.load("glider.yaml")
    trained = evo.train(with_lift, "runs/glider")
    without = evo.load("glider.yaml", {"world.forces": []})
    assert [type(law) for law in without.parts.simulation.world.forces] == [Drag]
    genes = trained.genome[None]
    fitness = with_lift.evaluate(0, genes).fitness
    np.testing.assert_array_equal(fitness, [trained.fitness])
    assert abs(fitness - without.evaluate(0, genes).fitness)[0] > 1e-3
    again = evo.load(trained.folder).evaluate(0, genes).fitness
    np.testing.assert_array_equal(again, fitness)
    simulation = with_lift.parts.simulation
    steps = quick_jit(lambda g: rollout(simulation, g, observers=EachPhysicsStep()))(
        jnp.asarray(genes.T)
    )
    book = ledger(simulation.world, jax.tree.map(np.asarray, steps), simulation.step_length)
    scale = sum(np.abs(work).sum() for work in book.work.values())
    # Lift does no work at the centre of mass, except for the rotation during a step.
    assert abs(book.left_over.sum()) < 0.02 * scale
    assert np.abs(book.impulse).max() < 1e-3


@pytest.mark.slow
def test_a_number_of_a_law_has_a_derivative(glider):
    """Compare the derivative with a central difference of rebuilt simulations."""
    source = glider / "glider.yaml"
    config = load_config(source, ["simulation.seconds=0.0833"])
    parameters = parametrise(config, source, ["world.forces.0.options.area"])
    genes = jnp.full((3, 1), 1.0)

    def displacement(values):
        return rollout(parameters.simulation(values), genes, None).terms["distance"][0]

    slope = quick_jit(jax.grad(displacement))(jnp.array([0.03]))
    ends = [quick_jit(displacement)(jnp.array([area])) for area in (0.029, 0.031)]
    expected = float(ends[1] - ends[0]) / 0.002
    assert abs(expected) > 1e-4 and float(slope[0]) == pytest.approx(expected, rel=0.02)


def test_export_reports_omitted_force_laws(glider, capsys):
    export(glider / "glider.yaml", glider / "glider.xml")
    assert "left out: force laws of your own, PlateLift\n" in capsys.readouterr().err


def test_lint_reports_no_falling_if_a_law_may_hold_the_creature(glider):
    """The law may be a leash, so `validate` does not warn of gravity."""
    held = ["world.water=null", "world.ground=null"]
    falls = [d.key for d in lint(load_config(glider / "glider.yaml", held), "glider.yaml")]
    free = [*held, "world.forces=[]"]
    there = [d.key for d in lint(load_config(glider / "glider.yaml", free), "glider.yaml")]
    assert ("world", "ground") in there and ("world", "ground") not in falls


@pytest.mark.parametrize(
    ("kind", "body", "expected"),
    [
        ("plate:PlateLift", "wing", "no body 'wing'"),
        ("plate:PlateLift", None, "cannot be built with these options"),
        ("plate:Nobody", None, "cannot be imported"),
        ("wriggler:Wave", None, "is not a subclass of evo_cpg.physics.water.force_law:ForceLaw"),
        ("plate:Wrong", "fluke", r"Wrong.wrench must return float32\[6, 2, 7\]"),
        ("plate:Broken", "fluke", r"Broken.wrench fails at line \d+ of plate.py \(ValueError"),
        ("plate:Slow", "fluke", r"Slow\.\w+ is NaN or infinite for a creature at rest"),
        ("plate:Kinked", "fluke", "Kinked.derivative is NaN or infinite for a creature at rest"),
        ("drag", None, "must be a module and a class, such as my_module:MyClass"),
    ],
)
def test_wrong_laws_are_refused(glider, kind, body, expected):
    setting = {"type": kind} | ({"options": {"body": body, "area": 1}} if body else {})
    with pytest.raises(ConfigError, match=rf"world\.forces.*{expected}"):
        evo.load("glider.yaml", {"world.forces": [setting]})


@pytest.mark.slow
def test_a_law_beyond_native_code_runs_on_plain_jax(glider, request):
    if request.config.getoption("--engine") == "jax":
        pytest.skip("everything runs on plain JAX")
    law = {"type": "plate:Strange", "options": {"body": "fluke", "area": 0.03}}
    strange = evo.load("glider.yaml", {"world.forces": [law], "simulation.seconds": 0.0333})
    genes = np.full((1, 3), 1.0, np.float32)
    with pytest.warns(EngineWarning, match=r"Strange.wrench runs on plain JAX.*fft"):
        found = strange.evaluate(0, genes).fitness
    same = evo.load("glider.yaml", {"simulation.seconds": 0.0333}).evaluate(0, genes).fitness
    np.testing.assert_allclose(found, same, rtol=1e-4)
