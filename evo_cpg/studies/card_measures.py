"""Values of the report card, from answers of the laboratory.

Each measure takes the answers of a question, and returns a list with one value for each setting or
seed. Values that do not exist are NaN. A row of the card binds all
arguments but the answers with `functools.partial`.
"""

import itertools
import math
from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float

from evo_cpg.analysis.animals import running_cost
from evo_cpg.analysis.cycles import mean_phase, upward_crossings
from evo_cpg.analysis.gait import fourier_component
from evo_cpg.analysis.laboratory.ask import Answer
from evo_cpg.analysis.laboratory.settings import Setting
from evo_cpg.simulation.recording import Recording

Measure = Callable[[Sequence[Answer]], Sequence[float]]
"""Function of the answers of a question."""

# Samples of a trial that are measured, as a fraction of the trial at its end.
_LAST = 0.5
# Smallest activity of a muscle that counts as a burst, as a fraction of the largest.
_BURST = 0.1
# Largest difference from the lag of the intact animal at which the lag has returned, cycles.
_RETURNED = 0.1
# Ranges of Reynolds numbers of swimmers in Gazzola et al. 2014. The two laws meet at 3600
# (`analysis.animals`), and the laminar law begins with larvae.
LAMINAR = {"low": 10.0, "high": 3600.0}
TURBULENT = {"low": 3600.0, "high": math.inf}


def each(key: str, answers: Sequence[Answer], scale: float = 1.0) -> list[float]:
    """Return a quantity of all settings, times a scale."""
    return [scale * row.get(key, math.nan) for one in answers for row in one.rows]


def where(measured: Measure, answers: Sequence[Answer], **knobs: object) -> Sequence[float]:
    """Return the values of a measure for only those settings whose knobs have these values."""
    return measured([_where(one, knobs) for one in answers])


def _where(answer: Answer, knobs: Setting) -> Answer:
    kept = [i for i, row in enumerate(answer.rows) if all(row[k] == v for k, v in knobs.items())]
    return answer._replace(
        settings=[answer.settings[i] for i in kept],
        rows=[answer.rows[i] for i in kept],
        recordings=tuple(answer.recordings[i] for i in kept),
        simulations=tuple(answer.simulations[i] for i in kept),
    )


def at_best(
    key: str, answers: Sequence[Answer], best: str, over: str, scale: float = 1.0
) -> list[float]:
    """Return a quantity where another one is largest, for each value of a knob.

    Args:
        key: quantity.
        answers: answers of the question.
        best: quantity to be largest.
        over: knob.
        scale: factor of the quantity.
    """
    values = []
    for answer in answers:
        for value in dict.fromkeys(row[over] for row in answer.rows):
            rows = [row for row in answer.rows if row[over] == value]
            rows = [row for row in rows if math.isfinite(row.get(best, math.nan))]
            if rows:
                values.append(scale * max(rows, key=lambda row: row[best]).get(key, math.nan))
    return values


def slope(
    y: str,
    x: str,
    over: Sequence[str],
    answers: Sequence[Answer],
    low: float = 0.0,
    high: float = math.inf,
) -> list[float]:
    """Return the exponent of a power law y ~ x^n, for each combination of some knobs.

    Args:
        y: quantity.
        x: quantity.
        over: knobs with one law for each combination of their values.
        answers: answers of the question.
        low: least Reynolds number, 0 for any.
        high: largest Reynolds number.
    """
    return [_law(x, y) for x, y in _pairs(answers, y, x, over, low, high)]


def slope_at_best(y: str, x: str, answers: Sequence[Answer], best: str, over: str) -> list[float]:
    """Return the exponent of y ~ x^n over the settings of `at_best`."""
    pairs = zip(at_best(x, answers, best, over), at_best(y, answers, best, over), strict=True)
    known = np.array([pair for pair in pairs if min(pair) > 0], float).reshape(-1, 2)
    return [_law(known[:, 0], known[:, 1])]


def prefactor(
    y: str,
    x: str,
    over: Sequence[str],
    power: float,
    answers: Sequence[Answer],
    low: float,
    high: float,
) -> list[float]:
    """Return the geometric mean of y / x^power, for each combination as in `slope`."""
    return [
        float(np.exp(np.mean(np.log(y) - power * np.log(x)))) if len(x) else math.nan
        for x, y in _pairs(answers, y, x, over, low, high)
    ]


def _pairs(
    answers: Sequence[Answer], y: str, x: str, over: Sequence[str], low: float, high: float
) -> list[tuple[np.ndarray, np.ndarray]]:
    found = []
    for answer in answers:
        for values in dict.fromkeys(tuple(row[k] for k in over) for row in answer.rows):
            pairs = [
                (row.get(x, math.nan), row.get(y, math.nan))
                for row in answer.rows
                if tuple(row[k] for k in over) == values
                and (not low or low <= row.get("reynolds", 0.0) < high)
            ]
            own = np.array([pair for pair in pairs if min(pair) > 0], float).reshape(-1, 2)
            found.append((own[:, 0], own[:, 1]))
    return found


def _law(x: np.ndarray, y: np.ndarray) -> float:
    """Return the exponent of a power law, or NaN with fewer than three points."""
    return float(np.polyfit(np.log(x), np.log(y), 1)[0]) if len(x) >= 3 else math.nan


def change(
    key: str, knob: str, before: float, after: float, answers: Sequence[Answer]
) -> list[float]:
    """Return the change of a quantity in percent, between two values of a knob.

    Args:
        key: quantity, or ``curvature`` for the root mean square of all joint angles.
        knob: knob.
        before: first value.
        after: second value.
        answers: answers of the question.
    """
    return [
        100.0 * (_value(one, j, key) / _value(one, i, key) - 1.0)
        for one in answers
        for i, j in _partners(one, knob, before, after)
    ]


def ratio(
    key: str,
    knob: str,
    before: object,
    after: object,
    answers: Sequence[Answer],
    scale: float = 1.0,
) -> list[float]:
    """Return a quantity after a change of a knob over the one before, times a scale."""
    return [
        scale * _value(one, j, key) / _value(one, i, key)
        for one in answers
        for i, j in _partners(one, knob, before, after)
    ]


def _partners(answer: Answer, knob: str, before: object, after: object) -> list[tuple[int, int]]:
    """Return the numbers of two settings that differ only in one knob, for all other values."""
    places = {
        tuple(sorted(setting.items(), key=str)): i for i, setting in enumerate(answer.settings)
    }
    return [
        (i, places[tuple(sorted({**setting, knob: after}.items(), key=str))])
        for i, setting in enumerate(answer.settings)
        if setting[knob] == before
    ]


def _value(answer: Answer, number: int, key: str) -> float:
    if key != "curvature":
        found = answer.rows[number].get(key, math.nan)
        return found if found else math.nan
    angle = np.asarray(answer.recordings[number].joint_angle, float)
    angle = angle[round(len(angle) * _LAST) :]
    return float(np.sqrt(np.square(angle - angle.mean(0)).mean()))


def _phases(recording: Recording, row: Setting, signal: str) -> Float[np.ndarray, " d"]:
    """Return the phase of a signal of each joint in the second half of a trial, cycles."""
    values = np.asarray(getattr(recording, signal), float)
    values = values[round(len(values) * _LAST) :]
    step = float(recording.time[1] - recording.time[0])
    frequency = row.get("stride_frequency", math.nan)
    if not frequency > 0:
        return np.full(values.shape[1], np.nan)
    return np.unwrap(np.angle(fourier_component(values, step, frequency))) / (2 * np.pi)


def _delay(answer: Answer, number: int, signal: str) -> float:
    """Return the delay of a wave along the body, cycles per body length."""
    phase = _phases(answer.recordings[number], answer.rows[number], signal)
    if not np.isfinite(phase).all():
        return math.nan
    # Distance of each joint from the root, then from the first joint, along the body.
    tree = answer.simulations[number].world.tree
    apart = np.linalg.norm(np.asarray(tree.joint_offset, float), axis=0)
    behind = np.zeros(len(apart))
    for body, parent in enumerate(tree.parents):
        behind[body] = behind[parent] + apart[body] if parent >= 0 else 0.0
    joints = behind[list(tree.dof_bodies)]
    places = (joints - joints[0]) / answer.rows[number]["length"]
    return -float(np.polyfit(places, phase, 1)[0])


def outrunning(answers: Sequence[Answer]) -> list[float]:
    """Return the speed of the wave of muscle activity over the speed of the wave of bending."""
    return [
        _delay(one, i, "joint_angle") / _delay(one, i, "cpg_output")
        for one in answers
        for i in range(len(one.rows))
    ]


def activity_speed(answers: Sequence[Answer]) -> list[float]:
    """Return the speed of the wave of muscle activity, body lengths in a cycle."""
    return [1.0 / _delay(one, i, "cpg_output") for one in answers for i in range(len(one.rows))]


def lead_grows(answers: Sequence[Answer]) -> list[float]:
    """Return the growth of the lead of activity on bending, last third less first, cycles."""
    found = []
    for answer in answers:
        for row, recording in zip(answer.rows, answer.recordings, strict=True):
            lead = _phases(recording, row, "cpg_output") - _phases(recording, row, "joint_angle")
            third = max(1, len(lead) // 3)
            found.append(float(lead[-third:].mean() - lead[:third].mean()))
    return found


def burst(place: float, answers: Sequence[Answer]) -> list[float]:
    """Return the part of the cycle with activity on one side, percent.

    Args:
        place: place along the body, 0 to 1.
        answers: answers of the question.
    """
    values = []
    for recording in [recording for answer in answers for recording in answer.recordings]:
        output = np.asarray(recording.cpg_output, float)
        own = output[round(len(output) * _LAST) :, round(place * (output.shape[1] - 1))]
        top = own.max()
        part = 100.0 * float((own > _BURST * top).mean())
        values.append(part if top > 0 else math.nan)
    return values


def cycles_to_return(
    joint: str, intact: Setting, cut: Setting, answers: Sequence[Answer]
) -> list[float]:
    """Return the cycles until the lag across a cut has returned to the intact animal's.

    The lag is that of the oscillator at the cut on the oscillator before it. It has returned when
    it stays within 0.1 cycle of the mean lag of the intact animal. Without a return, the value is
    the number of cycles of the whole trial.

    Args:
        joint: joint in front of which the cord is cut.
        intact: knobs of the intact animal.
        cut: knobs of the animal with the cut.
        answers: answers of the question.
    """
    values = []
    for answer in answers:
        whole, parted = _where(answer, intact), _where(answer, cut)
        for one, other in zip(whole.recordings, parted.recordings, strict=True):
            usual = _lags(one, joint)
            usual = usual[len(usual) // 2 :]
            mean, _ = mean_phase(usual)
            apart = _lags(other, joint) - mean
            apart = np.abs(apart - np.round(apart))
            late = np.flatnonzero(~(apart < _RETURNED))
            back = float(late[-1] + 1) if len(late) else 0.0
            values.append(back if len(apart) else math.nan)
    return values


def _lags(recording: Recording, joint: str) -> Float[np.ndarray, " c"]:
    """Return the lag of an oscillator on the one before it, in each cycle of the latter, cycles."""
    k = recording.dof_names.index(joint)
    before, behind = np.asarray(recording.cpg_output, float)[:, [k - 1, k]].T
    starts, own = upward_crossings(before), upward_crossings(behind)
    lags = []
    for start, end in itertools.pairwise(starts):
        later = own[own >= start]
        # Without a later crossing, the trial ends first.
        if len(later):
            lags.append((later[0] - start) / (end - start))
    return np.array(lags)


# Mechanical work over metabolic energy of whole animals (secondary source).
_EFFICIENCY = 0.25


def size(measured: Measure, answers: Sequence[Answer]) -> list[float]:
    """Return the magnitudes of another measure."""
    return [abs(value) for value in measured(answers)]


def cost_over_allometry(answers: Sequence[Answer]) -> list[float]:
    """Return the metabolic cost of transport over that of running animals of its mass and speed."""
    return [
        row["cost_of_transport"] / _EFFICIENCY / float(running_cost(row["mass"], row["speed"]))
        if row.get("speed", 0.0) > 0
        else math.nan
        for answer in answers
        for row in answer.rows
    ]
