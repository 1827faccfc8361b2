"""Specks in the water, against which motion shows."""

import numpy as np
import pyvista as pv

_PARTICLES = 1200
_PARTICLE = "#d9fff6"
_PARTICLE_SEED = 20101


def add_particles(
    plotter: pv.Plotter, path: np.ndarray, floor: float, radius: float, scale: float
) -> None:
    """Specks at rest in the world.

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
