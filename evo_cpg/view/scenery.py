"""Light, trail, specks, sun and sky of a scene, and the lines on the floor of a race."""

from typing import cast

import numpy as np
import pyvista as pv
from jaxtyping import Float

from evo_cpg.simulation.recording import appearances
from evo_cpg.view.camera import VIEW_ANGLE, level_axes, turned_about_vertical
from evo_cpg.view.meshes import head_index
from evo_cpg.view.offscreen import add_faded, spot_texture
from evo_cpg.view.scene import Track
from evo_cpg.view.shadows import Spots
from evo_cpg.view.stage import Shot, Stage, Update
from evo_cpg.view.terrain import Terrain

# Points along a side of the pool of light, and its height in radii of the animal.
_POOL, _POOL_LIFT = 41, 0.02
LAMP = 0.075
"""Radius of a light, in radii of the animal."""

# Distance by which a light is drawn behind its place, in radii of the animal, so that it does not
# swallow a head. Width of the halo of a light of another lane in its radius, and its opacity.
# Opacity of a light that was reached.
_BEHIND, _LANE_HALO, _LANE_GLOW, _REACHED = 0.5, 9.0, 0.6, 0.5
# A light farther from the camera than this, in radii of the animal, does not become smaller.
_FAR = 18.0
# A light flares when a body is nearer than this, in radii of the animal. Growth of its sphere and
# of its brightness.
_NEAR, _SWELL, _FLARE = 0.35, 0.9, 2.0
# Brightness of a light.
_INTENSITY = 0.9
# Number of specks in water, and their colour.
_PARTICLES, _PARTICLE, _PARTICLE_SEED = 1200, "#d9fff6", 20101
# Time in which the trail fades to a third, s, and its thickness in radii of the animal.
_TRAIL_FADE, _TRAIL = 4.0, 0.0065
# Shafts of light in water: number, seed, lengths and half widths in radii of the animal, slant, and
# largest opacity. They stand within some radii of the path.
_SHAFTS, _SHAFT_SEED, _SHAFT_HIGH, _SHAFT_WIDE = 14, 20107, (3.0, 6.0), (0.12, 0.45)
_SHAFT_SLANT, _SHAFT_OPACITY, _SHAFT_NEAR = 0.22, 0.13, 4.5
# Distance of the sky from the camera and height over which it turns blue, in distances between the
# camera and its focus. The floor fades away before the sky begins. Water brightens slowly from the
# bottom up, over a larger height that begins below the horizon.
_SKY, _SKY_HEIGHT = 18.0, 2.6
_DEEP, _BRIGHT = -1.5, 7.0
# Factor of both heights behind a wall.
_DIM = 1.7


def add_goal_light(stage: Stage, goals: Float[np.ndarray, "frames 3"]) -> Update:
    """Draw the goal: a glowing sphere, its halo, and its light on the floor and on the bodies.

    It flares when a body is near, so that viewers see that the animal arrives. Lights that were
    reached stay as faint spheres.
    """
    plotter, look, radius, goal = stage.plotter, stage.look, stage.radius, goals[0]
    shine = spot_texture(look.halo, look.glow, sharpness=3.0)
    pool = Spots(plotter, shine, stage.ground, _POOL_LIFT * radius, 1, _POOL)
    wide = 1.8 * radius * np.eye(2)[None]
    core = LAMP * radius
    sphere = pv.Sphere(radius=core, center=goal, theta_resolution=32, phi_resolution=24)
    ball, halos = plotter.add_mesh(sphere, color=look.light, lighting=False), []
    for size, strength, sharpness in ((1.6 * radius, look.glow, 3.6), (4.5 * core, 0.95, 2.4)):
        place = {"center": goal - 1.05 * core * stage.sight, "direction": -stage.sight}
        halo = pv.Plane(**place, i_size=size, j_size=size, i_resolution=1, j_resolution=1)
        texture = spot_texture(look.halo, strength, sharpness)
        halos.append(plotter.add_mesh(halo, texture=texture, lighting=False))
    for actor in (ball, *halos):
        actor.origin = tuple(goal)
    lamp = pv.Light(position=goal, color=look.halo, light_type="scene light")
    lamp.positional = True
    lamp.cone_angle = 90
    lamp.attenuation_values = (1.0, 0.0, (0.7 / radius) ** 2)
    plotter.add_light(lamp)
    reached = []
    for end in appearances(goals)[1:]:
        past = pv.Sphere(radius=core, center=goals[end - 1])
        faint = plotter.add_mesh(past, color=look.light, opacity=_REACHED, lighting=False)
        faint.origin = tuple(goals[end - 1])
        reached.append((end, faint))

    def face_viewer(shot: Shot) -> None:
        now = goals[shot.number]
        pool.lay(now[None, :2], wide)
        lamp.position = tuple(now)
        ahead = now - shot.eye
        distance = float(np.linalg.norm(ahead))
        far = max(distance / (_FAR * radius), 1.0)
        for end, faint in reached:
            faint.visibility, faint.scale = bool(shot.number >= end), far
        back = _BEHIND * radius / distance
        away = np.linalg.norm(shot.position - now, axis=-1).min(initial=np.inf)
        near = float(np.exp(-((away / (_NEAR * radius)) ** 2)))
        lamp.intensity = _INTENSITY * (1 + _FLARE * near)
        # It is larger, so that it looks as large as at its place.
        scale = far * (1 + back) * (1 + _SWELL * near)
        for actor in (ball, *halos):
            actor.position, actor.scale = tuple(now - goal + back * ahead), scale
            actor.orientation = (0.0, 0.0, float(np.degrees(shot.turned)))

    return face_viewer


def add_lane_lights(stage: Stage, goals: Float[np.ndarray, "frames n 3"]) -> Update:
    """Draw the lights of the other lanes of a race: small spheres, each with a halo."""
    plotter, look, core = stage.plotter, stage.look, LAMP * stage.radius
    sphere = cast(pv.PolyData, pv.Sphere(radius=core, theta_resolution=16, phi_resolution=12))
    ball, faces = np.asarray(sphere.points), sphere.regular_faces
    balls = _copies(ball, faces, goals[0])
    plotter.add_mesh(balls, color=look.light, lighting=False)
    side = _LANE_HALO * core
    square = cast(pv.PolyData, pv.Plane(direction=-stage.sight, i_size=side, j_size=side))
    own, faces = np.asarray(square.points), square.regular_faces
    mesh = _copies(own, faces, goals[0])
    around = np.asarray(square.active_texture_coordinates)
    mesh.active_texture_coordinates = np.tile(around, (goals.shape[1], 1))
    texture = spot_texture(look.halo, _LANE_GLOW, sharpness=3.0)
    shine = plotter.add_mesh(mesh, texture=texture, lighting=False)
    shine.ForceTranslucentOn()

    def face_viewer(shot: Shot) -> None:
        turned = (turned_about_vertical(axis, shot.turned) for axis in np.eye(3))
        now = goals[shot.number][:, None]
        balls.points = (now + ball).reshape(-1, 3)
        mesh.points = (now + own @ np.stack([*turned])).reshape(-1, 3)

    return face_viewer


def _copies(
    points: Float[np.ndarray, "n 3"], faces: np.ndarray, places: Float[np.ndarray, "m 3"]
) -> pv.PolyData:
    """Return one mesh of copies of a mesh about the origin."""
    first = len(points) * np.arange(len(places))[:, None, None]
    every = (places[:, None] + points).reshape(-1, 3)
    return pv.PolyData.from_regular_faces(every, (faces + first).reshape(-1, faces.shape[1]))


def add_trail(stage: Stage) -> Update:
    """Draw a fading thread along the path of the head.

    The whole thread is meshed once. Each frame only sets opacities.
    """
    scene, thickness = stage.scene, _TRAIL * stage.radius
    path, surface = scene.clip.position[:, head_index(scene.creature)], scene.surface
    if scene.stands:
        # The trail lies on the ground, or in the water if the animal swims.
        low = top = stage.ground.height(path[:, :2]) + stage.lift
        if surface is not None:
            top = np.maximum(low, surface + stage.lift)
        elif stage.look.particles and isinstance(stage.ground, Terrain):
            top = np.full(len(low), np.inf)
        path = np.column_stack([path[:, :2], np.clip(path[:, 2], low, top)])
    moved = np.linalg.norm(np.diff(path, axis=0), axis=1) > thickness / 10
    kept = np.flatnonzero(np.concatenate([[True], moved]))
    if len(kept) < 2:
        return lambda shot: None
    line = pv.lines_from_points(path[kept])
    line["frame"] = kept.astype(float)
    tube = cast(pv.PolyData, line.tube(radius=thickness, n_sides=6, capping=False))
    born = np.asarray(tube.point_data["frame"])
    color = pv.Color(stage.look.trail, opacity=0).int_rgba
    rgba = np.tile(color, (len(born), 1)).astype(np.uint8)
    add_faded(stage.plotter, tube, rgba, culling="back")
    fade = _TRAIL_FADE * scene.clip.rate

    def update(shot: Shot) -> None:
        age = shot.number - born
        rgba[:, 3] = 255 * np.where(age >= 0, 0.75 * np.exp(-age / fade), 0.0)
        tube.point_data["rgba"] = rgba

    return update


def add_particles(stage: Stage) -> None:
    """Draw specks that rest in the water, which make motion visible."""
    scene, path = stage.scene, stage.camera.focus
    if scene.goal is not None:
        path = np.concatenate([path, scene.goal])
    generator = np.random.default_rng(_PARTICLE_SEED)
    # From far away, the edges of a small cloud of specks would be seen.
    around = max(3 * stage.radius, 0.6 * stage.away) if stage.wide else 3 * stage.radius
    low, high = path.min(0) - around, path.max(0) + around
    high[2] = path[:, 2].max() + 0.4 * around
    if scene.surface is not None:
        high[2] = min(high[2], scene.surface)
    low[2] = min(np.min(stage.ground.z), high[2])
    points = generator.uniform(low, high, (_PARTICLES, 3))
    points = points[points[:, 2] > stage.ground.height(points[:, :2])]
    # Specks fade with distance as the floor does.
    far = np.linalg.norm(points[:, None] - path[:: max(len(path) // 20, 1)], axis=-1).min(1)
    points = points[far < stage.visible]
    for chosen, size, opacity in ((points[::4], 2.1, 0.5), (points[1::2], 1.3, 0.35)):
        if len(chosen):
            stage.plotter.add_mesh(
                pv.PolyData(chosen),
                color=_PARTICLE,
                opacity=opacity,
                point_size=size * stage.oversampling,
                lighting=False,
            )


def add_shafts(stage: Stage) -> None:
    """Draw shafts of light that fall into water from above. They face the first view."""
    radius, focus = stage.radius, stage.camera.focus
    generator = np.random.default_rng(_SHAFT_SEED)
    across, ahead = level_axes(stage.sight)
    along = generator.choice(len(focus), _SHAFTS)
    aside, away = generator.uniform(-_SHAFT_NEAR, _SHAFT_NEAR, (2, _SHAFTS)) * radius
    # None stands before the animal.
    foot = focus[along] + np.outer(aside, across) + np.outer(np.abs(away) + radius, ahead)
    foot[:, 2] = np.min(stage.ground.z)
    high = generator.uniform(*_SHAFT_HIGH, _SHAFTS) * radius + focus[along, 2] - foot[:, 2]
    wide = generator.uniform(*_SHAFT_WIDE, _SHAFTS)[:, None] * radius * across
    top = foot + high[:, None] * ([0.0, 0.0, 1.0] + _SHAFT_SLANT * across)
    if stage.scene.surface is not None:
        # They end at the surface.
        reach = np.maximum(stage.scene.surface - foot[:, 2], 0.0) / high
        top = foot + np.minimum(reach, 1.0)[:, None] * (top - foot)
    middle = foot + 0.6 * (top - foot)
    rows = ([row - wide, row, row + wide] for row in (foot, middle, top))
    points = np.stack([point for row in rows for point in row], 1)
    lower = np.array([[0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4]])
    triangles = np.concatenate([lower, lower + 3])
    faces = (triangles + 9 * np.arange(_SHAFTS)[:, None, None]).reshape(-1, 3)
    mesh = pv.PolyData.from_regular_faces(points.reshape(-1, 3), faces)
    rgba = np.tile(pv.Color(stage.look.zenith, opacity=0).int_rgba, (9 * _SHAFTS, 1))
    # They are bright in the middle, and fade to all ends.
    rgba[4::9, 3] = 255 * _SHAFT_OPACITY * generator.uniform(0.5, 1.0, _SHAFTS)
    add_faded(stage.plotter, mesh, rgba.astype(np.uint8))


def add_sky(stage: Stage) -> Update:
    """Set background, sky and sun.

    A backdrop behind the floor's far end costs 2 ms a frame. VTK's own gradient costs 18 ms.
    """
    plotter, look = stage.plotter, stage.look
    plotter.background_color = pv.Color(look.distance)
    sun = pv.Light(position=tuple(stage.sun), color=look.sun, light_type="scene light")
    sun.intensity = 0.85
    sun.positional = False
    plotter.add_light(sun)
    # Light from the viewer, so that the sides that face the viewer are not black.
    fill = pv.Light(color=look.fill, intensity=0.4, light_type="camera light")
    fill.positional = False
    plotter.add_light(fill)

    across, ahead = level_axes(stage.sight)
    blue, away, foot = np.linspace(0, 1, 12), stage.away, 0.0
    if stage.scene.wall is not None and not stage.scene.stands:
        # The narrow view shows the change around its middle, but not the brightest water.
        narrow, wide = (np.tan(np.radians(x / 2)) for x in (stage.camera.view_angle, VIEW_ANGLE))
        away *= _DIM * narrow / wide
        foot = _SKY * stage.away * stage.sight[2] / np.hypot(*stage.sight[:2])
    height = _SKY_HEIGHT * away * np.concatenate([blue, [10.0]])
    mix = np.append(1 - (1 - blue) ** 2, 1.0)[:, None]
    if look.under_water:
        height = away * np.concatenate([_DEEP + (_BRIGHT - _DEEP) * blue, [10 * _BRIGHT]])
        mix = np.append(blue**1.5, 1.0)[:, None]
    haze, zenith = (np.array(pv.Color(color).int_rgb) for color in (look.distance, look.zenith))
    middle = _SKY * stage.away * ahead + (foot + height)[:, None] * [0.0, 0.0, 1.0]
    side = 2 * _SKY * stage.away * across
    points = np.stack([middle - side, middle + side], 1)
    backdrop = pv.StructuredGrid(*(points[..., i, None] for i in range(3)))
    backdrop = backdrop.extract_surface(algorithm=None)
    # The first axis of a structured grid varies fastest.
    backdrop["rgb"] = np.tile(haze + mix * (zenith - haze), (2, 1)).astype(np.uint8)
    actor = plotter.add_mesh(
        backdrop, scalars="rgb", rgb=True, lighting=False, show_scalar_bar=False
    )

    def update(shot: Shot) -> None:
        actor.position = tuple(shot.eye)
        actor.orientation = (0.0, 0.0, float(np.degrees(shot.turned)))

    return update


# Widths of a line and of the start line, and side of a square of the finish, in radii of the
# animal. Rows of squares.
_LINE, _START, _SQUARE, _ROWS = 0.035, 0.08, 0.16, 2
# Opacities of lines and squares.
_OPACITY, _OPAQUE = 0.55, 0.9
# Colours of the squares.
_WHITE, _BLACK = "#ffffff", "#11161c"


def add_track(stage: Stage, track: Track) -> None:
    """Draw the lines. `evo_cpg.view.captions` writes their distances."""
    radius, color = stage.radius, stage.look.text
    # Near and far end, right and left side, m, colour and opacity of each rectangle.
    parts: list[tuple[float, float, float, float, str, float]] = []
    for number in range(track.lines + 1):
        half = (_LINE if number else _START) * radius / 2
        middle = number * track.spacing
        if middle != track.finish:
            sides = -track.right, track.left
            parts.append((middle - half, middle + half, *sides, color, _OPACITY))
    if track.finish is not None:
        count = max(round((track.right + track.left) / (_SQUARE * radius)), 1)
        side = (track.right + track.left) / count
        for row in range(_ROWS):
            for column in range(count):
                near, right = track.finish + row * side, column * side - track.right
                shade = (_WHITE, _BLACK)[(row + column) % 2]
                parts.append((near, near + side, right, right + side, shade, _OPAQUE))
    points, rgba = np.zeros((4 * len(parts), 3)), np.zeros((4 * len(parts), 4), np.uint8)
    for number, (near, far, right, left, shade, opacity) in enumerate(parts):
        corners = [(near, right), (far, right), (far, left), (near, left)]
        own = slice(4 * number, 4 * number + 4)
        points[own] = [track.at(*corner) for corner in corners]
        rgba[own] = pv.Color(shade, opacity=opacity).int_rgba
    points[:, 2] = stage.ground.height(points[:, :2]) + stage.lift
    quads = np.arange(len(points)).reshape(-1, 4)
    add_faded(stage.plotter, pv.PolyData.from_regular_faces(points, quads), rgba)
