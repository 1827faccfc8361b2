"""Sections on the animal's movement: gait, signals, effort, and all measured numbers."""

import itertools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from evo_cpg.analysis.gait_numbers import GaitNumbers
from evo_cpg.analysis.gait_quantities import Quantity
from evo_cpg.creature.axis_kinds import body_and_axis
from evo_cpg.simulation.recording import Recording
from evo_cpg.view.plots import joint_signals_figure, path_figure
from evo_cpg.view.run_page import charts
from evo_cpg.view.run_page.html import Html, join, long_table, number, table, tag
from evo_cpg.view.run_page.subject import PageSubject, RecordedMotion

# Shortest and longest time on charts of signals and footfalls, s, and number of strides.
_LEAST_SHOWN, _MOST_SHOWN, _STRIDES_SHOWN = 2.0, 8.0, 6.0
# Number of points with which the path is drawn.
_PLACES = 400


def gait(motion: RecordedMotion) -> Html:
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
                "Contacts with the ground. Each bar is a stance. Click on a chart to move the "
                "animal to that instant.",
                timed=True,
            ),
            _feet_table(numbers),
        ]
    elif feet is not None:
        parts.append(tag("p", "No body other than the root ever touches the ground."))
    if wave is not None:
        chain = list(numbers.chain)
        names = [body_and_axis(recording.dof_names[i])[0] for i in chain]
        bending = np.asarray(recording.joint_angle)[:, chain] * numbers.axis_signs[chain]
        parts += [
            tag("h3", "The wave along the body"),
            charts.chart(
                charts.wave_figure(bending, numbers.step, window, names),
                f"Bending of each joint about {recording.dof_names[chain[0]].rpartition('.')[2]} "
                "over time, with the front at the top. The stripes of a wave that runs to the tail "
                "slant to the lower right. The stripes of a standing wave are upright.",
                timed=True,
            ),
        ]
        if math.isfinite(wave.count):
            parts.append(
                charts.chart(
                    charts.lag_figure(wave, motion.chain_places),
                    "Phase lag behind the first joint, and amplitude, at "
                    f"{numbers.frequency:.3g} Hz. A straight line is a wave of constant speed. A "
                    f"line explains {100 * wave.straightness:.0f} % of the variance of the lags.",
                )
            )
    if numbers.midline is not None:
        quadratic = numbers.midline.envelope.quadratic
        parts.append(
            charts.chart(
                charts.midline_figure(numbers.midline),
                "Left: the midline at twelve instants of a stride, in the body's frame, with the "
                "head on the left. Middle: half of the sway from side to side over the body's "
                "length, with the quadratic fit "
                f"{quadratic[0]:.2g} {quadratic[1]:+.2g} s {quadratic[2]:+.2g} s². Right: fraction "
                "of a cycle by which the sway follows the bending. Eels have 0.10 to 0.15 in water "
                "and none on land (Gillis 1998, secondary source).",
            )
        )
    every = max(1, len(recording.time) // _PLACES)
    thinned = {k: v[::every] for k, v in recording._asdict().items() if k != "dof_names"}
    parts += [
        tag("h3", "Its path"),
        charts.chart(
            path_figure(recording._replace(**thinned), motion.root_index),
            "Path of the root from above, and distance over time.",
        ),
    ]
    return join(*parts)


def signals(subject: PageSubject, motion: RecordedMotion) -> Html | None:
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
            "Angle of every joint about the axis with the most bending, and the signal that drives "
            "it. Thin lines join the crests of neighbouring joints. If their axes point against "
            "each other, a line joins a crest and a trough. The slope of the lines is the phase "
            "lag.",
            timed=True,
        )
    ]
    names, lags = recording.dof_names, numbers.lags
    # Rows of joints may share their first joints.
    pairs = dict.fromkeys(pair for row in subject.chains for pair in itertools.pairwise(row))
    rows = [
        [names[i], names[j], number(round(float(lags.lag[i, j]))), number(lags.coherence[i, j])]
        for i, j in pairs
        if math.isfinite(lags.lag[i, j])
    ]
    if rows:
        words = (
            f"Lag of the next joint behind the joint at {numbers.frequency:.3g} Hz, from the "
            "cross-spectrum of their angles (Welch 1967). Both angles are about the direction of "
            "the first axis in their row of joints. Coherence is 1 if the lag is always the same, "
            "and 0 if it is random. It has no value (a dash) if the second half of the trial is "
            "shorter than about six strides."
        )
        made = long_table(["joint", "next", "lag (deg)", "coherence"], rows, numbers=(2, 3))
        parts += [tag("h3", "Phase lags"), made, tag("p", words, class_="note")]
    elif not numbers.frequency > 0:
        words = (
            "There are no phase lags, because the joint angles do not repeat in the second half of "
            "the trial. A frequency in the title of the chart belongs to the shown part."
        )
        parts.append(tag("p", words))
    return join(*parts)


def effort(motion: RecordedMotion) -> Html:
    """Show power, speed and torques."""
    recording, numbers, clip = motion.recording, motion.numbers, motion.clip
    figure = charts.effort_figure(recording.time, numbers.power, clip.time, clip.speed)
    slides = recording.slides
    ranges = np.ptp(recording.joint_angle, axis=0) / 2
    ranges = np.where(slides, ranges, np.degrees(ranges))
    columns = np.transpose([numbers.peak_torque, numbers.rms_torque, ranges])
    order = np.lexsort((-numbers.peak_torque, slides))
    rows = [[recording.dof_names[i], *map(number, columns[i])] for i in order]
    parts: list[Any] = [
        charts.chart(
            figure,
            "Power of all motors, averaged over tenths of a second, and speed of the animal's "
            "centre, smoothed over half a second.",
            timed=True,
        )
    ]
    if rows:
        torque, angle = ("N m; slides: N", "deg; slides: m") if slides.any() else ("N m", "deg")
        head = ["joint", f"peak torque ({torque})", f"rms torque ({torque})"]
        parts.append(long_table([*head, f"half range ({angle})"], rows, numbers=(1, 2, 3)))
    return join(*parts)


def all_numbers(quantities: Sequence[Quantity]) -> Html:
    """Show a table of all measured numbers, each with its definition."""
    rows = [
        [
            each.name,
            number(each.value),
            each.unit,
            "; ".join(map(str, each.animals)),
            f"{each.definition}. No value: {each.missing}." if each.missing else each.definition,
        ]
        for each in quantities
    ]
    return table(["", "value", "unit", "animals", "definition"], rows, numbers=(1,))


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
        "Phase: touch-down as a fraction of the stride of the reference body (Hildebrand 1965). "
        "Regularity: 1 if the phases are always equal, 0 if they are random. Both have no value (a "
        "dash) for a body that does not touch down within the reference's strides in the second "
        "half of the trial, and for all bodies if none touches down twice. Slip is weighted "
        "by load."
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
