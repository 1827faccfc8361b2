"""Lines on the floor of a race: the start, and distances in metres, the last one in squares."""

import numpy as np
import pyvista as pv

from evo_cpg.view.offscreen import add_faded
from evo_cpg.view.scene import Track
from evo_cpg.view.stage import Stage

# Widths of a line and of the start line, and side of a square of the finish, in radii of the
# animal. Rows of squares.
_LINE, _START, _SQUARE, _ROWS = 0.035, 0.08, 0.16, 2
# Opacities of lines and squares.
_OPACITY, _OPAQUE = 0.55, 0.9
# Colours of the squares.
_WHITE, _BLACK = "#ffffff", "#11161c"


def add_track(stage: Stage, track: Track) -> None:
    """Draw the lines. `evo_cpg.view.story_words` writes their distances."""
    radius, color = stage.radius, stage.look.text
    parts: list[tuple[np.ndarray, np.ndarray]] = []

    def fill(near: float, far: float, right: float, left: float, shade: str, part: float) -> None:
        corners = [(near, right), (far, right), (far, left), (near, left)]
        place = np.array([track.at(*corner) for corner in corners])
        parts.append((place, np.array(pv.Color(shade, opacity=part).int_rgba)))

    for number in range(track.lines + 1):
        half = (_LINE if number else _START) * radius / 2
        middle = number * track.spacing
        if middle != track.finish:
            fill(middle - half, middle + half, -track.right, track.left, color, _OPACITY)
    if track.finish is not None:
        count = max(round((track.right + track.left) / (_SQUARE * radius)), 1)
        side = (track.right + track.left) / count
        for row in range(_ROWS):
            for column in range(count):
                near, right = track.finish + row * side, column * side - track.right
                shade = (_WHITE, _BLACK)[(row + column) % 2]
                fill(near, near + side, right, right + side, shade, _OPAQUE)
    points = np.concatenate([place for place, _ in parts])
    rgba = np.concatenate([np.tile(shade, (4, 1)) for _, shade in parts]).astype(np.uint8)
    quads = np.arange(len(points)).reshape(-1, 4)
    _lay(stage, pv.PolyData.from_regular_faces(points, quads), rgba)


def _lay(stage: Stage, mesh: pv.PolyData, rgba: np.ndarray) -> None:
    """Draw a mesh on the ground."""
    place = np.asarray(mesh.points)[:, :2].astype(float)
    mesh.points = np.column_stack([place, stage.ground.height(place) + stage.lift])
    add_faded(stage.plotter, mesh, rgba)
