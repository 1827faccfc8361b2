"""Shapes and densities of bodies as geoms of MJCF, and back.

| here | in MJCF |
|---|---|
| box, sphere, ellipsoid | ``geom`` of the same ``type``, with half sizes |
| capsule and cylinder, along x | ``geom`` of the same ``type``, along z |
| mesh | ``mesh`` asset with the body's name, which holds its vertices and faces |
| density | ``density``. MuJoCo's mass and inertia must belong to a uniform shape |
"""

import itertools
from typing import NamedTuple
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from evo_cpg.config.schema.shape import (
    BoxConfig,
    CapsuleConfig,
    CylinderConfig,
    EllipsoidConfig,
    MeshConfig,
    ShapeConfig,
    SphereConfig,
)
from evo_cpg.creature.creature import Body, Creature
from evo_cpg.creature.mesh import ConvexMesh, MeshError, convex_mesh
from evo_cpg.creature.shapes import Box, Capsule, Cylinder, Ellipsoid, Sphere
from evo_cpg.exchange.compiled import TOLERANCE, Compiled, rotation, tidy, tidy_vector
from evo_cpg.exchange.mjcf_ground import number_text
from evo_cpg.exchange.refusals import ExchangeError

# Rounding error of an inertia tensor that was rotated, as a fraction of the largest moment. A mesh
# has corners in single precision, so `TOLERANCE` applies to its inertia.
_ROUNDING = 1e-12

# Proper rotations that map the axes of a box onto each other. Columns are the new axes in the old
# ones.
_TURNS = [
    turn
    for order in itertools.permutations(np.eye(3))
    for signs in itertools.product((1.0, -1.0), repeat=3)
    if np.linalg.det(turn := np.array(order) * np.array(signs)) > 0
]


class Placed(NamedTuple):
    """A body's shape, and the origin (m) and axes of our body frame in MuJoCo's body frame."""

    shape: ShapeConfig
    centre: np.ndarray
    turn: np.ndarray


def add_meshes(root: Element, creature: Creature) -> None:
    """Add the assets of bodies that are meshes."""
    shapes = {body.name: body.shape for body in creature.bodies}
    meshes = {name: shape for name, shape in shapes.items() if isinstance(shape, ConvexMesh)}
    asset = SubElement(root, "asset") if meshes else root
    for name, shape in meshes.items():
        vertices = number_text(*shape.points.ravel())
        faces = " ".join(str(corner) for face in shape.faces for corner in face)
        SubElement(asset, "mesh", name=name, vertex=vertices, face=faces)


def shape_attributes(body: Body) -> dict[str, str]:
    """Return attributes of a body's geom.

    Raises:
        ExchangeError: MJCF cannot hold the shape.
    """
    shape = body.shape
    if isinstance(shape, Box):
        return {"type": "box", "size": number_text(*shape.half_extents)}
    if isinstance(shape, Sphere):
        return {"type": "sphere", "size": number_text(shape.radius)}
    if isinstance(shape, Ellipsoid):
        return {"type": "ellipsoid", "size": number_text(*shape.half_extents)}
    if isinstance(shape, Capsule | Cylinder):
        kind = "capsule" if isinstance(shape, Capsule) else "cylinder"
        size = number_text(shape.radius, shape.length / 2)
        return {"type": kind, "size": size, "zaxis": number_text(1.0, 0.0, 0.0)}
    if isinstance(shape, ConvexMesh):
        return {"type": "mesh", "mesh": body.name}
    raise ExchangeError(
        f"a {type(shape).__name__} cannot be written as MJCF. "
        "Allowed: Box, Sphere, Ellipsoid, Capsule, Cylinder, ConvexMesh"
    )


def only_geom(compiled: Compiled, body: int) -> int:
    """Return the only geom of a body. Refuse a body with none or several."""
    model = compiled.model
    count = int(model.body_geomnum[body])
    if count != 1:
        raise compiled.item("body", body).refusal(f"it has {count} geoms", "one, its shape")
    return int(model.body_geomadr[body])


def place_body(compiled: Compiled, body: int, geom: int, is_root: bool) -> Placed:
    """Place our frame at the geom's centre, turned as little from the body's as its shape allows.

    The root's frame is turned as little as possible from the world's. Both must agree in the
    neutral pose.
    """
    model, kinds = compiled.model, compiled.mujoco.mjtGeom
    size = model.geom_size[geom]
    outer = rotation(compiled, model.body_quat[body]) if is_root else np.eye(3)
    turn = outer @ rotation(compiled, model.geom_quat[geom])
    kind = int(model.geom_type[geom])
    item = compiled.item("geom", geom)
    if kind == kinds.mjGEOM_SPHERE:
        values = {"type": "sphere", "radius": tidy(size[0])}
        shape, turn = item.section(SphereConfig, values), np.eye(3)
    elif kind in (kinds.mjGEOM_CAPSULE, kinds.mjGEOM_CYLINDER):
        # MuJoCo's capsules and cylinders lie along z, ours along x. Either end may be the front.
        turn = _shortest_turn(turn[:, 2] if turn[0, 2] >= 0 else -turn[:, 2])
        values = {"radius": tidy(size[0]), "length": tidy(2 * size[1])}
        if kind == kinds.mjGEOM_CAPSULE:
            shape = item.section(CapsuleConfig, {"type": "capsule", **values})
        else:
            shape = item.section(CylinderConfig, {"type": "cylinder", **values})
    elif kind in (kinds.mjGEOM_BOX, kinds.mjGEOM_ELLIPSOID):
        best = max(_TURNS, key=lambda own: np.trace(turn @ own))
        turn, size = turn @ best, np.abs(best.T @ size)
        if kind == kinds.mjGEOM_BOX:
            values = {"type": "box", "size": tuple(map(tidy, 2 * size))}
            shape = item.section(BoxConfig, values)
        else:
            values = {"type": "ellipsoid", "radii": tuple(map(tidy, size))}
            shape = item.section(EllipsoidConfig, values)
    elif kind == kinds.mjGEOM_MESH:
        # MuJoCo has turned the mesh to its principal axes.
        shape, turn = _read_mesh(compiled, geom, turn), np.eye(3)
    else:
        word = str(kinds(kind).name).removeprefix("mjGEOM_").lower()
        raise item.refusal(f"it is a {word}", "box, sphere, ellipsoid, capsule, cylinder, mesh")
    if is_root and not np.allclose(turn, np.eye(3), rtol=0, atol=TOLERANCE):
        raise item.refusal(
            f"the root's {shape.type} is rotated in the world",
            "edges and axes along x, y and z, a capsule's or cylinder's along x",
        )
    return Placed(shape, np.array(model.geom_pos[geom]), outer.T @ turn)


def uniform_density(compiled: Compiled, body: int, geom: int, own: Placed) -> float:
    """Return the density of a body, kg/m^3. Refuse a body without uniform density."""
    model = compiled.model
    shape = own.shape.build()
    mass = float(model.body_mass[body])
    axes = rotation(compiled, model.body_iquat[body])
    found = axes @ np.diag(model.body_inertia[body]) @ axes.T
    expected = own.turn @ shape.inertia_tensor(mass) @ own.turn.T
    reach = float(np.linalg.norm(shape.half_extents))
    off_centre = np.abs(model.body_ipos[body] - own.centre).max() > TOLERANCE * reach
    # Compare in the principal frame, where the moments of a thin rod do not hide one another.
    moments, frame = np.linalg.eigh(expected)
    off = np.abs(frame.T @ found @ frame - np.diag(moments))
    rounding = TOLERANCE if own.shape.type == "mesh" else _ROUNDING
    within = np.maximum(TOLERANCE * np.sqrt(np.outer(moments, moments)), rounding * moments.max())
    if off_centre or (off > within).any():
        raise compiled.item("body", body).refusal(
            f"its centre of mass or inertia does not match its {own.shape.type}",
            "uniform density, without an inertial element",
        )
    return mass / shape.volume if shape.volume else float("inf")


def _read_mesh(compiled: Compiled, geom: int, turn: np.ndarray) -> MeshConfig:
    """Return the mesh of a geom about its centre of mass, in axes rotated by ``turn``."""
    model, item = compiled.model, compiled.item("geom", geom)
    mesh = int(model.geom_dataid[geom])
    first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    vertices = np.array(model.mesh_vert[first : first + count], float) @ turn.T
    first, count = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
    faces = np.array(model.mesh_face[first : first + count], int)
    try:
        _, centre = convex_mesh(vertices, faces)
    except MeshError as error:
        raise item.refusal(f"its mesh: {error}", "a closed convex mesh") from None
    # MuJoCo keeps vertices in single precision.
    vertices = tuple(tidy_vector(vertex) for vertex in vertices - centre)
    values = {"type": "mesh", "vertices": vertices, "faces": faces.tolist()}
    return item.section(MeshConfig, values)


def _shortest_turn(direction: np.ndarray) -> np.ndarray:
    """Return the shortest rotation from x to a unit vector that does not point backwards."""
    x, y, z = direction
    cross = np.array([[0, -y, -z], [y, 0, 0], [z, 0, 0]])
    return np.eye(3) + cross + cross @ cross / (1 + x)
