"""A skin over the gaps of a chain of bodies, as between the beads of an eel. It is only drawn.

The skin is a tube through the centres of the chain's bodies. Its section at a body is the body's
own, and changes evenly on the way to the next body. The bodies stay visible where they are thicker.

Every point follows the two bodies around it (linear blend skinning), as in glTF and three.js:

    x = sum_k w_k (R_k R0_k' (x0 - p0_k) + p_k),

with weights w that depend smoothly on the place between both centres. The tube therefore runs
through every centre along the body's axis.

| symbol | name |
|---|---|
| x0, R0, p0 | ``points``, and the neutral pose of `neutral_pose` |
| w_k | ``weights`` of the ``bodies`` k |
"""

import itertools
from typing import NamedTuple

import numpy as np
import pyvista as pv

from evo_cpg.creature.creature import Creature, neutral_pose
from evo_cpg.creature.shapes import Box, Ellipsoid, Shape
from evo_cpg.creature.slender import LEAST_BODIES, SlenderChain, slender_chains
from evo_cpg.view.fins import Fin, fins
from evo_cpg.view.meshes import body_colors
from evo_cpg.view.offscreen import grid_triangles
from evo_cpg.view.stage import Shot, Stage, Update

# Rings from one body to the next, and points around a ring.
_RINGS, _POINTS = 5, 16
# Exponent of the section (2 is an ellipse), and its size relative to the body: of boxes, which stay
# visible, of fins and round bodies, which the skin covers, and of round bodies at its ends, so that
# the edge of the skin lies below their surface.
_BOX, _FIN, _ROUND, _END = (5.0, 0.93), (2.0, 1.06), (2.0, 1.045), (2.0, 0.97)


class ChainSkin(NamedTuple):
    """Skin over a chain, in the animal's neutral pose.

    Attributes:
        points: positions ``(n, 3)``, m.
        normals: unit normals ``(n, 3)``.
        faces: indices of points ``(f, 3)``, counterclockwise seen from outside.
        colors: red, green and blue of every point ``(n, 3)``, 0 to 255.
        bodies: indices of the two bodies that every point follows ``(n, 2)``.
        weights: weights of both ``(n, 2)``, which add up to 1.
    """

    points: np.ndarray
    normals: np.ndarray
    faces: np.ndarray
    colors: np.ndarray
    bodies: np.ndarray
    weights: np.ndarray


def skins(creature: Creature) -> list[ChainSkin]:
    """Return a skin over every chain of at least three bodies."""
    pose, finned, made = neutral_pose(creature), fins(creature), []
    for chain in slender_chains(creature):
        # A fin at the end of a body is a fin, and not a body that widens.
        kinds = [creature.bodies[body].shape.exists + (body in finned) for body in chain.bodies]
        cuts = [0, *(np.flatnonzero(np.diff(kinds)) + 1), len(kinds)]
        for first, end in itertools.pairwise(cuts):
            if kinds[first] and end - first >= LEAST_BODIES:
                made.append(_skin(creature, pose, finned, chain, slice(first, end)))
    return made


def _skin(
    creature: Creature,
    pose: tuple[np.ndarray, np.ndarray],
    finned: dict[int, Fin],
    chain: SlenderChain,
    part: slice,
) -> ChainSkin:
    """Return the skin over a part of a chain."""
    bodies = np.array(chain.bodies[part])
    tangents = np.asarray(chain.tangents, float)[part]
    place, turn = (np.asarray(each, float)[bodies] for each in pose)
    count = len(bodies)
    last = count - 1
    outlines = np.array(
        [
            _outline(creature.bodies[body].shape, tangent, finned.get(body), i in (0, last))
            for i, (body, tangent) in enumerate(zip(bodies, tangents, strict=True))
        ]
    )
    # From the first centre to the last: the body before each ring, and the part of the way.
    along = np.linspace(0, last, last * _RINGS + 1)
    i = np.minimum(along.astype(int), count - 2)
    t = (along - i)[:, None]
    ahead = -np.einsum("bij,bj->bi", turn, tangents)
    rings = np.einsum("bij,bkj->bki", turn, outlines)
    far = np.linalg.norm(place[i + 1] - place[i], axis=1, keepdims=True)
    after = 3 * t**2 - 2 * t**3
    curve = (
        (1 - after) * place[i]
        + (t**3 - 2 * t**2 + t) * far * ahead[i]
        + after * place[i + 1]
        + (t**3 - t**2) * far * ahead[i + 1]
    )
    across = rings[i] * (1 - t[..., None]) + rings[i + 1] * t[..., None]
    # A wide body reaches beyond the section of a narrow neighbour. Sections of an ellipsoid narrow
    # away from its centre.
    wide = np.linalg.norm(across, axis=-1)
    shapes = [creature.bodies[body].shape for body in bodies]
    lengths = np.array(
        [
            float(tangent @ shape.support(tangent)) if isinstance(shape, Ellipsoid) else 0.0
            for shape, tangent in zip(shapes, tangents, strict=True)
        ]
    )
    for body, away in ((i, t[:, 0] * far[:, 0]), (i + 1, (1 - t[:, 0]) * far[:, 0])):
        half = lengths[body]
        off = np.divide(away, half, out=np.ones_like(away), where=half > 0)
        narrow = np.sqrt(np.maximum(1 - off**2, 0))
        own = np.linalg.norm(rings[body], axis=-1) * narrow[:, None]
        across *= np.maximum(own / wide, 1)[..., None]
        wide = np.maximum(wide, own)
    points = (curve[:, None] + across).reshape(-1, 3)
    around = np.roll(across, -1, 1) - np.roll(across, 1, 1)
    normals = np.cross(around, np.gradient(curve, axis=0)[:, None])
    normals *= np.sign((normals * across).sum(-1, keepdims=True))
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-12)
    grid = np.arange(len(along) * _POINTS).reshape(-1, _POINTS)
    colors = body_colors(creature)[bodies]
    mixed = colors[i] * (1 - t) + colors[i + 1] * t
    return ChainSkin(
        points,
        normals.reshape(-1, 3),
        grid_triangles(np.column_stack([grid, grid[:, 0]])),
        np.repeat(np.round(255 * mixed).astype(np.uint8), _POINTS, 0),
        np.repeat(np.stack([bodies[i], bodies[i + 1]], -1), _POINTS, 0),
        np.repeat(np.concatenate([1 - after, after], -1), _POINTS, 0),
    )


class Draped:
    """A skin in a picture, and its place on the animal.

    Args:
        creature: the animal.
        skin: the skin.

    Attributes:
        mesh: the surface, which `move` changes.
    """

    def __init__(self, creature: Creature, skin: ChainSkin):
        self._skin = skin
        centres, rotations = neutral_pose(creature)
        turn = np.asarray(rotations, float)[skin.bodies]
        # In the frames of both bodies, times the weight.
        weights = skin.weights[..., None]
        offset = skin.points[:, None] - np.asarray(centres, float)[skin.bodies]
        self._points = weights * np.einsum("nkji,nkj->nki", turn, offset)
        self._normals = weights * np.einsum("nkji,nj->nki", turn, skin.normals)
        self.mesh = pv.PolyData.from_regular_faces(skin.points, skin.faces)
        self.mesh["rgb"] = skin.colors
        self.mesh.point_data.active_normals = skin.normals.astype(np.float32)

    def laid(self, position: np.ndarray, rotation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return points ``(n, 3)`` and unit normals of the skin over bodies.

        Args:
            position: centres of the bodies ``(b, 3)``, m.
            rotation: their rotations ``(b, 3, 3)``.
        """
        skin = self._skin
        turn = rotation[skin.bodies]
        centre = np.einsum("nk,nki->ni", skin.weights, position[skin.bodies])
        normals = np.einsum("nkij,nkj->ni", turn, self._normals)
        normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-12)
        return centre + np.einsum("nkij,nkj->ni", turn, self._points), normals

    def move(self, position: np.ndarray, rotation: np.ndarray) -> None:
        """Lay the skin over bodies, see `laid`."""
        self.mesh.points, normals = self.laid(position, rotation)
        self.mesh.point_data.active_normals = normals.astype(np.float32)
        self.mesh.Modified()


def drape(plotter: pv.Plotter, creature: Creature, ambient: float) -> list[tuple[Draped, pv.Actor]]:
    """Draw the skins of an animal in its neutral pose, and return them with their actors."""
    made = []
    for skin in skins(creature):
        draped = Draped(creature, skin)
        actor = plotter.add_mesh(
            draped.mesh, scalars="rgb", rgb=True, show_scalar_bar=False, culling="back",
            ambient=ambient, diffuse=0.8, specular=0.25, specular_power=18,
        )  # fmt: skip
        # Only this makes VTK read the normals, which change from frame to frame.
        actor.prop.interpolation = "Phong"
        made.append((draped, actor))
    return made


def add_skins(stage: Stage) -> Update:
    """Draw the skins of the animal, which move with it."""
    draped = drape(stage.plotter, stage.scene.creature, stage.look.ambient)

    def update(shot: Shot) -> None:
        for skin, _ in draped:
            skin.move(shot.position, shot.rotation)

    return update


def _outline(shape: Shape, tangent: np.ndarray, fin: Fin | None, end: bool) -> np.ndarray:
    """Return points around a body's section ``(points, 3)``, m.

    Args:
        shape: shape of the body.
        tangent: unit vector across the section.
        fin: the fin as which the body is drawn, or None.
        end: whether the skin ends at the body.
    """
    # The axes of the section are those of the frame that lie most across.
    first = int(np.argmin(np.abs(tangent)))
    side = np.eye(3)[first] - tangent * tangent[first]
    side /= np.linalg.norm(side)
    up = np.cross(tangent, side)
    halves = [0.5 * axis @ (shape.support(axis) - shape.support(-axis)) for axis in (side, up)]
    if fin is not None:
        # A fin is thinner than its plate.
        _, wide, thick = fin.section(np.array((fin.start + fin.end) / 2))
        side = fin.axes[1]
        up = np.cross(tangent, side)
        halves = [float(wide) * fin.half[1], float(thick) * fin.half[2]]
    if fin is not None:
        exponent, size = _FIN
    elif isinstance(shape, Box):
        exponent, size = _BOX
    else:
        exponent, size = _END if end else _ROUND
    angle = 2 * np.pi * np.arange(_POINTS) / _POINTS
    wide, high = (np.sign(x) * np.abs(x) ** (2 / exponent) for x in (np.cos(angle), np.sin(angle)))
    return size * (np.outer(wide * halves[0], side) + np.outer(high * halves[1], up))
