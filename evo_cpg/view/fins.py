"""Fins: thin plates, drawn as the tapered fins and flippers that they stand for.

Plates that continue each other, such as those of a starfish's arm, are one fin. A drawn fin stays
within the plates. Physics knows only the plates.
"""

import math
from typing import NamedTuple, cast

import numpy as np
import pyvista as pv

from evo_cpg.creature.creature import Creature, Joint, lowest_height, neutral_pose
from evo_cpg.creature.shapes import Box, Shape
from evo_cpg.view.offscreen import grid_triangles, smooth_surface

# Largest thickness of a plate relative to its width, and least distance of the joint from the
# plate's middle, relative to its half length.
_THIN, _AT_EDGE = 0.4, 0.7
# A plate that lies on the ground is a foot: largest angle from level.
_LEVEL = math.cos(math.radians(25))
# Loss of width and of thickness up to the tip, and part of the length where the round tip begins.
_NARROWER, _FLATTER, _ROUND = 0.45, 0.6, 0.7
# Part of the narrowing that the front edge takes, which makes the fin swept back.
_SWEEP = 0.9
# A fin is a fan if what carries it has at most this fraction of its width. Depth of the notch in
# the rear edge of a fan, relative to its length.
_FAN, _NOTCH = 0.6, 0.4
# Thickness of an edge without an end, relative to the plate.
_FLAT = 1e-3
# Points along and across a fin.
_ALONG, _ACROSS = 13, 15


class Fin(NamedTuple):
    """A plate's part of a fin.

    Attributes:
        axes: directions in the plate's frame, as rows: from joint to tip, across (the fin is wide),
            and through (it is thin).
        half: half length, width and thickness of the plate, m.
        start: place of the plate's joint along the whole fin, from 0 to 1.
        end: place of the plate's other edge.
        sweep: shift of the narrower tip across, from -1 to 1.
        root: width of a fan at its joint, relative to the plate, or None for another fin.
    """

    axes: np.ndarray
    half: np.ndarray
    start: float
    end: float
    sweep: float
    root: float | None

    def section(self, along: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return middle, half width and half thickness of sections, relative to the plate.

        Args:
            along: places along the whole fin, from 0 to 1.
        """
        if self.root is not None:
            width = self.root + (1 - self.root) * along**0.8
            return 0 * along, width, (1 - _FLATTER * along) * np.sqrt(1 - along**4)
        tip = np.maximum(along - _ROUND, 0) / (1 - _ROUND)
        narrow = (1 - _NARROWER * along**1.5) * np.sqrt(np.maximum(1 - tip**2, 0.05**2))
        thick = (1 - _FLATTER * along) * np.sqrt(np.maximum(1 - tip**2, 0))
        return self.sweep * (1 - narrow), narrow, thick

    def mesh(self) -> pv.PolyData:
        """Return the surface in the plate's frame, m: two sides and two ends."""
        span = 1 - (1 - np.linspace(0, 1, _ALONG)) ** 1.5
        across = np.sin(np.linspace(-np.pi / 2, np.pi / 2, _ACROSS))
        middle, wide, thick = self.section(self.start + (self.end - self.start) * span)
        reach = np.ones_like(across)
        if self.root is not None:
            reach = 1 - _NOTCH * (1 - np.abs(across) ** 1.5)
        place = 2 * np.outer(span, reach) - 1
        side = middle[:, None] + np.outer(wide, across)
        bulge = np.outer(thick, np.sqrt(np.maximum(1 - across**2, 0)))
        grid = np.arange(_ALONG * _ACROSS).reshape(_ALONG, _ACROSS)
        patches: list[tuple] = [
            (place, side, bulge, grid, None),
            (place, side, -bulge, grid[:, ::-1], None),
        ]
        for row, sign in ((0, -1), (-1, 1)):
            if bulge[row].max() > _FLAT:
                edge = [np.tile(each[row], (2, 1)) for each in (place, side)]
                thin = sign * np.stack([bulge[row], -bulge[row]])
                corners = np.arange(2 * _ACROSS).reshape(2, _ACROSS)
                patches.append((*edge, thin, corners, sign * self.axes[0]))
        sheets = []
        for *where, corners, normal in patches:
            points = np.stack([each.ravel() for each in where], -1) * self.half @ self.axes
            triangles = grid_triangles(corners)
            if normal is None:
                sheets.append(smooth_surface(points, triangles))
                continue
            # An end is flat.
            end = pv.PolyData.from_regular_faces(points, triangles)
            end.point_data.active_normals = np.tile(normal, (len(points), 1)).astype(np.float32)
            sheets.append(end)
        return cast(pv.PolyData, pv.merge(sheets, merge_points=False))


def fins(creature: Creature) -> dict[int, Fin]:
    """Return the fins of an animal by their bodies in ``creature.bodies``."""
    centres, rotations = neutral_pose(creature)
    wholes = {body.whole for body in creature.bodies}
    lowest = float(lowest_height(creature, (centres, rotations)))
    plates: dict[int, _Plate] = {}
    for i, body in enumerate(creature.bodies):
        if body.joint is None or body.whole or body.name in wholes:
            continue
        found = _plate(creature, body.shape, body.joint)
        if found is None:
            continue
        level = abs(rotations[i][2] @ found.axes[2]) > _LEVEL
        # A plate that lies level at the lowest height of the animal is a foot.
        if not (level and centres[i][2] - found.half[2] <= lowest + 2 * found.half[2]):
            plates[i] = found
    after: dict[int, list[int]] = {}
    for i, plate in plates.items():
        after.setdefault(plate.parent, []).append(i)

    def following(body: int) -> int | None:
        """Return the plate at the far edge of a plate, if there is one."""
        if body not in plates or len(after.get(body, ())) != 1:
            return None
        (end,), plate = after[body], plates[body]
        there = plate.axes[0] @ plates[end].place >= _AT_EDGE * plate.half[0]
        return end if there else None

    made: dict[int, Fin] = {}
    for base, plate in plates.items():
        if following(plate.parent) is not None:
            continue
        row = [base]
        while (further := following(row[-1])) is not None:
            row.append(further)
        ends = np.cumsum([0.0, *(2 * plates[i].half[0] for i in row)])
        ends /= ends[-1]
        sweep, root = 0.0, None
        if len(row) == 1:
            across = rotations[base] @ plate.axes[1]
            sweep = -_SWEEP * float(across[0])
            carrier = creature.bodies[plate.parent].shape
            own = rotations[plate.parent].T @ across
            wide = float(own @ (carrier.support(own) - carrier.support(-own))) / 2
            if wide < _FAN * plate.half[1]:
                root = wide / float(plate.half[1])
        for i, start, end in zip(row, ends[:-1], ends[1:], strict=True):
            made[i] = Fin(plates[i].axes, plates[i].half, float(start), float(end), sweep, root)
    return made


class _Plate(NamedTuple):
    """A plate that hangs at an edge.

    Attributes:
        axes: directions in the plate's frame, as in `Fin`.
        half: half length, width and thickness, m.
        parent: body that carries it.
        place: place of the joint in the parent's frame, m.
    """

    axes: np.ndarray
    half: np.ndarray
    parent: int
    place: np.ndarray


def _plate(creature: Creature, shape: Shape, joint: Joint) -> _Plate | None:
    """Return a plate that hangs at an edge, or None for another shape."""
    if not isinstance(shape, Box):
        return None
    half, hung = np.asarray(shape.half_extents, float), np.asarray(joint.child_anchor, float)
    thin, *broad = np.argsort(half)
    if half[thin] > _THIN * half[broad[0]]:
        return None
    long = max(broad, key=lambda axis: abs(hung[axis]) / half[axis])
    if abs(hung[long]) < _AT_EDGE * half[long]:
        return None
    order = [long, *(axis for axis in broad if axis != long), thin]
    axes = np.eye(3)[order]
    axes[0] *= -np.sign(hung[long])
    # Right-handed, so that both sides face outwards.
    axes[2] = np.cross(axes[0], axes[1])
    place = np.asarray(joint.parent_anchor, float)
    return _Plate(axes, half[order], creature.body_index(joint.parent), place)
