"""A user's task: cost of transport, foot slip and clearance of a walker.

NumPy recomputes all terms from recorded poses and torques, the feet's geometry and Newton's second
law.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from creatures import hinge, quick_jit
from evo_cpg.creature.creature import Actuator, Body, Creature, Material
from evo_cpg.creature.shapes import Box, Sphere
from evo_cpg.creature.tree import build_tree
from evo_cpg.physics.contact.contact_model import Ground, make_contact_model
from evo_cpg.physics.step.world import World
from evo_cpg.simulation.recording import Recorder, as_recording
from evo_cpg.simulation.rollout import rollout
from evo_cpg.simulation.sensors import place_sensors
from evo_cpg.simulation.simulation import Simulation
from evo_cpg.simulation.situation import Situation
from evo_cpg.simulation.task import Task
from trials import SineController

RATE, STEPS, GRAVITY, RADIUS = 240.0, 240, 9.81, 0.04
FEET = ("front", "back")
# Amplitude (rad/s) and frequency (Hz) of two walkers that rock and slide, and one that stands.
GENES = np.array([[4.0, 6.0, 0.0], [1.5, 2.5, 1.0]], np.float32)


class TransportAndSlip(Task):
    """Cost of transport, and distance that feet slide under load."""

    light: None = eqx.field(default=None, init=False)

    def begin(self, batch, dtype, steps):
        place, number = jnp.zeros((3, *batch), dtype), jnp.zeros(batch, dtype)
        return {"start": place, "end": place, "impulse": place, "momentum": place} | dict.fromkeys(
            ("energy", "slip", "lift"), number
        )

    def update(self, tally, transition, steps):
        before, after = transition.before, transition.after
        feet, force = after.contacts_of(FEET), transition.forces.contact_force
        sliding = jnp.sqrt((after.contact_velocity[:2, feet] ** 2).sum(0))
        carries = force[2, feet] > 0
        mass = after.world.tree.mass.sum()
        return {
            "start": jnp.where(transition.step == 0, before.centre_of_mass, tally["start"]),
            "end": after.centre_of_mass,
            "impulse": tally["impulse"] + force.sum(1) * after.control_step,
            "momentum": mass * after.centre_of_mass_velocity,
            "energy": tally["energy"] + transition.energy,
            "slip": tally["slip"] + jnp.where(carries, sliding, 0.0).sum(0) * after.control_step,
            "lift": jnp.maximum(tally["lift"], after.clearance[feet].max(0)),
        }

    def terms(self, tally, steps):
        displacement = tally["end"] - tally["start"]
        length = jnp.sqrt(displacement[0] ** 2 + displacement[1] ** 2)
        weight = sum(body.shape.volume * body.material.density for body in WALKER.bodies) * GRAVITY
        return {
            "cost_of_transport": tally["energy"] / (weight * jnp.maximum(length, 1e-3)),
            "slip": tally["slip"],
            "lift": tally["lift"],
            "impulse": tally["impulse"][2],
            "push": tally["impulse"][0],
            "momentum": tally["momentum"][2],
            "drift": tally["momentum"][0],
        }

    def fitness(self, terms, scales):
        return -terms["cost_of_transport"] - terms["slip"]


def walker() -> Creature:
    """Return a box on two feet, one behind the other, with a ball on each side for balance."""
    legs = []
    for name, x in zip(FEET, (0.15, -0.15), strict=True):
        ends = (x, 0.0, -0.05), (-0.03, 0.0, 0.12)
        joint = hinge("torso", *ends, "y", 0.8, actuator=Actuator(6.0, 8.0))
        legs.append(Body(name, Sphere(RADIUS), Material(900.0, 0.0, 0.6, 0.5), joint))
    for side, y in (("left", 0.25), ("right", -0.25)):
        ends = (0.0, y, -0.17), (0.0, 0.0, 0.0)
        joint = hinge("torso", *ends, "x", 0.1, stiffness=20.0, damping=2.0)
        legs.append(Body(side, Sphere(RADIUS), Material(300.0, 0.0, 0.2, 0.2), joint))
    torso = Body("torso", Box((0.4, 0.2, 0.1)), Material(400.0, 0.0))
    return Creature("walker", (torso, *legs))


WALKER = walker()


@pytest.fixture(scope="module")
def trial():
    tree, ground = build_tree(WALKER), Ground(restitution=0.0)

    def simulation(steps):
        return Simulation(
            world=World(tree, GRAVITY, contact_model=make_contact_model(WALKER, tree, ground)),
            sensors=place_sensors(WALKER, tree),
            controller=SineController(),
            task=TransportAndSlip(),
            control_rate=RATE,
            substeps=1,
            steps=steps,
            situations=(Situation((0.0, 0.0, 0.215)),),
        )

    short, long = simulation(STEPS), simulation(STEPS + 1)
    outcome, frames = quick_jit(
        lambda g: (rollout(short, g), rollout(long, g, observers=Recorder(len(g[0]))))
    )(GENES)
    assert outcome.alive.all()
    names = [body.name for body in WALKER.bodies]
    return outcome.terms, [as_recording(long, frames, names, i) for i in range(len(GENES[0]))]


@pytest.mark.slow
@pytest.mark.parametrize("individual", range(3))
def test_cost_of_transport_and_slip_follow_from_the_recording(trial, individual):
    terms, recordings = trial
    motion = recordings[individual]
    found = {name: float(values[individual]) for name, values in terms.items()}
    mass = np.array([body.shape.volume * body.material.density for body in WALKER.bodies])
    position = motion.position.astype(float)

    rate = np.diff(motion.joint_angle.astype(float), axis=0) * RATE
    middle = (rate + np.vstack([np.zeros_like(rate[:1]), rate[:-1]])) / 2
    energy = np.abs(motion.torque[:STEPS] * middle).sum() / RATE
    centre = (position * mass[:, None]).sum(1) / mass.sum()
    displacement = max(np.linalg.norm((centre[-1] - centre[0])[:2]), 1e-3)
    cost = energy / (mass.sum() * GRAVITY * displacement)
    assert found["cost_of_transport"] == pytest.approx(cost, rel=5e-3, abs=1e-3)

    # A foot under load penetrates the ground slightly. Under a tiny load it is within 0.01 mm of
    # the ground, and without load above it.
    least, most, lift = 0.0, 0.0, 0.0
    for name in FEET:
        i = [body.name for body in WALKER.bodies].index(name)
        velocity = np.diff(position[:, i], axis=0) * RATE
        turn = Rotation.from_matrix(motion.rotation[:, i])
        spin = (turn[1:] * turn[:-1].inv()).as_rotvec() * RATE
        sole = velocity + np.cross(spin, [0, 0, -RADIUS])
        height = position[1:, i, 2] - RADIUS
        least += np.hypot(*sole[height < -1e-6, :2].T).sum() / RATE
        most += np.hypot(*sole[height < 1e-5, :2].T).sum() / RATE
        lift = max(lift, height.max())
    assert 0.95 * least - 2e-3 < found["slip"] < 1.05 * most + 2e-3
    assert most < 1.1 * least + 2e-3
    assert found["lift"] == pytest.approx(lift, abs=1e-4)

    # The impulses of ground and gravity equal the final momentum (Newton). The last two poses give
    # the momentum half a step earlier, and a swinging leg changes it meanwhile.
    momentum = mass.sum() * (centre[-1] - centre[-2]) * RATE
    weight = mass.sum() * GRAVITY * STEPS / RATE
    for name, axis, gravity in (("momentum", 2, weight), ("drift", 0, 0.0)):
        assert found[name] == pytest.approx(momentum[axis], abs=0.2 * mass.sum())
        impulse = found["impulse" if axis == 2 else "push"]
        assert impulse - gravity == pytest.approx(momentum[axis], abs=0.2 * mass.sum())


@pytest.mark.slow
def test_rocking_costs_energy_and_slides_and_standing_does_not(trial):
    terms, _ = trial
    assert (terms["slip"][:2] > 0.08).all() and terms["slip"][2] < 0.02
    assert (terms["cost_of_transport"][:2] > 0.1).all()
