"""Obstacles on the ground, drawn as stone."""

from collections.abc import Callable, Sequence
from typing import cast

import numpy as np
import pyvista as pv

from evo_cpg.physics.contact.terrain import Block, Boulder, GroundPart
from evo_cpg.view.offscreen import placed

_STONE = np.array([0.60, 0.57, 0.53])
_SEED = 20102
# Waves that make the grain: number, lowest and highest wave count across the stone. Then the change
# of brightness, and the tilt of the normals.
_WAVES, _LOWEST, _HIGHEST = 60, 2.0, 30.0
_GRAIN, _ROUGHNESS = 0.07, 0.25
# Facets along an edge of a block and around a boulder: for the picture, and for a shadow. A frame
# of 1280 x 720 with five boulders and two blocks took 58 ms. Twice the facets took 82 ms. Without
# the sides that face away it took 43 ms.
_SEEN, _SHADE = (24, 72), (8, 36)
# Parts deeper in the ground than this fraction of an obstacle's size are not drawn.
_SUNK = 0.02


def obstacle_mesh(
    obstacle: GroundPart, *, shade: bool = False
) -> tuple[pv.PolyData, np.ndarray, np.ndarray]:
    """Return an obstacle's surface in its frame, its place ``(3,)``, m, and rotation ``(3, 3)``.

    Args:
        obstacle: obstacle on the ground.
        shade: whether the surface only casts a shadow, which needs fewer facets.

    Raises:
        TypeError: the obstacle is neither a boulder nor a block.
    """
    edge, around = _SHADE if shade else _SEEN
    if isinstance(obstacle, Boulder):
        mesh = pv.Sphere(
            radius=float(obstacle.radius), theta_resolution=around, phi_resolution=around // 2
        )
        return mesh, np.array(obstacle.centre, float), np.eye(3)
    if isinstance(obstacle, Block):
        half = np.array(obstacle.half_extents, float)
        mesh = pv.Box((-1, 1, -1, 1, -1, 1), level=edge, quads=True).triangulate()
        faces = mesh.regular_faces
        mesh = pv.PolyData.from_regular_faces(np.asarray(mesh.points) * half, faces)
        mesh = cast(pv.PolyData, mesh.compute_normals(split_vertices=True, feature_angle=30.0))
        return mesh, np.array(obstacle.centre, float), _heading(obstacle)
    raise _unknown(obstacle)


def obstacle_top(obstacle: GroundPart, place: np.ndarray) -> np.ndarray:
    """Return the height of an obstacle's upper side, m, or -inf outside of it.

    Args:
        obstacle: obstacle on the ground.
        place: x and y ``(..., 2)``, m.

    Raises:
        TypeError: the obstacle is neither a boulder nor a block.
    """
    if isinstance(obstacle, Boulder):
        offset = place - np.array(obstacle.centre[:2])
        rise = np.sqrt(np.maximum(float(obstacle.radius) ** 2 - (offset**2).sum(-1), 0.0))
        return np.where(rise > 0, obstacle.centre[2] + rise, -np.inf)
    if isinstance(obstacle, Block):
        own = (place - np.array(obstacle.centre[:2])) @ _heading(obstacle)[:2, :2]
        over = (np.abs(own) < obstacle.half_extents[:2]).all(-1)
        return np.where(over, obstacle.centre[2] + obstacle.half_extents[2], -np.inf)
    raise _unknown(obstacle)


def add_obstacles(
    plotter: pv.Plotter,
    obstacles: Sequence[GroundPart],
    ambient: float,
    height: Callable[[np.ndarray], np.ndarray],
) -> None:
    """Draw obstacles as stones, with rough shading on a smooth surface.

    Buried parts are left out.

    Args:
        plotter: plotter of the picture.
        obstacles: obstacles on the ground.
        ambient: fraction of light that comes from everywhere.
        height: function that returns the drawn ground's height, m, at x and y ``(n, 2)``, m.
    """
    generator = np.random.default_rng(_SEED)
    for obstacle in obstacles:
        mesh, place, turn = obstacle_mesh(obstacle)
        own = np.asarray(mesh.points).astype(float)
        extent = np.ptp(own, axis=0).max()
        size = _LOWEST * (_HIGHEST / _LOWEST) ** generator.random(_WAVES)
        wave = generator.normal(size=(_WAVES, 3))
        wave *= size[:, None] / np.linalg.norm(wave, axis=1, keepdims=True)
        phase = own @ wave.T * (2 * np.pi / extent) + generator.random(_WAVES) * 2 * np.pi
        strength = size**-0.5 / np.sqrt((1 / size).sum() / 2)
        grain = np.cos(phase) @ strength
        tilt = -np.sin(phase) * strength @ (wave / np.linalg.norm(wave, axis=1, keepdims=True))
        normal = np.asarray(mesh.point_data.active_normals) - _ROUGHNESS * tilt
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        mesh.point_data.active_normals = normal
        tone = _STONE * (1 + _GRAIN * grain[:, None])
        mesh["rgb"] = (255 * np.clip(tone, 0, 1)).astype(np.uint8)
        world = own @ turn.T + place
        above = world[:, 2] > height(world[:, :2]) - _SUNK * extent
        if not above.any():
            continue
        mesh.clear_cell_data()
        mesh.regular_faces = mesh.regular_faces[above[mesh.regular_faces].any(1)]
        actor = plotter.add_mesh(
            mesh,
            scalars="rgb",
            rgb=True,
            smooth_shading=True,
            culling="back",
            ambient=ambient,
            diffuse=0.75,
            specular=0.05,
        )
        actor.user_matrix = placed(turn, place)


def _heading(block: Block) -> np.ndarray:
    """Return the rotation ``(3, 3)`` from a block's axes to the world's."""
    c, s = np.cos(block.heading), np.sin(block.heading)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _unknown(obstacle: GroundPart) -> TypeError:
    return TypeError(
        f"cannot draw a {type(obstacle).__name__} as an obstacle. Allowed: Boulder, Block"
    )
