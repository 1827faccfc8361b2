"""Lofts: bodies drawn through cross-sections along a spine, as convex polyhedra.

- The plane of a section is perpendicular to the spine, halfway between the directions before and
  after it.
- The width of the first section is horizontal. From section to section the axes turn as little as
  possible (rotation-minimizing frames).
- Between two sections the body is the convex hull of both.
- The whole body is one mesh if it is convex. Otherwise it is as few convex pieces as possible, from
  end to end.

Pieces meet at a section and never overlap, so their masses and moments add up exactly. A loft that
meets itself, such as a closed ring, is refused.

An elliptic section is a polygon of `_ROUND` corners with the area of the ellipse. Volumes of
cylinders and cones are therefore exact, and their inertias are correct to 1e-4.
"""

import dataclasses
import functools
import itertools
from typing import NamedTuple

import numpy as np
from typing_extensions import override

from evo_cpg.creature.algebra.numerics import Triple
from evo_cpg.creature.mesh import ConvexMesh, MeshError, convex_mesh, hull
from evo_cpg.creature.shapes import SkinMesh

# Corners of an elliptic section. Their second moment is that of the ellipse to 3e-5.
_ROUND = 24
# Circumradius of a regular polygon over the radius of a circle with its area.
_EQUAL_AREA = float(np.sqrt(2 * np.pi / _ROUND / np.sin(2 * np.pi / _ROUND)))
# Least cosine between the directions of the spine before and after a section: 120 degrees.
_SHARPEST = -0.5
# Sine below which a direction counts as vertical.
_VERTICAL = 1e-6
# Cosine of the largest angle between faces whose edge looks smooth: 35 degrees.
_CREASE = 0.82
# Distance of a corner beyond the plane of the next section, as a fraction of the body's size, and
# excess of a hull's volume over that of its pieces, as a fraction. Both are rounding.
_CROSSING, _HOLLOW = 1e-9, 1e-9
# Radius of a ball in the common space of two slices, as a fraction of the body's size, above which
# they overlap. Slices that only touch have a radius of about 1e-7 m, which is the tolerance of the
# linear program.
_OVERLAP = 1e-6


class LoftSection(NamedTuple):
    """A cross-section.

    Attributes:
        at: its centre, a point of the spine, m.
        width: size along its first axis, m.
        height: size across, m.
    """

    at: Triple
    width: float
    height: float


@dataclasses.dataclass(frozen=True)
class SmoothMesh(ConvexMesh):
    """Convex mesh whose picture is smooth where its faces turn by little."""

    @override
    def skin(self) -> SkinMesh:
        """Return separate points for each triangle, with the mean normals of similar neighbours."""
        a, b, c = self.triangles.swapaxes(0, 1)
        doubled = np.cross(b - a, c - a)
        area = np.linalg.norm(doubled, axis=1)
        kept = np.flatnonzero(area > 0)
        flat = doubled[kept] / area[kept, None]
        faces = np.array(self.faces)[kept]
        # The triangles at each vertex, in rows that end with repetitions of no weight.
        order = np.argsort(faces.ravel(), kind="stable")
        counts = np.bincount(faces.ravel(), minlength=len(self.vertices))
        column = np.arange(counts.max())
        place = (np.cumsum(counts) - counts)[:, None] + np.minimum(column, counts[:, None] - 1)
        near = (order[np.minimum(place, len(order) - 1)] // 3)[faces]
        alike = (flat[near] * flat[:, None, None]).sum(-1) > _CREASE
        weight = alike & (column < counts[faces][..., None])
        normals = (weight[..., None] * doubled[kept][near]).sum(2)
        normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
        points = self.triangles[kept].reshape(-1, 3)
        return SkinMesh(points, normals.reshape(-1, 3), np.arange(len(points)).reshape(-1, 3))


class LoftPiece(NamedTuple):
    """A convex piece, and its centre of mass ``(3,)`` in the frame of the sections, m."""

    shape: SmoothMesh
    centre: np.ndarray


@functools.lru_cache(maxsize=256)
def loft(sections: tuple[LoftSection, ...], corners: int | None = None) -> tuple[LoftPiece, ...]:
    """Return the convex pieces of a loft, the largest one first.

    Args:
        sections: at least two sections, in order.
        corners: even number of corners of every section, or None for ellipses. A polygon fills
            the rectangle of width and height, and has a flat lower side.

    Raises:
        MeshError: the spine turns back, sections cross, a section has no size, the loft meets
            itself, or a piece cannot be a mesh.
    """
    rings = _rings(sections, corners)
    slices = [_made(rings[i : i + 2], i) for i in range(len(rings) - 1)]
    # Neighbouring slices meet at the plane of their section. No others may overlap.
    places = np.array([each.at for each in sections])
    normals, size = _normals(places), np.ptp(np.concatenate(rings), axis=0).max()
    parts = [np.concatenate(both) for both in itertools.pairwise(rings)]
    for (i, one), (j, other) in itertools.combinations(enumerate(parts), 2):
        ahead = ((other - places[i + 1]) @ normals[i + 1]).min()
        behind = ((places[j] - one) @ normals[j]).min()
        near = (one.min(0) < other.max(0)).all() and (other.min(0) < one.max(0)).all()
        # The plane of a section between the slices often separates them, which is quick to find.
        if max(ahead, behind) > -_CROSSING * size or not near:
            continue
        from scipy.optimize import linprog
        from scipy.spatial import ConvexHull

        # The largest ball within both hulls. Qhull's rows are outward unit normals and negative
        # offsets. The radius is negative if the hulls are apart.
        rows = np.concatenate([ConvexHull(points).equations for points in (one, other)])
        inside = np.column_stack([rows[:, :3], np.ones(len(rows))])
        ball = linprog([0, 0, 0, -1], inside, -rows[:, 3], bounds=[(None, None)] * 4).x
        if ball[3] > _OVERLAP * size:
            raise MeshError(
                f"the loft meets itself: the part between sections {i} and {i + 1} overlaps the "
                f"part between sections {j} and {j + 1}, so their common space would count twice. "
                f"Move them apart, make them smaller, or end the loft at section {j}"
            )
    pieces, first = [], 0
    while first < len(slices):
        last, piece = first, slices[first]
        while last + 1 < len(slices):
            longer = _made(rings[first : last + 3], first)
            apart = sum(each.shape.volume for each in slices[first : last + 2])
            if longer.shape.volume > (1 + _HOLLOW) * apart:
                break
            last, piece = last + 1, longer
        pieces.append(piece)
        first = last + 1
    return tuple(sorted(pieces, key=lambda each: -each.shape.volume))


def section_axes(sections: tuple[LoftSection, ...]) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return the unit axes of width and height of each section, see `loft`.

    Raises:
        MeshError: the spine turns back, or two sections are at one place.
    """
    return _axes(_normals(np.array([each.at for each in sections])))


def outline(corners: int | None) -> np.ndarray:
    """Return the corners ``(n, 2)`` of a section with half sizes of 1."""
    count = corners or _ROUND
    angles = 2 * np.pi * (np.arange(count) + 0.5) / count - np.pi / 2
    found = np.column_stack([np.cos(angles), np.sin(angles)])
    return found * _EQUAL_AREA if corners is None else found / np.abs(found).max(0)


def _made(rings: list[np.ndarray], first: int) -> LoftPiece:
    """Return the hull of neighbouring sections."""
    vertices, faces = hull(np.concatenate(rings), f"sections {first} and {first + 1}")
    made, centre = convex_mesh(vertices, faces)
    return LoftPiece(SmoothMesh(made.vertices, made.faces), centre)


def _rings(sections: tuple[LoftSection, ...], corners: int | None) -> list[np.ndarray]:
    """Return the corners ``(n, 3)`` of each section, m.

    Raises:
        MeshError: the spine turns back, sections cross, or a section has no size.
    """
    places = np.array([each.at for each in sections])
    for i, each in enumerate(sections):
        if not each.width * each.height and 0 < i < len(sections) - 1:
            raise MeshError(f"section {i} has no area. Only the first and the last may be a tip")
    normals = _normals(places)
    corners_at = outline(corners)
    rings = []
    for place, (across, up), each in zip(places, _axes(normals), sections, strict=True):
        ring = corners_at * (each.width / 2, each.height / 2) @ np.array([across, up])
        rings.append(np.unique(place + ring, axis=0))
    size = np.ptp(np.concatenate(rings), axis=0).max()
    for i, (one, two) in enumerate(itertools.pairwise(rings)):
        ahead = ((two - places[i]) @ normals[i]).min()
        behind = ((places[i + 1] - one) @ normals[i + 1]).min()
        if min(ahead, behind) < -_CROSSING * size:
            raise MeshError(
                f"sections {i} and {i + 1} cross. Move them apart, make them smaller, or bend the "
                "spine less"
            )
    return rings


def _normals(places: np.ndarray) -> np.ndarray:
    """Return the unit normal ``(n, 3)`` of each section's plane."""
    steps = np.diff(places, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    if not lengths.all():
        i = int(lengths.argmin())
        raise MeshError(f"sections {i} and {i + 1} are at one place. Move them apart")
    steps /= lengths[:, None]
    for i, cosine in enumerate((steps[1:] * steps[:-1]).sum(1), start=1):
        if cosine < _SHARPEST:
            raise MeshError(
                f"the spine bends by {np.degrees(np.arccos(max(cosine, -1))):.0f} degrees at "
                f"section {i}. Allowed: up to {np.degrees(np.arccos(_SHARPEST)):.0f}. Are the "
                "sections in order?"
            )
    normals = np.concatenate([steps[:1], steps[1:] + steps[:-1], steps[-1:]])
    return normals / np.linalg.norm(normals, axis=1)[:, None]


def _axes(normals: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return the axes of width and height of each section."""
    first = normals[0]
    across = np.array([-first[1], first[0], 0.0])
    sine = np.linalg.norm(across)
    across = across / sine if sine > _VERTICAL else np.array([0.0, 1.0, 0.0])
    found = []
    before = first
    for normal in normals:
        # The shortest rotation from one normal to the next (Rodrigues).
        axis, cosine = np.cross(before, normal), before @ normal
        turned = cosine * across + np.cross(axis, across)
        across = turned + axis * (axis @ across) / (1 + cosine)
        across -= (across @ normal) * normal
        across /= np.linalg.norm(across)
        found.append((across, np.cross(normal, across)))
        before = normal
    return found
