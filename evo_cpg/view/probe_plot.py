"""Picture of an animal's paths in many situations, seen from above."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.markers import MarkerStyle
from matplotlib.patches import Circle
from matplotlib.transforms import Affine2D

from evo_cpg.training.probe import Probe, seen_from_start
from evo_cpg.view.figure import BLUE, GREEN, GREY, INK, ORANGE, RED, framed, new_figure

# Colours from lights on the right to lights on the left. All of them stand out on white.
_COLOURS = LinearSegmentedColormap.from_list("bearing", ["#5b2a86", BLUE, GREEN, ORANGE, RED])
# Longer side of the picture, and least length of each side, inches.
_LONG, _SHORT = 7.4, 5.6

# Offset of a label's centre from its light, across and up, points.
_LABEL = np.array([27.0, 19.0])


@framed
def probe_figure(probe: Probe, fraction: float, title: str) -> Figure:
    """Draw the animal's path in each situation, in the colour of its light.

    A filled star marks a reached light. A light counts as reached within the disc around it.

    Args:
        probe: results of the animal.
        fraction: fraction of the initial distance within which a light counts as reached.
        title: text above the picture.
    """
    bearings = np.array([seen_from_start(situation)[1] for situation in probe.situations])
    widest = max(float(np.abs(bearings).max()), 1e-9)
    colours = _COLOURS(0.5 + 0.5 * bearings / widest)
    reached = probe.reached(fraction)
    starts = np.array([situation.start_position for situation in probe.situations])
    lights = np.array([situation.light for situation in probe.situations], float)
    figure = new_figure(*_size(probe, lights), title)
    axes = figure.subplots()
    for i, colour in enumerate(colours):
        place, away = lights[i, :2], (lights - starts)[i, :2]
        near = Circle(tuple(place.tolist()), fraction * probe.start_distance[i], color=colour, lw=0)
        near.set_alpha(0.07)
        axes.add_patch(near)
        path = probe.paths[i][np.isfinite(probe.paths[i]).all(1)]
        axes.plot(*path[:, :2].T, color=colour, lw=1.5, zorder=3)
        end = path[-1:, :2].T
        axes.plot(*end, "o", color=colour, mec="white", mew=0.8, ms=7, zorder=5)
        face = colour if reached[i] else "white"
        axes.plot(*place, "*", mfc=face, mec=colour, mew=1.4, ms=17, zorder=4)
        axes.annotate(
            _bearing(bearings[i]),
            tuple(place.tolist()),
            tuple((_LABEL * away / max(float(np.linalg.norm(away)), 1e-9)).tolist()),
            textcoords="offset points",
            ha="center",
            va="center",
            fontsize=9,
        )
    _draw_starts(axes, probe)
    axes.set_aspect("equal", "datalim")
    axes.margins(0.07)
    axes.set_xlabel("x (m)")
    axes.set_ylabel("y (m)")
    axes.grid()
    figure.legend(handles=_legend(fraction), loc="outside lower center", ncols=2)
    return figure


def _size(probe: Probe, lights: np.ndarray) -> tuple[float, float]:
    """Return width and height of a picture that fits the lights and paths, inches."""
    places = np.concatenate([lights, probe.paths[np.isfinite(probe.paths).all(-1)]])
    extent = np.ptp(places[:, :2], axis=0) + 1e-9
    width, height = np.maximum(_LONG * extent / extent.max(), _SHORT)
    # The title and the legend need height.
    return float(width), float(height) + 1.0


def _bearing(angle: float) -> str:
    """Return an angle in degrees, with a sign unless it rounds to 0."""
    text = f"{np.rad2deg(angle):+.0f}".replace("-", "\N{MINUS SIGN}")
    return f"{text if text[1:] != '0' else '0'}\N{DEGREE SIGN}"


def _draw_starts(axes: Axes, probe: Probe) -> None:
    """Draw a wedge at every start, which points along the animal's heading."""
    for (x, y, _), heading in {s[:2] for s in probe.situations}:
        marker = MarkerStyle(">", transform=Affine2D().rotate(heading))
        axes.plot(x, y, marker=marker, color=INK, mec="white", mew=0.8, ms=12, zorder=6)


def _legend(fraction: float) -> list[Line2D]:
    def star(face: str, label: str) -> Line2D:
        return Line2D([], [], ls="", marker="*", mfc=face, mec=GREY, ms=13, label=label)

    return [
        Line2D([], [], ls="", marker=">", color=INK, ms=9, label="start"),
        Line2D([], [], ls="-", color=GREY, marker="o", ms=5, label="path and its end"),
        star(GREY, f"light reached: at most {fraction:.0%} of the distance left"),
        star("white", "light not reached"),
    ]
