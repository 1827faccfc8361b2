"""Rigid shapes, and their interface for the rest of the package.

- Mass and water: volume, inertia, cells, and a quadrature over the surface.
- Contact: parts that touch the floor, parts that meet obstacles, and a rounded box for other limbs.
- Pictures: the skin.

A new kind of shape is a class here. Only the exchange with MuJoCo depends on its type.

Every shape is centred on its own frame. Elongated shapes point along their x axis, the direction
that an animal faces. ``surface(resolution)`` returns points ``(n, 3)`` in m, unit outward normals
``(n, 3)`` and areas ``(n,)`` in m^2. Except on meshes the points are symmetric, so a flow along an
axis causes no sideways force on a shape at rest. The quadrature converges as the resolution grows.
"""

import abc
import dataclasses
import functools
import itertools
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np
from typing_extensions import override

from evo_cpg.creature.algebra.decisions import chosen
from evo_cpg.creature.algebra.numerics import Number, Numbers, Triple, as_vector, xp

# Number n of discs that a capsule's cylinder is cut into. Together they have its second moment. The
# righting moment of a level capsule about its short axes is 33 % / n^2 = 2 % too large.
_SLICES = 4

# Largest component of a unit vector along the axis from which vectors across it are made.
_NEARLY_ALONG = 0.9

# Least length, so that a body without size has no 0 / 0, m, and least semi-axis of `ellipsoid`.
LEAST, _LEAST_ELLIPSOID = 1e-12, 1e-9

# Edge radius of a box in pictures, as a fraction of its smallest half size. Vertices along an
# eighth of a circle: 6 look round on a body that fills a third of a frame.
_ROUNDING, _QUARTER = 0.28, 6

Profile = Literal["box", "ball", "disc", "cylinder", "polyhedron"]


class Surface(NamedTuple):
    """Quadrature points on a surface: positions (m), unit outward normals and areas (m^2)."""

    points: Numbers
    normals: Numbers
    areas: Numbers


class Cell(NamedTuple):
    """Part of a body's volume whose fraction below any plane is known in closed form.

    Attributes:
        profile: distribution of height in a box, a ball stretched along the axes, an upright disc,
            a cylinder along x, or a polyhedron.
        centre: centre in the shape's frame, m.
        half_axes: half axes along x, y and z, m.
        volume: volume of the cell, m^3.
        triangles: corners ``(f, 3, 3)`` of a polyhedron's triangles about the centre,
            counterclockwise seen from outside, m.
    """

    profile: Profile
    centre: Triple
    half_axes: Triple
    volume: Number
    triangles: Numbers | None = None


class FloorPart(NamedTuple):
    """Part of a shape that may touch the floor.

    Attributes:
        kind: a box and a mesh touch the floor with corners, a cylinder along x with its rims, a
            ball and an ellipsoid with their lowest point.
        size: half edges ``(3,)`` of a box, corners ``(k, 3)`` of a mesh, half length and radius
            ``(2,)`` of a cylinder, the radius of a ball, or semi-axes ``(3,)`` of an ellipsoid, m.
        centre: centre in the shape's frame, m, or None for the frame's origin.
    """

    kind: Literal["box", "mesh", "cylinder", "ball", "ellipsoid"]
    size: Any
    centre: Numbers | None = None


class ObstaclePart(NamedTuple):
    """Part of a shape that may meet obstacles.

    Attributes:
        kind: a box with sharp edges, a line along x, a ball, or an ellipsoid.
        centre: centre in the shape's frame, m.
        half_extents: half extents of a box or a line, or semi-axes of an ellipsoid, m.
        radius: radius of rounding, m. The part is all points within this distance of its box, line,
            centre (ball) or ellipsoid.
        axes: axes in the shape's frame, as columns, or None for the frame's axes.
        corners: corners ``(k, 3)`` of a mesh around an ellipsoid, along ``axes``, m, or None
            without a mesh.
    """

    kind: Literal["box", "line", "ball", "ellipsoid"]
    centre: Numbers
    half_extents: Numbers
    radius: Number
    axes: np.ndarray | None = None
    corners: np.ndarray | None = None


class SkinMesh(NamedTuple):
    """Triangles of a shape's picture.

    Attributes:
        points: positions ``(n, 3)``, m.
        normals: unit normals ``(n, 3)`` for smooth shading.
        faces: indices of points ``(f, 3)``, counterclockwise seen from outside.
    """

    points: np.ndarray
    normals: np.ndarray
    faces: np.ndarray


class RoundedBox(NamedTuple):
    """All points within some distance of a box, which may be a rectangle, a line or a point.

    Attributes:
        centre: centre of the box in the shape's frame, m.
        half_extents: half edges of the box along x, y and z, m.
        radius: largest distance from the box, m.
    """

    centre: Numbers
    half_extents: Numbers
    radius: Number


class Barrel(NamedTuple):
    """A shape seen as an elliptic cylinder with two ends.

    Attributes:
        axes: axis of the cylinder and the two half axes of its cross-section, as columns.
        half_axes: half axes ``(3,)`` of the half-ellipsoids at the ends, m. The first is the length
            of an end, which is 0 for flat ends.
        length: length of the cylinder, m.
        ends: kind of its ends.
    """

    axes: Numbers
    half_axes: Numbers
    length: Number
    ends: Literal["flat", "ball", "ellipsoid"]


class Shape(abc.ABC):
    """A convex rigid shape, centred on its own frame.

    Attributes:
        exists: False only for `NoShape`.
        blunt: whether it is round about its x axis, with flat ends.
        profile: profile of the whole volume, if that is one cell.
        floor_kind: kind of its only part on the floor, with its half extents, or None.
        obstacle_kind: kind of its only part for obstacles, its rounded box, or None.
        fills_rounded_box: whether the shape fills its `rounded_box`.
        corners: corners, or points on edges, that may touch the floor ``(k, 3)``, m. None for a
            shape without edges.
    """

    exists: ClassVar[bool] = True
    blunt: ClassVar[bool] = False
    profile: ClassVar[Profile]
    floor_kind: ClassVar[Literal["box", "ellipsoid"] | None] = None
    obstacle_kind: ClassVar[Literal["box", "line"] | None] = None
    fills_rounded_box: ClassVar[bool] = True
    corners: ClassVar[Numbers | None] = None

    @property
    @abc.abstractmethod
    def volume(self) -> Number:
        """Volume, m^3."""

    @property
    @abc.abstractmethod
    def half_extents(self) -> Numbers:
        """Half sizes of the bounding box along x, y and z, m."""

    @property
    def reach(self) -> Number:
        """Upper bound of the distance of the shape's points from the centre, m."""
        return xp.linalg.norm(self.half_extents)

    @abc.abstractmethod
    def inertia(self, mass: Number) -> Numbers:
        """Return the inertia ``(3, 3)`` of uniform mass about the centre, kg m^2.

        It is diagonal except for meshes, which have products of inertia.
        """

    @property
    def stretch(self) -> tuple[Numbers, Numbers]:
        """Half lengths ``(3,)`` along the principal axes, m, and the axes as columns ``(3, 3)``."""
        return self.half_extents, xp.eye(3)

    @property
    def ellipsoid(self) -> Numbers:
        """Semi-axes ``(3,)`` of an ellipsoid of equal volume that carries as much water, m.

        They are along the axes of `stretch`. By default they have the proportions of `stretch`.
        """
        half = xp.maximum(self.stretch[0], _LEAST_ELLIPSOID)
        return half * (self.volume / (4 / 3 * np.pi * xp.prod(half))) ** (1 / 3)

    @property
    def rounded_box(self) -> "RoundedBox":
        """Rounded box that stands for the shape where limbs touch each other.

        It is equal to boxes, spheres and capsules, and around ellipsoids and meshes.
        """
        return RoundedBox(np.zeros(3), self.half_extents, 0.0)

    @abc.abstractmethod
    def distance(self, points: Numbers) -> Numbers:
        """Return the signed distance ``(n,)`` of points ``(n, 3)``, m, negative inside.

        The sign is exact for every shape. The size is exact except for ellipsoids.
        """

    @abc.abstractmethod
    def support(self, direction: Numbers) -> Numbers:
        """Return the point ``(3,)`` of the shape that lies farthest along a direction, m.

        The middle of several equally far points is returned.

        Args:
            direction: vector ``(3,)`` of any nonzero length.
        """

    def height(self, directions: np.ndarray) -> np.ndarray:
        """Return the coordinate of the farthest point along unit vectors ``(..., 3)``, m.

        The shape's size must be known, not traced.
        """
        box = self.rounded_box
        half = np.asarray(box.half_extents, float)
        middle = directions @ np.asarray(box.centre, float)
        return middle + np.abs(directions) @ half + float(box.radius)

    @abc.abstractmethod
    def surface(self, resolution: int) -> Surface:
        """Return a quadrature over the whole surface, with more points at a higher resolution."""

    def cells(self) -> tuple[Cell, ...]:
        """Return the parts of the volume, which together have its first and second moments."""
        return (Cell(self.profile, (0.0, 0.0, 0.0), as_vector(self.half_extents), self.volume),)

    def barrel(self, direction: Numbers) -> Barrel:
        """Return the shape as a cylinder with ends, along its axis nearest to a direction.

        A shape without round ends, such as a mesh, becomes the box with its extents.

        Args:
            direction: vector ``(3,)`` in the shape's frame.
        """
        nearest = chosen(lambda: xp.argmax(xp.abs(direction)))
        axes = np.roll(np.eye(3), -nearest, 1)
        across = self.half_extents @ axes
        flat = xp.concatenate([xp.zeros(1), across[1:]])
        return Barrel(axes, flat, 2 * across[0], "flat")

    def floor_parts(self) -> tuple[FloorPart, ...]:
        """Return the parts that may touch the floor.

        Raises:
            TypeError: the shape is for use in water only.
        """
        if self.floor_kind is None:
            raise TypeError(f"no contact points for a {type(self).__name__}. Define floor_parts")
        return (FloorPart(self.floor_kind, self.half_extents),)

    def obstacle_parts(self) -> tuple[ObstaclePart, ...]:
        """Return the parts that may meet obstacles.

        Raises:
            TypeError: the shape is for use in water only.
        """
        if self.obstacle_kind is None:
            raise TypeError(f"no contact points for a {type(self).__name__}. Define obstacle_parts")
        return (ObstaclePart(self.obstacle_kind, *self.rounded_box),)

    def skin(self) -> SkinMesh:
        """Return the triangles of the shape's picture, by default between support points."""
        directions, _, faces = _split_sphere()
        return SkinMesh(np.array([self.support(each) for each in directions]), directions, faces)


@dataclasses.dataclass(frozen=True)
class Box(Shape):
    """Cuboid with edges ``size`` (m) along x, y and z."""

    profile = "box"
    floor_kind = "box"
    obstacle_kind = "box"

    size: Triple

    @property
    @override
    def volume(self) -> Number:
        return xp.prod(xp.array(self.size))

    @property
    @override
    def half_extents(self) -> Numbers:
        return xp.array(self.size) / 2

    @override
    def inertia(self, mass: Number) -> Numbers:
        squares = xp.square(xp.array(self.size))
        return xp.diag(mass / 12 * (squares.sum() - squares))

    @override
    def distance(self, points: Numbers) -> Numbers:
        excess = xp.abs(points) - self.half_extents
        outside = xp.linalg.norm(xp.maximum(excess, 0), axis=-1)
        return outside + xp.minimum(excess.max(-1), 0)

    @override
    def support(self, direction: Numbers) -> Numbers:
        return xp.sign(direction) * self.half_extents

    @override
    def surface(self, resolution: int) -> Surface:
        """Return Gauss-Legendre points, ``resolution`` squared on each of the six faces."""
        nodes, weights = np.polynomial.legendre.leggauss(resolution)
        u, v = (grid.ravel() for grid in np.meshgrid(nodes, nodes, indexing="ij"))
        # On the cube from -1 to 1, with weights whose sum is 1 on a face.
        faces = [
            (
                np.roll(np.column_stack([np.full(u.size, sign), u, v]), axis, 1),
                np.tile(sign * np.eye(3)[axis], (u.size, 1)),
            )
            for axis in range(3)
            for sign in (1.0, -1.0)
        ]
        places, normals = (np.concatenate(columns) for columns in zip(*faces, strict=True))
        weights = np.tile(np.outer(weights, weights).ravel() / 4, 6)
        axis, half = np.abs(normals).argmax(-1), self.half_extents
        areas = weights * 4 * half[(axis + 1) % 3] * half[(axis + 2) % 3]
        return Surface(places * half[None], normals, areas)

    @property
    @override
    def corners(self) -> Numbers:
        return np.array(list(itertools.product((-1, 1), repeat=3))) * self.half_extents

    @override
    def skin(self, quarter: int = _QUARTER) -> SkinMesh:
        """Return the skin of a box with rounded edges, of some points each."""
        directions, signs, faces = _split_sphere(quarter)
        radius = _ROUNDING * self.half_extents.min()
        return SkinMesh(
            signs * (self.half_extents - radius) + radius * directions, directions, faces
        )


@dataclasses.dataclass(frozen=True)
class Ellipsoid(Shape):
    """Ellipsoid with semi-axes ``radii`` (m) along x, y and z."""

    profile = "ball"
    floor_kind = "ellipsoid"

    radii: Triple

    @property
    @override
    def volume(self) -> Number:
        return 4 / 3 * xp.pi * xp.prod(xp.array(self.radii))

    @property
    @override
    def half_extents(self) -> Numbers:
        return xp.array(self.radii, float)

    @property
    @override
    def rounded_box(self) -> RoundedBox:
        radius = xp.min(self.half_extents)
        return RoundedBox(np.zeros(3), self.half_extents - radius, radius)

    @override
    def inertia(self, mass: Number) -> Numbers:
        squares = xp.square(xp.array(self.radii))
        return xp.diag(mass / 5 * (squares.sum() - squares))

    @override
    def distance(self, points: Numbers) -> Numbers:
        half = xp.maximum(self.half_extents, LEAST)
        scaled = points / half
        level = xp.linalg.norm(scaled, axis=-1)
        gradient = xp.linalg.norm(scaled / half, axis=-1)
        at_centre = gradient < 1e-12
        estimate = level * (level - 1) / xp.where(at_centre, 1.0, gradient)
        return xp.where(at_centre, -self.half_extents.min(), estimate)

    @override
    def support(self, direction: Numbers) -> Numbers:
        stretched = self.half_extents * direction
        return self.half_extents * stretched / xp.maximum(xp.linalg.norm(stretched), LEAST)

    @override
    def surface(self, resolution: int) -> Surface:
        """Map the sphere's product rule (Gauss in x, uniform around x) to the ellipsoid."""
        nodes, weights = np.polynomial.legendre.leggauss(2 * resolution)
        directions, solid_angles = _around_x(nodes, weights, ring(resolution))
        scaled = directions / xp.maximum(self.half_extents, LEAST)
        stretch = xp.linalg.norm(scaled, axis=-1)
        return Surface(
            directions * self.half_extents,
            scaled / stretch[:, None],
            solid_angles * xp.prod(xp.array(self.radii)) * stretch,
        )

    @override
    def barrel(self, direction: Numbers) -> Barrel:
        axes = super().barrel(direction).axes
        return Barrel(axes, self.half_extents @ axes, 0.0, "ellipsoid")

    @property
    @override
    def fills_rounded_box(self) -> bool:
        return float(np.ptp(np.asarray(self.radii, float))) == 0.0

    @override
    def height(self, directions: np.ndarray) -> np.ndarray:
        return np.linalg.norm(directions * np.asarray(self.radii, float), axis=-1)

    @override
    def obstacle_parts(self) -> tuple[ObstaclePart, ...]:
        return (ObstaclePart("ellipsoid", np.zeros(3), self.half_extents, 0.0),)

    @override
    def skin(self) -> SkinMesh:
        directions, _, faces = _split_sphere()
        normals = directions / self.half_extents
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        return SkinMesh(directions * self.half_extents, normals, faces)


class Sphere(Ellipsoid):
    """Sphere of the given ``radius`` (m)."""

    def __init__(self, radius: Number):
        super().__init__((radius, radius, radius))

    @property
    def radius(self) -> Number:
        """Radius, m."""
        return self.radii[0]

    @override
    def barrel(self, direction: Numbers) -> Barrel:
        """Return the sphere along the direction itself."""
        length = xp.linalg.norm(direction)
        first = xp.where(length > 0, direction, np.eye(3)[0]) / xp.where(length > 0, length, 1.0)
        helper = chosen(
            lambda: np.argmin(np.abs(first)), lambda axis: xp.abs(first[axis]) < _NEARLY_ALONG
        )
        across = xp.cross(first, np.eye(3)[helper])
        second = across / xp.linalg.norm(across)
        axes = xp.stack([first, second, xp.cross(first, second)], 1)
        return Barrel(axes, self.half_extents, 0.0, "ball")

    @override
    def floor_parts(self) -> tuple[FloorPart, ...]:
        return (FloorPart("ball", self.radius),)

    @override
    def obstacle_parts(self) -> tuple[ObstaclePart, ...]:
        return (ObstaclePart("ball", *self.rounded_box),)


@dataclasses.dataclass(frozen=True)
class Capsule(Shape):
    """Cylinder along x with half-spherical ends.

    Attributes:
        radius: radius of the cylinder and its ends, m.
        length: length of the cylinder, m. The whole capsule is ``length + 2 radius`` long.
    """

    obstacle_kind = "line"

    radius: Number
    length: Number

    @property
    @override
    def volume(self) -> Number:
        return xp.pi * self.radius**2 * (self.length + 4 / 3 * self.radius)

    @property
    @override
    def half_extents(self) -> Numbers:
        return xp.array([self.length / 2 + self.radius, self.radius, self.radius])

    @property
    @override
    def rounded_box(self) -> RoundedBox:
        return RoundedBox(np.zeros(3), xp.array([self.length / 2, 0.0, 0.0]), self.radius)

    @override
    def inertia(self, mass: Number) -> Numbers:
        r, length = self.radius, self.length
        cylinder = mass * xp.pi * r**2 * length / xp.maximum(self.volume, LEAST**3)
        ends = mass - cylinder
        axial = cylinder * r**2 / 2 + ends * 0.4 * r**2
        across = cylinder * (length**2 / 12 + r**2 / 4) + ends * (
            0.4 * r**2 + length**2 / 4 + 3 / 8 * length * r
        )
        return xp.diag(xp.array([axial, across, across]))

    @override
    def distance(self, points: Numbers) -> Numbers:
        along = xp.clip(points[:, :1], -self.length / 2, self.length / 2)
        nearest = along * np.array([[1.0, 0.0, 0.0]])
        return xp.linalg.norm(points - nearest, axis=-1) - self.radius

    @override
    def support(self, direction: Numbers) -> Numbers:
        end = xp.array([xp.sign(direction[0]) * self.length / 2, 0.0, 0.0])
        return end + self.radius * direction / xp.linalg.norm(direction)

    @override
    def surface(self, resolution: int) -> Surface:
        """Return rings of points on the cylinder, and a product rule on each half-sphere."""
        nodes, weights = np.polynomial.legendre.leggauss(resolution)
        around = ring(resolution)
        points = xp.concatenate(
            [
                xp.column_stack([xp.full(len(around), x * self.length / 2), self.radius * around])
                for x in nodes
            ]
        )
        normals = xp.tile(xp.column_stack([xp.zeros(len(around)), around]), (resolution, 1))
        ring_area = 2 * xp.pi * self.radius * self.length / len(around)
        side = Surface(points, normals, xp.repeat(weights / 2 * ring_area, len(around)))
        # Each half-sphere has its own rule, because a cylinder separates them. One rule across both
        # would treat their points as one smooth surface.
        half, part = (nodes + 1) / 2, weights / 2
        directions, solid_angles = _around_x(
            xp.concatenate([-half[::-1], half]), xp.concatenate([part[::-1], part]), around
        )
        shift = xp.sign(directions[:, :1]) * xp.array([[self.length / 2, 0.0, 0.0]])
        ends = Surface(self.radius * directions + shift, directions, solid_angles * self.radius**2)
        return Surface(*(xp.concatenate(both) for both in zip(side, ends, strict=True)))

    @override
    def barrel(self, direction: Numbers) -> Barrel:
        del direction
        return Barrel(np.eye(3), xp.array([self.radius] * 3), self.length, "ball")

    @override
    def cells(self) -> tuple[Cell, ...]:
        """Return a row of discs, and an ellipsoid for each half-spherical end.

        A half-sphere's centre of volume is 3/8 r from its base. Its second moment along the axis
        about that centre equals an ellipsoid's with a half axis of sqrt(19/64) r.
        """
        r, slices = self.radius, _SLICES if chosen(lambda: self.length > 0) else 0
        half_slice = self.length / (2 * _SLICES)
        discs = [
            Cell(
                "disc",
                ((2 * i + 1) * half_slice - self.length / 2, 0.0, 0.0),
                # A disc's variance is a quarter of its squared half axis, not a third.
                (xp.sqrt(4 / 3) * half_slice, r, r),
                xp.pi * r**2 * 2 * half_slice,
            )
            for i in range(slices)
        ]
        ends = [
            Cell(
                "ball",
                (sign * (self.length / 2 + 3 / 8 * r), 0.0, 0.0),
                (xp.sqrt(19 / 64) * r, r, r),
                2 / 3 * xp.pi * r**3,
            )
            for sign in (1, -1)
        ]
        return (*discs, *ends)

    @override
    def floor_parts(self) -> tuple[FloorPart, ...]:
        end = xp.array([self.length / 2, 0.0, 0.0])
        return FloorPart("ball", self.radius, -end), FloorPart("ball", self.radius, end)

    @override
    def skin(self) -> SkinMesh:
        directions, signs, faces = _split_sphere()
        points = signs * [self.length / 2, 0, 0] + self.radius * directions
        return SkinMesh(points, directions, faces)


@dataclasses.dataclass(frozen=True)
class NoShape(Shape):
    """Shape of a body that has none: a point that nothing touches, wets or draws."""

    exists: ClassVar[bool] = False
    volume: ClassVar[Number] = 0.0
    half_extents: ClassVar[Numbers] = np.zeros(3)
    corners: ClassVar[Numbers | None] = np.zeros((1, 3))

    @override
    def inertia(self, mass: Number) -> Numbers:
        return 0.0 * mass * np.eye(3)

    @override
    def distance(self, points: Numbers) -> Numbers:
        return xp.linalg.norm(points, axis=-1)

    @override
    def support(self, direction: Numbers) -> Numbers:
        return 0.0 * direction

    @override
    def surface(self, resolution: int) -> Surface:
        return Surface(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))

    @override
    def cells(self) -> tuple[Cell, ...]:
        return ()

    @override
    def floor_parts(self) -> tuple[FloorPart, ...]:
        return ()

    @override
    def obstacle_parts(self) -> tuple[ObstaclePart, ...]:
        return ()

    @override
    def skin(self) -> SkinMesh:
        """Return one triangle without area, because pictures cannot draw nothing."""
        return SkinMesh(np.zeros((3, 3)), np.tile([1.0, 0.0, 0.0], (3, 1)), np.array([[0, 1, 2]]))


def ring(resolution: int) -> Numbers:
    """Return unit vectors ``(4 resolution, 2)`` evenly on a circle, symmetric about both axes."""
    count = 4 * resolution
    angles = (xp.arange(count) + 0.5) * 2 * xp.pi / count
    return xp.column_stack([xp.cos(angles), xp.sin(angles)])


def _around_x(nodes: Numbers, weights: Numbers, around: Numbers) -> tuple[Numbers, Numbers]:
    """Return directions and solid angles of a product rule: ``nodes`` in x, a ring around x."""
    directions = xp.concatenate(
        [xp.column_stack([xp.full(len(around), x), xp.sqrt(1 - x * x) * around]) for x in nodes]
    )
    return directions, xp.repeat(weights * 2 * xp.pi / len(around), len(around))


@functools.cache
def _split_sphere(quarter: int = _QUARTER) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return a cube projected to a sphere, cut along the three coordinate planes.

    Moving each octant outwards makes a rounded box or a capsule.

    Returns:
        Unit vectors ``(n, 3)``, signs of their octants ``(n, 3)``, and triangles ``(m, 3)``.
    """
    half = np.linspace(0, np.pi / 4, quarter)
    along = np.tan(np.concatenate([-half[::-1], half]))
    side = np.repeat([-1.0, 1.0], quarter)
    u, v = (grid.ravel() for grid in np.meshgrid(along, along, indexing="ij"))
    sign_u, sign_v = (grid.ravel() for grid in np.meshgrid(side, side, indexing="ij"))
    count = 2 * quarter
    corner = (np.arange(count - 1)[:, None] * count + np.arange(count - 1)).ravel()
    quads = corner[:, None] + np.array([0, count, count + 1, 0, count + 1, 1])
    triangles = quads.reshape(-1, 3)
    points, signs, faces = [], [], []
    for axis in range(3):
        for outward in (1.0, -1.0):
            cube, octant = np.zeros((u.size, 3)), np.zeros((u.size, 3))
            order = [axis, (axis + 1) % 3, (axis + 2) % 3]
            cube[:, order] = np.column_stack([np.full(u.size, outward), u, v])
            octant[:, order] = np.column_stack([np.full(u.size, outward), sign_u, sign_v])
            faces.append(triangles[:, :: int(outward)] + u.size * len(points))
            points.append(cube / np.linalg.norm(cube, axis=1, keepdims=True))
            signs.append(octant)
    return np.concatenate(points), np.concatenate(signs), np.concatenate(faces)
