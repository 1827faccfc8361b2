"""Soft spots and shadows on the ground: cast shadows, patches under bodies, and contacts."""

from collections.abc import Sequence

import numpy as np
import pyvista as pv

from evo_cpg.view.offscreen import add_faded, spot_texture, write_depth
from evo_cpg.view.stage import Shot, Stage, Update
from evo_cpg.view.terrain import Level, Terrain

# Height of a body at which the patch under it begins to fade, and at which it has gone, in radii of
# the animal.
_HIGH, _GONE = 1.0, 2.0
# Opacity of the spot under a foot that touches the ground.
_CONTACT = 0.85
# Points along a side of a spot on uneven ground.
_POINTS = 9


class Spots:
    """Soft spots on the ground in one mesh, which draws faster than one actor for each spot.

    Args:
        plotter: plotter of the picture.
        texture: texture of each spot.
        ground: ground under the spots.
        lift: height of the spots above the ground, m.
        count: number of spots.
        points: points along a side of each spot, on uneven ground.
    """

    def __init__(
        self,
        plotter: pv.Plotter,
        texture: pv.Texture,
        ground: Level | Terrain,
        lift: float,
        count: int,
        points: int = _POINTS,
    ):
        cells = 1 if isinstance(ground, Level) else points - 1
        one = pv.Plane(i_size=2, j_size=2, i_resolution=cells, j_resolution=cells)
        corners = np.asarray(one.points)
        first = len(corners) * np.arange(count)[:, None, None]
        quads = (one.regular_faces + first).reshape(-1, 4)
        self._mesh = pv.PolyData.from_regular_faces(np.tile(corners, (count, 1)), quads)
        self._mesh.active_texture_coordinates = np.tile(
            np.asarray(one.active_texture_coordinates), (count, 1)
        )
        self._rgba = np.full((len(corners) * count, 4), 255, np.uint8)
        self._own, self._ground, self._lift = corners[:, :2].astype(float), ground, lift
        add_faded(plotter, self._mesh, self._rgba, texture=texture)

    def lay(self, middle: np.ndarray, axes: np.ndarray, opacity: np.ndarray | None = None) -> None:
        """Lay the spots on the ground at other places.

        Args:
            middle: middle of each spot ``(n, 2)``, m.
            axes: half axes of each spot, the columns of ``(n, 2, 2)``, m.
            opacity: opacity of each spot ``(n,)``, 0 to 1, or None to keep it.
        """
        place = (middle[:, None] + self._own @ axes.mT).reshape(-1, 2)
        self._mesh.points = np.column_stack([place, self._ground.height(place) + self._lift])
        if opacity is not None:
            self._rgba[:, 3] = np.repeat(255 * opacity, len(self._own))
            self._mesh["rgba"] = self._rgba


def add_sun_shadows(stage: Stage, meshes: Sequence[pv.PolyData]) -> Update:
    """Draw the shadows that meshes of bodies or obstacles, in their own frames, cast in the sun.

    Nothing is drawn if the look has no cast shadows.
    """
    look, ground, sun = stage.look, stage.ground, stage.sun
    if not look.cast_strength or not meshes:
        return lambda shot: None
    own = [np.asarray(mesh.points).astype(float) for mesh in meshes]
    first = np.cumsum([0, *map(len, own)])
    faces = [mesh.triangulate().regular_faces + i for mesh, i in zip(meshes, first, strict=False)]
    shadow = pv.PolyData.from_regular_faces(np.concatenate(own), np.concatenate(faces))
    actor = stage.plotter.add_mesh(
        shadow, color=look.shadow, opacity=look.cast_strength, lighting=False, culling="back"
    )
    # Overlapping shadows darken the ground once, because they write their depth. Each shadow lies a
    # little below the previous one.
    write_depth(actor)
    layer = np.repeat(stage.lift * np.linspace(1.0, 0.5, len(own)), [len(p) for p in own])
    slant = sun[:2] / sun[2]

    def update(shot: Shot) -> None:
        points = np.concatenate(
            [c + p @ turn.T for p, c, turn in zip(own, shot.position, shot.rotation, strict=True)]
        )
        place, high = points[:, :2], points[:, 2]
        # Find the place at which the ray through each point meets the ground.
        low = ground.height(place)
        for _ in range(4):
            low = ground.height(place - (high - low)[:, None] * slant)
        fallen = np.maximum(high - low, 0.0)[:, None]
        place = place - fallen * slant
        shadow.points = np.column_stack([place, ground.height(place) + layer])

    return update


def add_shadows(stage: Stage, half_extents: np.ndarray) -> Update:
    """Draw soft patches on the ground under bodies with these half extents ``(n, 3)``, m."""
    texture = spot_texture(stage.look.shadow, stage.look.shadow_strength, sharpness=2.2)
    spots = Spots(stage.plotter, texture, stage.ground, stage.lift, len(half_extents))

    def update(shot: Shot) -> None:
        gap = shot.position[:, 2] - stage.ground.height(shot.position[:, :2])
        under = np.zeros((len(half_extents), 2, 2))
        for i in np.flatnonzero(half_extents.any(1)):
            across = shot.rotation[i, :2] * half_extents[i]
            # The patch widens with height above the floor, because the sky lights its edge.
            blur = 0.9 * half_extents[i].min() + 0.12 * max(gap[i], 0.0)
            spread, axes = np.linalg.eigh(across @ across.T + blur**2 * np.eye(2))
            under[i] = axes * np.sqrt(spread) * 1.25
        spots.lay(shot.position[:, :2], under, patch_opacity(gap / stage.radius))

    return update


def add_contacts(stage: Stage) -> Update:
    """Draw dark soft spots under bodies that touch the ground. Spots fade as the gap opens."""
    bodies, ground = stage.scene.bodies, stage.ground
    drawn = [i for i, body in enumerate(bodies) if body.shape.exists]
    texture = spot_texture(stage.look.shadow, _CONTACT, sharpness=2.6)
    spots = Spots(stage.plotter, texture, ground, stage.lift, len(drawn))
    shapes = [bodies[i].shape for i in drawn]
    # Drawn boxes are rounded, the boxes of the physics are not.
    points = [each.skin().points if each.corners is None else each.corners for each in shapes]
    sizes = [float(each.half_extents.min()) for each in shapes]

    def update(shot: Shot) -> None:
        places = [
            centre + own @ turn.T
            for own, centre, turn in zip(
                points, shot.position[drawn], shot.rotation[drawn], strict=True
            )
        ]
        heights = ground.height(np.concatenate(places)[:, :2])
        lows = np.split(heights, np.cumsum([*map(len, places)])[:-1])
        under = [
            spot_under(place[:, :2], place[:, 2] - low, size)
            for place, low, size in zip(places, lows, sizes, strict=True)
        ]
        middles, axes, opacities = map(np.array, zip(*under, strict=True))
        spots.lay(middles, axes, opacities)

    return update


def patch_opacity(height: np.ndarray) -> np.ndarray:
    """Return opacities of patches under bodies, 0 to 1, by height in radii of the animal."""
    return np.interp(height, (_HIGH, _GONE), (1.0, 0.0))


def spot_under(
    place: np.ndarray, gap: np.ndarray, size: float
) -> tuple[np.ndarray, np.ndarray, float]:
    """Return the dark spot where a body touches the ground.

    Args:
        place: x and y of points of the body ``(n, 2)``, m.
        gap: heights of these points above the ground ``(n,)``, m.
        size: smallest half extent of the body, m.

    Returns:
        Middle ``(2,)``, half axes as the columns of ``(2, 2)``, and opacity.
    """
    weight = np.exp(-(gap - gap.min()) / (0.25 * size))
    weight /= weight.sum()
    middle = weight @ place
    offset = place - middle
    ellipse = (weight * offset.T) @ offset + (0.6 * size) ** 2 * np.eye(2)
    spread, axes = np.linalg.eigh(ellipse)
    opacity = float(np.exp(-max(gap.min(), 0.0) / (0.5 * size)))
    return middle, axes * np.sqrt(spread) * 2.2, opacity
