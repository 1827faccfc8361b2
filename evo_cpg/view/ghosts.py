"""A crowd as ghosts: translucent bodies of one colour, all in one mesh.

One actor for each body of two hundred animals takes seconds to draw. All ghosts together are one
mesh of coarse bodies. Each frame only overwrites its points.
"""

import numpy as np
import pyvista as pv

from evo_cpg.creature.mesh import hull
from evo_cpg.creature.shapes import Shape
from evo_cpg.view.offscreen import add_faded, spot_texture, write_depth
from evo_cpg.view.shadows import Spots, patch_opacity
from evo_cpg.view.stage import Shot, Stage, Update

# Opacity of a ghost, alone and among many, and in a lane of its own.
_OPACITY, _OPACITY_OF_MANY, _MANY, _OPACITY_IN_LANES = 0.5, 0.12, 100, 0.9
# Brightness of a point that faces sideways, and its change with the height of the direction.
_LEVEL, _SLOPE = 0.9, 0.3
# Mean distance of a ghost's bodies from the animal's at which it is fully seen, in its radius.
_APART = 0.2
# Subdivisions of the icosahedron whose directions give the points of a coarse body.
_FINENESS = 1
# Opacity of the soft patch under a ghost, relative to that under the animal.
_PATCH = 0.4


def add_ghosts(stage: Stage) -> Update:
    """Draw all ghosts of the scene, and soft patches under them."""
    scene, look = stage.scene, stage.look
    assert scene.ghosts is not None
    position, rotation = scene.ghosts.position, scene.ghosts.rotation
    drawn = [i for i, body in enumerate(scene.creature.bodies) if body.shape.exists]
    count = position.shape[1]
    own, faces = zip(*(coarse(scene.creature.bodies[i].shape) for i in drawn), strict=True)
    first = np.cumsum([0, *map(len, own)])
    of_one = np.concatenate([each + i for each, i in zip(faces, first, strict=False)])
    every = (of_one + first[-1] * np.arange(count)[:, None, None]).reshape(-1, 3)
    mesh = pv.PolyData.from_regular_faces(np.zeros((count * first[-1], 3), np.float32), every)
    opacity = np.interp(count, (1, _MANY), (_OPACITY, _OPACITY_OF_MANY))
    staged, appear = scene.staging is not None, None
    if scene.staging is not None:
        opacity, appear = _OPACITY_IN_LANES, scene.staging.appear
    color = np.array(pv.Color(look.ghost, opacity=float(opacity)).int_rgba, np.float32)
    rgba = np.tile(color.astype(np.uint8), (mesh.n_points, 1))
    actor = add_faded(stage.plotter, mesh, rgba, culling="back")
    if staged:
        # Each ghost hides what is behind it, so that it is seen as an animal and not as a cloud.
        write_depth(actor)
    outwards = [each / np.linalg.norm(each, axis=1, keepdims=True) for each in own]
    patches = None
    if scene.stands or staged:
        texture = spot_texture(look.shadow, _PATCH * look.shadow_strength, sharpness=2.2)
        patches = Spots(stage.plotter, texture, stage.ground, stage.lift, count)
    axes = np.tile(0.5 * stage.radius * np.eye(2), (count, 1, 1))

    def update(shot: Shot) -> None:
        place, turn = position[shot.number], rotation[shot.number]
        points = [
            place[:, i, None] + np.einsum("nij,kj->nki", turn[:, i], corners)
            for i, corners in zip(drawn, own, strict=True)
        ]
        mesh.points = np.concatenate(points, axis=1).reshape(-1, 3)
        # Points that face upwards are brighter. Lighting every pixel takes three times as long.
        upwards = [
            np.einsum("nj,kj->nk", turn[:, i, 2], normals)
            for i, normals in zip(drawn, outwards, strict=True)
        ]
        shade = _LEVEL + _SLOPE * np.concatenate(upwards, axis=1).reshape(-1, 1)
        rgba[:, :3] = np.minimum(color[:3] * shade, 255)
        # A ghost that still coincides with the animal is not seen.
        shown = np.linalg.norm(place - shot.position, axis=-1).mean(1) / (_APART * stage.radius)
        if appear is not None:
            shown = np.minimum(shown, np.interp(shot.number, appear, (0.0, 1.0)))
        rgba[:, 3] = np.repeat(color[3] * np.clip(shown, 0.0, 1.0), first[-1])
        mesh["rgba"] = rgba
        if patches is not None:
            middle = place.mean(1).astype(float)
            height = middle[:, 2] - stage.ground.height(middle[:, :2])
            patches.lay(middle[:, :2], axes, patch_opacity(height / stage.radius))

    return update


def coarse(shape: Shape) -> tuple[np.ndarray, np.ndarray]:
    """Return a hull of a shape with few points ``(n, 3)`` in m, and its triangles ``(f, 3)``."""
    directions = np.asarray(pv.Icosphere(nsub=_FINENESS).points, float)
    points = np.array([shape.support(each) for each in directions], float)
    corners, faces = hull(points, "points of a body")
    return corners.astype(np.float32), faces
