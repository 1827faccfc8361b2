"""The way that the animal has come."""

from collections.abc import Callable
from typing import cast

import numpy as np
import pyvista as pv

from evo_cpg.view.look import Look
from evo_cpg.view.offscreen import add_faded


def add_trail(
    plotter: pv.Plotter, look: Look, path: np.ndarray, thickness: float, fade: float
) -> Callable[[int], None]:
    """A fading thread along the way that a body has come.

    The whole thread is meshed once; each frame only says how much of it shows.

    Args:
        plotter: draws it.
        look: of the world.
        path: of the body ``(frames, 3)``, m.
        thickness: radius of the thread, m.
        fade: number of frames after which it has faded to a third.

    Returns:
        A function of the frame's number.
    """
    moved = np.linalg.norm(np.diff(path, axis=0), axis=1) > thickness / 10
    kept = np.flatnonzero(np.concatenate([[True], moved]))
    if len(kept) < 2:
        return lambda frame: None
    line = pv.lines_from_points(path[kept])
    line["frame"] = kept.astype(float)
    tube = cast(pv.PolyData, line.tube(radius=thickness, n_sides=6, capping=False))
    born = np.asarray(tube.point_data["frame"])
    rgba = np.tile(pv.Color(look.trail, opacity=0).int_rgba, (len(born), 1)).astype(np.uint8)
    add_faded(plotter, tube, rgba, culling="back")

    def update(frame: int) -> None:
        age = frame - born
        alpha = np.where(age >= 0, 0.75 * np.exp(-age / fade), 0.0)
        rgba[:, 3] = 255 * alpha
        tube.point_data["rgba"] = rgba

    return update
