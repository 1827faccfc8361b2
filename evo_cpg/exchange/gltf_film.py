"""A recording as an animated glTF scene, for Blender, three.js and whatever else reads it.

The animal, its ground, stones, water and light are those of our films. glTF counts metres and
seconds as we do, but has y upwards: one node, ``world``, turns everything below it, so that what
the file says of the bodies are the trajectory's own numbers in our axes (z upwards).
"""

import numpy as np
import pyvista as pv
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from evo_cpg.creature.creature import Creature
from evo_cpg.exchange.glb import Glb, Node
from evo_cpg.installation import version_of
from evo_cpg.physics.footing import Ground
from evo_cpg.physics.terrain import Part, Plane
from evo_cpg.simulation.recording import Recording, require_whole
from evo_cpg.view.camera import course
from evo_cpg.view.clip import sample
from evo_cpg.view.ground import grid_spacing, mark_spacing
from evo_cpg.view.look import Look
from evo_cpg.view.meshes import body_colors, eye_meshes, shape_mesh
from evo_cpg.view.obstacles import obstacle_mesh
from evo_cpg.view.scenery import sun_direction
from evo_cpg.view.stage import FLOOR_DEPTH, animal_radius, animal_reach, seen_world
from evo_cpg.view.terrain import Terrain, make_terrain
from evo_cpg.view.textures import CELLS, floor_texture

# From z upwards to y upwards: a quarter of a turn about x, as a quaternion x, y, z, w.
Z_UP = (-np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5))
# How far the ground reaches beyond the animal's way, in its radii.
_MARGIN = 6.0
_STONE, _WATER, _WATER_OPACITY = (0.55, 0.53, 0.5), "#4cadd2", 0.35
# Brightness of the sun, lux as viewers take it (pi is a white sheet at full tone), and of a lamp
# at one radius of the animal.
_SUN, _LAMP = 3.0, 2.0
_FPS = 30.0


def gltf_film(
    creature: Creature,
    recording: Recording,
    *,
    title: str,
    world: str = "water",
    ground: Ground | None = None,
    surface: float | None = None,
) -> bytes:
    """A binary glTF file (.glb) of a recording.

    A node for each body, named as it and as no other node, is moved by translation and rotation at
    every instant of the recording. `evo_cpg.view.film.side_by_side` shows the same.

    Args:
        creature: the animal.
        recording: its motion.
        title: of the scene.
        world: where the animal lives, ``water`` or ``land``.
        ground: that carries it; by default a floor lies below its way.
        surface: height of the water's surface, m.

    Raises:
        RecordingError: a recording that does not fit its creature, is empty or not finite.
    """
    require_whole(recording, creature)
    clip = sample(recording, _FPS)
    look, surface = seen_world(creature, clip, world, ground, surface)
    radius = animal_radius(creature, clip)
    glb = Glb(f"evo-cpg {version_of('evo-cpg')}", title)
    root = glb.node(_apart(creature, "world"), rotation=list(Z_UP))
    _add_animal(glb, root, creature, recording)
    _add_ground(glb, root, creature, recording, look, radius, ground, surface)
    if np.isfinite(recording.goal).all():
        _add_light(glb, root, _apart(creature, "light"), recording.goal, look, radius)
    sun = sun_direction(look, np.array([0.0, 1.0, -0.3]))
    turn = Rotation.align_vectors([sun], [[0.0, 0.0, 1.0]])[0]
    name = _apart(creature, "sun")
    shone = glb.light(name, "directional", np.array(pv.Color(look.sun).float_rgb), _SUN)
    glb.node(name, root, rotation=turn.as_quat().tolist(), extensions=shone)
    return glb.to_bytes()


def quaternions(rotation: Float[np.ndarray, "t 3 3"]) -> Float[np.ndarray, "t 4"]:
    """Unit quaternions x, y, z, w, of which neighbours lie on the same side: none jumps to -q."""
    found = Rotation.from_matrix(rotation).as_quat()
    flips = np.where((found[1:] * found[:-1]).sum(1) < 0, -1.0, 1.0)
    found[1:] *= np.cumprod(flips)[:, None]
    return found


def _apart(creature: Creature, name: str) -> str:
    """A name of the scenery as it is, or changed where a body has it."""
    names = {body.name for body in creature.bodies}
    while name in names:
        name += "_"
    return name


def _add_animal(glb: Glb, root: Node, creature: Creature, recording: Recording) -> None:
    times = glb.times(recording.time - recording.time[0])
    nodes = {}
    for i, (body, color) in enumerate(zip(creature.bodies, body_colors(creature), strict=True)):
        mesh = _add_mesh(glb, body.name, shape_mesh(body.shape), glb.material(body.name, color))
        nodes[body.name] = node = glb.node(body.name, root, mesh=mesh)
        glb.animate(node, "translation", times, recording.position[:, i])
        glb.animate(node, "rotation", times, quaternions(recording.rotation[:, i]))
    if not creature.light_sensors:
        return
    white = glb.material("eye", np.array([0.99, 0.99, 0.97]), roughness=0.3)
    black = glb.material("pupil", np.array([0.06, 0.08, 0.11]), roughness=0.2)
    for i, sensor in enumerate(creature.light_sensors):
        for part, mesh, material in zip(
            ("eye", "pupil"), eye_meshes(creature, sensor), (white, black), strict=True
        ):
            name = _apart(creature, f"{sensor.body}.{part}{i + 1}")
            glb.node(name, nodes[sensor.body], mesh=_add_mesh(glb, name, mesh, material))


def _add_ground(
    glb: Glb,
    root: Node,
    creature: Creature,
    recording: Recording,
    look: Look,
    radius: float,
    ground: Ground | None,
    surface: float | None,
) -> None:
    lowest = recording.position[..., 2].min() - animal_reach(creature)
    filmed = recording.position.reshape(-1, 3)
    if np.isfinite(recording.goal).all():
        filmed = np.concatenate([filmed, recording.goal[None]])
        lowest = min(lowest, recording.goal[2])
    shape = Plane(height=lowest - FLOOR_DEPTH * radius) if ground is None else ground.floor
    reach = _MARGIN * radius
    origin, bearing, spacing = np.zeros(2), 0.0, grid_spacing(2 * radius)
    if ground is not None:
        way = recording.position[:, next(i for i, b in enumerate(creature.bodies) if not b.joint)]
        origin, bearing = way[0, :2], course(way, recording.goal, radius / 10)
        spacing = mark_spacing(2 * radius) / CELLS
    terrain = _mesh_of(shape, filmed[:, :2], radius, reach)
    points = terrain.points()
    c, s = np.cos(bearing), np.sin(bearing)
    places = (points[:, :2] - origin) @ np.array([[c, -s], [s, c]]) / (CELLS * spacing)
    tile = floor_texture(look.floor, look.grid, look.checkered, ground is not None)
    texture = glb.texture(np.asarray(tile.to_array()))
    material = glb.material("ground", np.ones(3), roughness=1.0, texture=texture)
    name, normals = _apart(creature, "ground"), terrain.normals()
    mesh = glb.mesh(name, points, normals, terrain.triangles(), material, places)
    glb.node(name, root, mesh=mesh)
    obstacles = () if ground is None else ground.obstacles
    stone = glb.material("stone", np.array(_STONE), roughness=0.95) if obstacles else 0
    for i, obstacle in enumerate(obstacles):
        mesh, place, turn = obstacle_mesh(obstacle)
        name = _apart(creature, f"obstacle{i + 1}")
        glb.node(
            name,
            root,
            mesh=_add_mesh(glb, name, mesh, stone),
            translation=place.tolist(),
            rotation=Rotation.from_matrix(turn).as_quat().tolist(),
        )
    if surface is not None:
        blue = np.array(pv.Color(_WATER).float_rgb)
        material = glb.material("water", blue, roughness=0.1, alpha=_WATER_OPACITY)
        x, y = (terrain.x[[0, -1]], terrain.y[[0, -1]])
        corners = np.array([[a, b, surface] for b in y for a in x])
        up = np.tile([0.0, 0.0, 1.0], (4, 1))
        name = _apart(creature, "water")
        sheet = glb.mesh(name, corners, up, np.array([[0, 1, 3], [0, 3, 2]]), material)
        glb.node(name, root, mesh=sheet)


def _mesh_of(shape: Part, filmed: np.ndarray, radius: float, reach: float) -> Terrain:
    """The ground's mesh; two triangles where it is level."""
    if isinstance(shape, Plane) and tuple(shape.normal) == (0.0, 0.0, 1.0):
        low, high = filmed.min(0) - reach, filmed.max(0) + reach
        x, y = (np.array([low[axis], high[axis]]) for axis in (0, 1))
        return Terrain(x, y, np.full((2, 2), float(shape.height)))
    return make_terrain(shape, filmed, radius, reach)


def _add_light(
    glb: Glb, root: Node, name: str, goal: np.ndarray, look: Look, radius: float
) -> None:
    color = np.array(pv.Color(look.light).float_rgb)
    material = glb.material(name, color, glow=True)
    mesh = _add_mesh(glb, name, pv.Sphere(radius=0.075 * radius), material)
    halo = np.array(pv.Color(look.halo).float_rgb)
    shone = glb.light(name, "point", halo, _LAMP * radius**2)
    glb.node(name, root, mesh=mesh, translation=goal.tolist(), extensions=shone)


def _add_mesh(glb: Glb, name: str, surface: pv.PolyData, material: int) -> int:
    whole = surface.triangulate()
    normals = np.asarray(whole.point_data.active_normals, float)
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    corners = whole.regular_faces.astype(np.int64)
    return glb.mesh(name, np.asarray(whole.points), normals, corners, material)
