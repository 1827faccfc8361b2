"""What surrounds the animal: sea or land, the light, shadows and the trail.

Each ``add_...`` function puts actors into a plotter once. Those that must change from frame to
frame return a function that does it by moving actors or overwriting arrays in place; nothing is
meshed again. Translucent actors are drawn in the order in which they were added: floor, shadows,
light, trail.
"""

import dataclasses
from collections.abc import Callable
from typing import cast

import numpy as np
import pyvista as pv

from evo_cpg.view.textures import CELLS, floor_texture, spot_texture

_PARTICLES = 1200
_PARTICLE = "#d9fff6"
_PARTICLE_SEED = 20101


@dataclasses.dataclass(frozen=True)
class Look:
    """Colours and proportions of a world; lengths are relative to the animal's radius.

    Attributes:
        distance: colour of the background, into which the floor fades.
        floor: tints of the floor, from dark to light.
        grid: colour of the grid lines.
        shadow: colour of shadows.
        shadow_strength: opacity of shadows, 0 to 1.
        sun: colour of the directional light.
        fill: colour of the weak light from the viewer's side.
        ambient: share of light that comes from everywhere.
        trail: colour of the trail.
        light: colour of the glowing sphere.
        halo: colour of the glow around it.
        glow: opacity of the glow and of the pool of light on the floor, 0 to 1.
        text: colour of the captions.
        visibility: distance at which the floor has faded to a third.
        elevation: of the camera above the focus, rad.
        particles: whether specks drift in the medium.
        checkered: whether alternate grid cells differ in tone.
        buoyant: whether the floor lies below the animal's path rather than at z = 0.
    """

    distance: str
    floor: tuple[str, str]
    grid: str
    shadow: str
    shadow_strength: float
    sun: str
    fill: str
    ambient: float
    trail: str
    light: str
    halo: str
    glow: float
    text: str
    visibility: float
    elevation: float
    particles: bool
    checkered: bool
    buoyant: bool


LOOKS = {
    "water": Look(
        distance="#052a3b",
        floor=("#0d4c5c", "#2f8a8c"),
        grid="#8fe0d6",
        shadow="#02141d",
        shadow_strength=0.5,
        sun="#eafcff",
        fill="#7fd0e6",
        ambient=0.34,
        trail="#ffd9a0",
        light="#fffbe6",
        halo="#ffe9a8",
        glow=0.5,
        text="#f2fbff",
        visibility=5.5,
        elevation=np.radians(24),
        particles=True,
        checkered=False,
        buoyant=True,
    ),
    "land": Look(
        distance="#dfe3e6",
        floor=("#8d8577", "#b7ad9c"),
        grid="#6f675a",
        shadow="#2a241d",
        shadow_strength=0.6,
        sun="#fff4e0",
        fill="#cfe0f2",
        ambient=0.38,
        trail="#c2410c",
        light="#ffd75e",
        halo="#ffae1a",
        glow=0.3,
        text="#1d2530",
        visibility=7.0,
        elevation=np.radians(20),
        particles=False,
        checkered=True,
        buoyant=False,
    ),
}


def grid_spacing(length: float) -> float:
    """Spacing of the floor's grid: 1, 2 or 5 times a power of ten, about half the length (m)."""
    power = 10.0 ** np.floor(np.log10(length / 2))
    return float(power * max(step for step in (1, 2, 5) if step * power <= length / 2 * 1.001))


def add_sky(plotter: pv.Plotter, look: Look) -> None:
    """Background and sun.

    The background is plain: a gradient costs 18 ms a frame, and the floor's fading is one.
    """
    plotter.background_color = pv.Color(look.distance)
    sun = pv.Light(position=(-0.4, -0.6, 1.6), color=look.sun, light_type="scene light")
    sun.intensity = 0.85
    sun.positional = False
    plotter.add_light(sun)
    # Keeps the sides that face the viewer from going black.
    fill = pv.Light(color=look.fill, intensity=0.4, light_type="camera light")
    fill.positional = False
    plotter.add_light(fill)


def add_floor(
    plotter: pv.Plotter, look: Look, height: float, radius: float, spacing: float
) -> Callable[[np.ndarray], None]:
    """A floor that reaches to the horizon.

    It is a disc that travels below the focus, while its texture stays where it is in the world.

    Args:
        plotter: draws it.
        look: of the world.
        height: z of the floor, m.
        radius: of the animal, m.
        spacing: of the grid, m.

    Returns:
        A function of the focus ``(3,)``, m.
    """
    visible = look.visibility * radius
    reach = np.concatenate([[0.0], np.geomspace(0.2, 3.0, 28)]) * visible
    bearing = np.linspace(0, 2 * np.pi, 49)
    x = reach[:, None] * np.cos(bearing)
    y = reach[:, None] * np.sin(bearing)
    grid = pv.StructuredGrid(x[..., None], y[..., None], np.zeros_like(x)[..., None])
    disc = grid.extract_surface(algorithm=None)
    place = np.asarray(disc.points)[:, :2].copy()
    fade = np.exp(-((np.linalg.norm(place, axis=1) / visible) ** 2))
    disc["rgba"] = np.column_stack([np.full((len(place), 3), 255), 255 * fade]).astype(np.uint8)
    disc.active_texture_coordinates = place / (CELLS * spacing)
    texture = floor_texture(look.floor, look.grid, look.checkered)
    actor = plotter.add_mesh(
        disc, scalars="rgba", rgba=True, texture=texture, lighting=False, show_scalar_bar=False
    )

    def update(focus: np.ndarray) -> None:
        actor.position = (focus[0], focus[1], height)
        disc.active_texture_coordinates = (place + focus[:2]) / (CELLS * spacing)

    return update


def add_shadows(
    plotter: pv.Plotter, look: Look, height: float, half_extents: np.ndarray
) -> Callable[[np.ndarray, np.ndarray], None]:
    """Soft patches on the floor under the bodies.

    Args:
        plotter: draws them.
        look: of the world.
        height: z of the floor, m.
        half_extents: of the bodies ``(bodies, 3)``, m.

    Returns:
        A function of the bodies' centres ``(bodies, 3)`` in m and rotations ``(bodies, 3, 3)``.
    """
    patch = pv.Plane(i_size=2, j_size=2, i_resolution=1, j_resolution=1)
    texture = spot_texture(look.shadow, look.shadow_strength, sharpness=2.2)
    actors = [
        plotter.add_mesh(patch, texture=texture, lighting=False) for _ in range(len(half_extents))
    ]

    def update(position: np.ndarray, rotation: np.ndarray) -> None:
        for actor, centre, turn, half in zip(actors, position, rotation, half_extents, strict=True):
            # Higher above the floor the patch is wider: the sky lights its edge.
            blur = 0.9 * half.min() + 0.12 * max(centre[2] - height, 0.0)
            ellipse = (turn[:2] * half) @ (turn[:2] * half).T + blur**2 * np.eye(2)
            spread, axes = np.linalg.eigh(ellipse)
            matrix = np.eye(4)
            matrix[:2, :2] = axes * np.sqrt(spread) * 1.25
            matrix[:3, 3] = centre[0], centre[1], height
            actor.user_matrix = matrix

    return update


def add_light(
    plotter: pv.Plotter,
    look: Look,
    goal: np.ndarray,
    height: float,
    radius: float,
    sight: np.ndarray,
) -> None:
    """The goal: a glowing sphere, its halo, its pool on the floor, and the light it sheds.

    Args:
        plotter: draws it.
        look: of the world.
        goal: place of the light ``(3,)``, m.
        height: z of the floor, m.
        radius: of the animal, m.
        sight: the camera's fixed direction of view ``(3,)``, which the halo faces.
    """
    pool = pv.Plane(
        center=(goal[0], goal[1], height),
        i_size=3.6 * radius,
        j_size=3.6 * radius,
        i_resolution=1,
        j_resolution=1,
    )
    shine = spot_texture(look.halo, look.glow, sharpness=3.0)
    plotter.add_mesh(pool, texture=shine, lighting=False)
    core = 0.075 * radius
    plotter.add_mesh(
        pv.Sphere(radius=core, center=goal, theta_resolution=32, phi_resolution=24),
        color=look.light,
        lighting=False,
    )
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
        plotter.add_mesh(halo, texture=texture, lighting=False)
    lamp = pv.Light(position=goal, color=look.halo, intensity=0.9, light_type="scene light")
    lamp.positional = True
    lamp.cone_angle = 90
    lamp.attenuation_values = (1.0, 0.0, (0.7 / radius) ** 2)
    plotter.add_light(lamp)


def add_particles(
    plotter: pv.Plotter, path: np.ndarray, floor: float, radius: float, scale: float
) -> None:
    """Specks at rest in the world, against which motion shows.

    Args:
        plotter: draws them.
        path: points around which they float ``(n, 3)``, m.
        floor: z below which there are none, m.
        radius: of the animal, m.
        scale: pixels rendered per pixel of the film.
    """
    generator = np.random.default_rng(_PARTICLE_SEED)
    low, high = path.min(0) - 3 * radius, path.max(0) + 3 * radius
    low[2], high[2] = floor, path[:, 2].max() + 1.2 * radius
    points = generator.uniform(low, high, (_PARTICLES, 3))
    for chosen, size, opacity in ((points[::4], 2.1, 0.5), (points[1::2], 1.3, 0.35)):
        plotter.add_mesh(
            pv.PolyData(chosen),
            color=_PARTICLE,
            opacity=opacity,
            point_size=size * scale,
            lighting=False,
        )


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
    tube.point_data["rgba"] = rgba
    # Drawn as translucent from the first frame on, when nothing of it shows yet.
    actor = plotter.add_mesh(tube, scalars="rgba", rgba=True, lighting=False, culling="back")
    actor.ForceTranslucentOn()

    def update(frame: int) -> None:
        age = frame - born
        alpha = np.where(age >= 0, 0.75 * np.exp(-age / fade), 0.0)
        rgba[:, 3] = 255 * alpha
        tube.point_data["rgba"] = rgba

    return update
