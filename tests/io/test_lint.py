"""Warnings about probable mistakes: one for every mistake, and none for shipped files."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from evo_cpg.io.build import build_creature
from evo_cpg.io.lint import RULES, Case, lint
from evo_cpg.io.load import load_config
from shipped_configs import some_configs
from tiny_run import CONFIG, REPOSITORY, VISCOUS

CONFIGS = REPOSITORY / "configs"
WALKER = CONFIGS / "iwadate2010_salamander_land.yaml"
LEGS = CONFIGS / "fukui2003_model1.yaml"
SHORE = CONFIGS / "salamander_amphibious.yaml"
INSECT = CONFIGS / "hexapod.yaml"

# A head whose shape is in its parts: two bars along x.
BAR = "{shape: {type: box, size: [0.2, 0.08, 0.1]}, at: [0, %s, 0]}"
PARTS = (
    "creature.bodies.0={name: head, shape: null, material: body, mass: 2, "
    f"parts: [{BAR % 0.05}, {BAR % -0.05}]}}"
)

THICK = "; ".join(VISCOUS)

# File, settings with the mistake, key of the warning or a part of it, and a word of its message.
# The key is that of the last setting unless given.
MISTAKES = [
    (CONFIG, "creature.materials.body.density=1", "", "1000"),
    (WALKER, "creature.materials.body.density=1.05", "", "1050"),
    (CONFIG, "creature.materials.body.density=2700", "", "sinks"),
    (CONFIG, "creature.bodies.0.mass=0.1; creature.bodies.1.mass=0.2", "", "rises"),
    (
        CONFIG,
        "creature.bodies.1.joint.axes=[x, y, z]; creature.bodies.1.joint.limits_deg=[-86, 86]",
        "joint.axes",
        "armature",
    ),
    (CONFIG, "creature.bodies.1.joint.child_at=[-0.11, 0, 0]", "", "folded"),
    (INSECT, "creature.bodies.1.joint.child_at=[0, 0.1, 0]", "", "folded"),
    (CONFIG, "world.water.density=1.025", "", "1025"),
    (CONFIG, "world.water.density=80", "", "Water"),
    (CONFIG, f"{THICK}; world.water.viscosity=1", "", "0.001"),
    (CONFIG, "creature.bodies.0.shape.size=[200, 100, 100]", "", "30"),
    (CONFIG, "creature.bodies.0.shape={type: sphere, radius: 10}", "radius", "median"),
    (LEGS, "creature.bodies.0.shape.size=[0.4, 0.4, 0.0002]", "simulation.substeps", "sink"),
    (
        CONFIG,
        "creature.bodies.1.joint.axes=[z]; creature.bodies.1.joint.limits_deg=[20, 60]",
        "",
        "neutral",
    ),
    (CONFIG, "creature.bodies.1.joint.limits_deg=[-1.05, 1.05]", "", "60.2"),
    (WALKER, "creature.bodies.1.joint.limits_deg=[-2292, 2292]", "", "40"),
    (CONFIG, "world.gravity=981", "", "9.81"),
    (INSECT, "creature.bodies.2.joint.rotation_deg=[0, 1.05, 1.5708]", "", "60, 90"),
    (CONFIG, "task.light.bearing_deg=0.524", "", "30"),
    (CONFIG, "task.light.bearing_deg=1719", "", "twice"),
    (CONFIG, "creature.light_sensors.0.field_of_view_deg=3.1416", "", "180"),
    (CONFIG, "controller.max_rate=286", "", "4.992"),
    (CONFIG, "creature.bodies.1.joint.at=[-0.2, 0, 0]", "", "'head'"),
    (CONFIG, f"{PARTS}; creature.bodies.1.joint.at=[-0.2, 0, 0]", "", "0.1, 0.09, 0.05"),
    (CONFIG, "creature.light_sensors.0.position=[1, 0, 0]", "", "'head'"),
    (SHORE, "creature.depth_sensors=[{body: head, position: [0, 0, -50]}]", "position", "'head'"),
    (CONFIG, "world.water=null", "world.ground", "327"),
    (CONFIG, "world={ground: {}}", "world.water", "null"),
    (CONFIG, "task={type: walk}; creature.light_sensors=[]", "task.type", "ground"),
    (CONFIG, "creature.light_sensors=[]", "", "eye"),
    (LEGS, "task={type: reach_light}", "task.type", "senses"),
    (CONFIG, "creature.bodies.1.joint.actuator=null", "", "motor"),
    (CONFIG, "simulation.trials=5", "", "5"),
    (CONFIG, "creature.depth_sensors=[{body: head}]", "depth_sensors.0", "world.water.surface"),
    (CONFIG, "creature.pressure_sensors=[head]", "", "world.ground"),
    (CONFIG, "creature.sensors=[{type: rays, body: head}]", "sensors.0", "world.ground"),
    (LEGS, "creature.sensors=[{type: flow, body: torso}]", "sensors.0", "world.water"),
]


def found(path: Path, settings: list[str]) -> dict[str, str]:
    """Return the messages of all warnings, by key."""
    warnings = lint(load_config(path, settings), path)
    return {".".join(map(str, warning.key)): str(warning) for warning in warnings}


@pytest.mark.parametrize(("path", "settings", "key", "word"), MISTAKES)
def test_a_mistake_gets_a_warning(path, settings, key, word):
    key = key or settings.rpartition("; ")[2].partition("=")[0]
    warnings = found(path, settings.split("; "))
    said = [words.removeprefix(f"{each}: ") for each, words in warnings.items() if key in each]
    assert said and word in said[0], warnings


@some_configs
def test_shipped_configs_get_no_warning(path):
    assert found(path, []) == {}


def test_every_rule_has_a_mistake():
    """Every rule finds at least one of the mistakes above."""
    silent = set(RULES)
    for path, settings, *_ in MISTAKES:
        config = load_config(path, settings.split("; "))
        case = Case(config, build_creature(config, path))
        silent -= {rule for rule in silent if list(rule(case))}
    assert not silent


@pytest.mark.parametrize(
    ("path", "settings"),
    [
        # Small angles that match no common angle in radians.
        (CONFIG, ["task.light.bearing_deg=1", "simulation.start_heading_deg=3"]),
        # Stiff joints, also of a file in radians, and one beside joints that turn farther.
        (CONFIG, ["creature.bodies.1.joint.limits_deg=[-2, 2]"]),
        (CONFIG, ["creature.bodies.1.joint.limits_deg=[-2.00535, 2.00535]"]),
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
        (CONFIG, [PARTS, "creature.bodies.1.joint.at=[-0.12, 0, 0]"]),
        # A full turn, converted from 6.2832 rad.
        (WALKER, ["creature.bodies.1.joint.limits_deg=[-360.0004, 360.0004]"]),
        # A gap of a quarter of the body between two bodies.
        (CONFIG, ["creature.bodies.1.joint.at=[-0.125, 0, 0]"]),
        # An eye on a stalk.
        (CONFIG, ["creature.light_sensors.0.position=[0.12, 0, 0]"]),
        # The gravity of the moon, and none.
        (CONFIG, ["world.gravity=1.62"]),
        (CONFIG, ["world.gravity=0", "world.water=null"]),
        # Ground under water, if the key `water` is present.
        (CONFIG, ["world.water={}", "world.ground={}"]),
        (CONFIG, ["world={ground: {}}", "world.water.surface=1"]),
        # A sensor of the user's own in place of eyes, and a task without a light.
        (CONFIG, ["creature.light_sensors=[]", "creature.sensors=[{type: 'mine:Eye'}]"]),
        (CONFIG, ["creature.light_sensors=[]", "task={type: distance}"]),
        # Trials that differ.
        (CONFIG, ["simulation.trials=[{}, {start_heading_deg: 90}]"]),
        (CONFIG, ["simulation.trials=5", "noise.push=0.01"]),
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
