"""Shapes and densities of bodies as geoms of MJCF, and back.

| here | in MJCF |
|---|---|
| box, sphere, ellipsoid | ``geom`` of the same ``type``, with half sizes |
| capsule, cylinder, along x | ``geom`` of the same ``type``, along z |
| mesh | ``mesh`` asset, which holds its vertices and faces |
| shape of a body | its largest ``geom``. Our frame is at its centre, along its axes |
| parts | the other ``geom``s |

A body has the shapes of its colliding geoms, or of all its geoms if none collides. Drawings beside
colliding geoms are left out: every shape costs time, and would touch the ground. A root keeps
the axes of the world, because its x axis is the animal's forward direction. A mesh becomes the hull
of its corners, as in MuJoCo's collisions.

Planes, boulders and blocks of the ground are one geom each and exact. A shore is three slabs, of
which the outer two are finite. A relief is a height field. MuJoCo halves its cells into triangles,
and ours are bilinear. MuJoCo's field ends at its edges, and ours continues level.
"""

import itertools
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from evo_cpg.creature.algebra.rotation import matrix_to_euler
from evo_cpg.creature.creature import Body, Creature
from evo_cpg.creature.cylinder import Cylinder
from evo_cpg.creature.mesh import ConvexMesh, MeshError, convex_mesh, few_corners_hull
from evo_cpg.creature.shapes import Box, Capsule, Ellipsoid, Sphere
from evo_cpg.io.models.compiled import Compiled, tidy, tidy_vector
from evo_cpg.io.models.refusals import ExchangeError
from evo_cpg.io.models.rigid import Rigid, is_flat
from evo_cpg.physics.contact.contact_model import Ground
from evo_cpg.physics.contact.terrain import Block, Boulder, GroundPart, Plane, Relief, Shore

# Most corners of a mesh, and of further attempts: fewer corners are farther apart, so the hull has
# no needles. Contact and buoyancy use at most 64 (`evo_cpg.creature.mesh`).
_MOST_CORNERS = 100, 50, 25

# Digits of the coordinates of corners after the decimal point, m. Files have single precision.
_DIGITS = 9

# Largest difference from the world's axes of a root's shape.
_ALIGNED = 1e-12

# Proper rotations that map the axes of a box onto each other. Columns are the new axes in the old
# ones.
_TURNS = [
    turn
    for order in itertools.permutations(np.eye(3))
    for signs in itertools.product((1.0, -1.0), repeat=3)
    if np.linalg.det(turn := np.array(order) * np.array(signs)) > 0
]

# Reach of slabs, and thickness of slabs and height fields, m. An animal walks less in a trial, and
# sinks less in a step.
_FAR, _THICK = 100.0, 1.0

# Decimal places of coordinates (m) and directions.
_PLACES = 15


class Solid(NamedTuple):
    """A shape of the file.

    Attributes:
        geom: MuJoCo's number of the geom.
        shape: its keys in a configuration.
        centre: origin of its frame in the neutral pose, in the world, m.
        turn: rotation from its frame to the world ``(3, 3)``.
        size: volume of the box around it, m^3, without the ends of a capsule.
    """

    geom: int
    shape: dict[str, Any]
    centre: np.ndarray
    turn: np.ndarray
    size: float


class Placed(NamedTuple):
    """A rigid body with our frame.

    Attributes:
        rigid: its parts in the file.
        name: its name.
        centre: origin of our frame in the neutral pose, in the world, m.
        turn: rotation from our frame to the world ``(3, 3)``.
        solids: its shapes. The first one is in our frame, if ``own_shape``.
        own_shape: whether the first shape is the body's own, and not a part.
    """

    rigid: Rigid
    name: str
    centre: np.ndarray
    turn: np.ndarray
    solids: tuple[Solid, ...]
    own_shape: bool

    def place(self, point: np.ndarray) -> list[float]:
        """Return coordinates in our frame of a point in the world."""
        return tidy_vector(self.turn.T @ (point - self.centre))


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


def place_body(compiled: Compiled, rigid: Rigid, name: str) -> Placed:
    """Return the shapes of a rigid body, and its frame.

    The frame is at the centre of the largest shape, turned as little from MuJoCo's as the shape
    allows. A root without a shape along its axes has all its shapes as parts.
    """
    is_root, world = rigid.parent is None, np.eye(3)
    model, solids = compiled.model, []
    every = [
        geom
        for geom in range(model.ngeom)
        if model.geom_bodyid[geom] in rigid.members and not is_flat(compiled, geom)
    ]
    paired = {*map(int, model.pair_geom1), *map(int, model.pair_geom2)}
    colliding = [
        geom
        for geom in every
        if model.geom_contype[geom] or model.geom_conaffinity[geom] or geom in paired
    ]
    for geom in colliding or every:
        with compiled.refusals.collecting():
            outer = world if is_root else np.array(compiled.data.xmat[rigid.lead]).reshape(3, 3)
            solids.append(read_solid(compiled, geom, outer, is_root))
    solids.sort(key=lambda solid: -solid.size)
    fit = solids
    if is_root:
        fit = [solid for solid in solids if np.abs(solid.turn - world).max() < _ALIGNED]
    if fit:
        first = fit[0]
        ordered = (first, *(solid for solid in solids if solid is not first))
        return Placed(rigid, name, first.centre, first.turn, ordered, True)
    centre, turn = np.zeros(3), world
    if rigid.lead:
        centre = np.array(compiled.data.xpos[rigid.lead])
        if not is_root:
            turn = np.array(compiled.data.xmat[rigid.lead]).reshape(3, 3)
    return Placed(rigid, name, centre, turn, tuple(solids), False)


def body_keys(
    placed: Placed, materials: Sequence[str], colors: Sequence[str | None]
) -> dict[str, Any]:
    """Return the keys of a body that describe its shapes.

    Materials and colours are those of the shapes. A body without shapes has one material.
    """
    keys: dict[str, Any] = {"shape": None, "material": materials[0]}
    color = colors[0] if colors else None
    if color:
        keys["color"] = color
    if placed.own_shape:
        keys["shape"] = placed.solids[0].shape
    parts = []
    first = int(placed.own_shape)
    for solid, material, own_color in zip(
        placed.solids[first:], materials[first:], colors[first:], strict=False
    ):
        part: dict[str, Any] = {"shape": solid.shape, "at": placed.place(solid.centre)}
        angles = tidy_vector(np.rad2deg(matrix_to_euler(placed.turn.T @ solid.turn)))
        if np.any(angles):
            part["rotation_deg"] = angles
        if material != materials[0]:
            part["material"] = material
        if own_color and own_color != color:
            part["color"] = own_color
        parts.append(part)
    return keys | ({"parts": parts} if parts else {})


def read_solid(compiled: Compiled, geom: int, outer: np.ndarray, keeps_axes: bool) -> Solid:
    """Return the shape of a geom. Its frame is turned as little as possible from its body's.

    ``outer`` are the axes of its body in the world ``(3, 3)``. If it ``keeps_axes``, the corners of
    a mesh are turned instead of its frame.

    Raises:
        RefusedError: no shape of ours is like it.
    """
    model, data, kinds = compiled.model, compiled.data, compiled.mujoco.mjtGeom
    size = np.array(model.geom_size[geom])
    centre = np.array(data.geom_xpos[geom])
    turn = np.array(data.geom_xmat[geom]).reshape(3, 3)
    inner = outer.T @ turn
    kind, item = int(model.geom_type[geom]), compiled.item("geom", geom)
    if kind == kinds.mjGEOM_SPHERE:
        shape = {"type": "sphere", "radius": tidy(size[0])}
        return Solid(geom, shape, centre, outer, float((2 * size[0]) ** 3))
    if kind in (kinds.mjGEOM_CAPSULE, kinds.mjGEOM_CYLINDER):
        # MuJoCo's capsules lie along z, ours along x. Either end may be the front.
        x, y, z = inner[:, 2] if inner[0, 2] >= 0 else -inner[:, 2]
        # The shortest rotation from x to that direction.
        cross = np.array([[0, -y, -z], [y, 0, 0], [z, 0, 0]])
        own = np.eye(3) + cross + cross @ cross / (1 + x)
        word = "capsule" if kind == kinds.mjGEOM_CAPSULE else "cylinder"
        shape = {"type": word, "radius": tidy(size[0]), "length": tidy(2 * size[1])}
        return Solid(geom, shape, centre, outer @ own, float(8 * size[0] ** 2 * size[1]))
    if kind in (kinds.mjGEOM_BOX, kinds.mjGEOM_ELLIPSOID):
        best = max(_TURNS, key=lambda own: np.trace(inner @ own))
        sides = np.abs(best.T @ size)
        if kind == kinds.mjGEOM_BOX:
            shape = {"type": "box", "size": [tidy(2 * side) for side in sides]}
        else:
            shape = {"type": "ellipsoid", "radii": [tidy(side) for side in sides]}
        return Solid(geom, shape, centre, turn @ best, float(8 * np.prod(size)))
    if kind == kinds.mjGEOM_MESH:
        return _read_mesh(compiled, geom, outer if keeps_axes else None)
    word = str(kinds(kind).name).removeprefix("mjGEOM_").lower()
    raise item.refusal(
        f"it is a {word} on the animal", "box, sphere, ellipsoid, capsule, cylinder, mesh"
    )


def _read_mesh(compiled: Compiled, geom: int, axes: np.ndarray | None) -> Solid:
    """Return the hull of a mesh, in the frame of its file, or with the origin there and own axes.

    MuJoCo has moved the mesh to its centre and turned it to its principal axes.
    """
    model, data = compiled.model, compiled.data
    mesh = int(model.geom_dataid[geom])
    first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    vertices = np.array(model.mesh_vert[first : first + count], float)
    moved = np.zeros(9)
    compiled.mujoco.mju_quat2Mat(moved, model.mesh_quat[mesh])
    back = moved.reshape(3, 3)
    turn = np.array(data.geom_xmat[geom]).reshape(3, 3) @ back.T
    centre = np.array(data.geom_xpos[geom]) - turn @ np.array(model.mesh_pos[mesh])
    vertices = vertices @ back.T + np.array(model.mesh_pos[mesh])
    if axes is not None:
        vertices, turn = vertices @ (axes.T @ turn).T, axes
    try:
        shape, corners = _body_of(vertices)
    except MeshError as error:
        raise compiled.item("geom", geom).refusal(
            f"its mesh cannot be a body: {error}", "a solid mesh of 1 mm to 100 m"
        ) from None
    kept = len(shape["vertices"])
    if kept < corners:
        compiled.refusals.change(
            str(compiled.item("geom", geom)),
            f"the hull of its mesh, with {corners} corners, becomes one with {kept}",
        )
    return Solid(geom, shape, centre, turn, float(np.prod(np.ptp(vertices, axis=0))))


def _body_of(vertices: np.ndarray) -> tuple[dict[str, Any], int]:
    """Return the hull with the most corners that can be a body, and the whole hull's corner count.

    Raises:
        MeshError: no hull of the points can be a body.
    """
    fault: MeshError | None = None
    whole, _ = few_corners_hull(vertices, len(vertices))
    for most in _MOST_CORNERS:
        try:
            corners, faces = few_corners_hull(whole, most)
            corners = np.round(corners, _DIGITS)
            convex_mesh(corners, faces)
        except MeshError as error:
            fault = fault or error
        else:
            shape = {"type": "mesh", "vertices": corners.tolist(), "faces": faces.tolist()}
            return shape, len(whole)
    assert fault is not None
    raise fault


def number_text(*values: float) -> str:
    """Return numbers as the shortest text that reads back exactly."""
    # Adding 0 removes a negative zero.
    return " ".join(np.format_float_positional(float(v) + 0.0, trim="-") for v in values)


def set_effects(element: Element, values: Mapping[str, float]) -> None:
    """Set attributes of an element, except those that are 0 and have no effect."""
    for key, value in values.items():
        if value:
            element.set(key, number_text(value))


def place_text(values: np.ndarray) -> str:
    """Return coordinates without the digits that sines and cosines leave of a zero."""
    return number_text(*np.round(values, _PLACES))


def add_ground(root: Element, place: Element, ground: Ground, taken: list[str]) -> list[str]:
    """Add the floor and the obstacles.

    Args:
        root: the ``mujoco`` element.
        place: the ``worldbody`` element.
        ground: ground to add.
        taken: names of the creature's geoms.

    Returns:
        The names of the geoms.

    Raises:
        ExchangeError: MJCF cannot hold a part.
    """
    parts = {"ground": ground.floor}
    parts |= {f"obstacle{i + 1}": part for i, part in enumerate(ground.obstacles)}
    names = []
    for name, part in parts.items():
        solids = _solids(root, name, part)
        for i, solid in enumerate(solids):
            unique = f"{name}.{i + 1}" if len(solids) > 1 else name
            while unique in taken:
                unique += "_"
            geom = SubElement(place, "geom", {"name": unique, **solid})
            geom.set("friction", number_text(ground.dynamic_friction))
            names.append(unique)
    return names


def _solids(root: Element, name: str, part: GroundPart) -> list[dict[str, str]]:
    """Return the attributes of the geoms that make up a part. Add the asset of a height field."""
    if isinstance(part, Plane):
        normal = np.array(part.normal) / np.linalg.norm(part.normal)
        return [
            {
                "type": "plane",
                "size": number_text(0.0, 0.0, 1.0),
                "pos": place_text(part.height * normal),
                "zaxis": place_text(normal),
            }
        ]
    if isinstance(part, Boulder):
        ball = {"type": "sphere", "size": number_text(part.radius)}
        return [ball | {"pos": number_text(*part.centre)}]
    if isinstance(part, Block):
        box = {"type": "box", "size": number_text(*part.half_extents)}
        turn = number_text(0.0, 0.0, part.heading)
        return [box | {"pos": number_text(*part.centre), "euler": turn}]
    if isinstance(part, Shore):
        return _shore(part)
    if isinstance(part, Relief):
        heights = np.asarray(part.heights, float)
        lowest, rise = float(heights.min()), float(np.ptp(heights))
        half = part.spacing * (np.array(heights.shape) - 1) / 2
        asset = root.find("asset")
        if asset is None:
            asset = Element("asset")
            # The asset follows compiler, option and default.
            root.insert(3, asset)
        field = SubElement(asset, "hfield", name=name)
        field.set("ncol", str(heights.shape[0]))
        field.set("nrow", str(heights.shape[1]))
        # MuJoCo scales heights to 0 to 1, and has the last row first, as on a map.
        field.set("size", number_text(*half, rise or 1.0, _THICK))
        field.set("elevation", number_text(*(heights.T[::-1] - lowest).ravel()))
        middle = number_text(*(np.array(part.corner) + half), lowest)
        return [{"type": "hfield", "hfield": name, "pos": middle}]
    raise ExchangeError(
        f"ground with a {type(part).__name__} cannot be written as MJCF. "
        "Allowed: Plane, Boulder, Block, Shore, Relief"
    )


def _shore(part: Shore) -> list[dict[str, str]]:
    """Return slabs whose upper faces meet at the beginning and end of the slope."""
    first = np.array([part.start, part.start_height])
    last = np.array([part.stop, part.stop_height])
    out = np.array([_FAR, 0.0])
    slabs = []
    for begin, end in ((first - out, first), (first, last), (last, last + out)):
        length = float(np.linalg.norm(end - begin))
        along, up = (end - begin) / length
        middle = (begin + end) / 2 - _THICK / 2 * np.array([-up, along])
        across = part.axis == "y"
        size = (_FAR, length / 2) if across else (length / 2, _FAR)
        centre = (0.0, middle[0]) if across else (middle[0], 0.0)
        axes = (1, 0, 0, 0, along, up) if across else (along, 0, up, 0, 1, 0)
        slabs.append(
            {
                "type": "box",
                "size": number_text(*size, _THICK / 2),
                "pos": place_text(np.array([*centre, middle[1]])),
                "xyaxes": place_text(np.array(axes, float)),
            }
        )
    return slabs
