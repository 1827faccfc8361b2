"""Numbers of a configuration as parameters: derivatives against rebuilt simulations, refusals."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from creatures import quick_jit
from evo_cpg.config.build import build_simulation
from evo_cpg.config.errors import ConfigError
from evo_cpg.config.load import check_config, load_config
from evo_cpg.config.numbers import number_keys
from evo_cpg.config.parameters import all_parameters, parametrise
from evo_cpg.simulation.rollout import rollout
from tiny_run import CONFIG, TINY

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
# Off the values at which much is zero by symmetry, or at rest.
SWIMMER = (
    *TINY,
    "simulation.steps=18",
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
    "simulation": {"steps": 45, "substeps": 2},
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
# Relative; with a tenth of it rounding shows in what hardly depends on static friction.
DIFFERENCE = 1e-5


def swimmer(*overrides):
    return load_config(CONFIG, [*SWIMMER, *overrides])


def check_derivatives(config, keys):
    """Reverse mode against central differences of simulations that are built anew.

    One program takes the elements that any of the parameters changes, and is given those of each
    rebuilt simulation; that all others are equal is checked when it is rebuilt.
    """
    parameters = parametrise(config, CONFIG, keys)
    simulation, inputs = parameters.experiment.simulation, parameters.inputs
    genes = simulation.genome.random(jax.random.key(5), (), np.float64)

    def terms(simulation):
        return jnp.stack(list(rollout(simulation, genes).terms.values()))

    def rebuilt(values):
        parameters.require(values)
        layout = parameters.building.layout
        return inputs.of(build_simulation(parameters.config_at(values), layout)[1])

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
    assert (effect > 1e-7).all(), "every parameter has to matter"
    largest = np.abs(differences).max(0)
    np.testing.assert_allclose(found / largest, differences / largest, rtol=1e-6, atol=1e-6)


@pytest.mark.slow
@pytest.mark.usefixtures("x64")
def test_derivatives_by_a_swimmers_numbers_equal_those_of_rebuilt_simulations():
    check_derivatives(swimmer(), SWIMMING)


@pytest.mark.slow
@pytest.mark.usefixtures("x64")
def test_derivatives_by_a_walkers_numbers_equal_those_of_rebuilt_simulations():
    check_derivatives(check_config(WALKER, CONFIG), WALKING)


@pytest.mark.parametrize(
    ("key", "words"),
    [
        ("world.water.form_darg", "does not exist; did you mean world.water.form_drag"),
        ("form_drag", "does not exist; did you mean world.water.form_drag?"),
        ("creature.bodies.7.shape.size.0", r"bodies.7.*does not exist"),
        ("creature.bodies.1.shape", "a part of the configuration.*creature.bodies.1.shape.size.0"),
        ("simulation.steps", r"is a whole number \(18\)"),
        ("world.water.law", "is 'normal', not a number"),
        ("simulation.control_rate_hz", "changes more than numbers"),
        ("controller.cpg.cross_weight", "changes more than numbers"),
        ("world.water.surface", "is None, not a number"),
        ("controller.brain.init_range", "changes nothing in a trial"),
        ("creature.materials.body.static_friction", "changes nothing in a trial"),
        ("controller.cpg.sensory_feedback", "0 is at a kink of `controller.max_amplitude`"),
    ],
)
def test_what_is_no_parameter_is_refused_by_its_key(key, words):
    with pytest.raises(ConfigError, match=words) as refusal:
        parametrise(swimmer(), CONFIG, [key])
    assert key in str(refusal.value)


def test_a_parameter_is_given_once():
    with pytest.raises(ConfigError, match="gravity: is given twice"):
        parametrise(swimmer(), CONFIG, ["world.gravity", "world.gravity"])


def test_values_that_are_not_allowed_are_refused():
    parameters = parametrise(swimmer(), CONFIG, ["world.water.form_drag"])
    with pytest.raises(ConfigError, match=r"form_drag.*greater than or equal to 0"):
        parameters.require(np.array([-1.0]))
    walls = parametrise(swimmer(), CONFIG, ["controller.cpg.time_scale"])
    with pytest.raises(
        ConfigError, match=r"time_scale=0\.1 the simulation is laid out differently"
    ):
        walls.require(np.array([0.1]))


def test_a_number_at_the_end_of_what_is_allowed_has_the_derivative_to_its_other_side():
    # A volume of 2 l of flesh: mass is volume times density, and damping is what it says.
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
def test_the_listed_numbers_are_those_that_work():
    config = check_config(WALKER, CONFIG)
    found = all_parameters(config, CONFIG)
    assert set(WALKING) <= set(found) <= set(number_keys(config))
    # Only the longer legs touch the ground at the start: which ones do is a kink.
    assert "simulation.control_rate_hz" not in found
    parametrise(config, CONFIG, found)
