"""A skin over the gaps of a chain of bodies, as between the beads of an eel. It is only drawn.

The skin is a tube through the centres of the chain's bodies. Its section at a body is the body's
own, and changes evenly on the way to the next body. The bodies stay visible where they are thicker.
"""

import numpy as np
import pyvista as pv

from evo_cpg.creature.creature import Creature
from evo_cpg.creature.shapes import Box, Shape
from evo_cpg.creature.slender import LEAST_BODIES, SlenderChain, slender_chains
from evo_cpg.view.meshes import body_colors
from evo_cpg.view.stage import Shot, Stage, Update

# Rings from one body to the next, and points around a ring.
_RINGS, _POINTS = 6, 20
# Exponent of the section (2 is an ellipse), and its size relative to the body: of boxes, which stay
# visible, and of round bodies, which the skin covers.
_BOX, _ROUND = (5.0, 0.93), (2.0, 1.03)


class Skin:
    """Skin over one chain.

    Args:
        creature: the animal.
        chain: the chain.
    """

    def __init__(self, creature: Creature, chain: SlenderChain):
        self._bodies = list(chain.bodies)
        count = len(self._bodies)
        # From the first centre to the last: the body before each ring, and the part of the way.
        along = np.linspace(0, count - 1, (count - 1) * _RINGS + 1)
        self._before = np.minimum(along.astype(int), count - 2)
        self._part = (along - self._before)[:, None]
        tangents = np.asarray(chain.tangents, float)
        self._outlines = np.array(
            [
                _outline(creature.bodies[body].shape, tangent)
                for body, tangent in zip(self._bodies, tangents, strict=True)
            ]
        )
        colors = body_colors(creature)[self._bodies]
        mixed = colors[self._before] * (1 - self._part) + colors[self._before + 1] * self._part
        self._tangents = tangents
        rows, columns = len(along), _POINTS
        ring = np.arange(rows - 1)[:, None] * columns
        here, there = np.arange(columns), np.roll(np.arange(columns), -1)
        corners = np.stack([ring + here, ring + columns + there, ring + there], -1)
        others = np.stack([ring + here, ring + columns + here, ring + columns + there], -1)
        faces = np.concatenate([corners.reshape(-1, 3), others.reshape(-1, 3)])
        self.mesh = pv.PolyData.from_regular_faces(np.zeros((rows * columns, 3)), faces)
        self.mesh["rgb"] = np.repeat(np.round(255 * mixed).astype(np.uint8), columns, 0)
        self.mesh.point_data.active_normals = np.tile([0.0, 0.0, 1.0], (rows * columns, 1))

    def move(self, position: np.ndarray, rotation: np.ndarray) -> None:
        """Lay the skin over the bodies at new poses: centres ``(b, 3)``, rotations ``(b, 3, 3)``.

        The centreline is a cubic curve that passes every centre along the body's axis.
        """
        place, turn = position[self._bodies], rotation[self._bodies]
        ahead = -np.einsum("bij,bj->bi", turn, self._tangents)
        rings = np.einsum("bij,bkj->bki", turn, self._outlines)
        i, t = self._before, self._part
        far = np.linalg.norm(place[i + 1] - place[i], axis=1, keepdims=True)
        curve = (
            (2 * t**3 - 3 * t**2 + 1) * place[i]
            + (t**3 - 2 * t**2 + t) * far * ahead[i]
            + (3 * t**2 - 2 * t**3) * place[i + 1]
            + (t**3 - t**2) * far * ahead[i + 1]
        )
        across = rings[i] * (1 - t[..., None]) + rings[i + 1] * t[..., None]
        self.mesh.points = (curve[:, None] + across).reshape(-1, 3)
        around = np.roll(across, -1, 1) - np.roll(across, 1, 1)
        normals = np.cross(around, np.gradient(curve, axis=0)[:, None])
        normals *= np.sign((normals * across).sum(-1, keepdims=True))
        normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-12)
        self.mesh.point_data.active_normals = normals.reshape(-1, 3).astype(np.float32)
        self.mesh.Modified()


def add_skins(stage: Stage) -> Update:
    """Draw a skin over every chain of at least three bodies."""
    creature = stage.scene.creature
    skins = [
        Skin(creature, chain)
        for chain in slender_chains(creature)
        if len(chain.bodies) >= LEAST_BODIES
        and all(creature.bodies[body].shape.exists for body in chain.bodies)
    ]
    for skin in skins:
        actor = stage.plotter.add_mesh(
            skin.mesh, scalars="rgb", rgb=True, show_scalar_bar=False, culling="back",
            ambient=stage.look.ambient, diffuse=0.8, specular=0.25, specular_power=18,
        )  # fmt: skip
        # Only this makes VTK read the normals, which change from frame to frame.
        actor.prop.interpolation = "Phong"

    def update(shot: Shot) -> None:
        for skin in skins:
            skin.move(shot.position, shot.rotation)

    return update


def _outline(shape: Shape, tangent: np.ndarray) -> np.ndarray:
    """Return points around a body's section across a unit vector ``(points, 3)``, m."""
    # The axes of the section are those of the frame that lie most across.
    first = int(np.argmin(np.abs(tangent)))
    side = np.eye(3)[first] - tangent * tangent[first]
    side /= np.linalg.norm(side)
    up = np.cross(tangent, side)
    halves = [0.5 * axis @ (shape.support(axis) - shape.support(-axis)) for axis in (side, up)]
    exponent, size = _BOX if isinstance(shape, Box) else _ROUND
    angle = 2 * np.pi * np.arange(_POINTS) / _POINTS
    wide, high = (np.sign(x) * np.abs(x) ** (2 / exponent) for x in (np.cos(angle), np.sin(angle)))
    return size * (np.outer(wide * halves[0], side) + np.outer(high * halves[1], up))
