"""Sections on the animal's movement: gait, signals, effort, and all measured numbers."""

import itertools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from evo_cpg.analysis.gait_numbers import GaitNumbers, Quantity
from evo_cpg.simulation.recording import Recording
from evo_cpg.view.page import charts
from evo_cpg.view.page.html import Html, join, long_table, table, tag
from evo_cpg.view.page.subject import Motion, Subject
from evo_cpg.view.page.words import number
from evo_cpg.view.plots import joint_signals_figure, path_figure

# Shortest and longest time on charts of signals and footfalls, s, and number of strides.
_LEAST_SHOWN, _MOST_SHOWN, _STRIDES_SHOWN = 2.0, 8.0, 6.0
# Number of points with which the path is drawn.
_PLACES = 400


def gait(motion: Motion) -> Html:
    """Show footfalls, the wave along the body, and the path."""
    numbers, recording = motion.numbers, motion.recording
    window = _window(recording, numbers.frequency)
    parts: list[Any] = []
    feet, wave = numbers.feet, numbers.wave
    if feet is not None and feet.names:
        parts += [
            tag("h3", "Footfalls"),
            charts.chart(
                charts.footfall_figure(feet, numbers.step, window),
                "When what touches the ground: a bar is a stance. Click into a chart, and the "
                "animal goes to that instant.",
                timed=True,
            ),
            _feet_table(numbers),
        ]
    elif feet is not None:
        parts.append(tag("p", "Nothing but its root ever touches the ground."))
    if wave is not None:
        chain = list(numbers.chain)
        names = [recording.dof_names[i].rpartition(".")[0] for i in chain]
        bending = np.asarray(recording.joint_angle)[:, chain] * numbers.axis_signs[chain]
        parts += [
            tag("h3", "The wave along the body"),
            charts.chart(
                charts.wave_figure(bending, numbers.step, window, names),
                f"Bending of each joint about {recording.dof_names[chain[0]].rpartition('.')[2]} "
                "over time, the front above. A wave that runs to the tail slants to the lower "
                "right; one that stands is upright.",
                timed=True,
            ),
        ]
        if math.isfinite(wave.count):
            parts.append(
                charts.chart(
                    charts.lag_figure(wave, motion.chain_places),
                    f"Phase and amplitude at {numbers.frequency:.3g} Hz. A straight line is a wave "
                    f"of one speed; here {100 * wave.straightness:.0f} % of the phases' variance "
                    "is that of a line.",
                )
            )
    places = max(1, len(recording.time) // _PLACES)
    parts += [
        tag("h3", "Its path"),
        charts.chart(
            path_figure(_every(recording, places)), "From above, and the distance over time."
        ),
    ]
    return join(*parts)


def signals(subject: Subject, motion: Motion) -> Html | None:
    """Show joint angles, the controller's signals, and phase lags, or None without joints."""
    recording, numbers = motion.recording, motion.numbers
    if not recording.dof_names:
        return None
    window = _window(recording, numbers.frequency)
    figure = joint_signals_figure(
        recording,
        window=window,
        chains=subject.chains,
        signs=numbers.axis_signs,
        signal=subject.signal,
    )
    parts: list[Any] = [
        charts.chart(
            figure,
            "Angle of every joint about the axis that bends most, and what drives it. Thin lines "
            "join crests of neighbours, or a crest and a trough where their axes point against "
            "each other: their slope is the phase lag.",
            timed=True,
        )
    ]
    names, lags = recording.dof_names, numbers.lags
    rows = [
        [names[i], names[j], number(round(float(lags.lag[i, j]))), number(lags.coherence[i, j])]
        for row in subject.chains
        for i, j in itertools.pairwise(row)
        if math.isfinite(lags.lag[i, j])
    ]
    if rows:
        words = (
            f"By how much a joint is behind the one before it at {numbers.frequency:.3g} Hz, from "
            "the cross-spectrum of their angles (Welch 1967), both about the direction of the axis "
            "of the first in the row; coherence: 1 where the lag is always the same, 0 where it is "
            "anything."
        )
        made = long_table(["joint", "next", "lag (deg)", "coherence"], rows, numbers=(2, 3))
        parts += [tag("h3", "Phase lags"), made, tag("p", words, class_="note")]
    elif not numbers.frequency > 0:
        words = (
            "Over the second half of the trial the joints do not repeat themselves, so there are "
            "no phase lags; a frequency above is that of the part that the chart shows."
        )
        parts.append(tag("p", words))
    return join(*parts)


def effort(motion: Motion) -> Html:
    """Show power, speed and torques."""
    recording, numbers, clip = motion.recording, motion.numbers, motion.clip
    figure = charts.effort_figure(recording.time, numbers.power, clip.time, clip.speed)
    ranges = np.degrees(np.ptp(recording.joint_angle, axis=0) / 2)
    columns = np.transpose([numbers.peak_torque, numbers.rms_torque, ranges])
    rows = [
        [recording.dof_names[i], *map(number, columns[i])] for i in np.argsort(-numbers.peak_torque)
    ]
    parts: list[Any] = [
        charts.chart(
            figure,
            "Power of all motors, in tenths of a second, and speed of the animal's middle, "
            "averaged over half a second.",
            timed=True,
        )
    ]
    if rows:
        head = ["joint", "peak torque (N m)", "rms torque (N m)", "half range (deg)"]
        parts.append(long_table(head, rows, numbers=(1, 2, 3)))
    return join(*parts)


def all_numbers(quantities: Sequence[Quantity]) -> Html:
    """Show a table of all measured numbers, each with its definition."""
    rows = [
        [
            each.name,
            number(each.value),
            each.unit,
            f"{each.definition}. None: {each.missing}." if each.missing else each.definition,
        ]
        for each in quantities
    ]
    return table(["", "value", "unit", "what it is"], rows, numbers=(1,))


def _feet_table(numbers: GaitNumbers) -> Html:
    feet = numbers.feet
    assert feet is not None
    phases = feet.phases
    columns = (feet.duty_factor, phases.phase, phases.regularity, feet.slip)
    rows = [
        [name, *map(number, values)] for name, *values in zip(feet.names, *columns, strict=True)
    ]
    if phases.reference is not None:
        rows[phases.reference][2] += " (reference)"
    words = (
        "Phase: where in the stride of the reference it touches down, from 0 to 1 (Hildebrand "
        "1965); regularity: 1 where always at the same, 0 where at any time."
    )
    head = ["body", "duty factor", "phase", "regularity", "slip (m/s)"]
    return join(table(head, rows, numbers=(1, 2, 3, 4)), tag("p", words, class_="note"))


def _window(recording: Recording, frequency: float) -> tuple[float, float]:
    """Return the window of the charts: some strides in the middle of the second half, s."""
    start, end = float(recording.time[0]), float(recording.time[-1])
    length = _STRIDES_SHOWN / frequency if frequency > 0 else _MOST_SHOWN
    length = min(max(length, _LEAST_SHOWN), _MOST_SHOWN, end - start)
    middle = start + 0.75 * (end - start)
    first = max(start, min(middle - length / 2, end - length))
    return first, first + length


def _every(recording: Recording, step: int) -> Recording:
    kept = ("goal", "dof_names")
    return Recording(
        *(value if name in kept else value[::step] for name, value in recording._asdict().items())
    )
