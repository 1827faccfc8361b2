"""Strip under a film: the joints' angles, the controller's signals, and the feet on the ground.

The strip shows a page of some seconds, over which a cursor moves. Then the next page follows. Each
page is drawn once.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from evo_cpg.analysis.feet import stances, touch_downs
from evo_cpg.analysis.gait import bending_axis
from evo_cpg.creature.axis_kinds import body_and_axis
from evo_cpg.simulation.recording import Recording
from evo_cpg.view.figure import draw_stances, framed
from evo_cpg.view.legible import legible
from evo_cpg.view.look import Look

# Fraction of a picture's height, least height in pixels, and the smallest picture with room for a
# strip.
FRACTION, LOWEST, SMALLEST = 0.3, 44, (160, 110)
# Least sizes in pixels: a letter, a row of a joint and a row of a foot.
_LETTER, _ROW, _FOOT = 9.0, 16.0, 11.0
# Width of a letter, relative to its height.
_WIDTH = 0.58
# Height of letters relative to the strip's height, if that is more than the least size.
_LETTERS = 0.062
# Time on a page for every hundred pixels of width, and longest time on a page, s.
_PACE, _LONGEST = 0.75, 8.0
# Joints that swing by less than this fraction of the largest swing are not shown.
_STILL = 0.05
# A curve fills its row at the value that it does not exceed in this fraction of the time.
_TYPICAL = 0.99
# Feet with fewer than this fraction of the busiest foot's steps are left out.
_SELDOM = 0.2
# Colours of angle, signal and feet in a dark look and in a bright one.
_DARK, _BRIGHT = ("#8fe3ff", "#ffb454", "#8fe3a8"), ("#0067a8", "#c2410c", "#2f7d4f")


class Signals(NamedTuple):
    """Signals that a strip under a film shows.

    Attributes:
        names: names of the joints' axes.
        angle: angle about each axis, rad, or displacement along it, m.
        slides: whether each axis slides.
        signal: controller's signal for each axis.
        word: name of the controller's signal.
        time: time of the samples, s.
        feet: names of the bodies that touch the ground. Empty without ground.
        touched: whether each foot touches the ground.
        highest: angle, rad, signal, and displacement, m, at which curves fill their rows.
    """

    names: tuple[str, ...]
    angle: Float[np.ndarray, "t d"]
    slides: Bool[np.ndarray, " d"]
    signal: Float[np.ndarray, "t d"]
    word: str
    time: Float[np.ndarray, " t"]
    feet: tuple[str, ...]
    touched: Bool[np.ndarray, "t f"]
    highest: tuple[float, float, float]


def signals_of(
    recording: Recording,
    word: str,
    same_unit: bool = False,
    feet: tuple[str, ...] = (),
    touched: Bool[np.ndarray, "t f"] | None = None,
) -> Signals:
    """Return the signals of a recording, with one axis of every joint.

    The axis is y or z, about which the animal bends. A joint without this axis is shown with the
    axis about which it turns most, or along which it slides most if no axis turns.

    Args:
        recording: the motion.
        word: name of the controller's signal.
        same_unit: whether the signal is also an angle, to be drawn on the same scale.
        feet: names of the bodies that touch the ground.
        touched: whether each foot touches the ground at the recording's times, or None without
            ground.
    """
    swing, slides = recording.joint_angle.std(0), recording.slides
    bending = bending_axis(recording) if recording.dof_names else ""
    joints: dict[str, int] = {}
    for i, name in enumerate(recording.dof_names):
        body, axis = body_and_axis(name)
        best = joints.setdefault(body, i)
        bends = recording.dof_names[best] == f"{body}.{bending}"
        more = (not slides[i], swing[i]) > (not slides[best], swing[best])
        if axis == bending or (not bends and more):
            joints[body] = i
    shown = np.array([*joints.values()], int)
    most = {kind: swing[shown[slides[shown] == kind]].max(initial=0.0) for kind in (False, True)}
    chosen = [i for i in shown if swing[i] >= _STILL * most[bool(slides[i])]]
    names = tuple(recording.dof_names[i] for i in chosen)
    angle, signal = recording.joint_angle[:, chosen], recording.cpg_output[:, chosen]
    touched = np.zeros((len(recording.time), 0), bool) if touched is None else touched
    tallest, loudest = _highest(angle[:, ~slides[chosen]]), _highest(signal)
    if same_unit:
        tallest = loudest = max(tallest, loudest)
    highest = tallest, loudest, _highest(angle[:, slides[chosen]])
    return Signals(
        names, angle, slides[chosen], signal, word, recording.time, feet, touched, highest
    )


class Strip:
    """The strip of a film.

    Args:
        signals: contents of the strip.
        look: look of the world, for the colours.
        size: width and height, pixels of the film.
        scale: pixels drawn per pixel of the film.

    Attributes:
        height: height of the drawn strip, pixels.
    """

    def __init__(self, signals: Signals, look: Look, size: tuple[int, int], scale: float):
        self._look, self._scale = look, scale
        self._size = round(size[0] * scale), round(size[1] * scale)
        self.height = self._size[1]
        self._letter = scale * max(_LETTER, _LETTERS * size[1])
        height = size[1] - 2.6 * self._letter / scale
        room = height / max(1.0, self._letter / scale / _LETTER)
        steps = [len(touch_downs(foot, 1.0)) for foot in signals.touched.T]
        # A foot that hardly ever touches down would leave its row empty.
        often = [i for i, count in enumerate(steps) if count >= _SELDOM * max(steps)]
        most = max(int(0.45 * room / _FOOT), 1)
        feet = sorted(sorted(often, key=lambda i: -steps[i])[:most])
        # Choose every second or third joint, so that they lie evenly along the body.
        left = max(int((room - len(feet) * _FOOT) / _ROW), 1)
        every = max(-(-len(signals.names) // left), 1)
        self._signals = signals._replace(
            names=signals.names[::every],
            angle=signals.angle[:, ::every],
            slides=signals.slides[::every],
            signal=signals.signal[:, ::every],
            feet=tuple(signals.feet[i] for i in feet),
            touched=signals.touched[:, feet],
        )
        first, last = float(signals.time[0]), float(signals.time[-1])
        self._length = max(min(_PACE * size[0] / 100, _LONGEST, last - first), 1e-3)
        # The length of a page divides the time evenly, so that the last page is not almost empty.
        self._pages = max(round((last - first) / self._length), 1)
        self._length = (last - first) / self._pages or self._length
        self._ink = np.uint8(255 * np.array(to_rgb(look.text)))
        self._drawn, self._picture, self._box = -1, np.zeros(0), (0, 0, 0, 0)

    def at(self, time: float) -> np.ndarray:
        """Draw the strip at a time, s: ``(height, width, 3)`` bytes, bottom row first."""
        first = float(self._signals.time[0])
        page = int(np.clip((time - first) / self._length, 0, self._pages - 1))
        if page != self._drawn:
            self._picture, self._box = self._page(first + page * self._length)
            self._drawn = page
        picture = self._picture.copy()
        left, right, bottom, top = self._box
        fraction = (time - first - page * self._length) / self._length
        place = left + round(min(max(fraction, 0.0), 1.0) * (right - left))
        half = max(round(0.75 * self._scale), 1)
        picture[bottom:top, max(place - half, 0) : place + half] = self._ink
        return picture

    @framed
    def _page(self, start: float) -> tuple[np.ndarray, tuple[int, int, int, int]]:
        """Draw a page. Return its picture, and the left, right, lower and upper axes edges."""
        signals, look, (width, height) = self._signals, self._look, self._size
        figure = Figure(figsize=(width / 100, height / 100), dpi=100, facecolor=look.distance)
        canvas = FigureCanvasAgg(figure)
        names = [legible(name) for name in (*signals.names, *signals.feet)]
        letter, longest = self._letter, max(map(len, names), default=0)
        left = round(min(0.62 * letter * longest + 1.4 * letter, 0.3 * width))
        right, bottom, top = round(width - 1.2 * letter), round(1.45 * letter), round(1.35 * letter)
        box = left / width, bottom / height, (right - left) / width, 1 - (bottom + top) / height
        axes = figure.add_axes(box)
        axes.set_facecolor("none")
        axes.spines[:].set_visible(False)
        end = start + self._length
        axes.set_xlim(start, end)
        axes.set_yticks(self._curves(axes, start, end), names)
        points = letter * 72 / 100
        axes.tick_params(length=0, pad=0.25 * points, labelsize=points, labelcolor=look.text)
        axes.grid(axis="x", color=look.text, alpha=0.16, lw=0.5 * self._scale)
        axes.xaxis.set_major_formatter(lambda value, place: f"{value:g} s")
        # A legend of the lines and bars stands in a line above them.
        colours = _DARK if look.under_water else _BRIGHT
        angle, _, displacement = signals.highest
        words: list[tuple[str, str]] = []
        if signals.names:
            ranges = [f"joint angle, up to {np.degrees(angle):.0f} deg"]
            if signals.slides.any():
                slid = f"displacement, up to {displacement:.2g} m"
                ranges = [slid] if signals.slides.all() else [*ranges, slid]
            words = [(", ".join(ranges), colours[0])]
            if np.abs(signals.signal).max(initial=0.0) > 0:
                words.append((f"- - {signals.word}", colours[1]))
        if signals.feet:
            words.append(("foot on the ground", colours[2]))
        # Shrink the text if it would run out of the picture.
        place, above, per_letter = left / width, (height - 0.2 * letter) / height, letter / width
        needed = sum(_WIDTH * len(word) + 2 for word, _ in words) * per_letter
        smaller = min(1.0, (1.0 - place) / max(needed, 1e-9))
        size = points * smaller
        for word, colour in words:
            figure.text(place, above, legible(word), color=colour, va="top", fontsize=size)
            place += (_WIDTH * len(word) + 2) * per_letter * smaller
        canvas.draw()
        picture = np.asarray(canvas.buffer_rgba())[::-1, :, :3].copy()
        return picture, (left, right, bottom, height - top)

    def _curves(self, axes: Axes, start: float, end: float) -> list[float]:
        """Draw rows of joints, then of feet, from the top down, and return the rows' middles."""
        signals = self._signals
        inside = (signals.time >= start) & (signals.time <= end)
        time = signals.time[inside]
        colours = _DARK if self._look.under_water else _BRIGHT
        tallest, loudest, farthest = signals.highest
        scales = np.where(signals.slides, farthest, tallest)
        places: list[float] = []
        for i in range(len(signals.names)):
            middle = i + 0.5
            places.append(middle)
            axes.axhline(middle, color=self._look.text, alpha=0.12, lw=0.5 * self._scale)
            shown = (
                (signals.signal[inside, i] / loudest, colours[1], 0.9, (0, (3.5, 1.5))),
                (signals.angle[inside, i] / scales[i], colours[0], 1.5, "solid"),
            )
            for values, colour, wide, style in shown:
                curve = middle - 0.46 * np.clip(values, -1.0, 1.0)
                axes.plot(time, curve, color=colour, lw=0.72 * wide * self._scale, ls=style)
        high = _FOOT / _ROW
        step = float(np.median(np.diff(signals.time))) if len(signals.time) > 1 else 1.0
        for i, touched in enumerate(signals.touched.T):
            middle = len(signals.names) + (i + 0.5) * high
            places.append(middle)
            begins = signals.time[0] + stances(touched, step)
            draw_stances(axes, begins, (start, end), middle, 0.64 * high, colours[2])
        axes.set_ylim(len(signals.names) + len(signals.feet) * high, 0.0)
        return places


def _highest(values: Float[np.ndarray, "t d"]) -> float:
    """Return the bound that 99 % of the absolute values do not exceed, at least 0.001."""
    return max(float(np.quantile(np.abs(values), _TYPICAL)), 1e-3) if values.size else 1.0
