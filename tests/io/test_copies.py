"""Copies of bodies: rows, stars and mirror images, against geometry."""

import dataclasses
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import yaml

from creatures import quick_jit
from evo_cpg.creature.creature import neutral_pose
from evo_cpg.creature.tree import build_tree
from evo_cpg.io.build import build_experiment
from evo_cpg.io.errors import ConfigError
from evo_cpg.io.load import check_config, dump_config
from evo_cpg.io.parameters import parametrise
from evo_cpg.io.schema.creature import CreatureConfig
from evo_cpg.physics.tree.kinematics import kinematics
from evo_cpg.physics.tree.state import resting_state
from tiny_run import REPOSITORY
from wrong_values import with_changes

STAR = """
name: star
materials: {flesh: {density: 1000}}
bodies:
  - {name: disc, shape: {type: sphere, radius: 0.1}, material: flesh}
  - name: arm{j}_{i}
    radial: 5
    repeat: 2
    shape: {type: box, size: [0.2, 0.05, 0.03]}
    material: flesh
    joint:
      parent: disc
      at: [0.1, 0, 0.02]
      child_at: [-0.1, 0, 0]
      axes: [y]
      rotation_deg: [10, 20, 30]
  - name: tip{j}
    shape: {type: sphere, radius: 0.02}
    material: flesh
    joint: {parent: "arm{j}_2", at: [0.1, 0, 0], child_at: [-0.02, 0, 0], axes: [z]}
light_sensors: [{body: "tip{j}", position: [0.02, 0, 0]}]
pressure_sensors: ["arm{j}_1", disc]
"""

ROOT = {"name": "disc", "shape": {"type": "sphere", "radius": 0.1}, "material": "flesh"}

BUG = """
name: bug
materials: {shell: {density: 500}}
bodies:
  - {name: trunk, shape: {type: box, size: [0.4, 0.1, 0.1]}, material: shell}
  - name: front_{side}_thigh
    mirror: y
    shape: {type: box, size: [0.2, 0.03, 0.04]}
    material: shell
    joint:
      parent: trunk
      at: [0.15, 0.05, 0.01]
      child_at: [-0.1, 0.01, 0]
      axes: [-z, [0.6, 0.8, 0], y]
      limits_deg: [[-10, 50], [-20, 60], [-30, 5]]
      rotation_deg: [10, 20, 70]
  - name: front_{side}_claw
    shape:
      type: mesh
      vertices: [[0, 0, 0], [0.1, 0, 0], [0, 0.04, 0], [0, 0, 0.05]]
      faces: [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]
    material: shell
    joint: {parent: "front_{side}_thigh", at: [0.1, 0, 0], child_at: [0, 0.01, 0.02], axes: [x]}
light_sensors: [{body: "front_{side}_claw", position: [0, 0.01, 0], axis: [1, 1, 0]}]
depth_sensors: [{body: "front_{side}_claw", position: [0, 0.01, 0.003]}]
"""
FLIP = np.diag([1.0, -1.0, 1.0])


def built(text):
    return CreatureConfig.model_validate(yaml.safe_load(text)).build()


def changed(text, **changes):
    """Return a creature with changed keys of its second body."""
    data = yaml.safe_load(text)
    data["bodies"][1] |= changes
    return data


def refused(data):
    """Return the error message for an invalid creature."""
    with pytest.raises(ConfigError) as caught:
        build_experiment(check_config({"name": "x", "creature": data}, "x.yaml"), "x.yaml")
    return str(caught.value).removeprefix("x.yaml: creature.")


def test_arms_of_a_star_are_rotated_about_the_vertical():
    creature = built(STAR)
    assert [body.name for body in creature.bodies[:4]] == ["disc", "arm1_1", "arm1_2", "arm2_1"]
    assert [body.name for body in creature.bodies[-5:]] == [f"tip{j}" for j in range(1, 6)]
    centres, rotations = neutral_pose(creature)
    for name in ("arm{}_1", "arm{}_2", "tip{}"):
        first = creature.body_index(name.format(1))
        for j in range(5):
            angle = 2 * np.pi * j / 5
            c, s = np.cos(angle), np.sin(angle)
            turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
            here = creature.body_index(name.format(j + 1))
            np.testing.assert_allclose(centres[here], turn @ centres[first], atol=1e-12)
            np.testing.assert_allclose(rotations[here], turn @ rotations[first], atol=1e-12)
    assert [eye.body for eye in creature.light_sensors] == [f"tip{j}" for j in range(1, 6)]
    assert creature.pressure_sensors == (*(f"arm{j}_1" for j in range(1, 6)), "disc")


def test_mirrored_limbs_are_mirror_images_in_every_pose():
    creature = built(BUG)
    tree = build_tree(creature)
    names = [body.name for body in creature.bodies]
    assert names[1:] == [
        f"front_{side}_{part}" for part in ("thigh", "claw") for side in ("left", "right")
    ]
    state = resting_state(tree)
    angle = {"thigh": [0.3, -0.2, 0.4], "claw": [0.5]}
    q = np.zeros(tree.dof_count)
    for part, values in angle.items():
        for side in ("left", "right"):
            body = tree.names.index(f"front_{side}_{part}")
            q[[i for i, b in enumerate(tree.dof_bodies) if b == body]] = values
    state = dataclasses.replace(state, q=jnp.asarray(q, state.q.dtype))
    pose = quick_jit(lambda state: kinematics(tree, state))(state)
    rotation = np.asarray(pose.rotation)
    place = np.asarray(pose.origin) + np.einsum("ijb,jb->ib", rotation, tree.com)
    for part in angle:
        left, right = (tree.names.index(f"front_{side}_{part}") for side in ("left", "right"))
        np.testing.assert_allclose(place[:, right], FLIP @ place[:, left], atol=1e-6)
        inertia = tree.inertia[:3, :3]
        seen = rotation[..., left] @ inertia[..., left] @ rotation[..., left].T
        other = rotation[..., right] @ inertia[..., right] @ rotation[..., right].T
        np.testing.assert_allclose(other, FLIP @ seen @ FLIP, atol=1e-9)


def test_mirrored_limbs_have_the_same_limits_and_mirrored_senses():
    creature = built(BUG)
    left, right = (
        next(body.joint for body in creature.bodies if body.name == f"front_{side}_thigh")
        for side in ("left", "right")
    )
    assert (right.lower, right.upper) == (left.lower, left.upper)
    assert right.axes == ((0.0, 0.0, 1.0), (-0.6, 0.8, 0.0), (0.0, 1.0, 0.0))
    centres, rotations = neutral_pose(creature)
    for sensors in (creature.light_sensors, creature.depth_sensors):
        places = [
            centres[i] + rotations[i] @ sensor.position
            for sensor in sensors
            for i in [creature.body_index(sensor.body)]
        ]
        np.testing.assert_allclose(places[1], FLIP @ places[0], atol=1e-12)
    views = [rotations[creature.body_index(e.body)] @ e.axis for e in creature.light_sensors]
    np.testing.assert_allclose(views[1], FLIP @ views[0], atol=1e-12)


@pytest.mark.parametrize(
    ("axis", "sides"),
    [("x", ("front", "hind")), ("y", ("left", "right")), ("z", ("upper", "lower"))],
)
def test_the_sides_of_each_mirror_have_names(axis, sides):
    data = changed(BUG, mirror=axis)
    data["bodies"][1]["joint"]["at"] = [0.1, 0.1, 0.1]
    creature = CreatureConfig.model_validate(data).build()
    centres, _ = neutral_pose(creature)
    flip = np.where(np.array(list("xyz")) == axis, -1, 1)
    written, image = (creature.body_index(f"front_{side}_thigh") for side in sides)
    np.testing.assert_allclose(centres[image], flip * centres[written], atol=1e-12)


def test_a_limb_on_each_segment_of_a_row():
    data = changed(STAR, name="segment{i}", radial=1, repeat=3)
    joint = {"parent": "segment{i}", "at": [0, 0.05, 0], "child_at": [0, -0.02, 0], "axes": ["x"]}
    data["bodies"][2] |= {"name": "{side}_leg{i}", "mirror": "y", "joint": joint}
    bodies = (
        CreatureConfig.model_validate(data | {"light_sensors": [], "pressure_sensors": []})
        .build()
        .bodies
    )
    assert {body.name: body.joint.parent for body in bodies[4:]} == {
        f"{side}_leg{i}": f"segment{i}" for i in (1, 2, 3) for side in ("left", "right")
    }


@pytest.mark.slow
def test_copies_are_read_back_and_differentiated_together():
    data = {"name": "x", "creature": yaml.safe_load(STAR), "world": {"water": None}}
    data["task"] = {"type": "distance"}
    data["creature"]["light_sensors"] = []
    data["world"]["ground"] = {}
    config = check_config(data, "x.yaml")
    assert check_config(yaml.safe_load(dump_config(config)), "x.yaml") == config
    parameters = parametrise(config, "x.yaml", ["creature.bodies.1.shape.size.0"])
    tree = parameters.experiment.simulation.world.tree
    # One length determines the mass of all ten segments.
    density = 1000 * 0.05 * 0.03
    masses = quick_jit(jax.jacfwd(lambda p: jnp.asarray(parameters.simulation(p).world.tree.mass)))
    arms = [name.startswith("arm") for name in tree.names]
    derivatives = masses(jnp.asarray(parameters.values))[:, 0]
    np.testing.assert_allclose(derivatives, density * np.array(arms), rtol=1e-5)


def test_too_many_bodies_are_rejected_before_building():
    words = "creature: bodies: 1801 bodies with 'arm{j}_{i}'. Allowed: up to 1000"
    assert refused(changed(STAR, radial=900)).endswith(words)


@pytest.mark.parametrize(
    ("text", "key", "value", "word"),
    [
        (STAR, "bodies.1.name", "arm{i}", "bodies.1: name: .*{j}"),
        (STAR, "bodies.1.radial", 1, "bodies.1: name: {j}"),
        (STAR, "bodies.1.radial", 0, "bodies.1.radial: 0"),
        (STAR, "bodies.1.raidal", 5, "bodies.1.raidal: .*'radial'"),
        (STAR, "bodies.1.repeat", 1, "bodies.2.joint.parent: 'arm{j}_2'"),
        (STAR, "bodies.2.name", "tip", "bodies.2: name: .*{j}"),
        (STAR, "bodies.2.radial", 3, "bodies.2: radial: .*'arm{j}_2'"),
        (STAR, "bodies.0", ROOT | {"name": "disc{j}", "radial": 2}, "bodies.0: radial"),
        (STAR, "bodies.0", ROOT | {"name": "arm2_1"}, "bodies.1.name: .*'arm2_1'"),
        (STAR, "light_sensors.0.body", "tip{side}", "light_sensors.0.body: 'tip{side}'"),
        (BUG, "bodies.1.name", "thigh", "bodies.1: name: .*{side}"),
        (BUG, "bodies.1.mirror", "w", "bodies.1.mirror: 'w'"),
        (BUG, "bodies.1.joint.at", [0.15, -0.05, 0.01], "bodies.1: mirror"),
    ],
)
def test_wrong_copies_are_refused_with_their_key(text, key, value, word):
    assert re.match(word, refused(with_changes(yaml.safe_load(text), {key: value})))


def test_example_in_the_docs_is_a_starfish():
    page = (REPOSITORY / "docs/config.md").read_text()
    block = page.split("### Limbs that are written once")[1].split("```yaml\n")[1].split("```")[0]
    creature = built("name: example\nmaterials: {flesh: {density: 1000}}\n" + block)
    assert len(creature.bodies) == 1 + 5 * 4
    assert [eye.body for eye in creature.light_sensors] == [f"tip{j}" for j in range(1, 6)]
