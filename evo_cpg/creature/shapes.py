"""Rigid shapes: volume, inertia, distance, support, cells, and a quadrature over the surface.

Every shape is centred on its own frame. Elongated shapes point along their x axis, which is the
direction an animal faces. ``surface(resolution)`` returns points ``(n, 3)`` in m, unit outward
normals ``(n, 3)`` and areas ``(n,)`` in m^2; the layouts are symmetric, so a still shape in a
uniform stream feels no sideways force, and they converge as the resolution grows.
"""

import abc
import dataclasses
from typing import Literal, NamedTuple

import numpy as np
from typing_extensions import override

# Discs into which the cylinder of a capsule is cut. Between them they have its second moment; a
# capsule that floats level rights itself 33 % / n^2 too strongly about its short axes: 2 %.
_SLICES = 4

Profile = Literal["box", "ball", "disc", "polyhedron"]


class Surface(NamedTuple):
    """Quadrature points on a surface: places (m), unit outward normals and areas (m^2)."""

    points: np.ndarray
    normals: np.ndarray
    areas: np.ndarray


class Cell(NamedTuple):
    """Part of a body's volume, of which the share below any plane is known in closed form.

    Attributes:
        profile: how height is distributed over it: as in a box, as in a ball stretched along
            the axes, as in a disc that stands upright, or as in the polyhedron of its triangles.
        centre: in the shape's frame, m.
        half_axes: along x, y and z, m.
        volume: m^3.
        triangles: of a polyhedron ``(f, 3, 3)``: their corners about the centre,
            counterclockwise seen from outside, m.
    """

    profile: Profile
    centre: tuple[float, float, float]
    half_axes: tuple[float, float, float]
    volume: float
    triangles: np.ndarray | None = None


class Shape(abc.ABC):
    """A convex rigid shape, centred on its own frame."""

    @property
    @abc.abstractmethod
    def volume(self) -> float:
        """Volume, m^3."""

    @property
    @abc.abstractmethod
    def half_extents(self) -> np.ndarray:
        """Half sizes of the bounding box along x, y and z, m."""

    @property
    def reach(self) -> float:
        """Largest distance from the centre that a part of it may have, m."""
        return float(np.linalg.norm(self.half_extents))

    @abc.abstractmethod
    def inertia(self, mass: float) -> np.ndarray:
        """Moments of inertia ``(3,)`` about x, y and z through the centre, uniform mass, kg m^2."""

    def inertia_tensor(self, mass: float) -> np.ndarray:
        """Inertia ``(3, 3)`` about the centre; diagonal but for meshes, kg m^2."""
        return np.diag(self.inertia(mass))

    @property
    def stretch(self) -> tuple[np.ndarray, np.ndarray]:
        """Half lengths ``(3,)`` along its principal axes, m, and the axes as columns ``(3, 3)``."""
        return self.half_extents, np.eye(3)

    @abc.abstractmethod
    def distance(self, points: np.ndarray) -> np.ndarray:
        """Signed distance ``(n,)`` of points ``(n, 3)`` from the surface, m; negative inside.

        Its sign is exact for every shape; its size is exact but for the ellipsoid.
        """

    @abc.abstractmethod
    def support(self, direction: np.ndarray) -> np.ndarray:
        """The point ``(3,)`` of the shape that lies farthest along a direction ``(3,)``, m.

        Args:
            direction: of any length but zero. Where several points lie equally far, the one in
                their middle is returned.
        """

    @abc.abstractmethod
    def surface(self, resolution: int) -> Surface:
        """Quadrature over the whole surface; the number of points grows with the resolution."""

    @abc.abstractmethod
    def cells(self) -> tuple[Cell, ...]:
        """The volume in parts that have its first and second moments between them."""


@dataclasses.dataclass(frozen=True)
class Box(Shape):
    """Cuboid with edges ``size`` (m) along x, y and z."""

    size: tuple[float, float, float]

    @property
    @override
    def volume(self) -> float:
        return float(np.prod(self.size))

    @property
    @override
    def half_extents(self) -> np.ndarray:
        return np.array(self.size) / 2

    @override
    def inertia(self, mass: float) -> np.ndarray:
        squares = np.square(self.size)
        return mass / 12 * (squares.sum() - squares)

    @override
    def distance(self, points: np.ndarray) -> np.ndarray:
        excess = np.abs(points) - self.half_extents
        outside = np.linalg.norm(np.maximum(excess, 0), axis=-1)
        return outside + np.minimum(excess.max(-1), 0)

    @override
    def support(self, direction: np.ndarray) -> np.ndarray:
        return np.sign(direction) * self.half_extents

    @override
    def surface(self, resolution: int) -> Surface:
        """Gauss-Legendre points, ``resolution`` squared on each of the six faces."""
        nodes, weights = np.polynomial.legendre.leggauss(resolution)
        u, v = (grid.ravel() for grid in np.meshgrid(nodes, nodes, indexing="ij"))
        weight = np.outer(weights, weights).ravel() / 4
        half = self.half_extents
        faces = []
        for axis in range(3):
            first, second = (axis + 1) % 3, (axis + 2) % 3
            for sign in (1.0, -1.0):
                points = np.zeros((u.size, 3))
                points[:, axis] = sign * half[axis]
                points[:, first], points[:, second] = u * half[first], v * half[second]
                normals = np.zeros_like(points)
                normals[:, axis] = sign
                faces.append(Surface(points, normals, weight * 4 * half[first] * half[second]))
        return _join(faces)

    @override
    def cells(self) -> tuple[Cell, ...]:
        return (Cell("box", (0.0, 0.0, 0.0), tuple(self.half_extents), self.volume),)


@dataclasses.dataclass(frozen=True)
class Ellipsoid(Shape):
    """Ellipsoid with semi-axes ``radii`` (m) along x, y and z."""

    radii: tuple[float, float, float]

    @property
    @override
    def volume(self) -> float:
        return float(4 / 3 * np.pi * np.prod(self.radii))

    @property
    @override
    def half_extents(self) -> np.ndarray:
        return np.array(self.radii, float)

    @override
    def inertia(self, mass: float) -> np.ndarray:
        squares = np.square(self.radii)
        return mass / 5 * (squares.sum() - squares)

    @override
    def distance(self, points: np.ndarray) -> np.ndarray:
        scaled = points / self.half_extents
        level = np.linalg.norm(scaled, axis=-1)
        gradient = np.linalg.norm(scaled / self.half_extents, axis=-1)
        at_centre = gradient < 1e-12
        estimate = level * (level - 1) / np.where(at_centre, 1.0, gradient)
        return np.where(at_centre, -self.half_extents.min(), estimate)

    @override
    def support(self, direction: np.ndarray) -> np.ndarray:
        stretched = self.half_extents * direction
        return self.half_extents * stretched / np.linalg.norm(stretched)

    @override
    def surface(self, resolution: int) -> Surface:
        """The sphere's product rule (Gauss in x, uniform around x), mapped to the ellipsoid."""
        directions, solid_angles = _sphere_rule(resolution)
        scaled = directions / self.half_extents
        stretch = np.linalg.norm(scaled, axis=-1)
        return Surface(
            directions * self.half_extents,
            scaled / stretch[:, None],
            solid_angles * np.prod(self.radii) * stretch,
        )

    @override
    def cells(self) -> tuple[Cell, ...]:
        return (Cell("ball", (0.0, 0.0, 0.0), self.radii, self.volume),)


class Sphere(Ellipsoid):
    """Sphere of the given ``radius`` (m)."""

    def __init__(self, radius: float):
        super().__init__((radius, radius, radius))

    @property
    def radius(self) -> float:
        """Radius, m."""
        return self.radii[0]


@dataclasses.dataclass(frozen=True)
class Capsule(Shape):
    """Cylinder along x with half-spherical ends.

    Attributes:
        radius: m.
        length: of the cylindrical part, m; the whole capsule is ``length + 2 radius`` long.
    """

    radius: float
    length: float

    @property
    @override
    def volume(self) -> float:
        return np.pi * self.radius**2 * (self.length + 4 / 3 * self.radius)

    @property
    @override
    def half_extents(self) -> np.ndarray:
        return np.array([self.length / 2 + self.radius, self.radius, self.radius])

    @override
    def inertia(self, mass: float) -> np.ndarray:
        r, length = self.radius, self.length
        cylinder = mass * np.pi * r**2 * length / self.volume
        ends = mass - cylinder
        axial = cylinder * r**2 / 2 + ends * 0.4 * r**2
        across = cylinder * (length**2 / 12 + r**2 / 4) + ends * (
            0.4 * r**2 + length**2 / 4 + 3 / 8 * length * r
        )
        return np.array([axial, across, across])

    @override
    def distance(self, points: np.ndarray) -> np.ndarray:
        nearest = np.zeros_like(points)
        nearest[:, 0] = np.clip(points[:, 0], -self.length / 2, self.length / 2)
        return np.linalg.norm(points - nearest, axis=-1) - self.radius

    @override
    def support(self, direction: np.ndarray) -> np.ndarray:
        end = np.array([np.sign(direction[0]) * self.length / 2, 0.0, 0.0])
        return end + self.radius * direction / np.linalg.norm(direction)

    @override
    def surface(self, resolution: int) -> Surface:
        """Rings on the cylinder, and the two halves of the sphere's rule as its ends."""
        nodes, weights = np.polynomial.legendre.leggauss(resolution)
        around = _ring(resolution)
        points = np.concatenate(
            [
                np.column_stack([np.full(len(around), x * self.length / 2), self.radius * around])
                for x in nodes
            ]
        )
        normals = np.tile(np.column_stack([np.zeros(len(around)), around]), (resolution, 1))
        ring_area = 2 * np.pi * self.radius * self.length / len(around)
        side = Surface(points, normals, np.repeat(weights / 2 * ring_area, len(around)))
        # A rule on either half: one across both would not see the step between them.
        half, share = (nodes + 1) / 2, weights / 2
        directions, solid_angles = _around_x(
            np.concatenate([-half[::-1], half]), np.concatenate([share[::-1], share]), around
        )
        shift = np.sign(directions[:, :1]) * np.array([[self.length / 2, 0, 0]])
        ends = Surface(self.radius * directions + shift, directions, solid_angles * self.radius**2)
        return _join([side, ends])

    @override
    def cells(self) -> tuple[Cell, ...]:
        """Discs in a row, and an ellipsoid for each half-spherical end.

        A half-sphere's centre of volume lies 3/8 r from its base; its second moment along the axis
        about there is that of a half axis of sqrt(19/64) r.
        """
        r, slices = self.radius, _SLICES if self.length > 0 else 0
        half_slice = self.length / (2 * _SLICES)
        discs = [
            Cell(
                "disc",
                ((2 * i + 1) * half_slice - self.length / 2, 0.0, 0.0),
                # A disc's variance is a quarter of the square of its half axis, not a third.
                (np.sqrt(4 / 3) * half_slice, r, r),
                np.pi * r**2 * 2 * half_slice,
            )
            for i in range(slices)
        ]
        ends = [
            Cell(
                "ball",
                (sign * (self.length / 2 + 3 / 8 * r), 0.0, 0.0),
                (np.sqrt(19 / 64) * r, r, r),
                2 / 3 * np.pi * r**3,
            )
            for sign in (1, -1)
        ]
        return (*discs, *ends)


def _ring(resolution: int) -> np.ndarray:
    """Unit vectors ``(4 resolution, 2)`` evenly around a circle, symmetric about both axes."""
    count = 4 * resolution
    angles = (np.arange(count) + 0.5) * 2 * np.pi / count
    return np.column_stack([np.cos(angles), np.sin(angles)])


def _sphere_rule(resolution: int) -> tuple[np.ndarray, np.ndarray]:
    """Directions ``(n, 3)`` and solid angles ``(n,)``: Gauss-Legendre in x, uniform around x."""
    return _around_x(*np.polynomial.legendre.leggauss(2 * resolution), _ring(resolution))


def _around_x(
    nodes: np.ndarray, weights: np.ndarray, around: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Directions and solid angles of a product rule: ``nodes`` in x times a ring around x."""
    directions = np.concatenate(
        [np.column_stack([np.full(len(around), x), np.sqrt(1 - x * x) * around]) for x in nodes]
    )
    return directions, np.repeat(weights * 2 * np.pi / len(around), len(around))


def _join(parts: list[Surface]) -> Surface:
    return Surface(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))
