"""Ground that reaches to the horizon, its grid, and the distances painted on it.

A level floor writes no depth, so what lies in its plane does not flicker.
"""

from collections.abc import Callable
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
import pyvista as pv

from evo_cpg.view.camera import VIEW_ANGLE, turned_about_vertical
from evo_cpg.view.look import Look
from evo_cpg.view.offscreen import add_faded, write_depth
from evo_cpg.view.terrain import Terrain
from evo_cpg.view.textures import CELLS, floor_texture

# Numbers on the ground: height of a digit and distance from the way, in radii of the animal.
# They fade between these shares of the way from the focus to the camera, and from above already
# between these shares of the way down from the middle of the picture: captions are below.
_DIGIT, _BESIDE = 0.1, 0.45
_FADES, _FADES_DOWN = (0.33, 0.43), (0.57, 0.8)
# Brightness of level ground, change of it with the sine of the angle to the sun, and the darkest.
_LEVEL, _SLOPE, _DARKEST = 0.92, 0.9, 0.25
# Water takes the red out of what lies deep: what is left of red, green and blue, and the depth at
# which two thirds of it are gone, in radii of the animal.
_SUNKEN, _SUNKEN_DEPTH = (0.36, 0.87, 1.0), 0.6
# Wet ground is this much darker, up to this height above the water in radii of the animal.
_WET, _WET_HEIGHT = 0.78, 0.07

# Triangles are sorted anew when the camera has turned so far, rad.
_RESORT = np.radians(8.0)
# The horizon follows when the focus has moved by this share of the visibility: less changes no
# opacity by more than one of 255 levels, and to hand over all of them takes as long as to draw.
_FOLLOW = 0.004


@runtime_checkable
class Update(Protocol):
    """Brings what lies on the ground up to date."""

    def __call__(self, focus: np.ndarray, turned: float = 0.0) -> None:
        """Take the focus ``(3,)``, m, and how far the camera has turned, rad."""


class Marks(NamedTuple):
    """Where the pattern of the ground lies, along which the animal's way can be read.

    Attributes:
        origin: of the pattern and its numbers ``(2,)``, m.
        course: bearing of the numbers from the x axis, rad.
        spacing: distance between the numbers, m.
    """

    origin: np.ndarray
    course: float
    spacing: float

    def turn(self) -> np.ndarray:
        """Rotation from the pattern's axes to the world's ``(2, 2)``."""
        c, s = np.cos(self.course), np.sin(self.course)
        return np.array([[c, -s], [s, c]])


def grid_spacing(length: float) -> float:
    """Spacing of the floor's grid: 1, 2 or 5 times a power of ten, about half the length (m)."""
    power = 10.0 ** np.floor(np.log10(length / 2))
    return float(power * max(step for step in (1, 2, 5) if step * power <= length / 2 * 1.001))


def mark_spacing(length: float) -> float:
    """Distance between the numbers on the ground, about the length of the animal (m)."""
    return grid_spacing(2.4 * length)


def fading_disc(visible: float, first: float) -> tuple[pv.PolyData, np.ndarray, np.ndarray]:
    """Return a level disc that fades towards the horizon, places of its points, and its opacity.

    Args:
        visible: distance at which it has faded to a third, m.
        first: radius of its innermost ring, as a fraction of that.
    """
    reach = np.concatenate([[0.0], np.geomspace(first, 3.0, 28)]) * visible
    bearing = np.linspace(0, 2 * np.pi, 49)
    x, y = reach[:, None] * np.cos(bearing), reach[:, None] * np.sin(bearing)
    grid = pv.StructuredGrid(x[..., None], y[..., None], np.zeros_like(x)[..., None])
    disc = grid.extract_surface(algorithm=None)
    place = np.asarray(disc.points)[:, :2].astype(float)
    return disc, place, np.exp(-((place**2).sum(1) / visible**2))


def add_floor(
    plotter: pv.Plotter,
    look: Look,
    height: float,
    radius: float,
    spacing: float,
    marks: Marks | None = None,
) -> Update:
    """A floor that reaches to the horizon.

    It is a disc that travels below the focus, while its texture stays where it is in the world.

    Args:
        plotter: draws it.
        look: of the world.
        height: z of the floor, m.
        radius: of the animal, m.
        spacing: of the grid, m.
        marks: lie on the ground, with a strong line at each number; None where there are none.

    Returns:
        A function of the focus ``(3,)``, m; see `Update`.
    """
    disc, place, fade = fading_disc(look.visibility * radius, 0.2)
    rgba = np.column_stack([np.full((len(place), 3), 255), 255 * fade]).astype(np.uint8)
    disc.active_texture_coordinates = place / (CELLS * spacing)
    texture = floor_texture(look.floor, look.grid, look.checkered, marks is not None)
    actor = add_faded(plotter, disc, rgba, texture=texture)
    origin, turn = (marks.origin, marks.turn()) if marks else (np.zeros(2), np.eye(2))

    def update(focus: np.ndarray, turned: float = 0.0) -> None:
        del turned
        actor.position = (focus[0], focus[1], height)
        world = place + focus[:2] - origin
        disc.active_texture_coordinates = world @ turn / (CELLS * spacing)

    return update


def add_relief(
    plotter: pv.Plotter,
    look: Look,
    terrain: Terrain,
    radius: float,
    spacing: float,
    marks: Marks,
    sight: np.ndarray,
    sun: np.ndarray,
    surface: float | None = None,
) -> Update:
    """Draw ground with relief, lit by the sun, with the grid on it.

    It is drawn as translucent, so that it fades towards the horizon, but writes its depth, so that
    hills hide what is behind them. Its triangles are sorted from front to back for that.

    Args:
        plotter: draws it.
        look: of the world.
        terrain: its mesh.
        radius: of the animal, m.
        spacing: of the grid, m.
        marks: where the grid lies.
        sight: the camera's direction of view in the first frame ``(3,)``.
        sun: unit vector towards the sun ``(3,)``.
        surface: of the water, m; None where there is none.

    Returns:
        A function of the focus ``(3,)``, m; see `Update`.
    """
    points, triangles = terrain.points(), terrain.triangles()
    middle = points[triangles].mean(1)

    def sorted_for(turned: float) -> np.ndarray:
        return triangles[np.argsort(middle @ turned_about_vertical(sight, turned))]

    mesh, sorted_at = pv.PolyData.from_regular_faces(points, sorted_for(0.0)), 0.0
    shade = np.clip(_LEVEL + _SLOPE * (terrain.normals() @ sun - sun[2]), _DARKEST, 1.0)
    tint = np.repeat(shade[:, None], 3, 1)
    if surface is not None:
        depth = (surface - points[:, 2]) / radius
        wet = np.interp(-depth, (0.0, _WET_HEIGHT), (_WET, 1.0))
        sunken = 1 - np.exp(-np.maximum(depth, 0.0) / _SUNKEN_DEPTH)
        tint *= wet[:, None] * (1 + sunken[:, None] * (np.array(_SUNKEN) - 1))
    rgba = np.column_stack([255 * tint, np.full(len(points), 255)]).astype(np.uint8)
    turned = (points[:, :2] - marks.origin) @ marks.turn()
    mesh.active_texture_coordinates = turned / (CELLS * spacing)
    texture = floor_texture(look.floor, look.grid, look.checkered, marked=True)
    write_depth(add_faded(plotter, mesh, rgba, texture=texture))
    visible, faded_at = look.visibility * radius, np.full(2, np.inf)

    def update(focus: np.ndarray, turned: float = 0.0) -> None:
        nonlocal sorted_at, faded_at
        if abs(turned - sorted_at) > _RESORT:
            mesh.regular_faces, sorted_at = sorted_for(turned), turned
        if np.linalg.norm(focus[:2] - faded_at) < _FOLLOW * visible:
            return
        faded_at = focus[:2].copy()
        away = ((points[:, :2] - focus[:2]) ** 2).sum(1)
        rgba[:, 3] = 255 * np.exp(-away / visible**2)
        mesh["rgba"] = rgba

    return update


def add_numbers(
    plotter: pv.Plotter,
    look: Look,
    marks: Marks,
    path: np.ndarray,
    height: Callable[[np.ndarray], np.ndarray],
    radius: float,
    sight: np.ndarray,
    away: float,
) -> Update:
    """Distances from the start, painted on the ground on the viewer's side of the way.

    Args:
        plotter: draws them.
        look: of the world.
        marks: where they lie.
        path: of the animal ``(frames, 3)``, m.
        height: of the ground, m, a function of x and y ``(n, 2)``; NaN where no number may stand.
        radius: of the animal, m.
        sight: the camera's direction of view in the first frame ``(3,)``, from which they are read.
        away: distance of the camera from its focus, m.

    Returns:
        A function of the focus ``(3,)``, m; see `Update`.
    """
    along = (path[:, :2] - marks.origin) @ marks.turn()
    ahead = sight[:2] / np.hypot(*sight[:2])
    across = np.array([ahead[1], -ahead[0]])
    # Beside the way, where the animal does not tread on them even if it sways.
    nearer = -np.sign(ahead @ marks.turn()[:, 1]) or -1.0
    side = nearer * (nearer * along[:, 1]).max() + nearer * _BESIDE * radius
    last = int(np.ceil((along[:, 0].max() + 2 * radius) / marks.spacing))
    first = int(np.floor(min(along[:, 0].min(), 0.0) / marks.spacing))
    fades = np.minimum(_FADES, [_nearer(-sight[2], down) for down in _FADES_DOWN])
    size = _DIGIT * radius
    # Lying flat they look as low as the sight is slanting.
    stretch = 0.7 / max(-sight[2] / np.linalg.norm(sight), 0.15)
    digits = []
    for count in range(first, last + 1):
        digit = pv.Text3D(f"{count * marks.spacing:g} m", depth=0.0, height=size, center=(0, 0, 0))
        flat = np.asarray(digit.points)[:, :2] * [1.0, stretch]
        middle = marks.origin + marks.turn() @ [count * marks.spacing, side]
        # To the right of its line.
        flat[:, 0] += 0.7 * size - flat[:, 0].min()
        place = middle + flat @ np.stack([across, ahead])
        high = height(place)
        digit.points = np.column_stack([place, high])
        if np.isfinite(high).all():
            digits.append(digit)
    if not digits:
        return lambda focus, turned=0.0: None
    mesh = pv.merge(digits).extract_surface(algorithm=None)
    place = np.asarray(mesh.points)[:, :2].copy()
    rgba = np.tile(pv.Color(look.text).int_rgba, (len(place), 1)).astype(np.uint8)
    add_faded(plotter, mesh, rgba)

    def update(focus: np.ndarray, turned: float = 0.0) -> None:
        offset = place - focus[:2]
        seen = turned_about_vertical(sight, turned)
        now_ahead = seen[:2] / np.hypot(*seen[:2])
        gone = np.linalg.norm(offset, axis=1) / (0.4 * look.visibility * radius)
        near = np.interp(-(offset @ now_ahead) / away, fades, (1.0, 0.0))
        rgba[:, 3] = 200 * near * np.exp(-(gone**2))
        mesh["rgba"] = rgba

    return update


def _nearer(steep: float, down: float) -> float:
    """How much nearer than the focus the level ground is that is seen lower in the picture.

    Args:
        steep: sine of the camera's elevation above the focus.
        down: from the middle of the picture, 0, to its lower edge, 1.

    Returns:
        Level distance, in distances of the camera from the focus.
    """
    below = np.arcsin(steep) + np.arctan(down * np.tan(np.radians(VIEW_ANGLE / 2)))
    return float(np.sqrt(1 - steep**2) - steep / np.tan(below))
