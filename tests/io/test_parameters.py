"""Numbers of a configuration as parameters: derivatives against rebuilding, and errors."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from creatures import quick_jit
from evo_cpg.io.build import build_simulation
from evo_cpg.io.errors import ConfigError
from evo_cpg.io.load import check_config, load_config
from evo_cpg.io.numbers import number_keys
from evo_cpg.io.parameters import all_parameters, parametrise
from evo_cpg.simulation.rollout import rollout
from tiny_run import CONFIG, REPOSITORY, TINY

SWIMMING = (
    "world.gravity",
    "world.water.form_drag",
    "world.water.skin_drag",
    "world.water.current.0",
    "creature.materials.body.density",
    "creature.bodies.0.shape.size.0",
    "creature.bodies.1.shape.size.2",
    "creature.bodies.1.joint.at.0",
    "creature.bodies.1.joint.stiffness",
    "creature.bodies.1.joint.damping",
    "creature.bodies.1.joint.rotation_deg.1",
    "creature.bodies.1.joint.actuator.gain",
    "creature.light_sensors.0.field_of_view_deg",
    "simulation.start_heading_deg",
    "task.light.bearing_deg",
    "controller.cpg.time_scale",
    "controller.cpg.pair_weight",
    "controller.cpg.max_adaptation_gain",
    "controller.brain.temperature",
    "controller.rate_gain",
    "controller.centring",
)
# At other values, many derivatives are zero by symmetry or at rest.
SWIMMER = (
    *TINY,
    "simulation.seconds=0.3",
    "simulation.substeps=1",
    "simulation.start_heading_deg=10",
    "world.water.density=1100",
    "world.water.current=[0.1, 0.02, 0.05]",
    "creature.bodies.1.joint.stiffness=0.3",
    "creature.bodies.1.joint.damping=0.1",
    "creature.bodies.1.joint.rotation_deg=[3, 5, 4]",
)


def leg(number, side):
    return {
        "name": f"leg{number}",
        "shape": {"type": "capsule", "radius": 0.03, "length": 0.15 + 0.05 * number},
        "material": "wood",
        "joint": {
            "parent": "trunk",
            "at": [0.2 * side, 0.01, -0.05],
            "child_at": [-0.1, 0.0, 0.0],
            "rotation_deg": [0.0, 60.0, 0.0],
            "axes": ["y"],
            "actuator": {"gain": 2.0, "stiffness": 30.0, "torque_limit": 20.0},
        },
    }


WALKER = {
    "name": "hopper",
    "creature": {
        "name": "hopper",
        "materials": {"wood": {"density": 500.0, "restitution": 0.3, "dynamic_friction": 0.3}},
        "bodies": [
            {
                "name": "trunk",
                "shape": {"type": "box", "size": [0.4, 0.2, 0.1]},
                "material": "wood",
            },
            leg(1, 1),
            leg(2, -1),
        ],
    },
    "world": {
        "water": None,
        "ground": {
            "static_friction": 0.5,
            "dynamic_friction": 0.4,
            "stribeck_speed": 0.1,
            "floor": {"slope_deg": 4.0},
        },
    },
    # Long enough for a foot to slip.
    "simulation": {"seconds": 0.75, "substeps": 2},
    "controller": {"type": "brain_cpg", "brain": {"hidden": [3]}},
    "task": {"type": "walk"},
}
WALKING = (
    "world.gravity",
    "world.ground.static_friction",
    "world.ground.dynamic_friction",
    "creature.materials.wood.density",
    "creature.bodies.0.shape.size.1",
    "creature.bodies.1.shape.radius",
    "creature.bodies.1.joint.actuator.stiffness",
    "creature.bodies.2.joint.actuator.gain",
    "controller.cpg.time_scale",
    "controller.rate_gain",
)
# Relative step. Rounding at a tenth of it affects terms that hardly depend on static friction.
DIFFERENCE = 1e-5


def swimmer(*overrides):
    return load_config(CONFIG, [*SWIMMER, *overrides])


def check_derivatives(config, keys):
    """Compare reverse mode with central differences of rebuilt simulations.

    One program has the elements that any parameter changes as its input. It runs with the elements
    of each rebuilt simulation, whose other elements are checked to be equal.
    """
    parameters = parametrise(config, CONFIG, keys)
    simulation, inputs = parameters.experiment.simulation, parameters.inputs
    genes = simulation.genome.random(jax.random.key(5), (), np.float64)

    def terms(simulation):
        return jnp.stack(list(rollout(simulation, genes).terms.values()))

    def rebuilt(values):
        parameters.require(values)
        plan = parameters.building.plan
        return inputs.of(build_simulation(parameters.config_at(values), plan)[1])

    with_elements = quick_jit(lambda elements: terms(inputs.put(simulation, elements)))
    values = parameters.values
    steps = DIFFERENCE * np.where(values, np.abs(values), 1.0)
    differences = np.array(
        [
            (with_elements(rebuilt(values + step)) - with_elements(rebuilt(values - step)))
            / (2 * step.sum())
            for step in np.diag(steps)
        ]
    ).T
    derivatives = quick_jit(jax.jacrev(lambda values: terms(parameters.simulation(values))))
    found = np.asarray(derivatives(jnp.asarray(values)))
    effect = np.abs(differences * steps / DIFFERENCE).max(0)
    assert (effect > 1e-7).all(), "every parameter must have an effect"
    largest = np.abs(differences).max(0)
    np.testing.assert_allclose(found / largest, differences / largest, rtol=1e-6, atol=1e-6)


@pytest.mark.slow
@pytest.mark.usefixtures("x64")
def test_derivatives_of_a_swimmer_equal_finite_differences():
    check_derivatives(swimmer(), SWIMMING)


@pytest.mark.slow
@pytest.mark.usefixtures("x64")
def test_derivatives_of_a_walker_equal_finite_differences():
    check_derivatives(check_config(WALKER, CONFIG), WALKING)


@pytest.mark.parametrize(
    ("key", "words"),
    [
        ("world.water.form_darg", "does not exist: did you mean world.water.form_drag"),
        ("form_drag", "does not exist: did you mean world.water.form_drag?"),
        ("creature.bodies.7.shape.size.0", r"bodies.7.*does not exist"),
        ("creature.bodies.1.shape", "a section or a list.*creature.bodies.1.shape.size.0"),
        ("simulation.seconds", "changes nothing in a trial"),
        ("world.water.law", "is 'normal', not a number"),
        ("simulation.control_rate_hz", "changes more than numbers"),
        ("controller.cpg.cross_weight", "changes more than numbers"),
        ("world.water.surface", "is None, not a number"),
        ("controller.brain.init_range", "changes nothing in a trial"),
        ("creature.materials.body.static_friction", "changes nothing in a trial"),
        ("controller.cpg.constant_input", "0 is at a kink of `controller.max_amplitude`"),
    ],
)
def test_invalid_parameter_is_rejected_with_its_key(key, words):
    with pytest.raises(ConfigError, match=words) as refusal:
        parametrise(swimmer(), CONFIG, [key])
    assert key in str(refusal.value)


@pytest.mark.slow
def test_lengths_of_a_chain_in_viscous_water_have_values_but_no_derivative():
    """The derivative of the root of a distance from the nose is infinite at the nose."""
    path = REPOSITORY / "configs" / "worm.yaml"
    worm, key = load_config(path), "creature.bodies.1.shape.length"
    with pytest.raises(ConfigError, match=r"bodies\.1\.shape\.length: changes the distances along"):
        parametrise(worm, path, [key])
    parameters = parametrise(worm, path, [key], smooth=False)

    def area(values):
        return sum(
            patch.wetted.form.sum()
            for patch in parameters.simulation(values).world.forces[0].patches
        )

    longer = 1.1 * parameters.values
    assert quick_jit(area)(jnp.asarray(longer)) > quick_jit(area)(jnp.asarray(parameters.values))
    with pytest.raises(ConfigError, match="no derivative in this version"):
        jax.eval_shape(jax.jacfwd(area), longer)
    # Other numbers of the same animal have derivatives.
    parametrise(worm, path, ["creature.materials.flesh.density", "world.water.viscosity"])


def test_invalid_values_are_rejected():
    parameters = parametrise(swimmer(), CONFIG, ["world.water.form_drag"])
    with pytest.raises(ConfigError, match=r"form_drag.*greater than or equal to 0"):
        parameters.require(np.array([-1.0]))
    walls = parametrise(swimmer(), CONFIG, ["controller.cpg.time_scale"])
    with pytest.raises(ConfigError, match=r"another layout at controller\.cpg\.time_scale=0\.1"):
        walls.require(np.array([0.1]))


def test_number_at_its_limit_has_a_one_sided_derivative():
    # Mass is volume times density, so its derivative is the volume. Damping is its own number.
    parameters = parametrise(
        swimmer("creature.bodies.1.joint.damping=0"),
        CONFIG,
        ["creature.bodies.1.joint.damping", "creature.materials.body.density"],
    )
    tree = parameters.experiment.simulation.world.tree

    def leaves(values):
        tree = parameters.simulation(values).world.tree
        return jnp.asarray(tree.damping), jnp.asarray(tree.mass)

    damping, mass = quick_jit(jax.jacfwd(leaves))(jnp.asarray(parameters.values))
    np.testing.assert_allclose(damping[:, 0], 1.0, rtol=1e-6)
    np.testing.assert_allclose(mass[:, 1], tree.volume, rtol=1e-6)


@pytest.mark.slow
def test_listed_parameters_are_accepted():
    config = check_config(WALKER, CONFIG)
    found = all_parameters(config, CONFIG)
    assert set(WALKING) <= set(found) <= set(number_keys(config))
    # Only the longer legs touch the ground at the start.
    assert "simulation.control_rate_hz" not in found
    parametrise(config, CONFIG, found)
