"""What a scene shows besides the animal and the ground: light, trail, specks, sun and sky."""

from collections.abc import Callable
from typing import cast

import numpy as np
import pyvista as pv

from evo_cpg.view.look import Look
from evo_cpg.view.offscreen import add_faded
from evo_cpg.view.shadows import Spots
from evo_cpg.view.terrain import Level, Terrain
from evo_cpg.view.textures import spot_texture

# Points along a side of the pool of light, and how high it lies, in radii of the animal.
_POOL, _POOL_LIFT = 41, 0.02
# Specks in water: how many, and their colour.
_PARTICLES, _PARTICLE, _PARTICLE_SEED = 1200, "#d9fff6", 20101
# The sun of the land stands to the left of the viewer and behind him, so that it lights the sides
# that he sees and shadows fall away from him: to the right, ahead and up in his picture.
_SUN_SEEN = (-0.62, -0.45, 1.0)
_SUN_AT_SEA = (-0.4, -0.6, 1.6)
# Distance of the sky behind the focus and height over which it turns blue, in distances of the
# camera. The floor has faded away before it gets there.
_SKY, _SKY_HEIGHT = 18.0, 2.6


def add_goal_light(
    plotter: pv.Plotter,
    look: Look,
    goal: np.ndarray,
    ground: Level | Terrain,
    radius: float,
    sight: np.ndarray,
) -> Callable[[float], None]:
    """Draw the goal: a glowing sphere, its halo, its pool on the floor, and the light it sheds.

    Args:
        plotter: draws it.
        look: of the world.
        goal: place of the light ``(3,)``, m.
        ground: on which its pool lies.
        radius: of the animal, m.
        sight: the camera's direction of view in the first frame ``(3,)``, which the halo faces.

    Returns:
        A function of how far the camera has turned since, rad.
    """
    shine = spot_texture(look.halo, look.glow, sharpness=3.0)
    pool = Spots(plotter, shine, ground, _POOL_LIFT * radius, 1, _POOL)
    pool.lay(goal[None, :2], 1.8 * radius * np.eye(2)[None])
    core = 0.075 * radius
    plotter.add_mesh(
        pv.Sphere(radius=core, center=goal, theta_resolution=32, phi_resolution=24),
        color=look.light,
        lighting=False,
    )
    halos = []
    for size, strength, sharpness in ((1.6 * radius, look.glow, 3.6), (4.5 * core, 0.95, 2.4)):
        halo = pv.Plane(
            center=goal - 1.05 * core * sight,
            direction=-sight,
            i_size=size,
            j_size=size,
            i_resolution=1,
            j_resolution=1,
        )
        texture = spot_texture(look.halo, strength, sharpness)
        halos.append(plotter.add_mesh(halo, texture=texture, lighting=False))
    lamp = pv.Light(position=goal, color=look.halo, intensity=0.9, light_type="scene light")
    lamp.positional = True
    lamp.cone_angle = 90
    lamp.attenuation_values = (1.0, 0.0, (0.7 / radius) ** 2)
    plotter.add_light(lamp)
    for actor in halos:
        actor.origin = tuple(goal)

    def update(turned: float) -> None:
        for actor in halos:
            actor.orientation = (0.0, 0.0, float(np.degrees(turned)))

    return update


def add_trail(
    plotter: pv.Plotter, look: Look, path: np.ndarray, thickness: float, fade: float
) -> Callable[[int], None]:
    """Draw a fading thread along the way that a body has come.

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


def add_particles(
    plotter: pv.Plotter,
    path: np.ndarray,
    ground: Level | Terrain,
    radius: float,
    scale: float,
    surface: float | None = None,
) -> None:
    """Draw specks in the water, at rest in the world, against which motion shows.

    Args:
        plotter: draws them.
        path: points around which they float ``(n, 3)``, m.
        ground: below which there are none.
        radius: of the animal, m.
        scale: pixels rendered per pixel of the film.
        surface: of the water, above which there are none, m.
    """
    generator = np.random.default_rng(_PARTICLE_SEED)
    low, high = path.min(0) - 3 * radius, path.max(0) + 3 * radius
    high[2] = path[:, 2].max() + 1.2 * radius
    if surface is not None:
        high[2] = min(high[2], surface)
    low[2] = min(np.min(ground.z), high[2])
    points = generator.uniform(low, high, (_PARTICLES, 3))
    points = points[points[:, 2] > ground.height(points[:, :2])]
    for chosen, size, opacity in ((points[::4], 2.1, 0.5), (points[1::2], 1.3, 0.35)):
        if not len(chosen):
            continue
        plotter.add_mesh(
            pv.PolyData(chosen),
            color=_PARTICLE,
            opacity=opacity,
            point_size=size * scale,
            lighting=False,
        )


def sun_direction(look: Look, sight: np.ndarray) -> np.ndarray:
    """Unit vector towards the sun.

    Args:
        look: of the world.
        sight: the camera's direction of view in the first frame ``(3,)``.
    """
    towards = np.array(_SUN_AT_SEA)
    if look.cast_strength:
        across, ahead = _level_axes(sight)
        towards = np.array(_SUN_SEEN) @ np.stack([across, ahead, [0.0, 0.0, 1.0]])
    return towards / np.linalg.norm(towards)


def add_sky(
    plotter: pv.Plotter, look: Look, sight: np.ndarray, away: float
) -> Callable[[np.ndarray, float], None]:
    """Background, sky and sun.

    A backdrop stands behind the floor's far end: VTK's own gradient costs 18 ms a frame, this 2.

    Args:
        plotter: draws them.
        look: of the world.
        sight: the camera's direction of view in the first frame ``(3,)``.
        away: distance of the camera from its focus, m.

    Returns:
        A function of the camera's place ``(3,)``, m, and how far it has turned since, rad.
    """
    plotter.background_color = pv.Color(look.distance)
    sun = pv.Light(
        position=tuple(sun_direction(look, sight)), color=look.sun, light_type="scene light"
    )
    sun.intensity = 0.85
    sun.positional = False
    plotter.add_light(sun)
    # Keeps the sides that face the viewer from going black.
    fill = pv.Light(color=look.fill, intensity=0.4, light_type="camera light")
    fill.positional = False
    plotter.add_light(fill)
    if look.zenith is None:
        return lambda eye, turned: None

    across, ahead = _level_axes(sight)
    blue = np.linspace(0, 1, 12)
    height = _SKY_HEIGHT * away * np.concatenate([blue, [10.0]])
    share = np.append(1 - (1 - blue) ** 2, 1.0)[:, None]
    haze, zenith = (np.array(pv.Color(color).int_rgb) for color in (look.distance, look.zenith))
    middle = _SKY * away * ahead + height[:, None] * [0.0, 0.0, 1.0]
    side = 2 * _SKY * away * across
    points = np.stack([middle - side, middle + side], 1)
    backdrop = pv.StructuredGrid(*(points[..., i, None] for i in range(3)))
    backdrop = backdrop.extract_surface(algorithm=None)
    # A structured grid counts its first axis fastest.
    backdrop["rgb"] = np.tile(haze + share * (zenith - haze), (2, 1)).astype(np.uint8)
    actor = plotter.add_mesh(
        backdrop, scalars="rgb", rgb=True, lighting=False, show_scalar_bar=False
    )

    def update(eye: np.ndarray, turned: float) -> None:
        actor.position = tuple(eye)
        actor.orientation = (0.0, 0.0, float(np.degrees(turned)))

    return update


def _level_axes(sight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Level unit vectors to the right and ahead in the picture ``(3,)``."""
    ahead = np.array([sight[0], sight[1], 0.0]) / np.hypot(*sight[:2])
    return np.cross(ahead, [0.0, 0.0, 1.0]), ahead
