"""The shell of a turtle, with scutes above and a flat, pale belly. It is only drawn."""

from typing import cast

import numpy as np
import pyvista as pv

from evo_cpg.creature.creature import Body
from evo_cpg.creature.shapes import Ellipsoid

# Bodies with these names that are ellipsoids are drawn as shells.
NAMES = ("shell", "carapace")
# Middles of scutes from above, relative to the half length and half width: in a row along the
# middle, in a row on each side, and around the rim.
_MIDDLE = [(x, 0.0) for x in (0.72, 0.36, 0.0, -0.36, -0.72)]
_BESIDE = [(x, side) for x in (0.52, 0.18, -0.18, -0.52) for side in (0.48, -0.48)]
_RIM, _AT_RIM = 22, 0.97
# Width of a seam between scutes, its depth, and its brightness. Brightness of a scute's middle.
# Size of that middle.
_SEAM, _DEPTH, _DARK, _PALE, _MIDDLE_SIZE = 0.075, 0.03, 0.5, 1.3, 0.12
# Depth of the belly relative to the ellipsoid, and its colour, red, green and blue.
_BELLY, _BELLY_COLOR = 0.6, np.array([0.86, 0.78, 0.55])
# Rings from the middle to the rim, and points around.
_OUT, _AROUND = 25, 64
# The belly has a ring of points for this many rings above.
_COARSER = 4


def is_shell(body: Body) -> bool:
    """Return whether a body is drawn as a shell."""
    return body.name in NAMES and isinstance(body.shape, Ellipsoid)


def shell_mesh(body: Body, color: np.ndarray) -> pv.PolyData:
    """Return the surface of a shell in its own frame, m, with colours ``rgb`` of its points.

    Args:
        body: the body, an ellipsoid.
        color: colour of the scutes: red, green and blue from 0 to 1.
    """
    out, half = np.linspace(0, np.pi / 2, _OUT), np.asarray(body.shape.half_extents, float)
    flat, height = _dome(out)
    scute, far = _scutes(flat)
    # Seams end at the rim, where the belly begins.
    seam = _DEPTH * (1 - scute) * np.sqrt(height)
    above = np.column_stack([flat, height]) * (1 - seam)[:, None]
    tone = _DARK + (1 + (_PALE - 1) * np.exp(-((far / _MIDDLE_SIZE) ** 2)) - _DARK) * scute
    top = _sheet(above * half, _faces(_OUT), np.minimum(color * tone[:, None], 1))
    flat, height = _dome(out[::_COARSER])
    below = np.column_stack([flat, -_BELLY * height]) * half
    belly = _sheet(
        below,
        _faces(len(below) // _AROUND)[:, ::-1],
        np.broadcast_to(_BELLY_COLOR, below.shape),
    )
    return cast(pv.PolyData, pv.merge([top, belly], merge_points=False))


def _dome(out: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return places ``(n, 2)`` and heights ``(n,)`` on a half sphere, ring by ring.

    Args:
        out: angles of the rings from the middle, rad.
    """
    around = 2 * np.pi * np.arange(_AROUND) / _AROUND
    ring = np.stack([np.cos(around), np.sin(around)], -1)
    flat = (np.sin(out)[:, None, None] * ring).reshape(-1, 2)
    # The rim is level.
    return flat, np.repeat(np.maximum(np.cos(out), 0).round(9), _AROUND)


def _faces(rings: int) -> np.ndarray:
    """Return the triangles between rings. The first ring is one point."""
    grid = np.arange(rings * _AROUND).reshape(rings, _AROUND)
    a, b = grid[:-1], grid[1:]
    c, d = np.roll(b, -1, 1), np.roll(a, -1, 1)
    one, two = np.stack([a, b, c], -1), np.stack([a, c, d], -1)[1:]
    return np.concatenate([one.reshape(-1, 3), two.reshape(-1, 3)])


def _sheet(points: np.ndarray, faces: np.ndarray, rgb: np.ndarray) -> pv.PolyData:
    sheet = pv.PolyData.from_regular_faces(points, faces)
    sheet["rgb"] = np.round(255 * rgb).astype(np.uint8)
    smooth = sheet.compute_normals(
        cell_normals=False, split_vertices=False, consistent_normals=False
    )
    return cast(pv.PolyData, smooth)


def _scutes(places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return where places ``(n, 2)`` lie: 0 in a seam to 1 on a scute, and how far from its middle.

    The scutes are the Voronoi cells of their middles.
    """
    around = 2 * np.pi * (np.arange(_RIM) + 0.5) / _RIM
    rim = _AT_RIM * np.column_stack([np.cos(around), np.sin(around)])
    middles = np.array([*_MIDDLE, *_BESIDE, *rim])
    # Scutes of the rim are narrow.
    narrow = np.concatenate([np.zeros(len(_MIDDLE) + len(_BESIDE)), np.full(_RIM, 0.12)])
    away = np.linalg.norm(places[:, None] - middles, axis=-1) + narrow
    near, next_ = np.sort(away, axis=1)[:, :2].T
    part = np.clip((next_ - near) / _SEAM, 0, 1)
    return part * part * (3 - 2 * part), near
