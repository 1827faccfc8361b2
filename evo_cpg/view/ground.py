"""Ground that reaches to the horizon, its grid, and the distances painted on it.

A level floor writes no depth, so things in its plane do not flicker.
"""

import numpy as np
import pyvista as pv
from jaxtyping import Float

from evo_cpg.view.camera import VIEW_ANGLE, CameraPath, level_axes, project, turned_about_vertical
from evo_cpg.view.offscreen import add_faded, floor_texture, write_depth
from evo_cpg.view.stage import Shot, Stage, Update
from evo_cpg.view.terrain import Terrain

# Numbers on the ground: height of a digit and distance from the path, in radii of the animal. They
# fade between two fractions of the height from the picture's middle to its lower edge, because
# captions are there.
_DIGIT, _BESIDE = 0.1, 0.45
_FADES_DOWN = (0.45, 0.62)
# Brightness of level ground, its change with the sine of the angle to the sun, and the minimum.
_LEVEL, _SLOPE, _DARKEST = 0.92, 0.9, 0.25
# Water absorbs red light. Remaining fractions of red, green and blue in deep water, and the depth
# at which two thirds of the loss is reached, in radii of the animal.
_SUNKEN, _SUNKEN_DEPTH = (0.36, 0.87, 1.0), 0.6
# Brightness of wet ground, and its height above the water in radii of the animal.
_WET, _WET_HEIGHT = 0.78, 0.07

# Turn of the camera after which triangles are sorted again, rad.
_RESORT = np.radians(8.0)
# The horizon follows when the focus has moved by this fraction of the visibility. A smaller move
# changes no opacity by more than one of 255 levels, and an update takes as long as drawing.
_FOLLOW = 0.004


def fading_disc(visible: float, first: float) -> tuple[pv.PolyData, np.ndarray, np.ndarray]:
    """Return a level disc that fades towards the horizon.

    Args:
        visible: distance at which the opacity has fallen to about a third (1/e), m.
        first: radius of the innermost ring, as a fraction of ``visible``.

    Returns:
        The disc, the coordinates x and y of its points ``(n, 2)`` from its centre (m), and the
        opacity at each point, from 0 to 1.
    """
    reach = np.concatenate([[0.0], np.geomspace(first, 3.0, 28)]) * visible
    bearing = np.linspace(0, 2 * np.pi, 49)
    x, y = reach[:, None] * np.cos(bearing), reach[:, None] * np.sin(bearing)
    grid = pv.StructuredGrid(x[..., None], y[..., None], np.zeros_like(x)[..., None])
    disc = grid.extract_surface(algorithm=None)
    place = np.asarray(disc.points)[:, :2].astype(float)
    return disc, place, np.exp(-((place**2).sum(1) / visible**2))


def add_ground(stage: Stage) -> Update:
    """Draw the ground with its pattern, up to the horizon."""
    look, marks = stage.look, stage.scene.marks
    # On ground with relief, a net of strong lines makes slopes visible. On a level floor, strong
    # lines mark the places of the painted distances (`add_numbers`).
    marked = stage.measured or isinstance(stage.ground, Terrain)
    texture = floor_texture(look.floor, look.grid, look.checkered, marked)
    if isinstance(stage.ground, Terrain):
        return _add_relief(stage, stage.ground, texture)
    height = stage.ground.z
    disc, place, fade = fading_disc(stage.visible, 0.2)
    rgba = np.column_stack([np.full((len(place), 3), 255), 255 * fade]).astype(np.uint8)
    disc.active_texture_coordinates = marks.tiles(place)
    actor = add_faded(stage.plotter, disc, rgba, texture=texture)

    def update(shot: Shot) -> None:
        # The disc moves with the focus, while its texture stays fixed in the world.
        actor.position = (shot.focus[0], shot.focus[1], height)
        disc.active_texture_coordinates = marks.tiles(place + shot.focus[:2])

    return update


def _add_relief(stage: Stage, terrain: Terrain, texture: pv.Texture) -> Update:
    """Draw ground with relief, lit by the sun.

    The ground is translucent, so that it fades towards the horizon. It writes its depth, so that
    hills hide things behind them. For this its triangles are sorted from front to back.
    """
    points, triangles, surface = terrain.points(), terrain.triangles(), stage.scene.surface
    middle, sorted_at = points[triangles].mean(1), 0.0
    order = np.argsort(middle @ turned_about_vertical(stage.sight, sorted_at))
    mesh = pv.PolyData.from_regular_faces(points, triangles[order])
    shade = np.clip(_LEVEL + _SLOPE * (terrain.normals() @ stage.sun - stage.sun[2]), _DARKEST, 1.0)
    tint = np.repeat(shade[:, None], 3, 1)
    if surface is not None:
        depth = (surface - points[:, 2]) / stage.radius
        wet = np.interp(-depth, (0.0, _WET_HEIGHT), (_WET, 1.0))
        sunken = 1 - np.exp(-np.maximum(depth, 0.0) / _SUNKEN_DEPTH)
        tint *= wet[:, None] * (1 + sunken[:, None] * (np.array(_SUNKEN) - 1))
    rgba = np.column_stack([255 * tint, np.full(len(points), 255)]).astype(np.uint8)
    mesh.active_texture_coordinates = stage.scene.marks.tiles(points[:, :2])
    write_depth(add_faded(stage.plotter, mesh, rgba, texture=texture))
    faded_at = np.full(2, np.inf)

    def update(shot: Shot) -> None:
        nonlocal sorted_at, faded_at
        focus = shot.focus[:2]
        if abs(shot.turned - sorted_at) > _RESORT:
            sorted_at = shot.turned
            order = np.argsort(middle @ turned_about_vertical(stage.sight, sorted_at))
            mesh.regular_faces = triangles[order]
        if np.linalg.norm(focus - faded_at) < _FOLLOW * stage.visible:
            return
        faded_at = focus.copy()
        away = ((points[:, :2] - focus) ** 2).sum(1)
        rgba[:, 3] = 255 * np.exp(-away / stage.visible**2)
        mesh["rgba"] = rgba

    return update


def add_numbers(stage: Stage) -> Update:
    """Paint distances from the start on the ground, on the viewer's side of the path."""
    marks, radius, sight = stage.scene.marks, stage.radius, stage.sight
    along = (stage.scene.clip.position.mean(1)[:, :2] - marks.origin) @ marks.turn()
    across, ahead = (axis[:2] for axis in level_axes(sight))
    # The numbers stand off the path, so that a swaying animal does not step on them.
    nearer = -np.sign(ahead @ marks.turn()[:, 1]) or -1.0
    side = nearer * (nearer * along[:, 1]).max() + nearer * _BESIDE * radius
    last = int(np.ceil((along[:, 0].max() + 2 * radius) / marks.spacing))
    first = int(np.floor(min(along[:, 0].min(), 0.0) / marks.spacing))
    size = _DIGIT * radius
    # Digits that lie flat look lower, the more slanted the sight is.
    stretch = 0.7 / max(-sight[2], 0.15)
    glyphs, flat, middle = [], [], []
    for count in range(first, last + 1):
        glyph = pv.Text3D(f"{count * marks.spacing:g} m", depth=0.0, height=size, center=(0, 0, 0))
        own = np.asarray(glyph.points)[:, :2] * [1.0, stretch]
        # The number stands to the right of its line.
        own[:, 0] += 0.7 * size - own[:, 0].min()
        place = marks.origin + marks.turn() @ [count * marks.spacing, side]
        # No number stands in the water.
        high = stage.ground.height(place + own @ np.stack([across, ahead])) + stage.lift
        if stage.scene.surface is None or (high > stage.scene.surface).all():
            glyphs.append(glyph)
            flat.append(own)
            middle.append(np.broadcast_to(place, own.shape))
    if not glyphs:
        return lambda shot: None
    mesh = glyphs[0].append_polydata(*glyphs[1:])
    # Points in the plane of their number, and the place of the number that each belongs to.
    lying, middles = np.concatenate(flat), np.concatenate(middle)
    rgba = np.tile(pv.Color(stage.look.text).int_rgba, (mesh.n_points, 1)).astype(np.uint8)
    ground, turned = stage.ground, 0.0

    def points(turned: float) -> Float[np.ndarray, "n 3"]:
        right, ahead = level_axes(turned_about_vertical(sight, turned))
        place = middles + lying @ np.stack([right[:2], ahead[:2]])
        return np.column_stack([place, ground.height(place) + stage.lift])

    mesh.points = points(0.0)
    add_faded(stage.plotter, mesh, rgba)

    def update(shot: Shot) -> None:
        nonlocal turned
        # The numbers turn with a circling camera, so that they can be read all around.
        if shot.turned != turned:
            turned = shot.turned
            mesh.points = points(turned)
        place = np.asarray(mesh.points, float)
        away = np.linalg.norm(place[:, :2] - shot.focus[:2], axis=1)
        path = CameraPath(shot.eye[None], shot.focus[None], VIEW_ANGLE)
        down = -project(path, place[None], 1.0)[0, :, 1]
        shown = np.interp(np.nan_to_num(down, nan=1.0), _FADES_DOWN, (1.0, 0.0))
        rgba[:, 3] = 200 * shown * np.exp(-((away / (0.4 * stage.visible)) ** 2))
        mesh["rgba"] = rgba

    return update
