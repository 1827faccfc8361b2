"""Simulations built from traced numbers against simulations built from known numbers."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import yaml

from creatures import quick_jit
from evo_cpg.creature.algebra.numerics import MixedArray
from evo_cpg.io.errors import KeyProblem
from evo_cpg.io.load import check_config, load_config
from evo_cpg.io.parameters import all_parameters, parametrise
from tiny_run import CONFIG, REPOSITORY, TINY

# Relative step of the finite differences. Their error, of fourth order, is below rounding.
STEP = 1e-4
CENTRAL = {-1.0: 1 / 6, -0.5: -8 / 6, 0.5: 8 / 6, 1.0: -1 / 6}
# One-sided differences for values at the end of their range, such as a stiffness of 0.
FORWARD = {0.0: -25 / 3, 0.25: 16.0, 0.5: -12.0, 0.75: 16 / 3, 1.0: -1.0}
BACKWARD = {-fraction: -weight for fraction, weight in FORWARD.items()}


def check_elements(config, keys, accuracy=1e-14):
    """Compare traced elements of a simulation, and their derivatives, with rebuilt ones.

    Args:
        config: the configuration.
        keys: keys of the traced numbers.
        accuracy: accuracy of the elements, lower if a search computes them.
    """
    parameters = parametrise(config, CONFIG, keys)
    inputs, values = parameters.inputs, parameters.values

    def traced(values):
        built = parameters.simulation(values)
        leaves = jax.tree.leaves(built, is_leaf=lambda leaf: isinstance(leaf, MixedArray))
        places = zip(inputs.places, inputs.elements, strict=True)
        return [jnp.asarray(leaves[place]).reshape(-1)[own] for place, own in places]

    def known(values):
        building = parameters.building
        built = building.known(parameters.config_at(values))
        assert built.has_layout_of(building.own)
        changed = zip(inputs.places, inputs.elements, strict=True)
        return [np.ravel(built.leaves[place])[own] for place, own in changed]

    def around(values, step):
        """Build on both sides of the values, or on one side if the other is not allowed."""
        for stencil in (CENTRAL, FORWARD, BACKWARD):
            try:
                return stencil, {part: known(values + part * step) for part in stencil}
            except KeyProblem:
                continue
        raise AssertionError("no side is allowed")

    # One direction at a time: a whole Jacobian of a long animal takes gigabytes.
    along = quick_jit(lambda values, direction: jax.jvp(traced, (values,), (direction,)))
    here = jnp.asarray(values)
    elements, _ = along(here, jnp.zeros_like(here))
    same = inputs.of(parameters.experiment.simulation)
    for found, own in zip(elements, same, strict=True):
        np.testing.assert_allclose(found, own, rtol=1e-12, atol=accuracy)
    for i, value in enumerate(values):
        step = STEP * (abs(value) or 1.0) * (np.arange(len(values)) == i)
        stencil, others = around(values, step)
        _, derivatives = along(here, jnp.asarray(step / step[i]))
        for place, derivative in enumerate(derivatives):
            each = np.array([weight * others[part][place] for part, weight in stencil.items()])
            difference = each.sum(0) / step[i]
            rounding = accuracy * max(1.0, np.abs(each).max()) / step[i]
            slack = 1e-6 * np.abs(difference).max() + rounding
            np.testing.assert_allclose(
                derivative, difference, rtol=1e-6, atol=slack, err_msg=parameters.keys[i]
            )
    return parameters


JOINT = "creature.bodies.1.joint"
MOTOR = f"{JOINT}.actuator"
TENDONS = (
    "creature.tendons=[{name: a, joints: {segment1.x: 1, segment2.z: -0.5}, stiffness: 1, "
    "rest: [-0.1, 0.2], friction_loss: 0.1, limits: [-1, 0.5], armature: 0.01, "
    "actuator: {gain: 3, stiffness: 2, torque_limit: 4}}, "
    "{name: b, joints: {segment2.y: 2}, actuator: {type: torque, gear: 2}}]"
)
# Settings of a swimmer, and the traced numbers: names below the first key, and whole keys.
SWIMMERS = {
    "swimmer": (
        ["world.water.added_mass=true", f"{JOINT}.rotation_deg=[3, 5, 4]"],
        (JOINT, "at.0 rotation_deg.2 actuator.gain"),
        "world.water.density creature.materials.body.density creature.bodies.0.shape.size.0 "
        "creature.bodies.1.shape.size.0 creature.light_sensors.0.field_of_view_deg "
        "simulation.start_heading_deg task.light.bearing_deg controller.cpg.child_weight "
        "controller.steering_range",
    ),
    "torque motors": (
        [f"{MOTOR}={{type: torque, gear: 2, torque_limit: 3}}"],
        (MOTOR, "gear torque_limit"),
        "",
    ),
    "tendons": (
        [f"{MOTOR}=null", TENDONS],
        (
            "creature.tendons.0",
            "joints.segment2.z stiffness rest.1 friction_loss limits.0 armature actuator.gain "
            "actuator.torque_limit",
        ),
        "creature.tendons.1.actuator.gear creature.bodies.0.shape.size.0",
    ),
    "single axes": (
        [
            *(f"{JOINT}.axes=[y, z]", f"{JOINT}.limits_deg=[null, [-50, 40]]"),
            *(f"{JOINT}.stiffness=[1, 2]", f"{JOINT}.rest_deg=[20, -10]"),
            *(f"{JOINT}.armature=[0, 0.01]", f"{MOTOR}=[{{type: torque, gear: 2}}, {{gain: 3}}]"),
        ],
        (JOINT, "limits_deg.1.0 stiffness.1 rest_deg.0 armature.1 actuator.1.gain actuator.0.gear"),
        "",
    ),
    "muscles": (
        [f"{MOTOR}={{type: muscle, area: 2e-4, arm: 0.02, fibre_length: 0.05}}"],
        (MOTOR, "area arm fibre_length stress bend_deg tone curvature max_speed damping_time"),
        "",
    ),
    "reactive thrust": (
        ["world.water.reactive_thrust=true"],
        (JOINT, "at.0"),
        "world.water.density creature.bodies.0.shape.size.0",
    ),
}


@pytest.mark.usefixtures("x64")
@pytest.mark.slow
@pytest.mark.parametrize("name", SWIMMERS)
def test_elements_of_a_swimmer(name):
    settings, (first, names), others = SWIMMERS[name]
    config = load_config(CONFIG, [*TINY, "simulation.substeps=1", *settings])
    check_elements(config, [*(f"{first}.{each}" for each in names.split()), *others.split()])


SHAPES = """
name: shapes
materials: {wood: {density: 600, static_friction: 0.7}}
bodies:
  - {name: trunk, material: wood, shape: {type: ellipsoid, radii: [0.3, 0.2, 0.1]}}
  - name: leg
    material: wood
    shape: {type: capsule, radius: 0.04, length: 0.3}
    joint:
      {parent: trunk, at: [0.2, 0, -0.1], child_at: [-0.2, 0, 0], axes: [y], stiffness: 5,
       rotation_deg: [0, 80, 10], actuator: {gain: 2, stiffness: 30}}
  - name: foot
    material: wood
    shape: {type: box, size: [0.1, 0.08, 0.05]}
    joint: {parent: leg, at: [0.2, 0, 0], child_at: [-0.05, 0, 0], axes: [[0, 1, 0.2]]}
  - name: tail
    material: wood
    shape: {type: sphere, radius: 0.1}
    joint: {parent: trunk, at: [-0.3, 0, 0], child_at: [0.1, 0, 0], axes: [z, y], stiffness: 2}
"""


def shapes(start=None, **world):
    """Return an animal with a body of every shape."""
    return check_config(
        {
            "name": "shapes",
            "creature": yaml.safe_load(SHAPES),
            "world": world,
            "simulation": {"seconds": 5 / 60, **(start or {})},
            "task": {"type": "walk"},
        },
        CONFIG,
    )


@pytest.mark.slow
@pytest.mark.usefixtures("x64")
def test_elements_of_every_shape_on_a_slope():
    ground = {"floor": {"slope_deg": 8, "downhill_deg": 30}, "friction_rule": "average"}
    keys = [
        "world.ground.floor.slope_deg",
        "world.ground.static_friction",
        "creature.materials.wood.density",
        "creature.materials.wood.static_friction",
        "creature.bodies.0.shape.radii.1",
        "creature.bodies.1.shape.radius",
        "creature.bodies.1.shape.length",
        "creature.bodies.1.joint.rotation_deg.1",
        "creature.bodies.1.joint.actuator.stiffness",
        "creature.bodies.2.shape.size.2",
        "creature.bodies.3.shape.radius",
        "simulation.start.0",
    ]
    check_elements(shapes(water=None, ground=ground), keys)


@pytest.mark.slow
@pytest.mark.usefixtures("x64")
def test_elements_of_bodies_at_a_water_surface():
    water = {"surface": 0.0, "added_mass": True}
    keys = ["creature.bodies.1.shape.radius", "creature.bodies.2.shape.size.0"]
    assert check_elements(shapes(water=water), keys).building.plan.layout == "merged"


@pytest.mark.slow
@pytest.mark.usefixtures("x64")
def test_bodies_that_become_different_get_separate_surfaces():
    """Two balls have one common surface only while their radii are equal."""
    creature = yaml.safe_load(SHAPES)
    creature["bodies"] = [creature["bodies"][0], *(dict(creature["bodies"][3]) for _ in range(2))]
    for body, side in zip(creature["bodies"][1:], (1, -1), strict=True):
        body["name"] = f"ball{side}"
        body["joint"] = body["joint"] | {"at": [0.0, 0.4 * side, 0.0]}
    config = shapes(water={"sheltered": False}).model_dump(mode="json") | {"creature": creature}
    parameters = check_elements(check_config(config, CONFIG), ["creature.bodies.1.shape.radius"])
    assert parameters.building.plan.layout == "separate"


@pytest.mark.slow
@pytest.mark.usefixtures("x64")
def test_start_height_on_hills_is_differentiable():
    """The height comes from a search, and is differentiated as an implicit function."""
    hills = {"floor": {"type": "hills", "seed": 3, "height": 0.2, "length": 1.5}}
    keys = ["simulation.start.1", "simulation.start_heading_deg", "creature.bodies.1.shape.length"]
    config = shapes({"start": [1.3, -0.7]}, water=None, ground=hills)
    check_elements(config, keys, accuracy=1e-9)


@pytest.mark.slow
@pytest.mark.usefixtures("x64")
def test_rest_on_the_water_is_differentiable():
    keys = ["creature.materials.wood.density", "creature.bodies.1.joint.stiffness", "world.gravity"]
    check_elements(shapes({"start_pose": "settled"}, water={"surface": 0.3}), keys, accuracy=1e-9)


# Endings of the names of configurations whose body another configuration has in a like world.
VARIANTS = (
    *("_robust", "_open_es", "_gaits", "_model2", "_tripod"),
    *("_salamander_land", "salamander_boulders", "salamander_swim", "salamander_trot"),
)
# Finding the numbers of their surfaces takes minutes.
MANY_SURFACES = "eel", "fish", "iwadate2010_salamander_water", "salamander_amphibious"


@pytest.mark.slow  # a minute or two each
@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize(
    "name",
    sorted(
        path.stem
        for path in (REPOSITORY / "configs").glob("*.yaml")
        if not path.stem.endswith(VARIANTS)
    ),
)
def test_elements_of_the_shipped_experiments(name):
    path = REPOSITORY / "configs" / f"{name}.yaml"
    config = load_config(path)
    keys = all_parameters(config, path, surfaces=name not in MANY_SURFACES)
    some = np.random.default_rng(0).permutation(len(keys))[:25]
    check_elements(config, [keys[i] for i in sorted(some)], accuracy=1e-9)
