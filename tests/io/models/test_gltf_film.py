"""Animated scenes: poses of the bodies equal the recording, and the file is valid."""

import dataclasses
import json
import os
import shutil
import struct
import subprocess
from pathlib import Path

import numpy as np
import pytest
import trimesh

from evo_cpg.creature.creature import Body, Creature, Material
from evo_cpg.creature.mesh import convex_mesh
from evo_cpg.physics.contact.contact_model import Ground
from evo_cpg.physics.contact.terrain import Block, Boulder, Plane, Shore
from evo_cpg.simulation.recording import RecordingError
from evo_cpg.view.gltf_film import Z_UP, gltf_film
from evo_cpg.view.scene import Panel, quaternions
from evo_cpg.view.skin import Draped, skins
from view import synthetic

# Folder of `npm install gltf-validator`. Node also searches the folders above the tests.
_PACKAGES = os.environ.get("NODE_PATH", "")
_VALIDATE = """
const fs = require("fs"), validator = require("gltf-validator");
validator.validateBytes(new Uint8Array(fs.readFileSync(process.argv[1])))
  .then(report => console.log(JSON.stringify(report.issues)));
"""
_STONES = (Boulder((1.0, 0.5, 0.1), 0.2), Block((2.0, -0.5, 0.1), (0.2, 0.1, 0.1), 0.3))
SCENES = {
    "swimmer": (synthetic.swimmer, synthetic.swim, {"world": "water"}),
    "walker": (synthetic.walker, synthetic.walk, {"world": "land", "ground": Ground()}),
    "stones": (
        synthetic.walker,
        synthetic.walk,
        {"world": "land", "ground": Ground(floor=Plane(), obstacles=_STONES)},
    ),
    "shore": (
        synthetic.walker,
        synthetic.walk,
        {
            "world": "water",
            "ground": Ground(floor=Shore(start=1.0, stop=4.0, stop_height=1.0)),
            "surface": 0.6,
        },
    ),
}


@pytest.fixture(
    scope="module",
    params=[
        pytest.param(name, marks=pytest.mark.slow if name in ("shore", "stones") else [])
        for name in SCENES
    ],
)
def scene(request):
    make, move, settings = SCENES[request.param]
    creature, recording = make(), move(4.0)
    return creature, recording, gltf_film(Panel(creature, recording, "a title", **settings))


def decode(data):
    """Return the JSON document of a file, and its accessors as arrays."""
    magic, version, length = struct.unpack_from("<4sII", data)
    assert (magic, version, length) == (b"glTF", 2, len(data))
    size, kind = struct.unpack_from("<I4s", data, 12)
    assert kind == b"JSON"
    document = json.loads(data[20 : 20 + size])
    binary = data[20 + size + 8 :]
    widths = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
    arrays = []
    for accessor in document["accessors"]:
        view = document["bufferViews"][accessor["bufferView"]]
        dtype = {5126: "<f4", 5125: "<u4", 5123: "<u2"}[accessor["componentType"]]
        width = widths[accessor["type"]]
        count = accessor["count"] * width
        array = np.frombuffer(binary, dtype, count, view["byteOffset"]).reshape(-1, width)
        arrays.append(array)
    return document, arrays


def matrix(quaternion):
    """Return rotations of unit quaternions x, y, z, w (Shoemake 1985)."""
    x, y, z, w = np.moveaxis(quaternion, -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def movements(document, arrays):
    """Return instants and values of each moved node, by its name and by what moves."""
    nodes, motion = document["nodes"], document["animations"][0]
    moved = {}
    for channel in motion["channels"]:
        sampler = motion["samplers"][channel["sampler"]]
        assert sampler["interpolation"] == "LINEAR"
        target = channel["target"]
        values = arrays[sampler["input"]][:, 0], arrays[sampler["output"]]
        moved[nodes[target["node"]]["name"], target["path"]] = values
    return moved


@pytest.mark.slow
def test_the_bodies_move_as_in_the_recording(scene):
    creature, recording, data = scene
    found = movements(*decode(data))
    names = {body.name for body in creature.bodies}
    instants = {key: time for key, (time, _) in found.items() if key[0] in names}
    assert len(instants) == 2 * len(creature.bodies)
    for time in instants.values():
        np.testing.assert_allclose(time, recording.time, atol=1e-5)
    moved = {key: values for key, (_, values) in found.items()}
    for i, body in enumerate(creature.bodies):
        place, turn = moved[body.name, "translation"], moved[body.name, "rotation"]
        np.testing.assert_allclose(place, recording.position[:, i], atol=1e-5)
        np.testing.assert_allclose(matrix(turn.astype(float)), recording.rotation[:, i], atol=1e-5)
        np.testing.assert_allclose(np.linalg.norm(turn, axis=1), 1, atol=1e-6)
        assert ((turn[1:] * turn[:-1]).sum(1) > 0).all()


@pytest.mark.slow
def test_the_camera_sees_every_body_at_every_instant(scene):
    """The camera looks along its -z (glTF 2.0, section 3.10)."""
    creature, recording, data = scene
    document, arrays = decode(data)
    (camera,) = document["cameras"]
    lens, moved = camera["perspective"], movements(document, arrays)
    time, eye = moved["camera", "translation"]
    turn = matrix(moved["camera", "rotation"][1].astype(float))
    across = []
    for i in range(len(creature.bodies)):
        place = np.stack(
            [np.interp(time, recording.time, recording.position[:, i, k]) for k in range(3)], -1
        )
        x, y, z = np.moveaxis(np.einsum("tji,tj->ti", turn, place - eye), -1, 0)
        assert (-z > lens["znear"]).all()
        up = y / -z / np.tan(lens["yfov"] / 2)
        across.append(x / -z / np.tan(lens["yfov"] / 2) / lens["aspectRatio"])
        assert np.abs(up).max() < 1 and np.abs(across[-1]).max() < 1
    # The horizon is level, and the animal is not tiny.
    assert np.abs(turn[:, 2, 0]).max() < 1e-6 and (turn[:, 2, 1] > 0).all()
    assert np.median(np.ptp(across, axis=0)) > 0.3


def test_up_direction_is_converted(scene):
    document, _ = decode(scene[2])
    world = document["nodes"][document["scenes"][0]["nodes"][0]]
    assert world["name"] == "world" and world["rotation"] == list(Z_UP)
    np.testing.assert_allclose(matrix(np.array(Z_UP)) @ [0, 0, 1], [0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(matrix(np.array(Z_UP)) @ [1, 0, 0], [1, 0, 0], atol=1e-12)


def test_trimesh_reads_the_animal_and_its_world(scene, tmp_path):
    creature, recording, data = scene
    (tmp_path / "scene.glb").write_bytes(data)
    loaded = trimesh.load_scene(tmp_path / "scene.glb")
    assert {body.name for body in creature.bodies} <= set(loaded.geometry)
    for body in creature.bodies:
        size = loaded.geometry[body.name].extents / 2
        np.testing.assert_allclose(size, body.shape.half_extents, rtol=0.02)
    document, _ = decode(data)
    names = [node["name"] for node in document["nodes"]]
    assert len(set(names)) == len(names) and {"ground", "sun"} <= set(names)
    lit = bool(np.isfinite(recording.goal).all())
    assert ("light" in names) == lit
    if lit:
        light = document["nodes"][names.index("light")]
        np.testing.assert_allclose(light["translation"], recording.goal, atol=1e-5)


@pytest.mark.slow
def test_the_skin_follows_its_bones_as_in_films():
    """The formula of the specification (glTF 2.0, section 3.7.3.3) at some instants."""
    creature, recording = synthetic.swimmer(), synthetic.swim(2.0)
    document, arrays = decode(gltf_film(Panel(creature, recording)))
    nodes, moved = document["nodes"], movements(document, arrays)
    (node,) = (node for node in nodes if "skin" in node)
    attributes = document["meshes"][node["mesh"]]["primitives"][0]["attributes"]
    points, joints, weights = (
        arrays[attributes[name]].astype(float) for name in ("POSITION", "JOINTS_0", "WEIGHTS_0")
    )
    held = document["skins"][node["skin"]]
    inverses = arrays[held["inverseBindMatrices"]].reshape(-1, 4, 4).swapaxes(1, 2).astype(float)
    places = np.concatenate([points, np.ones((len(points), 1))], 1)
    (skin,) = skins(creature)
    draped = Draped(creature, skin)
    upright = np.eye(4)
    upright[:3, :3] = matrix(np.array(Z_UP))
    for k in (0, len(recording.time) // 2, -1):
        bones = np.tile(np.eye(4), (len(held["joints"]), 1, 1))
        for bone, joint in zip(bones, held["joints"], strict=True):
            bone[:3, 3] = moved[nodes[joint]["name"], "translation"][1][k]
            bone[:3, :3] = matrix(moved[nodes[joint]["name"], "rotation"][1][k].astype(float))
        each = (upright @ bones @ inverses)[joints.astype(int)]
        shown = np.einsum("nk,nkij,nj->ni", weights, each, places)[:, :3]
        draped.move(recording.position[k], recording.rotation[k])
        np.testing.assert_allclose(shown @ upright[:3, :3], draped.mesh.points, atol=2e-5)
    # Programs without animation show the animal where it starts.
    for i, body in enumerate(creature.bodies):
        (own,) = (node for node in nodes if node["name"] == body.name)
        np.testing.assert_allclose(own["translation"], recording.position[0, i])


@pytest.mark.slow
def test_places_of_stones_and_water():
    scenes = {}
    for name in ("stones", "shore"):
        make, move, settings = SCENES[name]
        scenes[name] = decode(gltf_film(Panel(make(), move(1.0), **settings)))
    document, _ = scenes["stones"]
    stones = [node for node in document["nodes"] if node["name"].startswith("obstacle")]
    assert [node["translation"] for node in stones] == [list(s.centre) for s in _STONES]
    document, arrays = scenes["shore"]
    (water,) = (mesh for mesh in document["meshes"] if mesh["name"] == "water")
    height = arrays[water["primitives"][0]["attributes"]["POSITION"]][:, 2]
    np.testing.assert_allclose(height, 0.6, rtol=1e-6)


def test_scenery_never_shares_a_name_with_a_body():
    """Bodies have names of the scenery, and all node names stay unique."""
    make, move, settings = SCENES["stones"]
    creature, recording = make(), move(4.0)
    scenery = ("ground", "light", "sun", "obstacle1")
    given = [body.name for body in creature.bodies]
    called = dict(zip(given, [*scenery, *given[len(scenery) :]], strict=True))

    def renamed(body: Body) -> Body:
        joint = body.joint and dataclasses.replace(body.joint, parent=called[body.joint.parent])
        return dataclasses.replace(body, name=called[body.name], joint=joint)

    creature = dataclasses.replace(
        creature, bodies=tuple(map(renamed, creature.bodies)), light_sensors=()
    )
    document, _ = decode(gltf_film(Panel(creature, recording, "a title", **settings)))
    names = [node["name"] for node in document["nodes"]]
    assert len(set(names)) == len(names)
    assert {*scenery, "ground_", "sun_", "obstacle1_", "obstacle2"} <= set(names)


@pytest.mark.slow
def test_a_triangle_without_area_is_left_out():
    """The triangle closes an edge that is split on one side only."""
    box = trimesh.creation.box((0.3, 0.2, 0.1))
    a, b, c = box.faces[0]
    vertices = np.concatenate([box.vertices, [box.vertices[[a, b]].mean(0)]])
    halves = [[a, 8, c], [8, b, c], [a, b, 8]]
    shape, _ = convex_mesh(vertices, np.concatenate([box.faces[1:], halves]))
    assert len(shape.faces) == 14
    creature = Creature("stone", (Body("stone", shape, Material(1000.0)),))
    still = synthetic.walk(0.5)._replace(
        time=np.array([0.0, 1.0]),
        position=np.zeros((2, 1, 3)),
        rotation=np.tile(np.eye(3), (2, 1, 1, 1)),
        light=np.full((2, 3), np.nan),
    )
    document, arrays = decode(gltf_film(Panel(creature, still)))
    attributes = document["meshes"][0]["primitives"][0]["attributes"]
    normals = arrays[attributes["NORMAL"]]
    assert len(normals) == len(arrays[attributes["POSITION"]]) == 3 * 13
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, rtol=1e-6)


def test_quaternions_are_continuous():
    """A rotation of 720 degrees about z changes the sign of its quaternions."""
    angle = np.linspace(0, 4 * np.pi, 200)
    c, s, o = np.cos(angle), np.sin(angle), np.zeros(200)
    turn = np.moveaxis(np.array([[c, -s, o], [s, c, o], [o, o, o + 1]]), -1, 0)
    found = quaternions(turn)
    half = np.stack([o, o, np.sin(angle / 2), np.cos(angle / 2)], 1)
    np.testing.assert_allclose(found * np.sign(found[0, 3]), half, atol=1e-9)


def test_invalid_recordings_are_refused():
    creature, recording = synthetic.walker(), synthetic.walk(0.5)
    with pytest.raises(RecordingError, match="the recording is empty"):
        gltf_film(Panel(creature, recording._replace(time=recording.time[:0])))
    broken = recording._replace(position=np.full_like(recording.position, np.nan))
    with pytest.raises(RecordingError, match="the recording diverges"):
        gltf_film(Panel(creature, broken))


def test_the_khronos_validator_finds_no_issues(scene, tmp_path):
    node = shutil.which("node")
    if node is None:
        pytest.skip("there is no node")
    environment = os.environ | {"NODE_PATH": _PACKAGES}
    place = {"cwd": Path(__file__).parent, "env": environment, "capture_output": True}
    look = [node, "-e", 'require.resolve("gltf-validator")']
    if subprocess.run(look, check=False, **place).returncode:
        pytest.skip("node has no package gltf-validator (npm install gltf-validator)")
    (tmp_path / "scene.glb").write_bytes(scene[2])
    command = [node, "-e", _VALIDATE, str(tmp_path / "scene.glb")]
    done = subprocess.run(command, check=True, text=True, **place)
    issues = json.loads(done.stdout)
    # The node of a skin moves only so that three.js finds it in view.
    codes = {message["code"] for message in issues["messages"]}
    assert codes <= {"ANIMATION_CHANNEL_TARGET_NODE_SKIN"} and issues["numErrors"] == 0
