"""Specks in the water, against which motion shows."""

import numpy as np
import pyvista as pv

from evo_cpg.view.terrain import Level, Terrain

_PARTICLES = 1200
_PARTICLE = "#d9fff6"
_PARTICLE_SEED = 20101


def add_particles(
    plotter: pv.Plotter,
    path: np.ndarray,
    ground: Level | Terrain,
    radius: float,
    scale: float,
    surface: float | None = None,
) -> None:
    """Specks at rest in the world.

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
