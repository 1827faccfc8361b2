"""Rhythm of an animal's oscillators."""

from typing import NamedTuple

import numpy as np

from evo_cpg.analysis.chains import chains
from evo_cpg.analysis.limit_cycle import LimitCycle, NoRhythmError, RhythmSearchError, limit_cycle
from evo_cpg.api.experiment import Experiment
from evo_cpg.control.couplings import ring_members
from evo_cpg.control.matsuoka import Oscillators, parts
from evo_cpg.errors import UserError


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
    rows = {tuple(sorted(chain)) for chain in chains(tree, cpg)}
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
