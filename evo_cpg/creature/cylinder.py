"""Cylinders with flat ends."""

import dataclasses
from typing import ClassVar

import numpy as np
from typing_extensions import override

from evo_cpg.creature.algebra.decisions import decided
from evo_cpg.creature.algebra.numerics import Number, Numbers, xp
from evo_cpg.creature.shapes import (
    LEAST,
    FloorPart,
    ObstaclePart,
    RoundedBox,
    Shape,
    SkinMesh,
    Surface,
    ring,
)

# Points on each rim of a cylinder that stand for it in pictures of contact, and corners of a rim in
# pictures of the body.
_RIM, _ROUND_RIM = 16, 48


@dataclasses.dataclass(frozen=True)
class Cylinder(Shape):
    """Cylinder along x with flat ends.

    Limbs that touch each other, and obstacles, see a long cylinder as a capsule of equal length and
    radius, so its rims may enter by 0.41 radii. They see a disc as a square plate with round edges.

    Attributes:
        radius: radius, m.
        length: length, m.
    """

    blunt: ClassVar[bool] = True
    profile = "cylinder"
    obstacle_kind = "line"

    radius: Number
    length: Number

    @property
    @override
    def volume(self) -> Number:
        return xp.pi * self.radius**2 * self.length

    @property
    @override
    def half_extents(self) -> Numbers:
        return xp.array([self.length / 2, self.radius, self.radius])

    @property
    @override
    def reach(self) -> Number:
        return xp.sqrt(self.length**2 / 4 + self.radius**2)

    @override
    def inertia(self, mass: Number) -> Numbers:
        r, length = self.radius, self.length
        across = mass * (length**2 / 12 + r**2 / 4)
        return xp.diag(xp.array([mass * r**2 / 2, across, across]))

    @property
    @override
    def ellipsoid(self) -> Numbers:
        """Semi-axes of an ellipsoid of equal volume.

        A thin disc has its radius, so the added mass is 8/3 rho r^3. A long cylinder has its second
        moment along the axis, so a rod that tumbles has rho pi r^2 L^3 / 12.
        """
        r, length = xp.maximum(self.radius, LEAST), xp.maximum(self.length, LEAST)
        slender = length**2 / (length**2 + 4 * r**2)
        along = length / 2 * (1.5 + (np.sqrt(5 / 3) - 1.5) * slender)
        across = r * xp.sqrt(0.75 * length / along)
        return xp.array([along, across, across])

    @property
    @override
    def rounded_box(self) -> RoundedBox:
        edge = xp.minimum(self.radius, self.length / 2)
        along = self.length / 2 - edge
        # A square of equal area stands for the flat part of a disc.
        across = np.sqrt(np.pi) / 2 * (self.radius - edge)
        return RoundedBox(np.zeros(3), xp.array([along, across, across]), edge)

    @override
    def distance(self, points: Numbers) -> Numbers:
        around = xp.sqrt(xp.square(points[:, 1]) + xp.square(points[:, 2]))
        excess = xp.stack([xp.abs(points[:, 0]) - self.length / 2, around - self.radius], 1)
        outside = xp.linalg.norm(xp.maximum(excess, 0), axis=-1)
        return outside + xp.minimum(excess.max(-1), 0)

    @override
    def support(self, direction: Numbers) -> Numbers:
        around = direction * np.array([0.0, 1.0, 1.0])
        size = xp.linalg.norm(around)
        # The middle of an end is its farthest point if the axis lies along the direction.
        outward = around / xp.where(size > 0, size, 1.0)
        end = xp.array([xp.sign(direction[0]) * self.length / 2, 0.0, 0.0])
        return end + self.radius * outward

    @override
    def height(self, directions: np.ndarray) -> np.ndarray:
        across = np.hypot(directions[..., 1], directions[..., 2])
        return np.abs(directions[..., 0]) * float(self.length) / 2 + across * float(self.radius)

    @override
    def surface(self, resolution: int) -> Surface:
        """Return rings of points on the side and on both ends.

        The rings of an end are Gauss points of the squared radius.
        """
        nodes, weights = np.polynomial.legendre.leggauss(resolution)
        around = ring(resolution)
        count = len(around)
        places = xp.repeat(nodes * self.length / 2, count)[:, None]
        normals = xp.tile(xp.column_stack([xp.zeros(count), around]), (resolution, 1))
        side = Surface(
            xp.concatenate([places, self.radius * xp.tile(around, (resolution, 1))], 1),
            normals,
            xp.repeat(weights / 2 * 2 * xp.pi * self.radius * self.length / count, count),
        )
        radii = np.repeat(np.sqrt((nodes + 1) / 2), count)[:, None]
        disc = self.radius * radii * xp.tile(around, (resolution, 1))
        areas = xp.repeat(weights / 2 * xp.pi * self.radius**2 / count, count)
        ends = [
            Surface(
                xp.concatenate([xp.full((len(disc), 1), sign * self.length / 2), disc], 1),
                xp.tile(xp.array([[sign, 0.0, 0.0]]), (len(disc), 1)),
                areas,
            )
            for sign in (1.0, -1.0)
        ]
        return Surface(*(xp.concatenate(parts) for parts in zip(side, *ends, strict=True)))

    @override
    def floor_parts(self) -> tuple[FloorPart, ...]:
        return (FloorPart("cylinder", xp.array([self.length / 2, self.radius])),)

    @override
    def obstacle_parts(self) -> tuple[ObstaclePart, ...]:
        """Return a capsule, or the ellipsoid in a disc, so that a wheel rolls over obstacles."""
        if decided(lambda: self.length < 2 * self.radius):
            return (ObstaclePart("ellipsoid", np.zeros(3), self.half_extents, 0.0),)
        return super().obstacle_parts()

    @property
    @override
    def corners(self) -> Numbers:
        around = self.radius * _rim(_RIM)
        ends = [
            xp.concatenate([xp.full((_RIM, 1), sign * self.length / 2), around], 1)
            for sign in (1.0, -1.0)
        ]
        return xp.concatenate(ends)

    @override
    def skin(self) -> SkinMesh:
        """Return the side and both ends, with points of their own, so that the rims are sharp."""
        around = _rim(_ROUND_RIM)
        here, ahead = np.arange(_ROUND_RIM), np.roll(np.arange(_ROUND_RIM), -1)
        points, normals, faces = [], [], []
        for sign in (1.0, -1.0):
            end = np.full((_ROUND_RIM, 1), sign * self.length / 2)
            rim = np.column_stack([end, self.radius * around])
            first = _ROUND_RIM * len(points)
            points += [rim, rim]
            normals += [
                np.column_stack([0 * end, around]),
                np.tile([sign, 0.0, 0.0], (_ROUND_RIM, 1)),
            ]
            fan = np.column_stack([0 * here[1:-1], here[1:-1], ahead[1:-1]])
            faces.append(first + _ROUND_RIM + fan[:, :: int(sign)])
        back = 2 * _ROUND_RIM
        faces += [
            np.column_stack([here, back + here, back + ahead]),
            np.column_stack([here, back + ahead, ahead]),
        ]
        return SkinMesh(np.concatenate(points), np.concatenate(normals), np.concatenate(faces))


def _rim(count: int) -> np.ndarray:
    """Return unit vectors ``(count, 2)`` evenly on a circle, beginning with the first axis."""
    angles = 2 * np.pi * np.arange(count) / count
    return np.column_stack([np.cos(angles), np.sin(angles)])
