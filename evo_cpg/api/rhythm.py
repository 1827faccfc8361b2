"""Rhythm of an animal's oscillators, and settings for a desired rhythm."""

from typing import NamedTuple

import numpy as np

from evo_cpg.analysis.chains import OscillatorChain, chains
from evo_cpg.analysis.limit_cycle import LimitCycle, NoRhythmError, RhythmSearchError, limit_cycle
from evo_cpg.analysis.reference_rhythm import Rhythm, UnreachableRhythmError, reference_rhythm
from evo_cpg.analysis.reference_rhythm import rhythm as rhythm_of_chain
from evo_cpg.api.experiment import Experiment
from evo_cpg.control.couplings import ring_members
from evo_cpg.control.matsuoka import CpgSettings, Oscillators, parts
from evo_cpg.errors import UserError, nearest

# Keys that the search may change, in addition to the range of b.
CHANGED = ("time_scale", "parent_weight", "child_weight")


class GroupRhythm(NamedTuple):
    """Rhythm of one set of oscillators that are coupled to each other.

    Attributes:
        oscillators: names of the oscillators.
        branched: True if they are no single row, so that lags along a row say nothing.
        cycle: their periodic orbit, or None without one.
        rests: True if they come to rest. If there is no orbit either, the search failed.
        reason: why there is no orbit, or "".
    """

    oscillators: tuple[str, ...]
    branched: bool
    cycle: LimitCycle | None
    rests: bool = False
    reason: str = ""


class Rhythms(NamedTuple):
    """Rhythm of all oscillators of an animal under a constant drive, without feedback.

    Attributes:
        adaptation_gain: b.
        tonic_input: u.
        groups: sets of coupled oscillators.
        rings: for each ring of the configuration that swings, the names of its oscillators and the
            lag of each behind the one before, degrees.
        open_loop: True if the animal has feedback, which is left out.
    """

    adaptation_gain: float
    tonic_input: float
    groups: tuple[GroupRhythm, ...]
    rings: tuple[tuple[tuple[str, ...], np.ndarray], ...]
    open_loop: bool


class FoundRhythm(NamedTuple):
    """Settings for a desired rhythm.

    Attributes:
        chain: chain of oscillators with the rhythm.
        present: present settings.
        present_gain: present b.
        before: present rhythm, or "rest" or "not found".
        found: the new settings and their rhythm.
        changes: changed keys of ``controller.cpg``. The middle of the new range of b is the new b.
    """

    chain: OscillatorChain
    present: CpgSettings
    present_gain: float
    before: Rhythm | str
    found: Rhythm
    changes: dict[str, float]


def rhythm(
    experiment: Experiment, gain: float | None = None, tonic_input: float | None = None
) -> Rhythms:
    """Return the rhythm of each group of oscillators, under a constant drive.

    Args:
        experiment: an animal with ``controller.type: brain_cpg``.
        gain: adaptation gain b, or None for the middle of its range.
        tonic_input: tonic input u, or None for the largest.

    Raises:
        UserError: the controller has no oscillators.
    """
    cpg, network, _ = oscillators_of(experiment)
    tree = experiment.world.tree
    b = (cpg.min_adaptation_gain + cpg.max_adaptation_gain) / 2 if gain is None else gain
    u = cpg.max_tonic_input if tonic_input is None else tonic_input
    gains = np.full(network.oscillator_count, b)
    drive = np.full((2, network.oscillator_count), u)
    rows = {tuple(sorted(chain.oscillators)) for chain in chains(tree, cpg)}
    groups, cycles = [], {}
    for part in parts(network):
        start = tuple(tree.dof_names[i] for i in part), len(part) > 2 and part not in rows
        try:
            cycle = limit_cycle(network, drive, gains, part)
            cycles |= dict.fromkeys(part, cycle)
            groups.append(GroupRhythm(*start, cycle))
        except NoRhythmError as error:
            groups.append(GroupRhythm(*start, None, True, str(error)))
        except RhythmSearchError as error:
            groups.append(GroupRhythm(*start, None, False, str(error)))
    rings = []
    for number, ring in enumerate(cpg.rings):
        members = ring_members(tree, ring, number)
        if members[0] in cycles:
            names = tuple(tree.dof_names[member] for member in members)
            rings.append((names, cycles[members[0]].lags(members)))
    return Rhythms(b, u, tuple(groups), tuple(rings), cpg.feedback is not None)


def find_rhythm(
    experiment: Experiment,
    frequency: float | None = None,
    lag: float | None = None,
    *,
    gain: float | None = None,
    tonic_input: float | None = None,
    joint: str | None = None,
) -> FoundRhythm:
    """Return settings of the oscillators that give a frequency, a lag or both.

    Args:
        experiment: an animal with ``controller.type: brain_cpg``.
        frequency: desired frequency, Hz, or None to keep ``time_scale``.
        lag: desired mean lag along the chain, degrees, negative from tail to head, or None to keep
            b and the couplings.
        gain: adaptation gain b to hold, or None to let the search change it.
        tonic_input: tonic input u, or None for the largest.
        joint: oscillator that the chain must contain, or None for the longest chain.

    Raises:
        UserError: an argument is wrong, the oscillators rest, or the rhythm is out of reach.
        RhythmSearchError: the search failed.
    """
    settings, tree = oscillators_of(experiment)[0], experiment.world.tree
    rate = experiment.parts.simulation.control_rate
    if frequency is None and lag is None:
        raise UserError("--chain needs --frequency or --lag. Add one of them")
    limits = (
        ("frequency", frequency, 0.0, rate / 2, f"half of the {rate:g} steps per second"),
        ("lag", lag, -180.0, 180.0, "180 degrees"),
        ("gain", gain, 0.0, np.inf, "infinity"),
        ("tonic-input", tonic_input, 0.0, np.inf, "infinity"),
    )
    for name, value, low, high, words in limits:
        if value is not None and not low < value < high:
            raise UserError(f"--{name} {value:g}: must lie between {low:g} and {words}")
    if joint is not None and joint not in tree.dof_names:
        raise UserError(f"--chain {joint}: no such oscillator: {nearest(joint, tree.dof_names)}")
    # The longest chain, or the longest chain through the oscillator.
    own = None if joint is None else tree.dof_names.index(joint)
    chain = next(c for c in chains(tree, settings) if own is None or own in c.oscillators)
    middle = (settings.min_adaptation_gain + settings.max_adaptation_gain) / 2
    b = middle if gain is None else gain
    try:
        before = rhythm_of_chain(tree, settings, chain, b, tonic_input)
    except NoRhythmError:
        before = "rest"
    except RhythmSearchError:
        before = "not found"
    target = frequency, lag, gain is not None, tonic_input
    where = f"{experiment.source}: {chain.name}"
    try:
        found = reference_rhythm(tree, settings, chain, b, *target)
    except (UnreachableRhythmError, NoRhythmError) as error:
        hint = ". Search for a rhythm with --lag" if lag is None else ""
        raise UserError(f"{where}: {error}{hint}") from None
    except RhythmSearchError as error:
        raise RhythmSearchError(f"{where}: {error}") from None
    factor = found.adaptation_gain / middle
    then = {key: getattr(found.settings, key) for key in CHANGED}
    for key in ("min_adaptation_gain", "max_adaptation_gain"):
        then[key] = factor * getattr(settings, key)
    changes = {
        key: value
        for key, value in then.items()
        if not np.isclose(value, getattr(settings, key), rtol=1e-6, atol=0)
    }
    return FoundRhythm(chain, settings, b, before, found, changes)


def oscillators_of(experiment: Experiment) -> Oscillators:
    """Return the oscillators of an animal.

    Raises:
        UserError: the controller has none.
    """
    found = experiment.parts.simulation.controller.rhythm_generator
    if found is None:
        raise UserError(
            f"{experiment.source}: its controller has no oscillators. Choose controller.type: "
            "brain_cpg"
        )
    return found
