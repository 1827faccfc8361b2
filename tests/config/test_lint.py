"""What is allowed but hardly meant: every mistake is doubted, and nothing that is shipped."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from evo_cpg.config.build import build_creature
from evo_cpg.config.lint import lint, single_fields
from evo_cpg.config.lint.rule import RULES, Case
from evo_cpg.config.load import load_config
from tiny_run import CONFIG, REPOSITORY

CONFIGS = REPOSITORY / "configs"
WALKER = CONFIGS / "iwadate2010_salamander_land.yaml"
LEGS = CONFIGS / "fukui2003_model1.yaml"
SHORE = CONFIGS / "salamander_amphibious.yaml"
INSECT = CONFIGS / "hexapod.yaml"

GAUGE = "creature.depth_sensors=[{body: head}]"
LEVEL = "world.ground.floor={type: plane, height: -1}"

# Two rows of a grid of 0.1 m.
RIDGE = [[0.25 if 20 <= i < 22 else 0.0] * 40 for i in range(40)]

# The file, settings that make the mistake, the key that is doubted, and what is said about it.
MISTAKES = {
    "density in g/cm^3": (
        CONFIG,
        ["creature.materials.body.density=1"],
        "creature.materials.body.density",
        "in g/cm^3 it would be 1000 kg/m^3",
    ),
    "density times 1000": (
        CONFIG,
        ["creature.materials.body.density=1e6"],
        "creature.materials.body.density",
        "in g/m^3 it would be 1000 kg/m^3",
    ),
    "water in g/cm^3": (
        CONFIG,
        ["world.water.density=1.025"],
        "world.water.density",
        "in g/cm^3 it would be 1025 kg/m^3",
    ),
    "viscosity in mPa s": (
        CONFIG,
        ["world.water.viscosity=1"],
        "world.water.viscosity",
        "in mPa s it would be 0.001 Pa s",
    ),
    "water like air": (CONFIG, ["world.water.density=80"], "world.water.density", "water has 1000"),
    "box in mm": (
        CONFIG,
        ["creature.bodies.0.shape.size=[200, 100, 100]"],
        "creature.bodies.0.shape.size",
        "in mm it would be 0.2 m",
    ),
    "box in km": (
        CONFIG,
        ["creature.bodies.0.shape.size=[0.0002, 0.0001, 0.0001]"],
        "creature.bodies.0.shape.size",
        "a body of 0.0002 m; plausible are 0.001 to 30 m",
    ),
    "speck that carries a trunk": (
        CONFIG,
        ["creature.bodies.0.shape.size=[0.002, 0.001, 0.001]"],
        "creature.bodies.1.joint.parent",
        "float32 resolves up to 5000 times its mass; make the heavier body the parent",
    ),
    "speck on a whale": (
        CONFIG,
        ["creature.bodies.1.shape.size=[1e-5, 1e-5, 1e-5]", "creature.bodies.1.repeat=1"],
        "creature.bodies.1.material",
        "float32 resolves down to 1e-12 of its mass",
    ),
    "thin claw in long steps": (
        LEGS,
        ["creature.bodies.0.shape.size=[0.4, 0.4, 0.0002]"],
        "simulation.substeps",
        "it would sink into the ground or bob for ever; plausible are",
    ),
    "hills within a body": (
        LEGS,
        ["world.ground.floor={type: hills, length: 0.4}"],
        "world.ground.floor.length",
        "is 0.6 m long and feels the floor by its corners alone",
    ),
    "a ridge within a body": (
        LEGS,
        [f"world.ground.floor={{type: relief, heights: {RIDGE}}}"],
        "world.ground.floor.spacing",
        "a bump of 0.25 m has room between them",
    ),
    "frictions swapped": (
        WALKER,
        ["world.ground.dynamic_friction=0.9", "world.ground.static_friction=0.5"],
        "world.ground.dynamic_friction",
        "were the two swapped?",
    ),
    "limits beyond the neutral pose": (
        CONFIG,
        ["creature.bodies.1.joint.axes=[z]", "creature.bodies.1.joint.limits_deg=[20, 60]"],
        "creature.bodies.1.joint.limits_deg",
        "the neutral pose, 0 degrees, is beyond the limits",
    ),
    "one radius in cm": (
        CONFIG,
        ["creature.bodies.0.shape={type: sphere, radius: 10}"],
        "creature.bodies.0.shape.radius",
        "a body of 20 m among others of 0.2 m",
    ),
    "boulder in mm": (
        WALKER,
        ["world.ground.obstacles=[{type: boulder, centre: [900, 0, 0], radius: 400}]"],
        "world.ground.obstacles.0.radius",
        "400 m beside a creature of",
    ),
    "block in mm": (
        WALKER,
        ["world.ground.obstacles=[{type: block, centre: [900, 0, 0], size: [500, 400, 300]}]"],
        "world.ground.obstacles.0.size",
        "300 m beside a creature of",
    ),
    "gravity in cm/s^2": (
        CONFIG,
        ["world.gravity=981"],
        "world.gravity",
        "in cm/s^2 it would be 9.81 m/s^2",
    ),
    "limits in rad": (
        CONFIG,
        ["creature.bodies.1.joint.limits_deg=[-1.05, 1.05]"],
        "creature.bodies.1.joint.limits_deg",
        "as radians it would be 60.2 degrees",
    ),
    "limits converted twice": (
        WALKER,
        ["creature.bodies.1.joint.limits_deg=[-2292, 2292]"],
        "creature.bodies.1.joint.limits_deg",
        "converted twice? then it was 40",
    ),
    "attitude in rad": (
        INSECT,
        ["creature.bodies.2.joint.rotation_deg=[0, 1.05, 1.5708]"],
        "creature.bodies.2.joint.rotation_deg",
        "as radians it would be 60, 90 degrees",
    ),
    "heading in rad": (
        CONFIG,
        ["simulation.start_heading_deg=3.14"],
        "simulation.start_heading_deg",
        "as radians it would be 180 degrees",
    ),
    "bearing in rad": (
        CONFIG,
        ["task.light.bearing_deg=0.524"],
        "task.light.bearing_deg",
        "as radians it would be 30 degrees",
    ),
    "bearing of a trial in rad": (
        CONFIG,
        ["simulation.trials=[{light: {bearing_deg: -0.7854}}, {start_heading_deg: 1.571}]"],
        "simulation.trials.0.light.bearing_deg",
        "as radians it would be -45 degrees",
    ),
    "bearing converted twice": (
        CONFIG,
        ["task.light.bearing_deg=1719"],
        "task.light.bearing_deg",
        "plausible are -360 to 360 degrees; converted twice?",
    ),
    "slope in rad": (
        WALKER,
        ["world.ground.floor={type: plane, slope_deg: 0.2618}"],
        "world.ground.floor.slope_deg",
        "as radians it would be 15 degrees",
    ),
    "block turned in rad": (
        WALKER,
        [
            "world.ground.obstacles="
            "[{type: block, centre: [3, 0, 0], size: [1, 1, 1], heading_deg: 0.7854}]"
        ],
        "world.ground.obstacles.0.heading_deg",
        "as radians it would be 45 degrees",
    ),
    "field of view in rad": (
        CONFIG,
        ["creature.light_sensors.0.field_of_view_deg=3.1416"],
        "creature.light_sensors.0.field_of_view_deg",
        "in radians it would be 180 degrees",
    ),
    "step of postures in rad": (
        LEGS,
        ["controller.angle_step=0.349"],
        "controller.angle_step",
        "as radians a step would be 20 degrees",
    ),
    "angle of postures in rad": (
        LEGS,
        ["controller.lowest_angle=1.92", "controller.neutral_angle=3.14"],
        "controller.lowest_angle",
        "as radians it would be 110 degrees",
    ),
    "rate in deg/s": (
        CONFIG,
        ["controller.max_rate=286"],
        "controller.max_rate",
        "in degrees per second it would be 4.992 rad/s",
    ),
    "joint beyond its parent": (
        CONFIG,
        ["creature.bodies.1.joint.at=[-0.2, 0, 0]"],
        "creature.bodies.1.joint.at",
        "lies 0.1 m outside of body 'head', on which 'segment1' hangs",
    ),
    "joint beyond its body": (
        CONFIG,
        ["creature.bodies.1.joint.child_at=[0.11, 0.2, 0]"],
        "creature.bodies.1.joint.child_at",
        "outside of body 'segment1' itself, which reaches to 0.1, 0.05, 0.05 m",
    ),
    "joint in mm": (
        CONFIG,
        ["creature.bodies.1.joint.at=[-110, 0, 0]"],
        "creature.bodies.1.joint.at",
        "places are in m: is this in mm?",
    ),
    "eye off its body": (
        CONFIG,
        ["creature.light_sensors.0.position=[1, 0, 0]"],
        "creature.light_sensors.0.position",
        "lies 0.9 m outside of body 'head'",
    ),
    "gauge off its body": (
        SHORE,
        ["creature.depth_sensors=[{body: head, position: [0, 0, -50]}]"],
        "creature.depth_sensors.0.position",
        "outside of body 'head'",
    ),
    "eyes without light": (
        WALKER,
        ["task={type: walk}"],
        "creature.light_sensors.0.body",
        "a task of type 'walk' has no light",
    ),
    "eye that looks up": (
        WALKER,
        [
            "creature.light_sensors.1.axis=[0, 0, 1]",
            "creature.light_sensors.1.field_of_view_deg=60",
        ],
        "creature.light_sensors.1.axis",
        "the eye looks 90 degrees above the horizon and sees 30 to each side",
    ),
    "touch without ground": (
        CONFIG,
        ["creature.pressure_sensors=[segment3]"],
        "creature.pressure_sensors.0",
        "there is no ground to press against it",
    ),
    "touch inside of another body": (
        WALKER,
        [
            "creature.bodies.1.shape={type: sphere, radius: 0.02}",
            "creature.bodies.1.joint.at=[0, 0, 0]",
            "creature.bodies.1.joint.child_at=[0, 0, 0]",
            "creature.pressure_sensors=[chest]",
        ],
        "creature.pressure_sensors.0",
        "the body lies inside of 'head'",
    ),
    "gauge without water": (
        WALKER,
        [GAUGE],
        "creature.depth_sensors.0.body",
        "there is no water, so this gauge always reads 0; set world.water,",
    ),
    "gauge without surface": (
        CONFIG,
        [GAUGE],
        "creature.depth_sensors.0.body",
        "the water has no surface, so this gauge always reads 0; set world.water.surface: 0",
    ),
    "gauge in mm": (
        SHORE,
        ["creature.depth_sensors=[{body: head, full_scale: 1000}]", LEVEL],
        "creature.depth_sensors.0.full_scale",
        "the water is 1 m deep, so this gauge never reads more than 0.001",
    ),
    "lift of a chain": (
        CONFIG,
        ["world.water.viscosity=0.001", "world.water.lift=true"],
        "world.water.lift",
        "no body has lift; it needs a body that is thinner than",
    ),
    "water under the ground": (
        SHORE,
        ["world.water.surface=-5"],
        "world.water.surface",
        "the ground is nowhere lower than -0.9",
    ),
    "eyes of postures": (
        LEGS,
        ["creature.light_sensors=[{body: torso}]"],
        "creature.light_sensors",
        "a controller of type 'postures' senses nothing",
    ),
    "lexicase in one trial": (
        CONFIG,
        ["evolution.selection=lexicase"],
        "evolution.selection",
        "individuals have but one trial",
    ),
    "lexicase in one trial over and over": (
        CONFIG,
        ["evolution.selection=lexicase", "simulation.trials=3"],
        "evolution.selection",
        "individuals have but one trial",
    ),
    "free fall": (
        CONFIG,
        ["world.water=null"],
        "world.gravity",
        "the animal falls from start to end",
    ),
    "ground under water by default": (
        CONFIG,
        ["world={ground: {}}"],
        "world.water",
        "left out: unless it is written, there is water everywhere, so the ground lies under water",
    ),
    "shore without water": (
        CONFIG,
        ["world={ground: {floor: {type: shore, stop: 3, stop_height: -1}}}"],
        "world.water",
        "water: null for dry land",
    ),
    "ground without weight": (
        WALKER,
        ["world.gravity=0"],
        "world.gravity",
        "without gravity nothing holds the animal on the ground",
    ),
    "start in mm": (
        WALKER,
        ["simulation.start_clearance=50"],
        "simulation.start_clearance",
        "falls from that height; plausible is up to",
    ),
    "start above no ground": (
        CONFIG,
        ["simulation.start_clearance=0.1"],
        "simulation.start_clearance",
        "there is no ground, so this changes nothing",
    ),
    "start above the water": (
        CONFIG,
        ["world.water.surface=-500"],
        "world.water.surface",
        "m above the water, at height 0, and falls in",
    ),
    "walking in water": (
        CONFIG,
        ["task={type: walk}", "creature.light_sensors=[]"],
        "task.type",
        "there is no ground to walk on",
    ),
    "light without eyes": (
        CONFIG,
        ["creature.light_sensors=[]"],
        "creature.light_sensors",
        "the animal has no eye; add one, such as light_sensors: [{body: head}]",
    ),
    "light without eyes, by default": (
        CONFIG,
        ["creature.light_sensors=[]", "task={}"],
        "creature.light_sensors",
        "the task rewards coming near to a light (reach_light, the default)",
    ),
    "light with postures": (
        LEGS,
        ["task={type: reach_light}"],
        "task.type",
        "the animal cannot steer towards the light",
    ),
    "velocity sensor of postures": (
        LEGS,
        ["creature.sensors=[{type: velocity, body: torso}]"],
        "creature.sensors",
        "a controller of type 'postures' senses nothing",
    ),
    "no motor": (
        CONFIG,
        ["creature.bodies.1.joint.actuator=null"],
        "creature.bodies.1.joint.actuator",
        "null: no joint has a motor, so the controller moves nothing",
    ),
    "motors without torque": (
        CONFIG,
        ["creature.bodies.1.joint.actuator={gain: 1, torque_limit: 1e-9}"],
        "creature.bodies.1.joint.actuator.torque_limit",
        "1e-09: the motors are too weak to move anything: the strongest turns its own body by",
    ),
    "motors that stand still": (
        CONFIG,
        ["controller.rate_gain=0"],
        "controller.rate_gain",
        "the animal stays in its neutral pose",
    ),
    "trials without noise": (
        CONFIG,
        ["simulation.trials=5"],
        "simulation.trials",
        "without noise all 5 trials are alike, so one is run",
    ),
    "situations that do not differ": (
        CONFIG,
        ["simulation.trials=[{}, {}]"],
        "simulation.trials",
        "without noise all 2 trials are alike, so one would do",
    ),
    "a row that hangs far off": (
        CONFIG,
        [
            "creature.bodies.0.shape={type: box, size: [0.6, 0.1, 0.1]}",
            "creature.bodies.1.joint.at=[-0.31, 0, 0]",
        ],
        "creature.bodies.1.joint.at",
        "repeat takes this place for every body of the row: on 'head', on which the first one "
        "hangs, it fits, but it lies 0.21 m outside of 'segment1'",
    ),
    "a row that hangs inside": (
        CONFIG,
        [
            "creature.bodies.0.shape={type: box, size: [0.05, 0.1, 0.1]}",
            "creature.bodies.1.joint.at=[-0.03, 0, 0]",
        ],
        "creature.bodies.1.joint.at",
        "it lies 0.05 m inside 'segment1', on which the next one hangs",
    ),
    "a row that curls up": (
        CONFIG,
        ["creature.bodies.1.joint.rotation_deg=[0, 90, 0]"],
        "creature.bodies.1.joint.rotation_deg",
        "repeat turns every body of the row by 90 degrees against the one before it",
    ),
}


def found(path: Path, settings: list[str]) -> dict[str, str]:
    """What is doubted, by key."""
    listed = lint(load_config(path, settings), path)
    return {".".join(map(str, doubt.key)): str(doubt) for doubt in listed}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_doubted(mistake):
    """With the key, the value, and what was probably meant."""
    path, settings, key, words = MISTAKES[mistake]
    said = found(path, settings)
    assert key in said, said
    assert words in said[key]
    assert said[key].startswith(f"{key}: ")


@pytest.mark.parametrize("path", sorted(CONFIGS.glob("*.yaml")), ids=lambda path: path.stem)
def test_nothing_that_is_shipped_is_doubted(path):
    assert found(path, []) == {}


def test_every_rule_has_a_mistake():
    """Each of the rules finds at least one of those above."""
    silent = {single_fields, *RULES}
    for path, settings, *_ in MISTAKES.values():
        config = load_config(path, settings)
        case = Case(config, build_creature(config, path))
        silent -= {rule for rule in silent if list(rule(case))}
    assert not silent


@pytest.mark.parametrize(
    ("path", "settings"),
    [
        # Small angles that are no common angle in radians.
        (CONFIG, ["task.light.bearing_deg=1", "simulation.start_heading_deg=3"]),
        (CONFIG, ["task.light.bearing_deg=0.9"]),
        (WALKER, ["world.ground.floor={type: plane, slope_deg: 2.5}"]),
        # A gap of a quarter of the body between two bodies.
        (CONFIG, ["creature.bodies.1.joint.at=[-0.125, 0, 0]"]),
        # An eye on a stalk, and one that looks up where the light is above.
        (CONFIG, ["creature.light_sensors.0.position=[0.12, 0, 0]"]),
        (
            WALKER,
            ["creature.light_sensors.0.axis=[0, 0, 1]", "task.light.elevation_deg=60"],
        ),
        # In water an animal may face anywhere.
        (CONFIG, ["creature.light_sensors.0={body: head, axis: [0, 0, 1], field_of_view_deg: 40}"]),
        # All pressure sensors is the default; it means nothing where there is no ground.
        (CONFIG, ["creature.pressure_sensors=all"]),
        (CONFIG, ["creature.pressure_sensors=[]"]),
        # The moon, and weightlessness.
        (CONFIG, ["world.gravity=1.62"]),
        (CONFIG, ["world.gravity=0", "world.water=null"]),
        # A house beside an animal, and a long wall.
        (
            WALKER,
            ["world.ground.obstacles=[{type: block, centre: [90, 0, 0], size: [1, 900, 3]}]"],
        ),
        (SHORE, [GAUGE]),
        # Ground under water, if that is written.
        (CONFIG, ["world.water={}", "world.ground={}"]),
        (CONFIG, ["world={ground: {}, water: null}"]),
        (CONFIG, ["world={ground: {}}", "world.water.surface=1"]),
        # Eyes of the user's own, and a task without a light.
        (
            CONFIG,
            ["creature.light_sensors=[]", "creature.sensors=[{type: 'mine:Eye'}]"],
        ),
        (CONFIG, ["creature.light_sensors=[]", "task={type: distance}"]),
        # A joint without a motor beside others, trials that differ, and a row that bends a little.
        (CONFIG, ["simulation.trials=[{}, {start_heading_deg: 90}]"]),
        (CONFIG, ["simulation.trials=5", "noise.push=0.01"]),
        (CONFIG, ["creature.bodies.1.joint.rotation_deg=[0, 20, 0]"]),
        # A dive, and a fall of less than a length.
        (CONFIG, ["world.water.surface=-1"]),
        (WALKER, ["simulation.start_clearance=0.1"]),
    ],
)
def test_what_may_be_meant_is_not_doubted(path, settings):
    assert found(path, settings) == {}


def test_a_mesh_is_measured_in_its_own_frame(tmp_path):
    """Joints and eyes of a mesh are in the frame of its file, wherever it lies in that."""
    made = trimesh.creation.box((0.2, 0.1, 0.1))
    made.apply_translation((5.0, 0, 0))
    made.export(tmp_path / "part.stl")
    shape = f"creature.bodies.0.shape={{type: mesh, file: {tmp_path / 'part.stl'}}}"
    where = [
        "creature.bodies.1.repeat=1",
        "creature.bodies.1.joint.at=[4.89, 0, 0]",
        "creature.light_sensors.0.position=[5, 0, 0]",
    ]
    assert found(CONFIG, [shape, *where]) == {}
    assert set(found(CONFIG, [shape])) == {
        "creature.bodies.1.joint.at",
        "creature.light_sensors.0.position",
    }


def test_a_row_of_bodies_is_doubted_once():
    said = lint(load_config(CONFIG, ["creature.bodies.1.joint.child_at=[1, 0, 0]"]), CONFIG)
    assert len(said) == 1
    assert np.isclose(said[0].value[0], 1)


def test_copies_of_a_sensor_are_looked_at_one_by_one():
    """Of five eyes and five feet that are written once."""
    path = CONFIGS / "starfish_land.yaml"
    eyes = "creature.light_sensors=[{body: 'arm{j}_2', position: [3, 0, 0]}]"
    config = load_config(path, [eyes])
    (doubt,) = lint(config, path)
    assert doubt.key == ("creature", "light_sensors", 0, "position")
