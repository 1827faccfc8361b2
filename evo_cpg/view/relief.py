"""The surface of ground with relief.

It is drawn as translucent, so that it fades towards the horizon, but writes its depth, so that
hills hide what is behind them; its triangles are sorted from front to back for that.
"""

import numpy as np
import pyvista as pv

from evo_cpg.view.camera import turned_about_vertical
from evo_cpg.view.ground import Marks, Update
from evo_cpg.view.look import Look
from evo_cpg.view.offscreen import add_faded, write_depth
from evo_cpg.view.terrain import Terrain
from evo_cpg.view.textures import CELLS, floor_texture

# Brightness of level ground, change of it with the sine of the angle to the sun, and the darkest.
_LEVEL, _SLOPE, _DARKEST = 0.92, 0.9, 0.25
# Water takes the red out of what lies deep: what is left of red, green and blue, and the depth at
# which two thirds of it are gone, in radii of the animal.
_SUNKEN, _SUNKEN_DEPTH = (0.36, 0.87, 1.0), 0.6
# Wet ground is this much darker, up to this height above the water in radii of the animal.
_WET, _WET_HEIGHT = 0.78, 0.07

# Triangles are sorted anew when the camera has turned so far, rad.
_RESORT = np.radians(8.0)
# The horizon follows when the focus has moved by this share of the visibility: less changes no
# opacity by more than one of 255 levels, and to hand over all of them takes as long as to draw.
_FOLLOW = 0.004


def add_relief(
    plotter: pv.Plotter,
    look: Look,
    terrain: Terrain,
    radius: float,
    spacing: float,
    marks: Marks,
    sight: np.ndarray,
    sun: np.ndarray,
    surface: float | None = None,
) -> Update:
    """Draw the surface of the ground, lit by the sun, with the grid on it.

    Args:
        plotter: draws it.
        look: of the world.
        terrain: its mesh.
        radius: of the animal, m.
        spacing: of the grid, m.
        marks: where the grid lies.
        sight: the camera's direction of view in the first frame ``(3,)``.
        sun: unit vector towards the sun ``(3,)``.
        surface: of the water, m; None where there is none.

    Returns:
        A function of the focus ``(3,)``, m; see `evo_cpg.view.ground.Update`.
    """
    points, triangles = terrain.points(), terrain.triangles()
    middle = points[triangles].mean(1)

    def sorted_for(turned: float) -> np.ndarray:
        return triangles[np.argsort(middle @ turned_about_vertical(sight, turned))]

    mesh, sorted_at = pv.PolyData.from_regular_faces(points, sorted_for(0.0)), 0.0
    shade = np.clip(_LEVEL + _SLOPE * (terrain.normals() @ sun - sun[2]), _DARKEST, 1.0)
    tint = np.repeat(shade[:, None], 3, 1)
    if surface is not None:
        depth = (surface - points[:, 2]) / radius
        wet = np.interp(-depth, (0.0, _WET_HEIGHT), (_WET, 1.0))
        sunken = 1 - np.exp(-np.maximum(depth, 0.0) / _SUNKEN_DEPTH)
        tint *= wet[:, None] * (1 + sunken[:, None] * (np.array(_SUNKEN) - 1))
    rgba = np.column_stack([255 * tint, np.full(len(points), 255)]).astype(np.uint8)
    turned = (points[:, :2] - marks.origin) @ marks.turn()
    mesh.active_texture_coordinates = turned / (CELLS * spacing)
    texture = floor_texture(look.floor, look.grid, look.checkered, marked=True)
    write_depth(add_faded(plotter, mesh, rgba, texture=texture))
    visible, faded_at = look.visibility * radius, np.full(2, np.inf)

    def update(focus: np.ndarray, turned: float = 0.0) -> None:
        nonlocal sorted_at, faded_at
        if abs(turned - sorted_at) > _RESORT:
            mesh.regular_faces, sorted_at = sorted_for(turned), turned
        if np.linalg.norm(focus[:2] - faded_at) < _FOLLOW * visible:
            return
        faded_at = focus[:2].copy()
        away = ((points[:, :2] - focus[:2]) ** 2).sum(1)
        rgba[:, 3] = 255 * np.exp(-away / visible**2)
        mesh["rgba"] = rgba

    return update
