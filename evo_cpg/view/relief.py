"""Ground with relief: its surface, and what is laid on it.

It is drawn as translucent, so that it fades towards the horizon, but writes its depth, so that
hills hide what is behind them; its triangles are sorted from front to back for that.
"""

from collections.abc import Callable

import numpy as np
import pyvista as pv

from evo_cpg.creature.creature import Creature
from evo_cpg.view.camera import turned_about_vertical
from evo_cpg.view.ground import Marks, Update
from evo_cpg.view.look import Look
from evo_cpg.view.offscreen import write_depth
from evo_cpg.view.shadows import CONTACT, patch_under, soles, spot_under
from evo_cpg.view.terrain import Terrain
from evo_cpg.view.textures import CELLS, floor_texture, spot_texture

# Brightness of level ground, change of it with the sine of the angle to the sun, and the darkest.
_LEVEL, _SLOPE, _DARKEST = 0.92, 0.9, 0.25
# Water takes the red out of what lies deep: what is left of red, green and blue, and the depth at
# which two thirds of it are gone, in radii of the animal.
_SUNKEN, _SUNKEN_DEPTH = (0.36, 0.87, 1.0), 0.6
# Wet ground is this much darker, up to this height above the water in radii of the animal.
_WET, _WET_HEIGHT = 0.78, 0.07
# What lies on the ground is lifted by this share of the animal's radius.
LIFT = 0.008
# Points along a side of a soft patch.
_PATCH = 9
# Likewise of the pool of light, which is larger, and how high it lies.
_POOL, _POOL_LIFT = 41, 0.02

# Triangles are sorted anew when the camera has turned so far, rad.
_RESORT = np.radians(8.0)
# The horizon follows when the focus has moved by this share of the visibility: less changes no
# opacity by more than one of 255 levels, and to hand over all of them takes as long as to draw.
_FOLLOW = 0.004

Pose = Callable[[np.ndarray, np.ndarray], None]


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
    """The surface of the ground, lit by the sun, with the grid on it.

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
    mesh["rgba"] = rgba
    turned = (points[:, :2] - marks.origin) @ marks.turn()
    mesh.active_texture_coordinates = turned / (CELLS * spacing)
    texture = floor_texture(look.floor, look.grid, look.checkered, marked=True)
    actor = plotter.add_mesh(
        mesh, scalars="rgba", rgba=True, texture=texture, lighting=False, show_scalar_bar=False
    )
    actor.ForceTranslucentOn()
    write_depth(actor)
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


def add_draped_shadows(
    plotter: pv.Plotter,
    look: Look,
    meshes: list[pv.PolyData],
    terrain: Terrain,
    sun: np.ndarray,
    radius: float,
) -> Pose:
    """The shadows that bodies or obstacles cast on the ground in the sun.

    Args:
        plotter: draws them.
        look: of the world; nothing is drawn where it casts no shadows.
        meshes: of the bodies, in their own frames.
        terrain: on which the shadows lie.
        sun: unit vector towards the sun ``(3,)``.
        radius: of the animal, m.

    Returns:
        A function of the bodies' centres ``(bodies, 3)`` in m and rotations ``(bodies, 3, 3)``.
    """
    if not look.cast_strength or not meshes:
        return lambda position, rotation: None
    own = [np.asarray(mesh.points).astype(float) for mesh in meshes]
    first = np.cumsum([0, *map(len, own)])
    faces = [mesh.triangulate().regular_faces + i for mesh, i in zip(meshes, first, strict=False)]
    shadow = pv.PolyData.from_regular_faces(np.concatenate(own), np.concatenate(faces))
    actor = plotter.add_mesh(
        shadow, color=look.shadow, opacity=look.cast_strength, lighting=False, culling="back"
    )
    # Where shadows overlap the ground is darkened once: they write their depth, each a little below
    # the one before.
    write_depth(actor)
    layer = np.repeat(LIFT * radius * np.linspace(1.0, 0.5, len(own)), [len(p) for p in own])
    slant = sun[:2] / sun[2]

    def update(position: np.ndarray, rotation: np.ndarray) -> None:
        points = np.concatenate(
            [c + p @ turn.T for p, c, turn in zip(own, position, rotation, strict=True)]
        )
        place, high = points[:, :2], points[:, 2]
        # Where the ray through each point meets the ground.
        ground = terrain.height(place)
        for _ in range(4):
            ground = terrain.height(place - (high - ground)[:, None] * slant)
        fallen = np.maximum(high - ground, 0.0)[:, None]
        place = place - fallen * slant
        shadow.points = np.column_stack([place, terrain.height(place) + layer])

    return update


def add_draped_patches(
    plotter: pv.Plotter, look: Look, terrain: Terrain, half_extents: np.ndarray, radius: float
) -> Pose:
    """Soft patches on the ground under the bodies.

    Args:
        plotter: draws them.
        look: of the world.
        terrain: on which they lie.
        half_extents: of the bodies ``(bodies, 3)``, m.
        radius: of the animal, m.

    Returns:
        A function of the bodies' centres ``(bodies, 3)`` in m and rotations ``(bodies, 3, 3)``.
    """
    texture = spot_texture(look.shadow, look.shadow_strength, sharpness=2.2)
    patches = _Patches(plotter, texture, terrain, LIFT * radius, len(half_extents))

    def update(position: np.ndarray, rotation: np.ndarray) -> None:
        gap = position[:, 2] - terrain.height(position[:, :2])
        under = [patch_under(*each) for each in zip(rotation, half_extents, gap, strict=True)]
        patches.lay(position[:, :2], np.array(under))

    return update


def add_draped_contacts(
    plotter: pv.Plotter, look: Look, creature: Creature, terrain: Terrain, radius: float
) -> Pose:
    """Dark soft spots where bodies touch the ground; they pale as the gap opens.

    Args:
        plotter: draws them.
        look: of the world.
        creature: the animal.
        terrain: on which they lie.
        radius: of the animal, m.

    Returns:
        A function of the bodies' centres ``(bodies, 3)`` in m and rotations ``(bodies, 3, 3)``.
    """
    texture = spot_texture(look.shadow, CONTACT, sharpness=2.6)
    patches = _Patches(plotter, texture, terrain, LIFT * radius, len(creature.bodies))
    points = [soles(body.shape) for body in creature.bodies]
    sizes = [float(body.shape.half_extents.min()) for body in creature.bodies]

    def update(position: np.ndarray, rotation: np.ndarray) -> None:
        places = [
            centre + own @ turn.T
            for own, centre, turn in zip(points, position, rotation, strict=True)
        ]
        ground = np.split(
            terrain.height(np.concatenate(places)[:, :2]), np.cumsum([*map(len, places)])[:-1]
        )
        spots = [
            spot_under(place[:, :2], place[:, 2] - low, size)
            for place, low, size in zip(places, ground, sizes, strict=True)
        ]
        middles, axes, opacities = map(np.array, zip(*spots, strict=True))
        patches.lay(middles, axes, opacities)

    return update


def add_draped_light(
    plotter: pv.Plotter, look: Look, terrain: Terrain, goal: np.ndarray, radius: float
) -> None:
    """The pool of light on the ground under the goal.

    Args:
        plotter: draws it.
        look: of the world.
        terrain: on which it lies.
        goal: place of the light ``(3,)``, m.
        radius: of the animal, m.
    """
    shine = spot_texture(look.halo, look.glow, sharpness=3.0)
    pool = _Patches(plotter, shine, terrain, _POOL_LIFT * radius, 1, _POOL)
    pool.lay(goal[None, :2], 1.8 * radius * np.eye(2)[None])


class _Patches:
    """Soft spots that hug the ground, in one mesh: an actor each would cost more than to draw it.

    Args:
        plotter: draws them.
        texture: of each.
        terrain: on which they lie.
        lift: above it, m.
        count: of the spots.
        points: along a side of each.
    """

    def __init__(
        self,
        plotter: pv.Plotter,
        texture: pv.Texture,
        terrain: Terrain,
        lift: float,
        count: int,
        points: int = _PATCH,
    ):
        one = pv.Plane(i_size=2, j_size=2, i_resolution=points - 1, j_resolution=points - 1)
        corners = np.asarray(one.points)
        first = len(corners) * np.arange(count)[:, None, None]
        quads = (one.regular_faces + first).reshape(-1, 4)
        self._mesh = pv.PolyData.from_regular_faces(np.tile(corners, (count, 1)), quads)
        self._mesh.active_texture_coordinates = np.tile(
            np.asarray(one.active_texture_coordinates), (count, 1)
        )
        self._rgba = np.full((len(corners) * count, 4), 255, np.uint8)
        self._mesh["rgba"] = self._rgba
        self._own, self._terrain, self._lift = corners[:, :2].astype(float), terrain, lift
        actor = plotter.add_mesh(
            self._mesh,
            scalars="rgba",
            rgba=True,
            texture=texture,
            lighting=False,
            show_scalar_bar=False,
        )
        actor.ForceTranslucentOn()

    def lay(self, middle: np.ndarray, axes: np.ndarray, opacity: np.ndarray | None = None) -> None:
        """Move them.

        Args:
            middle: of each ``(n, 2)``, m.
            axes: half axes of each, the columns of ``(n, 2, 2)``, m.
            opacity: of each ``(n,)``; all is drawn if None.
        """
        place = (middle[:, None] + self._own @ axes.mT).reshape(-1, 2)
        high = self._terrain.height(place) + self._lift
        self._mesh.points = np.column_stack([place, high])
        if opacity is not None:
            self._rgba[:, 3] = np.repeat(255 * opacity, len(self._own))
            self._mesh["rgba"] = self._rgba
