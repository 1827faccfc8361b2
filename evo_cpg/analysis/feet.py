"""Contacts of a recorded animal with the ground, by body and by limb, and footfalls.

| word | meaning | source |
|---|---|---|
| stance | interval in which a foot touches the ground | |
| duty factor | fraction of the time that a foot spends in stance | Alexander and Jayes 1983 |
| phase of a foot | its touch-down in the stride of a reference foot, 0 to 1 | Hildebrand 1965 |
| airborne fraction | fraction of the time in which nothing touches the ground | |

A *foot* is any body that touches the ground, even a belly.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from evo_cpg.creature.creature import Creature
from evo_cpg.creature.limbs import Limb, limbs
from evo_cpg.simulation.measures import Slip, slip_of_points
from evo_cpg.simulation.recording import Recording
from evo_cpg.simulation.simulation import Simulation

# Duration (s) below which contacts and breaks are chatter, and its limit as a fraction of a stride.
_CHATTER, _CHATTER_FRACTION = 0.05, 0.1
# Difference below which coefficients of variation count as equal. Sampling alone causes a
# difference.
_AS_REGULAR = 0.05


class Phases(NamedTuple):
    """Touch-downs of all feet in the stride of a reference foot.

    Attributes:
        reference: index of the foot whose touch-downs begin the strides, or None if no foot touches
            down twice.
        phase: mean phase of each foot, a fraction of a stride from 0 to 1. NaN without touch-down
            in these strides.
        regularity: length of each foot's mean vector, from 0 (random phases) to 1 (equal phases).
            NaN without touch-down in these strides.
    """

    reference: int | None
    phase: Float[np.ndarray, " f"]
    regularity: Float[np.ndarray, " f"]


class Feet(NamedTuple):
    """Bodies that touch the ground, except the root.

    Attributes:
        names: names of the bodies that ever touch, in the order of the creature.
        touched: whether each body touches in each control step.
        steady: ``touched`` without chatter.
        duty_factor: duty factor of each body.
        phases: phases of the touch-downs in the second half of the trial.
        load: mean load of each body, N.
        slip: slip speed of each body, m/s (`evo_cpg.simulation.measures`). NaN without load.
        whole_slip: slip speed of everything that touches the ground, the root included, m/s. NaN
            without load.
        airborne: fraction of the control steps in which nothing touches, the root included.
    """

    names: tuple[str, ...]
    touched: Bool[np.ndarray, "t f"]
    steady: Bool[np.ndarray, "t f"]
    duty_factor: Float[np.ndarray, " f"]
    phases: Phases
    load: Float[np.ndarray, " f"]
    slip: Float[np.ndarray, " f"]
    whole_slip: float
    airborne: float


class LimbContacts(NamedTuple):
    """Contacts of limbs, each with all its bodies. A limb is not a tail (`creature.limbs`).

    Attributes:
        limbs: limbs that ever touch the ground, from front to back.
        touched: whether each limb touches in each control step.
        steady: ``touched`` without chatter.
        duty_factor: duty factor of each limb.
        slip: slip speed of all limbs, m/s. NaN without load.
    """

    limbs: tuple[Limb, ...]
    touched: Bool[np.ndarray, "t l"]
    steady: Bool[np.ndarray, "t l"]
    duty_factor: Float[np.ndarray, " l"]
    slip: float


def contacts(
    simulation: Simulation,
    creature: Creature,
    frames: Mapping[str, Array | np.ndarray],
    recording: Recording,
    first: int,
    frequency: float,
) -> Feet | None:
    """Return the contacts of a recorded animal, or None without ground.

    Args:
        simulation: the trial.
        creature: the animal.
        frames: frames of one individual, see `evo_cpg.simulation.recording.Recorder`.
        recording: recording of the same trial, in the order of the creature.
        first: first sample of the part in which strides are measured.
        frequency: stride frequency, Hz, or NaN.
    """
    contact_model, tree = simulation.world.contact_model, simulation.world.tree
    if contact_model is None:
        return None
    step = 1.0 / simulation.control_rate
    force = np.asarray(frames["contact_force"])[..., 0]
    owners = np.array(contact_model.bodies, int)
    names = [body.name for body in creature.bodies]
    bodies = sorted(set(owners.tolist()), key=lambda i: names.index(tree.names[i]))
    touched = touching(force, owners, bodies)
    ever = np.flatnonzero(touched.any(0))
    bodies, touched = [bodies[i] for i in ever], touched[:, ever]
    pushes, moves = (
        jnp.moveaxis(jnp.asarray(frames[name])[..., 0], 0, -1)
        for name in ("contact_force", "contact_velocity")
    )
    sums = []
    for body in bodies:
        every = slip_of_points(pushes[:, owners == body], moves[:, owners == body])
        sums.append(Slip(every.slide.sum(), every.load.sum()))
    load = np.array([each.load for each in sums], float)
    slip = np.array([each.speed() if each.load > 0 else np.nan for each in sums], float)
    whole = mean_slip(slip, load)
    feet = np.array([body > 0 for body in bodies], bool)
    touched = touched[:, feet]
    steady = settled(touched, step, chatter(frequency))
    return Feet(
        names=tuple(tree.names[body] for body in bodies if body > 0),
        touched=touched,
        steady=steady,
        duty_factor=duty_factors(touched),
        phases=phases(steady[first:], step),
        load=load[feet] / len(force),
        slip=slip[feet],
        whole_slip=whole,
        airborne=float((force == 0).all((1, 2)).mean()),
    )


def limb_contacts(
    creature: Creature, feet: Feet, step: float, frequency: float
) -> LimbContacts | None:
    """Return the contacts of the limbs, or None if no limb ever touches the ground.

    The stride frequency (Hz) is NaN without a stride.
    """
    found, columns, own = [], [], []
    for limb in limbs(creature):
        names = [creature.bodies[i].name for i in limb.bodies]
        rows = [k for k, name in enumerate(feet.names) if name in names]
        if rows:
            found.append(limb)
            own += rows
            columns.append(feet.touched[:, rows].any(1))
    if not found:
        return None
    touched = np.stack(columns, -1)
    return LimbContacts(
        limbs=tuple(found),
        touched=touched,
        steady=settled(touched, step, chatter(frequency)),
        duty_factor=duty_factors(touched),
        slip=mean_slip(feet.slip[own], feet.load[own]),
    )


def mean_slip(slip: Float[np.ndarray, " f"], load: Float[np.ndarray, " f"]) -> float:
    """Return the slip speed of feet weighted by their load, m/s, or NaN without load."""
    loaded = load > 0
    return float(np.average(slip[loaded], weights=load[loaded])) if loaded.any() else np.nan


def touching(
    force: Float[np.ndarray, "t 3 p"], owners: Int[np.ndarray, " p"], bodies: Sequence[int]
) -> Bool[np.ndarray, "t f"]:
    """Return whether bodies touch the ground in each sample, as in the measure ``duty_factor``.

    Each contact point belongs to the body in ``owners``.
    """
    touched = (force != 0).any(1)
    return np.stack([touched[:, owners == body].any(1) for body in bodies], -1)


def settled(
    touched: Bool[np.ndarray, "t f"], step: float, shortest: float
) -> Bool[np.ndarray, "t f"]:
    """Remove chatter: close short breaks, then drop short contacts.

    Contacts and breaks at the edges of the record stay.

    Args:
        touched: whether each foot touches in each sample.
        step: time between samples, s.
        shortest: duration below which breaks and contacts are removed, s.
    """
    found = touched.copy()
    for foot in found.T:
        for state in (False, True):
            for first, last in _runs(foot == state):
                inner = first > 0 and last < len(foot)
                if inner and (last - first) * step < shortest * (1 - 1e-9):
                    foot[first:last] = not state
    return found


def chatter(frequency: float) -> float:
    """Return the duration below which a contact or a break is chatter, s."""
    return min(_CHATTER, _CHATTER_FRACTION / frequency) if frequency > 0 else _CHATTER


def stances(touched: Bool[np.ndarray, " t"], step: float) -> Float[np.ndarray, "n 2"]:
    """Return the beginning and end of every stance of a foot, s from the first sample.

    A stance at an edge of the record begins or ends at this edge.
    """
    return step * np.array(_runs(touched), float).reshape(-1, 2)


def touch_downs(touched: Bool[np.ndarray, " t"], step: float) -> Float[np.ndarray, " n"]:
    """Return the instants at which a foot touches down, s. An initial stance has none."""
    return step * (1 + np.flatnonzero(~touched[:-1] & touched[1:]))


def duty_factors(touched: Bool[np.ndarray, "t f"]) -> Float[np.ndarray, " f"]:
    """Return each foot's fraction of the time on the ground. NaN without contact."""
    fraction = touched.mean(0)
    return np.where(fraction > 0, fraction, np.nan)


def phases(touched: Bool[np.ndarray, "t f"], step: float) -> Phases:
    """Return the phase of each foot's touch-downs in the stride of a reference foot.

    A touch-down at t between two of the reference, a and b, has the phase (t - a) / (b - a)
    (Hildebrand 1965). Means are circular (Fisher 1993).

    Candidates for the reference have at least half the largest number of strides. The reference is
    the first of them that touches down most regularly. The measure is the coefficient of variation
    of the stride times, in which differences up to 0.05 do not count.

    Args:
        touched: whether each foot touches in each sample, without chatter.
        step: time between samples, s.
    """
    downs = [touch_downs(foot, step) for foot in touched.T]
    count = len(downs)
    nothing = np.full(count, np.nan)
    strides = [np.diff(down) for down in downs]
    most = max((len(stride) for stride in strides), default=0)
    if not most:
        return Phases(None, nothing, nothing.copy())
    spread = np.array(
        [
            stride.std() / stride.mean() if len(stride) >= max(1, most / 2) else np.inf
            for stride in strides
        ]
    )
    reference = int(np.argmax(spread <= spread.min() + _AS_REGULAR))
    begin = downs[reference]
    phase, regularity = nothing, nothing.copy()
    for i, down in enumerate(downs):
        inside = down[(down >= begin[0]) & (down < begin[-1])]
        if not len(inside):
            continue
        stride = np.searchsorted(begin, inside, "right") - 1
        fraction = (inside - begin[stride]) / (begin[stride + 1] - begin[stride])
        mean = np.exp(2j * np.pi * fraction).mean()
        # Rounding keeps a tiny negative phase at 0 instead of 1.
        phase[i] = round(float(np.angle(mean) / (2 * np.pi)), 9) % 1.0
        regularity[i] = abs(mean)
    return Phases(reference, phase, regularity)


def _runs(state: Bool[np.ndarray, " t"]) -> list[tuple[int, int]]:
    """Return the first sample of each interval with a true state, and the sample after it."""
    edges = np.diff(np.concatenate([[False], state, [False]]).astype(int))
    begin, end = (np.flatnonzero(sign * edges > 0).tolist() for sign in (1, -1))
    return list(zip(begin, end, strict=True))
