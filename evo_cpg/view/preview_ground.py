"""What is around a creature in the picture of its body plan: pale ground, stones and water."""

import dataclasses
import functools

import numpy as np
import pyvista as pv

from evo_cpg.creature.creature import Creature, lowest_height
from evo_cpg.physics.footing import Ground
from evo_cpg.view.ground import add_floor, grid_spacing
from evo_cpg.view.look import LOOKS, Look
from evo_cpg.view.obstacles import add_obstacles, obstacle_mesh
from evo_cpg.view.shadows import add_contacts, add_shadows
from evo_cpg.view.terrain import Level, heights, make_terrain

# Names and axes stand out from it.
_LOOK = dataclasses.replace(
    LOOKS["land"], floor=("#d3cab8", "#ece5d8"), grid="#a89c84", visibility=1.7
)
# The same under water, and what is behind.
_SUNK = dataclasses.replace(_LOOK, floor=("#86b5bd", "#a9d0d4"), grid="#4f8b95")
SEA = "#cde5ec"
# Colour and opacity of the water's surface, and of what is under it.
_WATER, _SHEET, _TINT = "#2f9fc4", 0.42, 0.4
# Brightness of level ground that is lit from above, and how much slopes change it.
_AMBIENT, _DIFFUSE = 0.55, 0.45
# Obstacles that are nearer than this many lengths of the creature are in the picture, and ground
# with relief reaches so many radii of the picture beyond them, finely and then coarsely, so that
# its edge is in no picture.
_NEAR, _BEYOND, _FAR = 5.0, 0.35, 4.0
# What hides the buried parts of obstacles lies so deep under the floor and is so wide, in radii.
_LIFT, _WIDE = 0.002, 20.0


def obstacles_near(ground: Ground | None, hull: np.ndarray) -> tuple[np.ndarray, int]:
    """Points of the obstacles that belong into the picture ``(n, 3)``, m, and how many do not.

    Args:
        ground: with its obstacles.
        hull: points of the creature ``(n, 3)`` in the world, m.
    """
    middle = (hull.min(0) + hull.max(0)) / 2
    length = float(np.ptp(hull, axis=0).max())
    near, far = [np.zeros((0, 3))], 0
    for obstacle in ground.obstacles if ground else ():
        mesh, place, turn = obstacle_mesh(obstacle)
        points = np.asarray(mesh.points) @ turn.T + place
        if np.linalg.norm(points - middle, axis=1).min() <= (_NEAR + 0.5) * length:
            near.append(points)
        else:
            far += 1
    return np.concatenate(near), far


def add_preview_ground(
    plotter: pv.Plotter,
    creature: Creature,
    centres: np.ndarray,
    rotations: np.ndarray,
    shown: np.ndarray,
    ground: Ground | None,
    sunk: bool,
) -> None:
    """Ground, shadows where the creature stands on it, and the obstacles.

    Args:
        plotter: draws them.
        creature: that stands on it.
        centres: of its bodies ``(b, 3)``, m.
        rotations: of its bodies ``(b, 3, 3)``.
        shown: points of all that the picture is to show ``(n, 3)``, m.
        ground: as it is in the world; None for level ground under the creature's lowest point.
        sunk: whether all of it is under water.
    """
    look = _SUNK if sunk else _LOOK
    middle = (shown.min(0) + shown.max(0)) / 2
    radius = float(np.linalg.norm(shown - middle, axis=1).max())
    if ground is not None:
        above = functools.partial(heights, ground.floor)
        add_obstacles(plotter, ground.obstacles, _AMBIENT, above)
        height = dataclasses.replace(ground, obstacles=()).level
    else:
        height = lowest_height(creature, (centres, rotations))
    if ground is not None and height is None:
        _add_relief(plotter, look, ground, shown[:, :2], radius)
        return
    assert height is not None
    if ground is not None and ground.obstacles:
        # The floor is translucent; what is under it shall not be seen.
        side, deep = _WIDE * radius, height - _LIFT * radius
        below = pv.Plane(center=(middle[0], middle[1], deep), i_size=side, j_size=side)
        plotter.add_mesh(below, color=plotter.background_color, lighting=False)
    add_floor(plotter, look, height, radius, grid_spacing(radius))(middle)
    half_extents = np.array([body.shape.half_extents for body in creature.bodies])
    level = Level(height)
    add_shadows(plotter, look, level, half_extents, radius)(centres, rotations)
    add_contacts(plotter, look, creature, level, radius)(centres, rotations)


def water_note(surface: float, hull: np.ndarray) -> str:
    """Return where a creature is in the water, in words.

    Args:
        surface: height of the water, m; infinite for water everywhere.
        hull: points of the creature ``(n, 3)``, m.
    """
    low, high = float(hull[:, 2].min()), float(hull[:, 2].max())
    if surface == np.inf:
        return "water everywhere"
    if surface >= high:
        return f"{surface - high:.2g} m under water"
    return "partly under water" if surface > low else f"{low - surface:.2g} m above the water"


def add_preview_water(plotter: pv.Plotter, surface: float, shown: np.ndarray) -> None:
    """The surface of the water.

    Args:
        plotter: draws it.
        surface: height of the water, m.
        shown: points of all that the picture is to show ``(n, 3)``, m.
    """
    middle = (shown.min(0) + shown.max(0)) / 2
    side = _WIDE * float(np.linalg.norm(shown - middle, axis=1).max())
    sheet = pv.Plane(center=(middle[0], middle[1], surface), i_size=side, j_size=side)
    plotter.add_mesh(sheet, color=_WATER, opacity=_SHEET, lighting=False)


def tint_under_water(plotter: pv.Plotter, surface: float, meshes: list[pv.PolyData]) -> None:
    """What of the creature is under water.

    Args:
        plotter: draws it.
        surface: height of the water, m.
        meshes: of the bodies, in the world.
    """
    for mesh in meshes:
        wet = mesh.clip("z", origin=(0.0, 0.0, surface))
        if wet.n_points:
            plotter.add_mesh(wet, color=_WATER, opacity=_TINT, lighting=False)


def _add_relief(
    plotter: pv.Plotter, look: Look, ground: Ground, place: np.ndarray, radius: float
) -> None:
    """Ground that is not level."""
    terrain = make_terrain(ground.floor, place, _BEYOND * radius, _FAR * radius)
    mesh = pv.PolyData.from_regular_faces(terrain.points(), terrain.triangles())
    mesh.point_data.active_normals = terrain.normals()
    plotter.add_mesh(
        mesh,
        color=look.floor[1],
        smooth_shading=True,
        ambient=_AMBIENT,
        diffuse=_DIFFUSE,
        specular=0.0,
    )
