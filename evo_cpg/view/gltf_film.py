"""A recording as an animated glTF scene, for Blender, three.js and other programs.

The scene shows the animal, ground, stones, water, light and camera of our films. glTF also uses
metres and seconds, but y points upwards. One node, ``world``, rotates all nodes below it. The file
therefore holds the unchanged numbers of the trajectory, in our axes (z upwards).
"""

from typing import Any, cast

import numpy as np
import pyvista as pv
from scipy.spatial.transform import Rotation

from evo_cpg.creature.creature import Creature, neutral_pose
from evo_cpg.io.models.glb import Glb, Node
from evo_cpg.physics.contact.terrain import Plane
from evo_cpg.simulation.recording import Recording
from evo_cpg.system import version_of
from evo_cpg.view.look import sun_direction
from evo_cpg.view.meshes import pieces
from evo_cpg.view.offscreen import floor_texture
from evo_cpg.view.scene import Panel, Scene, check_panel, quaternions, sample, scene_of
from evo_cpg.view.skin import skins
from evo_cpg.view.stage import camera_path
from evo_cpg.view.terrain import Terrain, obstacle_mesh

# Rotation from z upwards to y upwards: a quarter turn about x, as a quaternion x, y, z, w.
Z_UP = (-np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5))
# Distance that level ground reaches beyond the path and the light, in radii of the animal. Viewers
# show the whole scene at first, so the animal is small on a large ground.
_MARGIN = 2.0
_STONE, _WATER, _WATER_OPACITY = (0.55, 0.53, 0.5), "#4cadd2", 0.35
# Illuminance by the sun, and by the light at a distance of one radius of the animal, lux. Viewers
# show a white sheet under pi lux at full brightness.
_SUN, _LAMP = 3.0, 2.0
_FPS = 30.0
# Width over height of the picture of the camera, and its nearest visible distance in radii.
_ASPECT, _NEAR = 16 / 9, 0.05


def gltf_film(panel: Panel) -> bytes:
    """Return a binary glTF file (.glb) of a recording.

    Each body has a node with a unique name. Translation and rotation move the node at every instant
    of the recording. `evo_cpg.view.film.side_by_side` shows the same scene.

    Raises:
        RecordingError: the recording does not fit its creature, is empty or is not finite.
        ValueError: the world is unknown.
    """
    check_panel(panel)
    creature, title = panel.creature, panel.title or panel.creature.name
    scene = scene_of(panel, sample(panel.recording, _FPS))
    glb = Glb(f"evo-cpg {version_of('evo-cpg')}", title)
    root = glb.node(_apart(creature, "world"), rotation=list(Z_UP))
    _add_animal(glb, root, creature, panel.recording)
    _add_ground(glb, root, scene)
    if scene.goal is not None:
        name = _apart(creature, "light")
        color, halo = (
            np.array(pv.Color(each).float_rgb) for each in (scene.look.light, scene.look.halo)
        )
        material = glb.material(name, color, glow=True)
        mesh = _add_mesh(glb, name, pv.Sphere(radius=0.075 * scene.radius), material)
        shone = glb.light(name, "point", halo, _LAMP * scene.radius**2)
        place = scene.goal[0].tolist()
        node = glb.node(name, root, mesh=mesh, translation=place, extensions=shone)
        if panel.recording.moves_light:
            times = glb.times(scene.clip.time - scene.clip.time[0])
            glb.animate(node, "translation", times, scene.goal)
    sun = sun_direction(scene.look, np.array([0.0, 1.0, -0.3]))
    turn = Rotation.align_vectors([sun], [[0.0, 0.0, 1.0]])[0]
    name = _apart(creature, "sun")
    shone = glb.light(name, "directional", np.array(pv.Color(scene.look.sun).float_rgb), _SUN)
    glb.node(name, root, rotation=turn.as_quat().tolist(), extensions=shone)
    # The camera of our films, which follows the animal.
    path = camera_path(scene, "follow", _ASPECT)
    sight = path.focus - path.position
    # A camera of glTF looks along its -z, and its y axis points up in the picture.
    back = -sight / np.linalg.norm(sight, axis=-1, keepdims=True)
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right, axis=-1, keepdims=True)
    turn = quaternions(np.stack([right, np.cross(back, right), back], -1))
    angle = float(np.radians(path.view_angle))
    name = _apart(creature, "camera")
    node = glb.node(
        name,
        root,
        camera=glb.camera(name, angle, _ASPECT, _NEAR * scene.radius),
        translation=path.position[0].tolist(),
        rotation=turn[0].tolist(),
    )
    times = glb.times(scene.clip.time - scene.clip.time[0])
    glb.animate(node, "translation", times, path.position)
    glb.animate(node, "rotation", times, turn)
    return glb.to_bytes()


def _apart(creature: Creature, name: str) -> str:
    """Return a name for a node of the scenery, with underscores added if a body has the name."""
    names = {body.name for body in creature.bodies}
    while name in names:
        name += "_"
    return name


def _add_animal(glb: Glb, root: Node, creature: Creature, recording: Recording) -> None:
    times = glb.times(recording.time - recording.time[0])

    def add(i: int, name: str, **given: Any) -> Node:
        """Add a node that moves with a body. Viewers without animation show its first pose."""
        place, turn = recording.position[:, i], quaternions(recording.rotation[:, i])
        first = {"translation": place[0].tolist(), "rotation": turn[0].tolist()}
        node = glb.node(name, root, **first, **given)
        glb.animate(node, "translation", times, place)
        glb.animate(node, "rotation", times, turn)
        return node

    for i, (body, own) in enumerate(zip(creature.bodies, pieces(creature), strict=True)):
        meshes = []
        for mesh, color, eye in own:
            name = _apart(creature, f"{body.name}.{eye}") if eye else body.name
            # Colours of points multiply the material's.
            rgb = np.ones(3) if "rgb" in mesh.point_data else np.array(pv.Color(color).float_rgb)
            material = glb.material(name, rgb, roughness=0.25 if eye else 0.7)
            meshes.append((name, _add_mesh(glb, name, mesh, material)))
        (_, surface), *eyes = meshes
        node = add(i, body.name, mesh=surface)
        for name, mesh in eyes:
            glb.node(name, node, mesh=mesh)
    covered = skins(creature)
    if covered:
        # Skins have bones of their own, so that the bodies stay ordinary nodes.
        centres, rotations = map(np.asarray, neutral_pose(creature))
        # The neutral pose, moved to where the animal starts. Axes are glTF's.
        start = creature.root_index
        turn = recording.rotation[0, start] @ rotations[start].T
        upright = Rotation.from_quat(Z_UP).as_matrix()
        place = upright @ (recording.position[0, start] - turn @ centres[start])
        turn = upright @ turn
        used = np.unique(np.concatenate([skin.bodies.ravel() for skin in covered]))
        bones = [add(i, _apart(creature, f"{creature.bodies[i].name}.bone")) for i in used]
        rest = np.tile(np.eye(4), (len(used), 1, 1))
        rest[:, :3, :3] = turn @ rotations[used]
        rest[:, :3, 3] = centres[used] @ turn.T + place
        name = _apart(creature, "skin")
        material = glb.material(name, np.ones(3), roughness=0.7)
        bound = glb.skin(name, bones, rest)
        for number, skin in enumerate(covered, 1):
            own = _apart(creature, f"skin{number}")
            mesh = glb.mesh(
                own,
                skin.points @ turn.T + place,
                skin.normals @ turn.T,
                skin.faces,
                material,
                colors=skin.colors,
                joints=np.searchsorted(used, skin.bodies),
                weights=skin.weights,
            )
            # Only bones move a skin. three.js draws it as long as the place of its node is in view.
            node = glb.node(own, mesh=mesh, skin=bound)
            moved = (recording.position[:, start] - recording.position[0, start]) @ upright.T
            glb.animate(node, "translation", times, moved)


def _add_ground(glb: Glb, root: Node, scene: Scene) -> None:
    look, creature, obstacles = scene.look, scene.creature, scene.ground.obstacles
    floor = scene.ground.floor
    if isinstance(floor, Plane) and tuple(floor.normal) == (0.0, 0.0, 1.0):
        # Two triangles are enough for level ground.
        shown = scene.clip.position.reshape(-1, 3)
        if scene.goal is not None:
            shown = np.concatenate([shown, scene.goal])
        margin = _MARGIN * scene.radius
        x, y = np.stack([shown.min(0) - margin, shown.max(0) + margin])[:, :2].T
        terrain = Terrain(x, y, np.full((2, 2), float(floor.height)))
    else:
        terrain = scene.terrain(0.0)
    points = terrain.points()
    tile = floor_texture(look.floor, look.grid, look.checkered, scene.stands)
    texture = glb.texture(np.asarray(tile.to_array()))
    material = glb.material("ground", np.ones(3), roughness=1.0, texture=texture)
    name, places = _apart(creature, "ground"), scene.marks.tiles(points[:, :2])
    mesh = glb.mesh(name, points, terrain.normals(), terrain.triangles(), material, places)
    glb.node(name, root, mesh=mesh)
    stone = glb.material("stone", np.array(_STONE), roughness=0.95) if obstacles else 0
    for i, obstacle in enumerate(obstacles):
        mesh, place, turn = obstacle_mesh(obstacle)
        name = _apart(creature, f"obstacle{i + 1}")
        glb.node(
            name,
            root,
            mesh=_add_mesh(glb, name, mesh, stone),
            translation=place.tolist(),
            rotation=quaternions(turn[None])[0].tolist(),
        )
    if scene.surface is not None:
        blue = np.array(pv.Color(_WATER).float_rgb)
        material = glb.material("water", blue, roughness=0.1, alpha=_WATER_OPACITY)
        x, y = (terrain.x[[0, -1]], terrain.y[[0, -1]])
        sheet = Terrain(x, y, np.full((2, 2), float(scene.surface)))
        name = _apart(creature, "water")
        mesh = glb.mesh(name, sheet.points(), sheet.normals(), sheet.triangles(), material)
        glb.node(name, root, mesh=mesh)


def _add_mesh(glb: Glb, name: str, surface: pv.PolyData, material: int) -> int:
    whole = cast(pv.PolyData, surface.triangulate())
    normals = np.asarray(whole.point_data.active_normals, float)
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    corners = whole.regular_faces.astype(np.int64)
    colors = np.asarray(whole.point_data["rgb"]) if "rgb" in whole.point_data else None
    return glb.mesh(name, np.asarray(whole.points), normals, corners, material, colors=colors)
