"""The scene of a film: an animal in its world, seen by a camera.

It is built once: each ``add_...`` function puts actors into the plotter and, where they change from
frame to frame, returns a function that moves them or overwrites arrays in place; nothing is meshed
again.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pyvista as pv

from evo_cpg.creature.creature import Creature
from evo_cpg.physics.footing import Ground
from evo_cpg.physics.terrain import Part, Plane
from evo_cpg.simulation.recording import Recording
from evo_cpg.view.camera import CameraPath, aspect_of, course, follow, hidden
from evo_cpg.view.captions import captions
from evo_cpg.view.clip import Clip
from evo_cpg.view.ground import (
    Marks,
    add_floor,
    add_numbers,
    add_relief,
    grid_spacing,
    mark_spacing,
)
from evo_cpg.view.look import LOOKS, SHORE, Look
from evo_cpg.view.meshes import add_bodies, head_index, shape_mesh
from evo_cpg.view.obstacles import add_obstacles, obstacle_mesh, obstacle_top
from evo_cpg.view.offscreen import pixels, placed
from evo_cpg.view.scenery import (
    add_goal_light,
    add_particles,
    add_sky,
    add_trail,
    sun_direction,
)
from evo_cpg.view.shadows import LIFT, add_contacts, add_shadows, add_sun_shadows
from evo_cpg.view.terrain import Level, Terrain, heights, make_terrain
from evo_cpg.view.textures import CELLS
from evo_cpg.view.water import add_water, add_waterlines

# The floor lies this many radii of the animal below the lowest point of its way through water.
FLOOR_DEPTH = 0.55
# Time in which the trail fades to a third, s.
_TRAIL_FADE = 4.0
# Angles of the camera that are tried in turn where something stands in its way, rad, and how far
# above the ground it stays, in radii of the animal. Of all bodies and instants this share may be
# hidden: stones that pass in front show how far away they are.
_ELEVATIONS, _CLEARANCE, _HIDDEN = np.radians([16.0, 22.0, 28.0, 35.0, 45.0]), 0.3, 0.03
# Land rises out of the water within so many radii of the animal's way: the film shows the surface.
_NEARBY = 4.0
# The ground's mesh ends so many visibilities from the way, where it has faded to nothing.
HORIZON = 2.4


class Stage(NamedTuple):
    """How a film is made.

    Attributes:
        look: of the world.
        title: caption.
        note: below it.
        size: width and height of the film, pixels.
        oversampling: pixels rendered per pixel of the film, a side.
        rate: frames per second of recorded time.
        speed: recorded seconds per second of film.
        ground: None where there is none.
        surface: height of the water's surface, m; None where none is seen.
        camera: from where the animal is seen, one of `evo_cpg.view.camera.CAMERAS`.
    """

    look: Look
    title: str
    size: tuple[int, int]
    oversampling: float
    rate: float
    speed: float
    ground: Ground | None = None
    surface: float | None = None
    camera: str = "follow"
    note: str = ""

    @property
    def level(self) -> float | None:
        """Height of the ground where it is level and bare, and no water covers it, m."""
        return None if self.ground is None or self.surface is not None else self.ground.level


def camera_path(creature: Creature, recording: Recording, clip: Clip, stage: Stage) -> CameraPath:
    """The camera that looks at these frames, over whatever stands in its way."""
    width, height = stage.size
    look, lit = stage.look, np.isfinite(recording.goal).all()
    first, turn = look.elevation if lit else look.side_elevation, None
    if (aspect := aspect_of(stage.camera, len(clip.time))) is not None:
        turn, first = aspect

    def at(elevation: float) -> CameraPath:
        return follow(
            clip.position,
            recording.goal,
            animal_reach(creature),
            stage.rate,
            width / height,
            elevation,
            turn,
        )

    path, ground = at(first), stage.ground
    if stage.surface is None and (ground is None or stage.level is not None):
        return path
    margin = _CLEARANCE * animal_radius(creature, clip)

    def top(place: np.ndarray) -> np.ndarray:
        if ground is None:
            return np.full(place.shape[:-1], -np.inf)
        tops = [obstacle_top(obstacle, place) for obstacle in ground.obstacles]
        return np.maximum.reduce([heights(ground.floor, place), *tops])

    for elevation in _ELEVATIONS[first < _ELEVATIONS]:
        free = stage.surface is None or (path.position[:, 2] > stage.surface + margin).all()
        if isinstance(turn, np.ndarray):
            # Wherever it comes by it stays above the ground.
            free = free and (path.position[:, 2] > top(path.position[:, :2]) + margin).all()
        if free and hidden(path, clip.position, top, margin) <= _HIDDEN:
            break
        path = at(elevation)
    return path


def set_scene(
    plotter: pv.Plotter, creature: Creature, recording: Recording, clip: Clip, stage: Stage
) -> Callable[[int], np.ndarray]:
    """Build everything that the film shows.

    Returns:
        A function that draws a frame by its number: bytes ``(height, width, 3)``, bottom row
        first.
    """
    look = stage.look
    camera = camera_path(creature, recording, clip, stage)
    half_extents = np.array([body.shape.half_extents for body in creature.bodies])
    reach = animal_reach(creature)
    radius = animal_radius(creature, clip)
    lit = bool(np.isfinite(recording.goal).all())
    shown = np.concatenate([camera.focus, recording.goal[None]]) if lit else camera.focus
    lowest = min(clip.position[..., 2].min() - reach, shown[:, 2].min())
    floor = lowest - FLOOR_DEPTH * radius if stage.level is None else stage.level
    spacing = grid_spacing(2 * radius)
    centre = clip.position.mean(1)
    head = clip.position[:, head_index(creature)]
    sights = camera.focus - camera.position
    away = float(np.linalg.norm(sights[0]))
    sight = sights[0] / away
    # Since the first frame.
    turned = np.arctan2(sights[:, 1], sights[:, 0]) - np.arctan2(sight[1], sight[0])
    turned[np.abs(np.sin(turned / 2)) < 1e-9] = 0.0
    marks = None
    if stage.ground is not None:
        # Of the root, as the distance of a recording without a light.
        way = clip.position[:, next(i for i, b in enumerate(creature.bodies) if b.joint is None)]
        bearing = course(way, recording.goal, radius / 10)
        marks = Marks(way[0, :2], bearing, mark_spacing(2 * radius))
        spacing = marks.spacing / CELLS
    ground: Level | Terrain = Level(floor)
    if stage.surface is not None or (stage.ground is not None and stage.level is None):
        shape = Plane(height=floor) if stage.ground is None else stage.ground.floor
        filmed = np.concatenate([shown, clip.position.reshape(-1, 3)])[:, :2]
        ground = make_terrain(shape, filmed, radius, HORIZON * look.visibility * radius)
    lift = LIFT * radius

    def dry(place: np.ndarray) -> np.ndarray:
        high = ground.height(place) + lift
        return high if stage.surface is None else np.where(high > stage.surface, high, np.nan)

    if stage.ground is not None:
        # The trail lies on the ground, or in the water where the animal swims.
        low = top = ground.height(head[:, :2]) + lift
        if stage.surface is not None:
            top = np.maximum(low, stage.surface + lift)
        elif look.particles and isinstance(ground, Terrain):
            top = np.full(len(low), np.inf)
        head = np.column_stack([head[:, :2], np.clip(head[:, 2], low, top)])

    # Translucent actors are drawn in the order in which they are added: what lies in the plane of
    # the floor comes after it, the light and the trail over the shadows, the water over all.
    move_sky = add_sky(plotter, look, sight, away)
    sun = sun_direction(look, sight)
    if isinstance(ground, Level):
        moving = [add_floor(plotter, look, floor, radius, spacing, marks)]
    else:
        net, water = marks or Marks(np.zeros(2), 0.0, CELLS * spacing), stage.surface
        moving = [add_relief(plotter, look, ground, radius, spacing, net, sight, sun, water)]
    if marks is not None:
        moving.append(add_numbers(plotter, look, marks, centre, dry, radius, sight, away))
    if stage.ground is not None and stage.ground.obstacles:
        _add_stones(plotter, look, stage.ground.obstacles, ground, sun, radius)
    bodies = [shape_mesh(body.shape) for body in creature.bodies]
    shadows = [
        add_sun_shadows(plotter, look, bodies, ground, sun, radius),
        add_shadows(plotter, look, ground, half_extents, radius),
    ]
    if marks is not None:
        shadows.append(add_contacts(plotter, look, creature, ground, radius))
    face_viewer = None
    if lit:
        face_viewer = add_goal_light(plotter, look, recording.goal, ground, radius, sight)
    grow_trail = add_trail(plotter, look, head, 0.0065 * radius, _TRAIL_FADE * stage.rate)
    if look.particles:
        add_particles(plotter, shown, ground, radius, stage.oversampling, stage.surface)
    flow = None
    if isinstance(ground, Terrain) and stage.surface is not None:
        flow = add_water(plotter, look, ground, stage.surface, radius, sight)
        shadows.append(add_waterlines(plotter, stage.surface, half_extents, radius))
    bodies = add_bodies(plotter, creature, look.ambient)
    grid = f"grid {spacing:g} m" + (f", {stage.speed:g} x speed" if stage.speed != 1 else "")
    measured, note = "to the light" if lit else "way made", f"{stage.note}; {grid}"
    note = note if stage.note else grid
    caption = captions(look, stage.title, measured, note, stage.size, stage.oversampling)
    plotter.camera.view_angle = camera.view_angle
    plotter.camera.up = (0.0, 0.0, 1.0)
    # Makes the window, in which nothing need be drawn yet; without it VTK resets the camera later.
    plotter.renderer.SetDraw(False)
    plotter.show(auto_close=False, interactive=False)
    plotter.renderer.SetDraw(True)

    def show(frame: int) -> np.ndarray:
        plotter.camera.position = camera.position[frame]
        plotter.camera.focal_point = camera.focus[frame]
        plotter.camera.clipping_range = (0.05 * away, 20 * away)
        move_sky(camera.position[frame], turned[frame])
        if face_viewer is not None:
            face_viewer(turned[frame])
        for move in moving:
            move(camera.focus[frame], turned[frame])
        for move in shadows:
            move(clip.position[frame], clip.rotation[frame])
        if flow is not None:
            flow(camera.focus[frame], camera.position[frame], clip.time[frame], turned[frame])
        grow_trail(frame)
        for actors, place, turn in zip(
            bodies, clip.position[frame], clip.rotation[frame], strict=True
        ):
            for actor in actors:
                actor.user_matrix = placed(turn, place)
        plotter.render()
        picture, elapsed = pixels(plotter), clip.time[frame] - clip.time[0]
        caption(picture, elapsed, float(clip.distance[frame]), clip.speed[frame])
        return picture

    return show


def _add_stones(
    plotter: pv.Plotter,
    look: Look,
    stones: tuple[Part, ...],
    ground: Level | Terrain,
    sun: np.ndarray,
    radius: float,
) -> None:
    """Draw obstacles with their shadows."""
    add_obstacles(plotter, stones, look.ambient, ground.height)
    shades = [obstacle_mesh(stone, shade=True) for stone in stones]
    meshes, places, turns = zip(*shades, strict=True)
    half_extents = np.array([np.ptp(np.asarray(mesh.points), axis=0) / 2 for mesh in meshes])
    for lay in (
        add_shadows(plotter, look, ground, half_extents, radius),
        add_sun_shadows(plotter, look, meshes, ground, sun, radius),
    ):
        lay(np.array(places), np.array(turns))


def seen_world(
    creature: Creature, clip: Clip, world: str, ground: Ground | None, surface: float | None
) -> tuple[Look, float | None]:
    """Return the look of a world, and the height of the water's surface if it is seen, m."""
    if surface is None or not surface_is_seen(creature, clip, ground, surface):
        return LOOKS[world], None
    return SHORE, surface


def surface_is_seen(creature: Creature, clip: Clip, ground: Ground | None, surface: float) -> bool:
    """Whether the animal, or land near its way, rises out of the water."""
    for i, body in enumerate(creature.bodies):
        # Upwards, in the body's frame.
        ups = clip.rotation[:, i, 2]
        tops = [body.shape.support(up) @ up for up in ups]
        if (clip.position[:, i, 2] + tops).max() > surface:
            return True
    if ground is None:
        return False
    near = _NEARBY * animal_radius(creature, clip)
    way = clip.position.reshape(-1, 3)[:, :2]
    return bool(make_terrain(ground.floor, way, near / 4, near).z.max() > surface)


def animal_radius(creature: Creature, clip: Clip) -> float:
    """Distance of the animal's far ends from its middle at the start, m."""
    start = clip.position[0]
    return float(np.linalg.norm(start - start.mean(0), axis=-1).max()) + animal_reach(creature)


def animal_reach(creature: Creature) -> float:
    """Largest distance from a body's centre that a part of it may have, m."""
    return max(body.shape.reach for body in creature.bodies)
