"""The surface of the water, seen from above.

Two sheets lie on each other. The lower sheet tints things below it, more above deeper ground. The
upper sheet mirrors the sky in ripples. The ripples have a seeded random spectrum and the dispersion
of deep water, omega^2 = g k, on a tile that repeats. They are only decoration: the physics' surface
is level, and so are both sheets.
"""

import numpy as np
import pyvista as pv

from evo_cpg.view.camera import level_axes, turned_about_vertical
from evo_cpg.view.ground import fading_disc
from evo_cpg.view.offscreen import add_faded, light_texture, spot_texture, tile_texture
from evo_cpg.view.shadows import Spots
from evo_cpg.view.stage import Shot, Stage, Update
from evo_cpg.view.terrain import Level, Terrain

_SHALLOW, _DEEP = "#bfeae4", "#4cadd2"
# Opacity of the lower sheet where the water is shallow and deep. Depth of two thirds of the change,
# and depth below which the sheet clears towards the shore, in radii of the animal.
_CLEAR, _OPAQUE, _DEEPENS, _SHORE = 0.26, 0.52, 0.5, 0.1
# Side of a tile in radii of the animal, its texels, and wave counts per side of its longest and
# shortest waves. The steepness is the root mean square of the slopes.
_TILE, _TEXELS, _LONGEST, _SHORTEST, _STEEPNESS = 5.0, 256, 6.0, 50.0, 0.12
_SEED = 20103
# The surface from below: distance at which it has faded, relative to the ground, its tints, and the
# drift of its pattern, tiles per second.
_CEILING, _CEILING_TINTS, _DRIFT = 1.6, ("#2f9fb0", "#d8fbf6"), 0.03
_GRAVITY = 9.81
# Fraction of light that water mirrors at vertical incidence, 0 to 1 (Schlick 1994).
_REFLECTION = 0.02
# Glints are sharp and bright where a ripple reflects the sun towards the viewer.
_GLINT, _GLINT_SHARPNESS, _GLINT_HEIGHT = 0.8, 320.0, 0.62
# Opacity of the ring around a body that breaks through the surface, and its width relative to the
# body.
_RING, _RING_WIDTH = 0.8, 1.9


class Ripples:
    """Slopes of a sea of small waves on a square tile.

    Args:
        side: side of the tile, m.
    """

    def __init__(self, side: float):
        generator = np.random.default_rng(_SEED)
        along = 2 * np.pi / side * np.fft.fftfreq(_TEXELS, 1 / _TEXELS)[:, None]
        across = 2 * np.pi / side * np.fft.rfftfreq(_TEXELS, 1 / _TEXELS)
        number = np.hypot(along, across)
        band = (number >= 2 * np.pi / side * _LONGEST) & (number <= 2 * np.pi / side * _SHORTEST)
        phase = 2 * np.pi * generator.random(number.shape)
        wind = 0.35 + (along / np.where(number > 0, number, 1.0)) ** 2
        self._start = band * wind * np.exp(1j * phase) / np.where(number > 0, number, 1.0) ** 2.3
        self._number = along, across
        # Waves run in random directions, forward or backward with equal chance, as on a pond.
        self._rate = np.sqrt(_GRAVITY * number) * generator.choice([-1.0, 1.0], number.shape)
        steepness = np.sqrt(np.mean(np.square(self.slopes(0.0))) * 2)
        self._start *= _STEEPNESS / steepness

    def slopes(self, time: float) -> np.ndarray:
        """Return slopes along x and y ``(2, n, n)`` at a time, s. The tile's first axis is x."""
        now = self._start * np.exp(1j * self._rate * time)
        shape = (_TEXELS, _TEXELS)
        return np.stack([np.fft.irfft2(1j * k * now, shape) for k in self._number])


def add_waterlines(stage: Stage, surface: float) -> Update:
    """Draw bright rings around bodies that break through the surface at a height (m)."""
    half_extents = stage.scene.half_extents
    drawn = half_extents.any(1)
    half_extents = half_extents[drawn]
    texture = spot_texture("#ffffff", _RING, sharpness=2.0)
    level = Level(surface)
    rings = Spots(stage.plotter, texture, level, 0.004 * stage.radius, len(half_extents))

    def update(shot: Shot) -> None:
        # Each body counts as an ellipsoid with its half extents, which the surface cuts.
        position, rotation = shot.position[drawn], shot.rotation[drawn]
        shape = (rotation * half_extents[:, None] ** 2) @ rotation.mT
        off = surface - position[:, 2]
        inside = 1 - off**2 / shape[:, 2, 2]
        lean = shape[:, :2, 2] / shape[:, 2:, 2]
        cut = shape[:, :2, :2] - lean[:, :, None] * shape[:, None, :2, 2]
        spread, axes = np.linalg.eigh(cut * np.maximum(inside, 0.0)[:, None, None])
        size = _RING_WIDTH * np.sqrt(np.maximum(spread, 0.0)) + 0.6 * half_extents.min(1)[:, None]
        middle = position[:, :2] + lean * off[:, None]
        rings.lay(middle, axes * size[:, None], np.clip(3 * inside, 0.0, 1.0))

    return update


def add_tint(stage: Stage, terrain: Terrain, surface: float) -> Update:
    """Draw the lower sheet at a height (m), which tints things below it."""
    # Its corners lie over the corners of the ground, where the depth is known.
    points, triangles = terrain.points(), terrain.triangles()
    depth = (surface - points[:, 2]) / stage.radius
    wet = triangles[(depth[triangles] > 0).any(1)]
    used, wet = np.unique(wet, return_inverse=True)
    if not len(used):
        return lambda shot: None
    depth = np.maximum(depth[used], 0.0)
    place = points[used, :2]
    mesh = pv.PolyData.from_regular_faces(
        np.column_stack([place, np.full(len(used), surface)]), wet.reshape(-1, 3)
    )
    deep = 1 - np.exp(-depth / _DEEPENS)
    colors = [np.array(pv.Color(color).int_rgb) for color in (_SHALLOW, _DEEP)]
    rgba = np.empty((len(used), 4), np.uint8)
    rgba[:, :3] = colors[0] + deep[:, None] * (colors[1] - colors[0])
    opacity = (_CLEAR + (_OPAQUE - _CLEAR) * deep) * np.clip(depth / _SHORE, 0.25, 1.0)
    add_faded(stage.plotter, mesh, rgba)

    def update(shot: Shot) -> None:
        away = ((place - shot.focus[:2]) ** 2).sum(1)
        rgba[:, 3] = 255 * opacity * np.exp(-away / stage.visible**2)
        mesh["rgba"] = rgba

    return update


def add_ceiling(stage: Stage, surface: float) -> Update:
    """Draw the surface at a height (m) as it is seen from below: bright, with moving light."""
    disc, place, fade = fading_disc(_CEILING * stage.visible, 0.1)
    side = _TILE * stage.radius
    rgba = np.column_stack([np.full((len(place), 3), 255), 255 * fade]).astype(np.uint8)
    texture = light_texture(_CEILING_TINTS)
    disc.active_texture_coordinates = place / side
    actor = add_faded(stage.plotter, disc, rgba, texture=texture)

    def update(shot: Shot) -> None:
        actor.position = (shot.focus[0], shot.focus[1], surface)
        drift = _DRIFT * shot.time * np.array([1.0, 0.6])
        disc.active_texture_coordinates = (place + shot.focus[:2]) / side + drift

    return update


def add_mirror(stage: Stage, surface: float) -> Update:
    """Draw the upper sheet at a height (m): a disc that follows the focus and mirrors the sky."""
    sight, look = stage.sight, stage.look
    disc, place, fade = fading_disc(stage.visible, 0.02)
    rgba = np.full((len(place), 4), 255, np.uint8)
    side = _TILE * stage.radius
    disc.active_texture_coordinates = place / side
    ripples = Ripples(side)
    texture = tile_texture(np.zeros((_TEXELS, _TEXELS, 4), np.uint8))
    actor = add_faded(stage.plotter, disc, rgba, texture=texture)
    pixels = pv.wrap(texture.GetInput())
    haze, zenith = (np.array(pv.Color(c).int_rgb) for c in (look.distance, look.zenith))
    # Sun for the glints. It stands ahead of the viewer in the first frame.
    _, ahead = level_axes(sight)
    sun = ahead * np.sqrt(1 - _GLINT_HEIGHT**2) + [0.0, 0.0, _GLINT_HEIGHT]

    def update(shot: Shot) -> None:
        focus, eye, seen = shot.focus, shot.eye, turned_about_vertical(sight, shot.turned)
        half = (sun - seen) / np.linalg.norm(sun - seen)
        along_x, along_y = ripples.slopes(shot.time)
        upward = 1 / np.sqrt(1 + along_x**2 + along_y**2)
        normal = np.stack([-along_x * upward, -along_y * upward, upward], -1)
        facing = np.clip(-(normal @ seen), 0.0, 1.0)
        reflected = _REFLECTION + (1 - _REFLECTION) * (1 - facing) ** 5
        mirrored = np.clip(2 * facing * upward + sight[2], 0.0, 1.0)[..., None]
        glint = _GLINT * np.clip(normal @ half, 0.0, 1.0) ** _GLINT_SHARPNESS
        sky = haze + np.minimum(1.2 * mirrored, 1.0) * (zenith - haze)
        rgb = sky + glint[..., None] * (255 - sky)
        opacity = 255 * np.clip(reflected + glint, 0, 0.95)[..., None]
        # Texels vary fastest along x.
        shown = np.concatenate([rgb, opacity], -1).swapaxes(0, 1)
        pixels.point_data.active_scalars[:] = shown.reshape(-1, 4)
        pixels.Modified()
        actor.position = (focus[0], focus[1], surface)
        disc.active_texture_coordinates = (place + focus[:2]) / side
        # Water mirrors more where the view is more slanted.
        away = np.hypot(*(place + focus[:2] - eye[:2]).T)
        slant = (eye[2] - surface) / np.hypot(away, eye[2] - surface)
        more = ((1 - slant) / (1 + sight[2])) ** 4
        rgba[:, 3] = 255 * fade * np.clip(0.6 * more, 0.2, 1.0)
        disc["rgba"] = rgba

    return update
