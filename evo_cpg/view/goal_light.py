"""The light that the animal swims or walks to."""

from collections.abc import Callable

import numpy as np
import pyvista as pv

from evo_cpg.view.look import Look
from evo_cpg.view.shadows import Spots
from evo_cpg.view.terrain import Level, Terrain
from evo_cpg.view.textures import spot_texture

# Points along a side of the pool of light, and how high it lies, in radii of the animal.
_POOL, _POOL_LIFT = 41, 0.02


def add_goal_light(
    plotter: pv.Plotter,
    look: Look,
    goal: np.ndarray,
    ground: Level | Terrain,
    radius: float,
    sight: np.ndarray,
) -> Callable[[float], None]:
    """The goal: a glowing sphere, its halo, its pool on the floor, and the light it sheds.

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
