"""The light that the animal swims or walks to."""

from collections.abc import Callable

import numpy as np
import pyvista as pv

from evo_cpg.view.look import Look
from evo_cpg.view.textures import spot_texture


def add_goal_light(
    plotter: pv.Plotter,
    look: Look,
    goal: np.ndarray,
    height: float | None,
    radius: float,
    sight: np.ndarray,
) -> Callable[[float], None]:
    """The goal: a glowing sphere, its halo, its pool on the floor, and the light it sheds.

    Args:
        plotter: draws it.
        look: of the world.
        goal: place of the light ``(3,)``, m.
        height: z of the level floor, m; None to leave the pool to `evo_cpg.view.relief`.
        radius: of the animal, m.
        sight: the camera's direction of view in the first frame ``(3,)``, which the halo faces.

    Returns:
        A function of how far the camera has turned since, rad.
    """
    if height is not None:
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
