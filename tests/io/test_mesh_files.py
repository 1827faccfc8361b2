"""Meshes from files: their paths, the bodies built from them, and errors."""

import contextlib
import json

import numpy as np
import pytest
import trimesh
import yaml

from evo_cpg.creature.creature import neutral_pose
from evo_cpg.creature.mesh import ConvexMesh
from evo_cpg.creature.shapes import Box
from evo_cpg.io.build import build_creature
from evo_cpg.io.errors import ConfigError
from evo_cpg.io.load import check_config, dump_config, load_config
from polyhedra import TETRAHEDRON, TETRAHEDRON_FACES

SIZE = (0.3, 0.2, 0.1)
CREATURE = {
    "name": "duck",
    "materials": {"wood": {"density": 500}},
    "bodies": [
        {"name": "trunk", "shape": {"type": "box", "size": list(SIZE)}, "material": "wood"},
        {
            "name": "head",
            "shape": {"type": "mesh", "file": "head.stl", "scale": 0.001},
            "material": "wood",
            "joint": {
                "parent": "trunk",
                "at": [0.15, 0, 0],
                "child_at": [0.01, 0.02, 0.03],
                "axes": ["z"],
                "actuator": {"gain": 1},
            },
        },
    ],
    "light_sensors": [{"body": "head", "position": [0.1, 0.02, 0.03]}],
    "depth_sensors": [{"body": "head", "position": [0.1, 0.02, 0.03]}],
}


@pytest.fixture
def folder(tmp_path):
    """Return the folder of an experiment, with the creature and its mesh in a subfolder.

    The head is drawn in millimetres, with its back at the origin.
    """
    parts = tmp_path / "animals"
    parts.mkdir()
    head = trimesh.creation.box(np.array(SIZE) * 1000)
    head.apply_translation([150, 0, 0])
    for name in ("head.stl", "head.obj"):
        head.export(parts / name)
    (tmp_path / "folder.stl").mkdir()
    (parts / "duck.yaml").write_text(yaml.safe_dump(CREATURE))
    (tmp_path / "x.yaml").write_text("name: x\ncreature: animals/duck.yaml\n")
    return tmp_path


def load(folder, *overrides: str):
    return load_config(folder / "x.yaml", overrides)


@pytest.mark.parametrize("suffix", ["stl", "obj"])
def test_mesh_path_is_relative_to_the_file_that_names_it(folder, suffix):
    """The body equals the box that was exported, up to the file's single precision."""
    override = () if suffix == "stl" else ("creature.bodies.1.shape.file=animals/head.obj",)
    shape = build_creature(load(folder, *override), "x").bodies[1].shape
    assert isinstance(shape, ConvexMesh)
    assert len(shape.vertices) == 8 and len(shape.faces) == 12
    assert shape.volume == pytest.approx(Box(SIZE).volume, rel=1e-6)
    np.testing.assert_allclose(
        np.diag(shape.inertia(1.0)), np.diag(Box(SIZE).inertia(1.0)), rtol=1e-6
    )


def test_an_override_can_scale_a_mesh(folder):
    shape = build_creature(load(folder, "creature.bodies.1.shape.scale=0.002"), "x").bodies[1].shape
    np.testing.assert_allclose(shape.half_extents, SIZE, rtol=1e-6)
    three = "creature.bodies.1.shape.scale=[0.001, 0.002, 0.004]"
    shape = build_creature(load(folder, three), "x").bodies[1].shape
    np.testing.assert_allclose(shape.half_extents, [0.15, 0.2, 0.2], rtol=1e-6)


def test_positions_are_in_the_frame_of_the_file(folder):
    """Anchor, eye and gauge are converted to the body's frame at its centre of mass."""
    creature = build_creature(load(folder), "x")
    head = creature.bodies[1]
    assert head.joint is not None
    np.testing.assert_allclose(head.joint.child_anchor, [0.01 - 0.15, 0.02, 0.03], atol=1e-7)
    np.testing.assert_allclose(creature.light_sensors[0].position, [-0.05, 0.02, 0.03], atol=1e-7)
    np.testing.assert_allclose(creature.depth_sensors[0].position, [-0.05, 0.02, 0.03], atol=1e-7)
    centres, _ = neutral_pose(creature)
    np.testing.assert_allclose(centres[1], [0.15 + 0.14, -0.02, -0.03], atol=1e-7)


def test_joint_position_on_a_mesh_is_in_its_frame(folder):
    """In a row of two heads, ``at`` is in the file's frame of the predecessor."""
    head = CREATURE["bodies"][1] | {"name": "h{i}", "repeat": 2}
    mesh = {"name": "root", "shape": head["shape"], "material": "wood"}
    chain = head | {"joint": head["joint"] | {"parent": "root"}}
    (folder / "animals" / "duck.yaml").write_text(
        yaml.safe_dump(
            CREATURE | {"bodies": [mesh, chain], "light_sensors": [], "depth_sensors": []}
        )
    )
    centres, _ = neutral_pose(build_creature(load(folder), "x"))
    np.testing.assert_allclose(np.diff(centres, axis=0), [[0.14, -0.02, -0.03]] * 2, atol=1e-7)


def test_saved_configuration_contains_the_mesh(folder):
    """The configuration of a run folder needs no other file, and gives an equal creature."""
    config = load(folder)
    text = dump_config(config)
    assert "head.stl" not in text
    again = check_config(yaml.safe_load(text), "run.yaml")
    assert again == config
    assert build_creature(again, "x") == build_creature(config, "x")


def test_vertices_and_faces_can_be_in_the_configuration(folder):
    written = {"vertices": TETRAHEDRON.tolist(), "faces": TETRAHEDRON_FACES.tolist()}
    shape = yaml.safe_dump({"type": "mesh", **written}, default_flow_style=True)
    override = f"creature.bodies.1.shape={' '.join(shape.split())}"
    made = build_creature(load(folder, override), "x").bodies[1].shape
    assert made.volume == pytest.approx(0.001, rel=1e-12)


@pytest.mark.parametrize(
    ("override", "expected"),
    [
        ("shape.file=nowhere.stl", "shape.file: nowhere.stl: no such file"),
        ("shape.file=head.step", "file: head.step: '.step' is not known. Allowed: .glb, .obj"),
        ("shape.file=3", "shape.file: 3: must be text"),
        ("shape.scale=big", "shape.scale: 'big': must be a number or a list of 3 numbers"),
        ("shape.scale=100000000000000000000", "scale: 1(0*): must be less than 1000000000"),
        ("shape.scle=2", "shape.scle: unknown key: did you mean 'scale'"),
        ("shape.scale=1", "head.stl: its longest side is 300 m. .* set scale: 0.001"),
        ("shape={type: mesh}", "shape.file: is missing and has no default"),
        ("shape={file: ok.stl}", "shape.type: is missing and has no default"),
        (
            "shape={type: mesh, vertices: [[0, 0, 0]], faces: [[0, 1, 100000000000000000000]]}",
            "shape.faces.0.2: 1(0*): must be less than 2147483648",
        ),
        (f"shape.file={'x' * 5000}.stl", r"file: x{60}: cannot be read \(File name too long\)"),
        ('shape.file="a\\0.stl"', r"file: a.\.stl: cannot be read \(.*null"),
        ("shape.file=folder.stl", "file: folder.stl: is a folder"),
        ("shape={type: mesh, vertices: [], faces: []}", "bodies.1.shape: it has no faces"),
        ("shape={type: mash}", "Allowed: .*'mesh'"),
    ],
)
def test_invalid_keys_of_a_mesh_are_named(folder, override, expected):
    with pytest.raises(ConfigError, match=expected) as caught:
        load(folder, f"creature.bodies.1.{override}")
    assert str(caught.value).startswith(f"{folder / 'x.yaml'}: creature.bodies.1.shape")


@pytest.mark.parametrize("suffix", ["stl", "obj"])
def test_invalid_mesh_is_rejected_with_its_key(folder, suffix):
    """`creature/test_mesh_shape.py` has a mesh for each reason."""
    trimesh.creation.annulus(0.05, 0.1, 0.1, sections=16).export(folder / f"bad.{suffix}")
    words = (
        rf"x.yaml: creature.bodies.1.shape.file: bad.{suffix}: it is not convex: vertex \d+ lies"
    )
    with pytest.raises(ConfigError, match=words):
        load(folder, f"creature.bodies.1.shape={{type: mesh, file: bad.{suffix}}}")


@pytest.mark.parametrize(
    ("suffix", "content", "expected"),
    [
        ("stl", b"", r"bad.stl: cannot be read as a mesh \(it has no faces\)"),
        ("stl", b"\x89PNG\r\n" + bytes(200), r"cannot be read as a mesh \(it has no faces\)"),
        ("stl", b"solid nothing\nendsolid nothing\n", "bad.stl: cannot be read as a mesh"),
        ("glb", b"glTF", "it is no binary glTF"),
        ("glb", b"no glTF at all, but long enough", "it is no binary glTF"),
    ],
)
def test_file_without_a_mesh_is_rejected(folder, suffix, content, expected):
    (folder / f"bad.{suffix}").write_bytes(content)
    with pytest.raises(ConfigError, match=expected):
        load(folder, f"creature.bodies.1.shape={{type: mesh, file: bad.{suffix}}}")


@pytest.mark.parametrize(
    ("number", "expected"),
    [
        (np.nan, "a coordinate of a vertex is not a finite number"),
        (np.inf, "a coordinate of a vertex is not a finite number"),
        (1e38, r"its longest side is 1e\+38 m. Allowed: 0.001 to 100 m"),
    ],
)
@pytest.mark.filterwarnings("error")
def test_invalid_coordinates_are_rejected_without_a_warning(folder, number, expected):
    box = trimesh.creation.box(SIZE)
    triangles = box.vertices[box.faces].copy()
    triangles[0, 0, 0] = number
    record = np.zeros(12, [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("end", "<u2")])
    record["corners"] = triangles
    content = bytes(80) + np.uint32(12).tobytes() + record.tobytes()
    (folder / "bad.stl").write_bytes(content)
    with pytest.raises(ConfigError, match=expected):
        load(folder, "creature.bodies.1.shape={type: mesh, file: bad.stl}")


def test_an_obj_with_materials_and_groups_is_one_body(folder):
    """Vertices that differ only in texture or normal are merged. Materials are ignored."""
    lines = ["mtllib missing.mtl", "o first"]
    box = trimesh.creation.box(SIZE)
    lines += [f"v {x} {y} {z}" for x, y, z in box.vertices]
    lines += [f"vt {i / 40} 0.5" for i in range(36)]
    for i, face in enumerate(box.faces):
        if i == 6:
            lines += ["o second", "usemtl other"]
        lines.append("f " + " ".join(f"{v + 1}/{3 * i + k + 1}" for k, v in enumerate(face)))
    (folder / "box.obj").write_text("\n".join(lines))
    config = load(folder, "creature.bodies.1.shape={type: mesh, file: box.obj}")
    shape = build_creature(config, "x").bodies[1].shape
    assert isinstance(shape, ConvexMesh) and len(shape.vertices) == 8


def glb(path, header: dict | None = None, mesh: trimesh.Trimesh | None = None) -> None:
    """Write a box, or another mesh, as a binary glTF file, with replaced sections of its header."""
    made = (mesh or trimesh.creation.box(SIZE)).export(file_type="glb")
    length = int.from_bytes(made[12:16], "little")
    text = json.dumps(json.loads(made[20 : 20 + length]) | (header or {})).encode()
    text += b" " * (-len(text) % 4)
    rest = made[20 + length :]
    total = (20 + len(text) + len(rest)).to_bytes(4, "little")
    path.write_bytes(made[:8] + total + len(text).to_bytes(4, "little") + made[16:20] + text + rest)


@pytest.mark.parametrize("suffix", ["glb", "ply", "off"])
def test_other_formats_give_the_same_body(folder, suffix):
    """glTF has z ahead and y up. The other formats have the axes of the configuration."""
    sides = (0.2, 0.1, 0.3) if suffix == "glb" else SIZE
    box = trimesh.creation.box(sides)
    content = box.export(file_type=suffix)
    (folder / f"box.{suffix}").write_bytes(
        content if isinstance(content, bytes) else content.encode()
    )
    config = load(folder, f"creature.bodies.1.shape={{type: mesh, file: box.{suffix}}}")
    shape = config.creature.bodies[1].shape.build()[0][0]
    np.testing.assert_allclose(2 * shape.half_extents, SIZE, rtol=1e-6)


def test_all_nodes_of_a_glb_are_one_mesh(folder):
    """Two boxes side by side are two pieces. Their convex hull is one box."""
    box = trimesh.creation.box(SIZE)
    scene = trimesh.Scene([box])
    place = np.eye(4)
    place[0, 3] = 1.0
    scene.graph.update("second", matrix=place, geometry=next(iter(scene.geometry)))
    (folder / "two.glb").write_bytes(scene.export(file_type="glb"))
    given = "creature.bodies.1.shape={type: mesh, file: two.glb%s}"
    with pytest.raises(ConfigError, match="it consists of 2 separate pieces"):
        load(folder, given % "")
    shape = load(folder, given % ", hull: true").creature.bodies[1].shape.build()[0][0]
    np.testing.assert_allclose(2 * shape.half_extents, [0.1, 1.3, 0.2], rtol=1e-6)


def test_the_hull_of_a_fine_mesh_has_few_triangles(folder):
    """A ball of 5120 triangles: its hull keeps 99 % of the volume."""
    ball = trimesh.creation.icosphere(4, radius=0.1)
    ball.export(folder / "ball.stl")
    given = "creature.bodies.1.shape={type: mesh, file: ball.stl, hull: true}"
    shape = load(folder, given).creature.bodies[1].shape.build()[0][0]
    assert len(shape.faces) <= 2000
    assert shape.volume == pytest.approx(ball.volume, rel=0.01)


@pytest.mark.parametrize(
    ("header", "expected"),
    [
        ({"nodes": [{"mesh": 0}] * 1001}, "it has 1001 nodes. Allowed: at most 1000"),
        ({"accessors": [{"count": 10**9}]}, "its arrays have 1000000000 entries"),
        ({"buffers": [{"uri": "/etc/passwd", "byteLength": 9}]}, "it refers to other files"),
        ({"extensionsRequired": ["KHR_draco_mesh_compression"]}, "needs the extensions KHR_draco"),
        ({"meshes": [{"primitives": []}]}, "cannot be read as a mesh"),
        ({"nodes": 3}, "cannot be read as a mesh"),
        ({"nodes": [{"mesh": 7}]}, "cannot be read as a mesh"),
        ({"nodes": [{"mesh": 0, "children": [0]}]}, None),
    ],
)
def test_a_wrong_or_huge_glb_is_refused(folder, header, expected):
    glb(folder / "bad.glb", header)
    if expected is None:
        # A node within itself is read, or refused, but never followed forever.
        with contextlib.suppress(ConfigError):
            load(folder, "creature.bodies.1.shape={type: mesh, file: bad.glb}")
        return
    with pytest.raises(ConfigError, match=f"creature.bodies.1.shape.file: bad.glb: .*{expected}"):
        load(folder, "creature.bodies.1.shape={type: mesh, file: bad.glb}")


def test_many_copies_in_a_glb_are_refused_before_they_are_made(folder):
    ball = trimesh.creation.icosphere(4)
    glb(folder / "bad.glb", {"nodes": [{"mesh": 0}] * 1000}, ball)
    with pytest.raises(ConfigError, match="its nodes have 5120000 triangles"):
        load(folder, "creature.bodies.1.shape={type: mesh, file: bad.glb}")
