"""Warnings about probable mistakes: one for every mistake, and none for shipped files."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from evo_cpg.io.build import build_creature
from evo_cpg.io.lint import lint, single_fields
from evo_cpg.io.lint.rule import RULES, Case
from evo_cpg.io.load import load_config
from tiny_run import CONFIG, REPOSITORY, VISCOUS

CONFIGS = REPOSITORY / "configs"
WALKER = CONFIGS / "iwadate2010_salamander_land.yaml"
LEGS = CONFIGS / "fukui2003_model1.yaml"
SHORE = CONFIGS / "salamander_amphibious.yaml"
INSECT = CONFIGS / "hexapod.yaml"

GAUGE = "creature.depth_sensors=[{body: head}]"
LEVEL = "world.ground.floor={type: plane, height: -1}"

# A head whose shape is in its parts: two bars along x.
BAR = "{shape: {type: box, size: [0.2, 0.08, 0.1]}, at: [0, %s, 0]}"
PARTS = (
    f"{{name: head, shape: null, material: body, mass: 2, parts: [{BAR % 0.05}, {BAR % -0.05}]}}"
)

# A ridge of two rows, on a grid with 0.1 m spacing.
RIDGE = [[0.25 if 20 <= i < 22 else 0.0] * 40 for i in range(40)]

# File, settings with the mistake, key of the warning, and a part of its message.
MISTAKES = {
    "distance of a fixed root": (
        CONFIG,
        [
            "creature.bodies.0.joint={parent: world, at: [0, 0, 0], child_at: [0, 0, 0], axes: []}",
            "task={type: distance}",
        ],
        "task.type",
        "'head' is fixed to the world, so it is always 0",
    ),
    "limits in rad at the world": (
        CONFIG,
        [
            "creature.bodies.0.joint={parent: world, at: [0, 0, 0], child_at: [0, 0, 0], "
            "axes: [z], limits_deg: [-1.05, 1.05]}",
        ],
        "creature.bodies.0.joint.limits_deg",
        "If it is in radians, write 60.2",
    ),
    "density in g/cm^3": (
        CONFIG,
        ["creature.materials.body.density=1"],
        "creature.materials.body.density",
        "If it is in g/cm^3, write 1000",
    ),
    "axes that reach a plane": (
        CONFIG,
        ["creature.bodies.1.joint.axes=[x, y, z]", "creature.bodies.1.joint.limits_deg=[-86, 86]"],
        "creature.bodies.1.joint.axes",
        "Give it an armature",
    ),
    "density of steel in g/cm^3 in water": (
        CONFIG,
        ["creature.materials.body.density=7.8"],
        "creature.materials.body.density",
        "If it is in g/cm^3, write 7800",
    ),
    "density of flesh in g/cm^3 on land": (
        WALKER,
        ["creature.materials.body.density=1.05"],
        "creature.materials.body.density",
        "If it is in g/cm^3, write 1050",
    ),
    "animal that sinks": (
        CONFIG,
        ["creature.materials.body.density=2700"],
        "creature.materials.body.density",
        "has 2.7 times the mass of the water that it displaces, so it sinks from start to end",
    ),
    "animal of given mass that rises": (
        CONFIG,
        ["creature.bodies.0.mass=0.1", "creature.bodies.1.mass=0.2"],
        "creature.bodies.1.mass",
        "so it rises from start to end. Give the water a surface",
    ),
    "row folded by one sign": (
        CONFIG,
        ["creature.bodies.1.joint.child_at=[-0.11, 0, 0]"],
        "creature.bodies.1.joint.child_at",
        "lies 0.05 m inside 'head', its parent, so the animal is folded into itself",
    ),
    "row folded by the parent's sign": (
        CONFIG,
        ["creature.bodies.1.joint.at=[0.11, 0, 0]"],
        "creature.bodies.1.joint.child_at",
        "Change the sign of one of its numbers, or of one of at",
    ),
    "leg folded into the trunk": (
        INSECT,
        ["creature.bodies.1.joint.child_at=[0, 0.1, 0]"],
        "creature.bodies.1.joint.child_at",
        "so the animal is folded into itself",
    ),
    "density times 1000": (
        CONFIG,
        ["creature.materials.body.density=1e6"],
        "creature.materials.body.density",
        "If it is in g/m^3, write 1000",
    ),
    "water in g/cm^3": (
        CONFIG,
        ["world.water.density=1.025"],
        "world.water.density",
        "If it is in g/cm^3, write 1025",
    ),
    "viscosity in mPa s": (
        CONFIG,
        [*VISCOUS, "world.water.viscosity=1"],
        "world.water.viscosity",
        "If it is in mPa s, write 0.001",
    ),
    "water like air": (CONFIG, ["world.water.density=80"], "world.water.density", "Water has 1000"),
    "box in mm": (
        CONFIG,
        ["creature.bodies.0.shape.size=[200, 100, 100]"],
        "creature.bodies.0.shape.size",
        "In mm it would be 0.2 m",
    ),
    "box in km": (
        CONFIG,
        ["creature.bodies.0.shape.size=[0.0002, 0.0001, 0.0001]"],
        "creature.bodies.0.shape.size",
        "a body of 0.0002 m. Plausible: 0.001 to 30 m",
    ),
    "light body that carries a trunk": (
        CONFIG,
        ["creature.bodies.0.shape.size=[0.002, 0.001, 0.001]"],
        "creature.bodies.1.joint.parent",
        "float32 resolves up to 5000 times the body's mass. Make the heavier body the parent",
    ),
    "very light body on a creature": (
        CONFIG,
        ["creature.bodies.1.shape.size=[1e-5, 1e-5, 1e-5]", "creature.bodies.1.repeat=1"],
        "creature.bodies.1.material",
        "float32 resolves down to 1e-12 of the creature's mass",
    ),
    "thin body with long steps": (
        LEGS,
        ["creature.bodies.0.shape.size=[0.4, 0.4, 0.0002]"],
        "simulation.substeps",
        "It would sink into the ground or bob forever. Plausible: ",
    ),
    "hills shorter than a body": (
        LEGS,
        ["world.ground.floor={type: hills, length: 0.4}"],
        "world.ground.floor.length",
        "is 0.6 m long and touches the floor only with its corners",
    ),
    "ridge narrower than a body": (
        LEGS,
        [f"world.ground.floor={{type: relief, heights: {RIDGE}}}"],
        "world.ground.floor.spacing",
        "A bump of 0.25 m fits between them",
    ),
    "frictions swapped": (
        WALKER,
        ["world.ground.dynamic_friction=0.9", "world.ground.static_friction=0.5"],
        "world.ground.dynamic_friction",
        "Were the two swapped?",
    ),
    "limits without the neutral pose": (
        CONFIG,
        ["creature.bodies.1.joint.axes=[z]", "creature.bodies.1.joint.limits_deg=[20, 60]"],
        "creature.bodies.1.joint.limits_deg",
        "the neutral pose, 0 degrees, is beyond the limits",
    ),
    "one radius in cm": (
        CONFIG,
        ["creature.bodies.0.shape={type: sphere, radius: 10}"],
        "creature.bodies.0.shape.radius",
        "a body of 20 m, but the median is 0.2 m",
    ),
    "boulder in mm": (
        WALKER,
        ["world.ground.obstacles=[{type: boulder, centre: [900, 0, 0], radius: 400}]"],
        "world.ground.obstacles.0.radius",
        "400 m next to a creature of",
    ),
    "block in mm": (
        WALKER,
        ["world.ground.obstacles=[{type: block, centre: [900, 0, 0], size: [500, 400, 300]}]"],
        "world.ground.obstacles.0.size",
        "300 m next to a creature of",
    ),
    "gravity in cm/s^2": (
        CONFIG,
        ["world.gravity=981"],
        "world.gravity",
        "If it is in cm/s^2, write 9.81",
    ),
    "limits in rad": (
        CONFIG,
        ["creature.bodies.1.joint.limits_deg=[-1.05, 1.05]"],
        "creature.bodies.1.joint.limits_deg",
        "If it is in radians, write 60.2",
    ),
    "limits in rad, uncommon": (
        CONFIG,
        ["creature.bodies.1.joint.limits_deg=[-0.4, 1.2]"],
        "creature.bodies.1.joint.limits_deg",
        "If it is in radians, write 68.8",
    ),
    "limits converted twice": (
        WALKER,
        ["creature.bodies.1.joint.limits_deg=[-2292, 2292]"],
        "creature.bodies.1.joint.limits_deg",
        "If it was converted twice, write 40",
    ),
    "attitude in rad": (
        INSECT,
        ["creature.bodies.2.joint.rotation_deg=[0, 1.05, 1.5708]"],
        "creature.bodies.2.joint.rotation_deg",
        "If it is in radians, write 60, 90",
    ),
    "heading in rad": (
        CONFIG,
        ["simulation.start_heading_deg=3.14"],
        "simulation.start_heading_deg",
        "If it is in radians, write 180",
    ),
    "bearing in rad": (
        CONFIG,
        ["task.light.bearing_deg=0.524"],
        "task.light.bearing_deg",
        "If it is in radians, write 30",
    ),
    "bearing of a trial in rad": (
        CONFIG,
        ["simulation.trials=[{light: {bearing_deg: -0.7854}}, {start_heading_deg: 1.571}]"],
        "simulation.trials.0.light.bearing_deg",
        "If it is in radians, write -45",
    ),
    "bearing converted twice": (
        CONFIG,
        ["task.light.bearing_deg=1719"],
        "task.light.bearing_deg",
        "plausible: -360 to 360 degrees. Was it converted twice?",
    ),
    "slope in rad": (
        WALKER,
        ["world.ground.floor={type: plane, slope_deg: 0.2618}"],
        "world.ground.floor.slope_deg",
        "If it is in radians, write 15",
    ),
    "block turned in rad": (
        WALKER,
        [
            "world.ground.obstacles="
            "[{type: block, centre: [3, 0, 0], size: [1, 1, 1], heading_deg: 0.7854}]"
        ],
        "world.ground.obstacles.0.heading_deg",
        "If it is in radians, write 45",
    ),
    "field of view in rad": (
        CONFIG,
        ["creature.light_sensors.0.field_of_view_deg=3.1416"],
        "creature.light_sensors.0.field_of_view_deg",
        "If it is in radians, write 180",
    ),
    "step of postures in rad": (
        LEGS,
        ["controller.angle_step=0.349"],
        "controller.angle_step",
        "If the step is in radians, write 20",
    ),
    "angle of postures in rad": (
        LEGS,
        ["controller.lowest_angle=1.92", "controller.neutral_angle=3.14"],
        "controller.lowest_angle",
        "If it is in radians, write 110",
    ),
    "rate in deg/s": (
        CONFIG,
        ["controller.max_rate=286"],
        "controller.max_rate",
        "If it is in degrees per second, write 4.992",
    ),
    "joint beyond its parent": (
        CONFIG,
        ["creature.bodies.1.joint.at=[-0.2, 0, 0]"],
        "creature.bodies.1.joint.at",
        "lies 0.1 m outside body 'head', the parent of 'segment1'",
    ),
    "joint beyond its body": (
        CONFIG,
        ["creature.bodies.1.joint.child_at=[0.11, 0.2, 0]"],
        "creature.bodies.1.joint.child_at",
        "outside body 'segment1' itself. The body reaches to 0.1, 0.05, 0.05 m",
    ),
    "joint of a leg that lies along the body": (
        CONFIG,
        [
            "creature.bodies.1.shape={type: capsule, radius: 0.03, length: 0.1}",
            "creature.bodies.1.joint.child_at=[0, 0.2, 0]",
        ],
        "creature.bodies.1.joint.child_at",
        "A capsule lies along its own x. To turn a leg sideways, use rotation_deg",
    ),
    "joint beyond a body of parts": (
        CONFIG,
        [f"creature.bodies.0={PARTS}", "creature.bodies.1.joint.at=[-0.2, 0, 0]"],
        "creature.bodies.1.joint.at",
        "lies 0.1 m outside body 'head', the parent of 'segment1'. The body reaches to 0.1, 0.09, "
        "0.05 m",
    ),
    "joint in mm": (
        CONFIG,
        ["creature.bodies.1.joint.at=[-110, 0, 0]"],
        "creature.bodies.1.joint.at",
        "Positions are in m. Is this in mm?",
    ),
    "eye off its body": (
        CONFIG,
        ["creature.light_sensors.0.position=[1, 0, 0]"],
        "creature.light_sensors.0.position",
        "lies 0.9 m outside body 'head'",
    ),
    "gauge off its body": (
        SHORE,
        ["creature.depth_sensors=[{body: head, position: [0, 0, -50]}]"],
        "creature.depth_sensors.0.position",
        "outside body 'head'",
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
    "gauge without water": (
        WALKER,
        [GAUGE],
        "creature.depth_sensors.0.body",
        "there is no water, so this gauge always reads 0. Set world.water,",
    ),
    "gauge without surface": (
        CONFIG,
        [GAUGE],
        "creature.depth_sensors.0.body",
        "the water has no surface, so this gauge always reads 0. Set world.water.surface: 0",
    ),
    "lift of a chain": (
        CONFIG,
        [*VISCOUS, "world.water.lift=true"],
        "world.water.lift",
        "no body has lift; it needs a body that is thinner than",
    ),
    "water under the ground": (
        SHORE,
        ["world.water.surface=-5"],
        "world.water.surface",
        "the lowest ground is at -0.9",
    ),
    "eyes of postures": (
        LEGS,
        ["creature.light_sensors=[{body: torso}]"],
        "creature.light_sensors",
        "a controller of type 'postures' senses nothing",
    ),
    "free fall": (
        CONFIG,
        ["world.water=null"],
        "world.ground",
        "the animal falls from start to end, to 327 m/s. Above 100 m/s it counts as diverged",
    ),
    "ground under water by default": (
        CONFIG,
        ["world={ground: {}}"],
        "world.water",
        "left out: without this key there is water everywhere, so the ground lies under water",
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
        "falls from that height. Plausible: up to",
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
        "the animal has no eye. Add light_sensors: [{body: head}]",
    ),
    "light without eyes, by default": (
        CONFIG,
        ["creature.light_sensors=[]", "task={}"],
        "creature.light_sensors",
        "the task rewards approaching a light (reach_light, the default)",
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
    "rate of 0": (
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
        "without noise all 2 trials are alike, so one is enough",
    ),
    "row far from its joint position": (
        CONFIG,
        [
            "creature.bodies.0.shape={type: box, size: [0.6, 0.1, 0.1]}",
            "creature.bodies.1.joint.at=[-0.31, 0, 0]",
        ],
        "creature.bodies.1.joint.at",
        "repeat uses this position for all bodies of the row. It fits 'head', which carries the "
        "first, but lies 0.21 m outside 'segment1'",
    ),
    "row with its joint inside a body": (
        CONFIG,
        [
            "creature.bodies.0.shape={type: box, size: [0.05, 0.1, 0.1]}",
            "creature.bodies.1.joint.at=[-0.03, 0, 0]",
        ],
        "creature.bodies.1.joint.at",
        "lies 0.05 m inside 'segment1', which carries the next",
    ),
    "row that curls up": (
        CONFIG,
        ["creature.bodies.1.joint.rotation_deg=[0, 90, 0]"],
        "creature.bodies.1.joint.rotation_deg",
        "repeat turns every body of the row by 90 degrees relative to its predecessor",
    ),
}


def found(path: Path, settings: list[str]) -> dict[str, str]:
    """Return the messages of all warnings, by key."""
    warnings = lint(load_config(path, settings), path)
    return {".".join(map(str, warning.key)): str(warning) for warning in warnings}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_gets_a_warning(mistake):
    """The warning has the key, the value and the probable intention."""
    path, settings, key, words = MISTAKES[mistake]
    warnings = found(path, settings)
    assert key in warnings, warnings
    assert words in warnings[key]
    assert warnings[key].startswith(f"{key}: ")


@pytest.mark.parametrize("path", sorted(CONFIGS.glob("*.yaml")), ids=lambda path: path.stem)
def test_shipped_configs_get_no_warning(path):
    assert found(path, []) == {}


def test_every_rule_has_a_mistake():
    """Every rule finds at least one of the mistakes above."""
    silent = {single_fields, *RULES}
    for path, settings, *_ in MISTAKES.values():
        config = load_config(path, settings)
        case = Case(config, build_creature(config, path))
        silent -= {rule for rule in silent if list(rule(case))}
    assert not silent


@pytest.mark.parametrize(
    ("path", "settings"),
    [
        # Small angles that match no common angle in radians.
        (CONFIG, ["task.light.bearing_deg=1", "simulation.start_heading_deg=3"]),
        (CONFIG, ["task.light.bearing_deg=0.9"]),
        (WALKER, ["world.ground.floor={type: plane, slope_deg: 2.5}"]),
        # Stiff joints, also of a file in radians, and one beside joints that turn farther.
        (CONFIG, ["creature.bodies.1.joint.limits_deg=[-2, 2]"]),
        (CONFIG, ["creature.bodies.1.joint.limits_deg=[-2.00535, 2.00535]"]),
        (WALKER, ["creature.bodies.1.joint.limits_deg=[-2.5, 2.5]"]),
        # Bodies of foam on land, and a density without effect.
        (LEGS, ["creature.materials.body.density=5"]),
        (
            CONFIG,
            [
                "creature.materials.body.density=1",
                "creature.bodies.0.mass=2",
                "creature.bodies.1.mass=2",
            ],
        ),
        # A shark is a little heavier than water. A heavy animal walks on the ground of a lake.
        (CONFIG, ["creature.materials.body.density=1080"]),
        (CONFIG, ["creature.materials.body.density=2700", "world.water={}", "world.ground={}"]),
        # Gaps between bodies of parts.
        (CONFIG, [f"creature.bodies.0={PARTS}", "creature.bodies.1.joint.at=[-0.12, 0, 0]"]),
        # A full turn, converted from 6.2832 rad.
        (WALKER, ["creature.bodies.1.joint.limits_deg=[-360.0004, 360.0004]"]),
        # A gap of a quarter of the body between two bodies.
        (CONFIG, ["creature.bodies.1.joint.at=[-0.125, 0, 0]"]),
        # An eye on a stalk, and an eye that looks up to a light above.
        (CONFIG, ["creature.light_sensors.0.position=[0.12, 0, 0]"]),
        (
            WALKER,
            ["creature.light_sensors.0.axis=[0, 0, 1]", "task.light.elevation_deg=60"],
        ),
        # In water an animal may face anywhere.
        (CONFIG, ["creature.light_sensors.0={body: head, axis: [0, 0, 1], field_of_view_deg: 40}"]),
        # All pressure sensors, the default, are harmless without ground.
        (CONFIG, ["creature.pressure_sensors=all"]),
        (CONFIG, ["creature.pressure_sensors=[]"]),
        # The gravity of the moon, and none.
        (CONFIG, ["world.gravity=1.62"]),
        (CONFIG, ["world.gravity=0", "world.water=null"]),
        # A long wall, far larger than the animal.
        (
            WALKER,
            ["world.ground.obstacles=[{type: block, centre: [90, 0, 0], size: [1, 900, 3]}]"],
        ),
        (SHORE, [GAUGE]),
        # Ground under water, if the key `water` is present.
        (CONFIG, ["world.water={}", "world.ground={}"]),
        (CONFIG, ["world={ground: {}, water: null}"]),
        (CONFIG, ["world={ground: {}}", "world.water.surface=1"]),
        # A sensor of the user's own in place of eyes, and a task without a light.
        (
            CONFIG,
            ["creature.light_sensors=[]", "creature.sensors=[{type: 'mine:Eye'}]"],
        ),
        (CONFIG, ["creature.light_sensors=[]", "task={type: distance}"]),
        # Trials that differ, and a row that bends a little.
        (CONFIG, ["simulation.trials=[{}, {start_heading_deg: 90}]"]),
        (CONFIG, ["simulation.trials=5", "noise.push=0.01"]),
        (CONFIG, ["creature.bodies.1.joint.rotation_deg=[0, 20, 0]"]),
        # A fall of less than ten lengths, into water and onto the ground.
        (CONFIG, ["world.water.surface=-1"]),
        (WALKER, ["simulation.start_clearance=0.1"]),
    ],
)
def test_unusual_but_sensible_values_get_no_warning(path, settings):
    assert found(path, settings) == {}


def test_a_root_that_hangs_does_not_fall():
    joint = "{parent: world, at: [0, 0, 0], child_at: [0, 0, 0], axes: []}"
    config = load_config(CONFIG, ["world.water=null", f"creature.bodies.0.joint={joint}"])
    assert not [each for each in lint(config, CONFIG) if "falls from start" in str(each)]


def test_a_mesh_is_measured_in_its_own_frame(tmp_path):
    """Positions on a mesh are in the frame of its file, even far from the origin."""
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


def test_a_row_of_bodies_gets_one_warning():
    warnings = lint(load_config(CONFIG, ["creature.bodies.1.joint.child_at=[1, 0, 0]"]), CONFIG)
    assert len(warnings) == 1
    assert np.isclose(warnings[0].value[0], 1)


def test_a_repeated_sensor_gets_one_warning():
    """One entry stands for five eyes."""
    path = CONFIGS / "starfish_land.yaml"
    eyes = "creature.light_sensors=[{body: 'arm{j}_2', position: [3, 0, 0]}]"
    config = load_config(path, [eyes])
    (warning,) = lint(config, path)
    assert warning.key == ("creature", "light_sensors", 0, "position")
