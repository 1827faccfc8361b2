"""What darkens the floor under the animal: cast shadows, soft patches, spots where it touches."""

from collections.abc import Callable

import numpy as np
import pyvista as pv

from evo_cpg.creature.creature import Creature
from evo_cpg.creature.mesh import ConvexMesh
from evo_cpg.creature.shapes import Box, Shape
from evo_cpg.view.look import Look
from evo_cpg.view.meshes import shape_mesh
from evo_cpg.view.offscreen import write_depth
from evo_cpg.view.textures import spot_texture

# Opacity of the spot under a foot that touches the ground.
CONTACT = 0.85


def add_sun_shadows(
    plotter: pv.Plotter, look: Look, creature: Creature, height: float, sun: np.ndarray
) -> Callable[[np.ndarray, np.ndarray], None]:
    """The shadows that the bodies cast on the floor in the sun: the bodies, flattened along it.

    Args:
        plotter: draws them.
        look: of the world; nothing is drawn where it casts no shadows.
        creature: the animal.
        height: z of the floor, m.
        sun: unit vector towards the sun ``(3,)``.

    Returns:
        A function of the bodies' centres ``(bodies, 3)`` in m and rotations ``(bodies, 3, 3)``.
    """
    if not look.cast_strength:
        return lambda position, rotation: None
    flatten = np.eye(4)
    flatten[:2, 2] = -sun[:2] / sun[2]
    flatten[2, 2] = 0.0
    actors = []
    for body in creature.bodies:
        actor = plotter.add_mesh(
            shape_mesh(body.shape),
            color=look.shadow,
            opacity=look.cast_strength,
            lighting=False,
            culling="back",
        )
        # Of a body only the sunny side is flattened. Shadows write their depth, each a little
        # below the one before, so that where two overlap the floor is darkened once.
        write_depth(actor)
        actors.append(actor)
    layer = 1e-3 * min(body.shape.half_extents.min() for body in creature.bodies)

    def update(position: np.ndarray, rotation: np.ndarray) -> None:
        for i, (actor, centre, turn) in enumerate(zip(actors, position, rotation, strict=True)):
            pose = np.eye(4)
            pose[:3, :3], pose[:3, 3] = turn, centre - [0.0, 0.0, height]
            matrix = flatten @ pose
            matrix[2, 3] = height - i * layer
            actor.user_matrix = matrix

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
            matrix = np.eye(4)
            matrix[:2, :2] = patch_under(turn, half, centre[2] - height)
            matrix[:3, 3] = centre[0], centre[1], height
            actor.user_matrix = matrix

    return update


def add_contacts(
    plotter: pv.Plotter, look: Look, creature: Creature, height: float
) -> Callable[[np.ndarray, np.ndarray], None]:
    """Dark soft spots where bodies touch the ground; they pale as the gap opens.

    Args:
        plotter: draws them.
        look: of the world.
        creature: the animal.
        height: z of the ground, m.

    Returns:
        A function of the bodies' centres ``(bodies, 3)`` in m and rotations ``(bodies, 3, 3)``.
    """
    patch = pv.Plane(i_size=2, j_size=2, i_resolution=1, j_resolution=1)
    texture = spot_texture(look.shadow, CONTACT, sharpness=2.6)
    spots = []
    for body in creature.bodies:
        actor = plotter.add_mesh(patch, texture=texture, lighting=False)
        actor.ForceTranslucentOn()
        spots.append((actor, soles(body.shape), float(body.shape.half_extents.min())))

    def update(position: np.ndarray, rotation: np.ndarray) -> None:
        for (actor, points, size), centre, turn in zip(spots, position, rotation, strict=True):
            place = centre + points @ turn.T
            gap = place[:, 2] - height
            matrix = np.eye(4)
            middle, matrix[:2, :2], actor.prop.opacity = spot_under(place[:, :2], gap, size)
            matrix[:3, 3] = *middle, height
            actor.user_matrix = matrix

    return update


def patch_under(turn: np.ndarray, half: np.ndarray, gap: float) -> np.ndarray:
    """The half axes of the soft patch under a body, the columns of ``(2, 2)``, m.

    Args:
        turn: body to world ``(3, 3)``.
        half: half extents of the body ``(3,)``, m.
        gap: of its centre from the floor, m.
    """
    # Higher above the floor the patch is wider: the sky lights its edge.
    blur = 0.9 * half.min() + 0.12 * max(gap, 0.0)
    ellipse = (turn[:2] * half) @ (turn[:2] * half).T + blur**2 * np.eye(2)
    spread, axes = np.linalg.eigh(ellipse)
    return axes * np.sqrt(spread) * 1.25


def soles(shape: Shape) -> np.ndarray:
    """Points of a body that may touch the ground ``(n, 3)``, in its own frame, m."""
    # Meshes of boxes are rounded, the physics' boxes are not.
    if isinstance(shape, Box):
        corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        return corners * shape.half_extents
    if isinstance(shape, ConvexMesh):
        return shape.corners
    return np.asarray(shape_mesh(shape).points)


def spot_under(
    place: np.ndarray, gap: np.ndarray, size: float
) -> tuple[np.ndarray, np.ndarray, float]:
    """The dark spot where a body touches the ground.

    Args:
        place: x and y of points of the body ``(n, 2)``, m.
        gap: their heights above the ground ``(n,)``, m.
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
