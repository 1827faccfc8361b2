"""Soft spots and shadows on the ground: cast shadows, patches under bodies, and contacts."""

from collections.abc import Callable, Sequence

import numpy as np
import pyvista as pv

from evo_cpg.creature.creature import Creature
from evo_cpg.creature.shapes import Shape
from evo_cpg.view.look import Look
from evo_cpg.view.offscreen import add_faded, write_depth
from evo_cpg.view.terrain import Level, Terrain
from evo_cpg.view.textures import spot_texture

# Opacity of the spot under a foot that touches the ground.
_CONTACT = 0.85
# What lies on the ground is lifted by this fraction of the animal's radius.
LIFT = 0.008
# Points along a side of a spot on uneven ground.
_POINTS = 9

# A function of the bodies' centres ``(bodies, 3)``, m, and rotations ``(bodies, 3, 3)``.
Pose = Callable[[np.ndarray, np.ndarray], None]


class Spots:
    """Soft spots that lie on the ground, in one mesh: an actor for each would cost more to draw.

    Args:
        plotter: draws them.
        texture: of each.
        ground: on which they lie.
        lift: above it, m.
        count: of the spots.
        points: along a side of each, on uneven ground.
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
        """Move the spots.

        Args:
            middle: of each ``(n, 2)``, m.
            axes: half axes of each, the columns of ``(n, 2, 2)``, m.
            opacity: of each ``(n,)``; all is drawn if None.
        """
        place = (middle[:, None] + self._own @ axes.mT).reshape(-1, 2)
        self._mesh.points = np.column_stack([place, self._ground.height(place) + self._lift])
        if opacity is not None:
            self._rgba[:, 3] = np.repeat(255 * opacity, len(self._own))
            self._mesh["rgba"] = self._rgba


def add_sun_shadows(
    plotter: pv.Plotter,
    look: Look,
    meshes: Sequence[pv.PolyData],
    ground: Level | Terrain,
    sun: np.ndarray,
    radius: float,
) -> Pose:
    """Draw the shadows that bodies or obstacles cast on the ground in the sun.

    Args:
        plotter: draws them.
        look: of the world; nothing is drawn where it casts no shadows.
        meshes: of the bodies, in their own frames.
        ground: on which the shadows lie.
        sun: unit vector towards the sun ``(3,)``.
        radius: of the animal, m.

    Returns:
        A function of the bodies' centres ``(bodies, 3)`` in m and rotations ``(bodies, 3, 3)``.
    """
    if not look.cast_strength or not meshes:
        return lambda position, rotation: None
    own = [np.asarray(mesh.points).astype(float) for mesh in meshes]
    first = np.cumsum([0, *map(len, own)])
    faces = [mesh.triangulate().regular_faces + i for mesh, i in zip(meshes, first, strict=False)]
    shadow = pv.PolyData.from_regular_faces(np.concatenate(own), np.concatenate(faces))
    actor = plotter.add_mesh(
        shadow, color=look.shadow, opacity=look.cast_strength, lighting=False, culling="back"
    )
    # Where shadows overlap the ground is darkened once: they write their depth, each a little below
    # the one before.
    write_depth(actor)
    layer = np.repeat(LIFT * radius * np.linspace(1.0, 0.5, len(own)), [len(p) for p in own])
    slant = sun[:2] / sun[2]

    def update(position: np.ndarray, rotation: np.ndarray) -> None:
        points = np.concatenate(
            [c + p @ turn.T for p, c, turn in zip(own, position, rotation, strict=True)]
        )
        place, high = points[:, :2], points[:, 2]
        # Where the ray through each point meets the ground.
        low = ground.height(place)
        for _ in range(4):
            low = ground.height(place - (high - low)[:, None] * slant)
        fallen = np.maximum(high - low, 0.0)[:, None]
        place = place - fallen * slant
        shadow.points = np.column_stack([place, ground.height(place) + layer])

    return update


def add_shadows(
    plotter: pv.Plotter,
    look: Look,
    ground: Level | Terrain,
    half_extents: np.ndarray,
    radius: float,
) -> Pose:
    """Draw soft patches on the ground under the bodies.

    Args:
        plotter: draws them.
        look: of the world.
        ground: on which they lie.
        half_extents: of the bodies ``(bodies, 3)``, m.
        radius: of the animal, m.

    Returns:
        A function of the bodies' centres ``(bodies, 3)`` in m and rotations ``(bodies, 3, 3)``.
    """
    texture = spot_texture(look.shadow, look.shadow_strength, sharpness=2.2)
    spots = Spots(plotter, texture, ground, LIFT * radius, len(half_extents))

    def update(position: np.ndarray, rotation: np.ndarray) -> None:
        gap = position[:, 2] - ground.height(position[:, :2])
        under = [patch_under(*each) for each in zip(rotation, half_extents, gap, strict=True)]
        spots.lay(position[:, :2], np.array(under))

    return update


def add_contacts(
    plotter: pv.Plotter, look: Look, creature: Creature, ground: Level | Terrain, radius: float
) -> Pose:
    """Draw dark soft spots where bodies touch the ground; they pale as the gap opens.

    Args:
        plotter: draws them.
        look: of the world.
        creature: the animal.
        ground: on which they lie.
        radius: of the animal, m.

    Returns:
        A function of the bodies' centres ``(bodies, 3)`` in m and rotations ``(bodies, 3, 3)``.
    """
    texture = spot_texture(look.shadow, _CONTACT, sharpness=2.6)
    spots = Spots(plotter, texture, ground, LIFT * radius, len(creature.bodies))
    points = [soles(body.shape) for body in creature.bodies]
    sizes = [float(body.shape.half_extents.min()) for body in creature.bodies]

    def update(position: np.ndarray, rotation: np.ndarray) -> None:
        places = [
            centre + own @ turn.T
            for own, centre, turn in zip(points, position, rotation, strict=True)
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
    return shape.skin().points if shape.corners is None else shape.corners


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
