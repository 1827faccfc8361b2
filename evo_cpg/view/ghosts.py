"""A crowd as ghosts: translucent animals, all in one mesh.

One actor for each body of two hundred animals takes seconds to draw. All ghosts together are one
mesh. Each frame only overwrites its points. Ghosts of a crowd are coarse bodies of one colour.
Ghosts in lanes are few, so they have the skins, fins and eyes of the animal, in paler colours.
"""

from typing import NamedTuple

import numpy as np
import pyvista as pv

from evo_cpg.creature.creature import Creature
from evo_cpg.creature.mesh import hull
from evo_cpg.creature.shapes import Shape
from evo_cpg.view.meshes import pieces
from evo_cpg.view.offscreen import add_faded, spot_texture, write_depth
from evo_cpg.view.shadows import Spots, patch_opacity
from evo_cpg.view.skin import Draped, skins
from evo_cpg.view.stage import Shot, Stage, Update

# Opacity of a ghost, alone and among many, and in a lane of its own.
_OPACITY, _OPACITY_OF_MANY, _MANY, _OPACITY_IN_LANES = 0.5, 0.12, 100, 0.9
# Brightness of a point that faces sideways, and its change with the height of the direction.
_LEVEL, _SLOPE = 0.9, 0.3
# Mean distance of a ghost's bodies from the animal's at which it is fully seen, in its radius.
_APART = 0.2
# Subdivisions of the icosahedron whose directions give the points of a coarse body.
_FINENESS = 1
# Part of the animal's own colour in a ghost with a lane.
_OWN = 0.4
# Opacity of the soft patch under a ghost, relative to that under the animal.
_PATCH = 0.4


def add_ghosts(stage: Stage) -> Update:
    """Draw all ghosts of the scene, and soft patches under them."""
    scene, look = stage.scene, stage.look
    assert scene.ghosts is not None
    position, rotation = scene.ghosts.position, scene.ghosts.rotation
    count, staged = position.shape[1], scene.staging is not None
    opacity = np.interp(count, (1, _MANY), (_OPACITY, _OPACITY_OF_MANY))
    color = np.array(pv.Color(look.ghost).int_rgb, np.float32)
    if staged:
        opacity, parts = _OPACITY_IN_LANES, _whole(scene.creature, color)
        coats = [Draped(scene.creature, skin) for skin in skins(scene.creature)]
    else:
        parts, coats = _coarse(scene.creature, color), []
    meshes = [(each.faces, each.colors) for each in parts]
    meshes += [(each.mesh.regular_faces, _pale(each.mesh["rgb"], color)) for each in coats]
    colors = np.concatenate([each for _, each in meshes])
    first = np.cumsum([0, *(len(each) for _, each in meshes)])
    of_one = np.concatenate([each + i for (each, _), i in zip(meshes, first, strict=False)])
    every = (of_one + first[-1] * np.arange(count)[:, None, None]).reshape(-1, 3)
    mesh = pv.PolyData.from_regular_faces(np.zeros((count * first[-1], 3), np.float32), every)
    rgba = np.zeros((mesh.n_points, 4), np.uint8)
    actor = add_faded(stage.plotter, mesh, rgba, culling="back")
    if staged:
        # Each ghost hides what is behind it, so that it is seen as an animal and not as a cloud.
        write_depth(actor)
    patches = None
    if scene.stands or staged:
        texture = spot_texture(look.shadow, _PATCH * look.shadow_strength, sharpness=2.2)
        patches = Spots(stage.plotter, texture, stage.ground, stage.lift, count)
    axes = np.tile(0.5 * stage.radius * np.eye(2), (count, 1, 1))

    def update(shot: Shot) -> None:
        place, turn = position[shot.number], rotation[shot.number]
        points = [
            place[:, part.body, None] + np.einsum("nij,kj->nki", turn[:, part.body], part.points)
            for part in parts
        ]
        # Points that face upwards are brighter. Lighting every pixel takes three times as long.
        upwards = [np.einsum("nj,kj->nk", turn[:, part.body, 2], part.normals) for part in parts]
        for coat in coats:
            worn = [coat.laid(*pose) for pose in zip(place, turn, strict=True)]
            points.append(np.stack([each for each, _ in worn]))
            upwards.append(np.stack([normals[:, 2] for _, normals in worn]))
        mesh.points = np.concatenate(points, axis=1).reshape(-1, 3)
        shade = _LEVEL + _SLOPE * np.concatenate(upwards, axis=1)
        rgba[:, :3] = np.minimum(colors * shade[..., None], 255).reshape(-1, 3)
        # A ghost that still coincides with the animal is not seen.
        shown = np.linalg.norm(place - shot.position, axis=-1).mean(1) / (_APART * stage.radius)
        rgba[:, 3] = np.repeat(255 * opacity * np.clip(shown, 0.0, 1.0), first[-1])
        mesh["rgba"] = rgba
        if patches is not None:
            middle = place.mean(1).astype(float)
            height = middle[:, 2] - stage.ground.height(middle[:, :2])
            patches.lay(middle[:, :2], axes, patch_opacity(height / stage.radius))

    return update


class _Part(NamedTuple):
    """Surface of a ghost that moves with one body, in the body's frame.

    Attributes:
        body: number of the body.
        points, normals: positions, m, and unit normals ``(n, 3)``.
        faces: triangles ``(f, 3)``.
        colors: red, green and blue of the points ``(n, 3)``, 0 to 255.
    """

    body: int
    points: np.ndarray
    normals: np.ndarray
    faces: np.ndarray
    colors: np.ndarray


def _coarse(creature: Creature, color: np.ndarray) -> list[_Part]:
    """Return coarse bodies of one colour."""
    parts = []
    for i, body in enumerate(creature.bodies):
        if body.shape.exists:
            points, faces = coarse(body.shape)
            normals = points / np.linalg.norm(points, axis=1, keepdims=True)
            parts.append(_Part(i, points, normals, faces, np.tile(color, (len(points), 1))))
    return parts


def _whole(creature: Creature, color: np.ndarray) -> list[_Part]:
    """Return bodies and eyes as the animal has them, in paler colours."""
    return [
        _Part(i, *piece.arrays(), _pale(piece.colors, color))
        for i, own in enumerate(pieces(creature, fine=False))
        for piece in own
        if piece.mesh.n_points
    ]


def _pale(colors: np.ndarray, color: np.ndarray) -> np.ndarray:
    """Return colours mixed with a ghost's."""
    return _OWN * np.asarray(colors, np.float32) + (1 - _OWN) * color


def coarse(shape: Shape) -> tuple[np.ndarray, np.ndarray]:
    """Return a hull of a shape with few points ``(n, 3)`` in m, and its triangles ``(f, 3)``."""
    directions = np.asarray(pv.Icosphere(nsub=_FINENESS).points, float)
    points = np.array([shape.support(each) for each in directions], float)
    corners, faces = hull(points, "points of a body")
    return corners.astype(np.float32), faces
