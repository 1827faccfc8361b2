"""Convex meshes as shapes: polyhedra with exact mass and moments.

`convex_mesh` moves a mesh so that it is centred on its own frame. Two bounds keep steps fast with a
fine mesh:

- Contact with the ground and buoyancy use the hull of at most `MOST_CORNERS` corners at which three
  planes meet. If the mesh has more corners, the corner farthest from the centre is chosen first.
  Each further corner is the farthest from all corners chosen before. For buoyancy the hull is
  scaled to the mesh's volume about the mesh's centre.
- The quadrature over the surface in water has at most about as many points as an ellipsoid's.
  Coplanar triangles are one facet. If there are more facets than points, neighbouring facets share
  a point.
"""

import dataclasses
import functools
import itertools
from typing import ClassVar, NamedTuple

import numpy as np
from typing_extensions import override

from evo_cpg.creature.algebra.decisions import chosen
from evo_cpg.creature.algebra.numerics import Number, Numbers, xp
from evo_cpg.creature.shapes import (
    Cell,
    FloorPart,
    ObstaclePart,
    RoundedBox,
    Shape,
    SkinMesh,
    Surface,
)

# More triangles do not change the physics, but fill the run folder's config.
MOST_TRIANGLES = 2000
MOST_CORNERS = 64
# Bounds of the longest side, m: other meshes have most likely been drawn in other units.
SHORTEST, LONGEST = 1e-3, 100.0
# Largest distance of a corner beyond the plane of a face, as a fraction of the longest side, and
# largest volume of a flat mesh, as a fraction of the cube of that side.
_DENT, _FLAT = 1e-3, 1e-9

# Height of a triangle below which rounding in files (single precision) turns its normal noticeably,
# as a fraction of the mesh's longest side.
_THIN = 1e-4
# Largest fraction of the surface in thin triangles.
_LOST = 1e-4
# Angle (rad) below which planes count as one. Rounding in files turns planes by 1e-6.
_SAME_PLANE = 1e-4
# Least spread of the normals at a corner, squared radians: smallest over largest eigenvalue of the
# sum of n n^T over its triangles. A vertex with less spread lies on an edge or in a face.
_SPREAD = 1e-7
# Difference between the coordinates of corners along a direction below which the corners count as
# equally far, as a fraction of the range of all corners.
_EQUALLY_FAR = 1e-9
# Steps of Lloyd's iteration, after which facets hardly change their points.
_SHARING_STEPS = 20
# Fewest points among which the facets of a mesh are divided: as many as an icosahedron's vertices.
_FEWEST_POINTS = 12
# Relative difference of the two second moments of a facet below which its principal axes are not
# unique.
_ROUND = 1e-6
# Pairs of points and triangles for which distances are computed at a time: some 100 MB.
_PAIRS = 400_000


class MeshError(ValueError):
    """A mesh that cannot be a body. The message is for the user."""


@dataclasses.dataclass(frozen=True)
class ConvexMesh(Shape):
    """Convex polyhedron with its centre of mass at the origin, made by `convex_mesh`.

    Attributes:
        vertices: positions of the vertices, m.
        faces: triangles of three vertices' indices, counterclockwise seen from outside.
    """

    fills_rounded_box: ClassVar[bool] = False

    vertices: tuple[tuple[float, float, float], ...]
    faces: tuple[tuple[int, int, int], ...]

    @functools.cached_property
    def points(self) -> np.ndarray:
        """The vertices as an array ``(v, 3)``, m."""
        return np.array(self.vertices, float)

    @functools.cached_property
    def triangles(self) -> np.ndarray:
        """Positions of the three corners of each face ``(f, 3, 3)``, m."""
        return self.points[np.array(self.faces)]

    @property
    @override
    def volume(self) -> float:
        return self._mass_properties[0]

    @property
    @override
    def half_extents(self) -> np.ndarray:
        return np.ptp(self.points, axis=0) / 2

    @property
    @override
    def rounded_box(self) -> RoundedBox:
        low, high = self.points.min(0), self.points.max(0)
        return RoundedBox((low + high) / 2, (high - low) / 2, 0.0)

    @property
    @override
    def reach(self) -> float:
        return float(np.linalg.norm(self.points, axis=1).max())

    @override
    def inertia(self, mass: Number) -> Numbers:
        return mass / self.volume * self._mass_properties[2]

    @property
    @override
    def stretch(self) -> tuple[np.ndarray, np.ndarray]:
        """Half lengths and axes of a box with the same second moments."""
        tensor = self.inertia(1.0)
        moments, turn = np.linalg.eigh(np.trace(tensor) / 2 * np.eye(3) - tensor)
        return np.sqrt(3 * moments), turn

    @functools.cached_property
    def _mass_properties(self) -> tuple[float, np.ndarray, np.ndarray]:
        return _mass_properties(self.triangles)

    @functools.cached_property
    def broad(self) -> np.ndarray:
        """Triangles that are not thin, which represent the surface, ``(f, 3, 3)``, m."""
        return self.triangles[_is_broad(self.triangles, np.ptp(self.points, axis=0).max())]

    @functools.cached_property
    def planes(self) -> tuple[np.ndarray, np.ndarray]:
        """Unit outward normals ``(f, 3)`` of the broad triangles and their areas ``(f,)``, m^2."""
        return _planes(self.broad)

    @override
    def distance(self, points: np.ndarray) -> np.ndarray:
        from trimesh.triangles import closest_point

        normals, _ = self.planes
        beyond = points @ normals.T - (normals * self.broad[:, 0]).sum(1)
        distance = beyond.max(1)
        outside = np.flatnonzero(distance > 0)
        count = len(self.broad)
        for some in np.array_split(outside, len(outside) * count // _PAIRS + 1):
            pairs = np.repeat(points[some], count, 0)
            nearest = closest_point(np.tile(self.broad, (len(some), 1, 1)), pairs)
            gaps = np.linalg.norm(pairs - nearest, axis=1).reshape(len(some), count)
            distance[some] = gaps.min(1)
        return distance

    @override
    def support(self, direction: Numbers) -> np.ndarray:
        reach = self.points @ direction
        far = chosen(lambda: reach.max() - reach <= _EQUALLY_FAR * xp.ptp(reach))
        return self.points[far].mean(0)

    @override
    def height(self, directions: np.ndarray) -> np.ndarray:
        return (directions @ self.points.T).max(-1)

    @override
    def floor_parts(self) -> tuple[FloorPart, ...]:
        return (FloorPart("mesh", self.corners),)

    @override
    def obstacle_parts(self) -> tuple[ObstaclePart, ...]:
        """Return one part: the largest ellipsoid about the mesh's centre, and the corners.

        The ellipsoid has the proportions of `stretch`.
        """
        half, axes = self.stretch
        normals, _ = self.planes
        reach = np.linalg.norm(half * (normals @ axes), axis=1)
        half = half * ((normals * self.broad[:, 0]).sum(1) / reach).min()
        return (ObstaclePart("ellipsoid", np.zeros(3), half, 0.0, axes, self.corners @ axes),)

    @override
    def skin(self) -> SkinMesh:
        """Return a skin with sharp edges: separate points for each triangle that has an area."""
        normals, areas = _planes(self.triangles)
        points = self.triangles[areas > 0].reshape(-1, 3)
        faces = np.arange(len(points)).reshape(-1, 3)
        return SkinMesh(points, np.repeat(normals[areas > 0], 3, 0), faces)

    @functools.cached_property
    def corners(self) -> np.ndarray:
        """Corners that may touch the ground ``(k, 3)``, at most `MOST_CORNERS`, m."""
        normals, _ = _planes(self.triangles)
        spread = np.zeros((len(self.points), 3, 3))
        for corner in np.array(self.faces).T:
            np.add.at(spread, corner, normals[:, :, None] * normals[:, None])
        least = np.linalg.eigvalsh(spread)
        points = self.points[least[:, 0] > _SPREAD * least[:, 2]]
        farthest = int(np.linalg.norm(points, axis=1).argmax())
        return points[_far_apart(points, farthest, min(len(points), MOST_CORNERS))]

    @override
    def cells(self) -> tuple[Cell, ...]:
        """Return one cell: the hull of the corners, with the mesh's volume and centre."""
        corners, faces = hull(self.corners, "its corners")
        triangles = corners[faces]
        volume, centre, _ = _mass_properties(triangles)
        triangles = (triangles - centre) * (self.volume / volume) ** (1 / 3)
        half_axes = np.ptp(triangles.reshape(-1, 3), axis=0) / 2
        return (
            Cell("polyhedron", (0.0, 0.0, 0.0), tuple(half_axes), self.volume, triangles=triangles),
        )

    @override
    def surface(self, resolution: int) -> Surface:
        """Return points with the area, centre and second moments of each facet.

        Four points at one standard deviation along the facet's principal axes lie within any convex
        facet (Kannan, Lovasz and Simonovits 1995). They are Gauss points on a rectangle. Resolution
        1 has one point in the middle of each facet, and so has a mesh for which four would be too
        many. From resolution 4 on, facets are cut into quarters while the number of points allows.

        The number of points is limited to an ellipsoid's, 8 times the squared resolution, or to 12
        if that is more. If there are more facets, neighbouring facets share a point with their
        whole area, at their mean position and along their mean normal.
        """
        # The indices of the broad triangles in each plane.
        normals, _ = self.planes
        first = (normals @ normals.T > 1 - _SAME_PLANE**2 / 2).argmax(1)
        facets = [np.flatnonzero(first == i) for i in np.unique(first)]
        budget = max(8 * resolution**2, _FEWEST_POINTS)
        if len(facets) > budget:
            return self._shared_surface(facets, budget)
        if resolution == 1 or 4 * len(facets) > budget:
            return _join([_moments(self.broad[facet]) for facet in facets], spread=False)
        pieces = [self.broad[facet] for facet in facets]
        quarters = 4
        while quarters <= resolution**2 // 4 and 16 * len(pieces) <= budget:
            pieces = [part for piece in pieces for half in _halves(piece) for part in _halves(half)]
            quarters *= 4
        return _join([_moments(piece) for piece in pieces], spread=True)

    def _shared_surface(self, facets: list[np.ndarray], count: int) -> Surface:
        """Return at most ``count`` points, each for a cluster of facets (Lloyd's iteration).

        The facets of a cluster are similar in position and normal.
        """
        normals, areas = self.planes
        area = np.array([areas[facet].sum() for facet in facets])
        middle = np.array(
            [np.average(self.broad[facet].mean(1), 0, areas[facet]) for facet in facets]
        )
        normal = normals[[facet[0] for facet in facets]]
        features = np.column_stack([middle / self.half_extents.max(), normal])
        centres = features[_far_apart(features, int(area.argmax()), count)]
        owner = np.zeros(len(facets), int)
        for _ in range(_SHARING_STEPS):
            owner = ((centres**2).sum(1) - 2 * features @ centres.T).argmin(1)
            for i in np.unique(owner):
                centres[i] = np.average(features[owner == i], 0, area[owner == i])
        parts = []
        for i in np.unique(owner):
            own = owner == i
            mean = area[own] @ normal[own]
            place = np.average(middle[own], 0, area[own])
            parts.append((place, mean / np.linalg.norm(mean), area[own].sum()))
        places, directions, sizes = zip(*parts, strict=True)
        return Surface(np.array(places), np.array(directions), np.array(sizes))


def convex_mesh(vertices: np.ndarray, faces: np.ndarray) -> tuple[ConvexMesh, np.ndarray]:
    """Return a mesh as a shape, and its centre of mass ``(3,)`` in the frame of the vertices.

    Args:
        vertices: positions of the vertices ``(v, 3)``, m.
        faces: ``(f, 3)`` indices of vertices, counterclockwise seen from outside. Faces with a
            vertex twice are lines, and left out.

    Raises:
        MeshError: the mesh is no closed convex body of a sensible size.
    """
    vertices, faces = np.asarray(vertices, float), np.asarray(faces, int)
    first, second, third = faces.T
    faces = faces[(first != second) & (second != third) & (third != first)]
    if not len(faces):
        raise MeshError("it has no faces")
    if len(faces) > MOST_TRIANGLES:
        raise MeshError(
            f"it has {len(faces)} triangles. Allowed: at most {MOST_TRIANGLES}. Simplify it in the "
            "program that made it (in Blender: Decimate)"
        )
    if not np.isfinite(vertices).all():
        raise MeshError("a coordinate of a vertex is not a finite number")
    if faces.min() < 0 or faces.max() >= len(vertices):
        wrong = int(faces.min() if faces.min() < 0 else faces.max())
        raise MeshError(f"a face names vertex {wrong}. Allowed: 0 to {len(vertices) - 1}")
    used, renumbered = np.unique(faces, return_inverse=True)
    vertices, faces = vertices[used], renumbered.reshape(faces.shape)
    with np.errstate(over="ignore"):
        longest = float(np.ptp(vertices, axis=0).max())
    if not SHORTEST <= longest <= LONGEST:
        long = longest > LONGEST
        advice = (
            "For a drawing in millimetres, set scale: 0.001" if long else "Is the scale too small?"
        )
        raise MeshError(
            f"its longest side is {longest:.4g} m. Allowed: {SHORTEST:g} to {LONGEST:g} m. {advice}"
        )
    _require_one_closed_surface(faces)
    _, centre, _ = _mass_properties(vertices[faces], longest)
    vertices = vertices - centre
    triangles = vertices[faces]
    (normals, areas), broad = _planes(triangles), _is_broad(triangles, longest)
    if areas[~broad].sum() > _LOST * areas.sum():
        raise MeshError(
            f"{(~broad).sum()} of its {len(triangles)} triangles are lower than {_THIN:.2%} of the "
            "mesh's longest side. Make the mesh thicker, or use fewer triangles"
        )
    # Thin triangles have no reliable normals.
    beyond = normals @ vertices.T - (normals * triangles[:, 0]).sum(1)[:, None]
    beyond = np.where(broad[:, None], beyond, 0.0)
    deepest = float(beyond.max())
    if deepest > _DENT * longest:
        face, vertex = np.unravel_index(beyond.argmax(), beyond.shape)
        raise MeshError(
            f"it is not convex: vertex {vertex} lies {deepest:.3g} m beyond the plane of face "
            f"{face}. Allowed: {_DENT:.1%} of its longest side, {_DENT * longest:.2g} m. Split it "
            "into convex bodies, or use its convex hull"
        )
    shape = ConvexMesh(tuple(map(tuple, vertices.tolist())), tuple(map(tuple, faces.tolist())))
    return shape, centre


def few_corners_hull(
    vertices: np.ndarray, most: int = MOST_TRIANGLES // 2
) -> tuple[np.ndarray, np.ndarray]:
    """Return the vertices and faces of the convex hull of a mesh, with few vertices.

    Args:
        vertices: positions of the mesh's vertices ``(v, 3)``, m.
        most: most vertices of the hull. A closed surface of triangles has twice as many faces as
            vertices, less four.

    Raises:
        MeshError: a coordinate is not finite, or the vertices lie in a plane.
    """
    if not np.isfinite(vertices).all():
        raise MeshError("a coordinate of a vertex is not a finite number")
    points, faces = hull(vertices, "its vertices")
    if len(points) <= most:
        return points, faces
    first = int(np.linalg.norm(points - points.mean(0), axis=1).argmax())
    return hull(points[_far_apart(points, first, most)], "its vertices")


def hull(points: np.ndarray, whose: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the vertices ``(v, 3)`` and the faces ``(f, 3)`` of the convex hull of points.

    Faces are counterclockwise seen from outside. ``whose`` names the points in the error message.

    Raises:
        MeshError: the points lie in a plane.
    """
    from scipy.spatial import ConvexHull, QhullError

    try:
        found = ConvexHull(points)
    except QhullError:
        raise MeshError(f"{whose} enclose no volume") from None
    a, b, c = points[found.simplices].swapaxes(0, 1)
    inwards = (np.cross(b - a, c - a) * found.equations[:, :3]).sum(1) < 0
    faces = np.where(inwards[:, None], found.simplices[:, ::-1], found.simplices)
    used, renumbered = np.unique(faces, return_inverse=True)
    return points[used], renumbered.reshape(faces.shape)


def _require_one_closed_surface(faces: np.ndarray) -> None:
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    directed = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    edges, counts = np.unique(np.sort(directed, 1), axis=0, return_counts=True)
    wrong = int((counts != 2).sum())
    if wrong:
        raise MeshError(
            f"it is open: {wrong} of {len(edges)} edges do not join two faces. Close its holes "
            "and remove parts in its interior"
        )
    count = faces.max() + 1
    joined = coo_array((np.ones(len(edges)), edges.T), shape=(count, count))
    pieces, _ = connected_components(joined, directed=False)
    if pieces > 1:
        raise MeshError(
            f"it consists of {pieces} separate pieces. Allowed: one. Save each in its own file"
        )
    if len(np.unique(directed, axis=0)) != len(directed):
        raise MeshError(
            "neighbouring faces have opposite orientations. Make their normals consistent"
        )


def _planes(triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return unit normals ``(f, 3)`` and areas ``(f,)`` of triangles. No area: a zero normal."""
    a, b, c = triangles.swapaxes(0, 1)
    normals = np.cross(b - a, c - a)
    doubled = np.linalg.norm(normals, axis=1)
    return normals / np.maximum(doubled, np.finfo(float).tiny)[:, None], doubled / 2


def _is_broad(triangles: np.ndarray, longest: float) -> np.ndarray:
    """Return which triangles ``(f,)`` are high enough for a reliable normal."""
    sides = np.linalg.norm(triangles - np.roll(triangles, 1, axis=1), axis=-1)
    return 2 * _planes(triangles)[1] > _THIN * longest * sides.max(1)


def _mass_properties(
    triangles: np.ndarray, longest: float | None = None
) -> tuple[float, np.ndarray, np.ndarray]:
    """Return volume, centre ``(3,)``, and inertia ``(3, 3)`` about the centre at a density of 1.

    Raises:
        MeshError: the volume is zero or negative. Checked only with ``longest``, the longest side.
    """
    from trimesh.triangles import mass_properties

    # A mesh far from its origin would lose digits in moments about the origin.
    middle = triangles.mean((0, 1))
    volume = float(np.linalg.det(triangles - middle).sum() / 6)
    if longest is not None and abs(volume) <= _FLAT * longest**3:
        raise MeshError(f"it is flat: {longest:.3g} m long, it encloses {abs(volume):.2g} m^3")
    if longest is not None and volume < 0:
        raise MeshError("it is inside out: its faces look inwards. Flip its normals")
    found = mass_properties(triangles - middle, density=1.0)
    return volume, middle + found.center_mass, np.asarray(found.inertia)


def _far_apart(points: np.ndarray, first: int, count: int) -> list[int]:
    """Return indices of points, each the farthest from all points before it."""
    chosen = [first]
    away = np.full(len(points), np.inf)
    while len(chosen) < count:
        away = np.minimum(away, np.linalg.norm(points - points[chosen[-1]], axis=1))
        chosen.append(int(away.argmax()))
    return chosen


class _Moments(NamedTuple):
    """Area, centre and normal of a flat piece of surface, and its standard deviations."""

    area: float
    centre: np.ndarray
    normal: np.ndarray
    deviations: np.ndarray


def _moments(triangles: np.ndarray) -> _Moments:
    """Return the moments of triangles ``(t, 3, 3)`` in one plane.

    ``deviations`` are two vectors along the principal axes, each one standard deviation long.
    """
    a, b, c = triangles.swapaxes(0, 1)
    doubled = np.cross(b - a, c - a)
    weights = np.linalg.norm(doubled, axis=1)
    total = doubled.sum(0)
    normal = total / np.linalg.norm(total)
    centre = np.average(triangles.mean(1), 0, weights)
    # Second moments of a triangle: a twelfth from each corner, nine twelfths from its middle.
    nodes = np.concatenate([triangles.reshape(-1, 3), triangles.mean(1)]) - centre
    parts = np.concatenate([np.repeat(weights, 3) / 12, weights * 9 / 12]) / weights.sum()
    # A square has no unique axes. They are then as near to the frame's axes as possible.
    first = np.eye(3)[np.abs(normal).argmin()]
    first = first - (first @ normal) * normal
    first /= np.linalg.norm(first)
    basis = np.array([first, np.cross(normal, first)])
    flat = nodes @ basis.T
    covariance = (parts * flat.T) @ flat
    spread, axes = np.linalg.eigh(covariance)
    if np.ptp(spread) < _ROUND * spread.max():
        axes = np.eye(2)
    deviations = np.sqrt(spread)[:, None] * (axes.T @ basis)
    return _Moments(float(weights.sum() / 2), centre, normal, deviations)


def _halves(triangles: np.ndarray) -> list[np.ndarray]:
    """Return both halves of a flat piece, cut through its middle across its longest axis."""
    piece = _moments(triangles)
    height = (triangles - piece.centre) @ piece.deviations[1]
    halves: list[np.ndarray] = []
    for sign in (1.0, -1.0):
        kept = []
        for corners, heights in zip(triangles, sign * height, strict=True):
            polygon = []
            for here in range(3):
                there = (here + 1) % 3
                if heights[here] >= 0:
                    polygon.append(corners[here])
                if heights[here] * heights[there] < 0:
                    fraction = heights[here] / (heights[here] - heights[there])
                    polygon.append(corners[here] + fraction * (corners[there] - corners[here]))
            kept += [[polygon[0], polygon[n], polygon[n + 1]] for n in range(1, len(polygon) - 1)]
        halves.append(np.array(kept))
    return halves


def _join(pieces: list[_Moments], spread: bool) -> Surface:
    """Return the surface with one point in the middle of each piece, or four around the middle."""
    signs = list(itertools.product((1.0, -1.0), repeat=2)) if spread else [(0.0, 0.0)]
    points = [
        piece.centre + sign @ piece.deviations for piece in pieces for sign in np.array(signs)
    ]
    normals = np.repeat([piece.normal for piece in pieces], len(signs), 0)
    areas = np.repeat([piece.area / len(signs) for piece in pieces], len(signs))
    return Surface(np.array(points), normals, areas)
