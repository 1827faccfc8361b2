"""Checks of an audit: what a replay, its variations and second opinions say about a gait."""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from evo_cpg.analysis.energy import Ledger
from evo_cpg.analysis.excursions import Excursions, displacement
from evo_cpg.analysis.second_opinion import Opinion
from evo_cpg.analysis.verdict import KEPT, Check, shown
from evo_cpg.creature.creature import Creature, length_of
from evo_cpg.creature.self_collision import candidate_pairs
from evo_cpg.physics.contact.pairs import make_pairs
from evo_cpg.simulation.limits import Limits
from evo_cpg.simulation.observers import PhysicsSteps
from evo_cpg.training.checkpoint import Champion
from evo_cpg.training.conditions import Variation, Varied
from evo_cpg.training.experiment import ExperimentParts, situation_numbers

# Largest number of unchecked body pairs that are listed by name.
_NAMED = 5

# With noise: key of the variation that compares fresh trials with the champion's own trials in
# training.
CHANCE = "pose"

# Unaccounted energy is summed over stretches of this length, s. In single steps much of the energy
# only fluctuates.
_STRETCH = 0.25

# Shortest displacement, in lengths of the animal, for which variations are evaluated.
LEAST_DISPLACEMENT = 0.1

# The time upright in a second opinion is named if it is shorter than ours by more than this
# fraction of the trial.
_LESS_UPRIGHT = 0.1


class AuditedTrial(NamedTuple):
    """Step-by-step results of one trial of the champion.

    Attributes:
        steps: all physics steps of the trial.
        ledger: balance of energy and momentum.
        excursions: extremes that are compared with the limits.
    """

    steps: PhysicsSteps
    ledger: Ledger
    excursions: Excursions


def displacement_checks(
    own: float,
    kept: dict[str, tuple[Variation, Varied]],
    limits: Limits,
    creature: Creature,
    carried: float = 0.0,
) -> list[Check]:
    """Return checks of the displacement that a champion keeps in variations.

    Args:
        own: displacement in the unchanged simulation, m.
        kept: results of the variations, by the key of the limit.
        limits: smallest allowed fractions.
        creature: the animal.
        carried: displacement by the water alone, m.
    """
    checks = [Check("way", "displacement in its own trials", own, unit="m")]
    if not own > LEAST_DISPLACEMENT * length_of(creature):
        return checks
    chance, drawn = kept[CHANCE]
    # Mean displacement with fresh noise: the reference of the other variations with several draws.
    # Without noise, only the variation of poses has several draws.
    usual = float(drawn.mean_displacements(chance)[0])
    for key, (variation, one) in kept.items():
        of_own = variation.draws == 1 or key == CHANCE
        reference = own if of_own else usual
        displacements = one.mean_displacements(variation)
        detail = ", ".join(f"{x:.3g}" for x in displacements) + f" of {reference:.3g} m"
        if key == "limp_way":
            # Subtract the displacement by the flow. From the limp animal's displacement, subtract
            # it only if it is positive.
            swum, limp = reference - carried, float(displacements.max()) - max(0.0, carried)
            if carried > 0 and swum <= LEAST_DISPLACEMENT * length_of(creature):
                # The displacement is due to the water alone.
                fraction = 1.0
            else:
                fraction = float(np.clip(limp / swum, 0.0, 1.0)) if swum > 0 else 0.0
            if carried:
                detail += f" ({carried:.3g} m by the flow alone)"
            question = f"displacement with {variation.name}"
            checks.append(Check(key, question, fraction, limits.limp_way, unit="%", detail=detail))
            continue
        fractions = np.zeros_like(displacements)
        if reference > 0:
            fractions = np.clip(displacements / reference, 0.0, 1.0)
        question, limit = f"{KEPT}{variation.name}", getattr(limits, key, None)
        # The worst of several settings counts.
        checks.append(Check(key, question, float(fractions.min()), limit, True, "%", detail))
    return checks


def carried_by_flow(experiment: ExperimentParts, trials: Sequence[AuditedTrial]) -> float:
    """Return the displacement of a point that keeps the flow's velocity at the start, m.

    If the flow changes, it is the mean velocity at the initial place. The result is the mean over
    trials.
    """
    simulation, numbers = experiment.simulation, situation_numbers(experiment)
    water, displacements = simulation.world.water, []
    if water is None:
        return 0.0
    for i, trial in enumerate(trials):
        start = np.asarray(trial.steps.before.position[:, :1], float)
        time = np.arange(simulation.steps if water.changes else 1) / simulation.control_rate
        path = start.repeat(len(time), 1)
        flow = np.asarray(water.along(jnp.asarray(path), jnp.asarray(time)), float)
        flow = flow.mean(1, keepdims=True)
        if start[2] > simulation.world.water_level:
            flow = 0.0 * flow
        light = simulation.goals[0 if numbers is None else i]
        displacements.append(
            displacement(np.hstack([start, start + simulation.duration * flow]), light)
        )
    return float(np.mean(displacements))


def opinion_checks(
    experiment: ExperimentParts, opinions: Sequence[Opinion], diverged: Sequence[str]
) -> list[Check]:
    """Return the displacements in the first trial that second opinions keep.

    If the task rewards only displacement along x, only this displacement counts. A displacement
    backwards counts as 0. There are no checks if our animal hardly moves, because fractions of its
    displacement mean nothing then.
    """
    checks = [Check(_key_of(name), KEPT + name, math.nan, None, True, "%") for name in diverged]
    if not opinions:
        return checks
    light, forward = experiment.simulation.goals[0], experiment.simulation.task.heading
    own, *others = (
        float(one.path[0, -1] - one.path[0, 0])
        if light is None and forward == "forward"
        else displacement(one.path, light)
        for one in opinions
    )
    if not own > LEAST_DISPLACEMENT * length_of(experiment.creature):
        return []
    for one, theirs in zip(opinions[1:], others, strict=True):
        question, upright = KEPT + one.program, one.upright
        # Only on the ground, because swimmers may roll.
        if one.airborne is not None and upright < opinions[0].upright - _LESS_UPRIGHT:
            question += f" (upright {shown(upright, '%')} of the time)"
        fraction, detail = float(np.clip(theirs / own, 0.0, 1.0)), f"{theirs:.3g} of {own:.3g} m"
        checks.append(Check(_key_of(one.program), question, fraction, None, True, "%", detail))
    return checks


def _key_of(program: str) -> str:
    return program.lower().replace(", ", "_").replace(" ", "_")


def books(
    experiment: ExperimentParts,
    champion: Champion,
    trials: tuple[AuditedTrial, ...],
    limits: Limits,
) -> list[Check]:
    """Return the checks that need no variation, such as energy, each for the worst trial."""
    simulation, mass = experiment.simulation, float(experiment.creature.mass)
    length, h = float(length_of(experiment.creature)), simulation.step_length
    limits = limits.of_length(length)
    found = [trial.excursions for trial in trials]
    ledgers = [trial.ledger for trial in trials]

    def worst(name: str) -> float:
        return max(getattr(each, name) for each in found)

    def check(key: str, question: str, measured: float, unit: str = "%", detail: str = "") -> Check:
        return Check(key, question, measured, getattr(limits, key), False, unit, detail)

    # Work in each trial relative to the motors' work: unaccounted energy, summed over the stretches
    # in which energy is gained, and positive net work of limits, between limbs and of the push-out.
    gains, stops, parted, raised = [], [], [], []
    for one in ledgers:
        # If the motors' work is zero, all work counts instead, or infinity.
        done = sum(np.abs(each).sum() for each in one.work.values())
        effort = one.effort or float(done) or np.inf
        starts = np.arange(0, len(one.stored), max(1, round(_STRETCH / h)))
        gain = np.maximum(np.add.reduceat(one.left_over, starts), 0.0).sum()
        gains.append(float(gain) / effort)
        stops.append(max(0.0, float(one.limits.sum())) / effort)
        parted.append(max(0.0, float(one.limbs.sum())) / effort)
        raised.append(one.push_out.sum() / effort)
    first = ledgers[0]
    parts = [f"{name} {value.sum():.3g}" for name, value in first.work.items() if np.any(value)]
    checks = [
        check(
            "simulator_energy",
            "unaccounted energy / motors' work",
            max(gains),
            detail=f"{', '.join(parts)}, left over {first.left_over.sum():.3g} J",
        ),
        check("limit_energy", "work of joint limits / motors' work", max(stops)),
        check("speed", "highest speed of the root", worst("peak_speed") / length, "lengths/s"),
        check("power", "peak power of all motors", worst("peak_power") / mass, "W/kg"),
        Check("peak_torque", "peak torque of a motor", worst("peak_torque"), unit="N m"),
        Check("mean_power", "mean power of all motors", worst("mean_power") / mass, unit="W/kg"),
        check("joint_rate", "highest joint rate", worst("peak_rate"), "rad/s"),
    ]
    world = simulation.world
    # The fixed world takes up the momentum of an animal that hangs from it by a joint.
    if world.tree.hanging is None:
        fractions = [
            np.linalg.norm(one.impulse.sum(1)) / one.given.sum()
            for one in ledgers
            if one.given.sum() > 0
        ]
        words = "unaccounted momentum / impulses"
        checks.insert(1, check("simulator_momentum", words, float(max(fractions, default=0.0))))
    if np.isfinite(world.tree.torque_limit).any():
        checks.append(check("overload", "torque above its limit", worst("overload")))
    if world.pairs is not None or any(np.any(one.limbs) for one in ledgers):
        checks.append(check("limb_energy", "work between limbs / motors' work", max(parted)))
    checks += _overlap(experiment, found, check)
    if world.contact_model is not None:
        checks += [
            check("penetration", "penetration of the ground", worst("penetration"), "m"),
            check("push_out_energy", "push-out work / motors' work", max(raised)),
        ]
        # Nothing flies with water everywhere.
        if world.water_level < math.inf:
            checks.append(
                check("airborne_way", "displacement while airborne", worst("airborne_way"))
            )
    if any(np.any(trial.steps.coulomb_residual) for trial in trials):
        checks.append(check("unsolved", "unsolved steps", worst("unsolved")))
        if world.contact_model is not None:
            checks.append(check("slipping", "steps off the friction cone", worst("slipping")))
    lit = any(light is not None for light in simulation.goals)
    if lit and simulation.sensors.eye_bodies and world.contact_model is not None:
        seen = worst("seen_through_ground")
        checks.append(check("seen_through_ground", "light seen through the ground", seen))
    for name, excess in simulation.task.beyond_scales(champion.terms, champion.scales).items():
        checks.append(check(f"free_{name}", f"{name} without cost to fitness", excess))
    return checks


def _overlap(
    experiment: ExperimentParts, found: Sequence[Excursions], check: Callable[..., Check]
) -> list[Check]:
    """Return the check of the overlap of limbs, or [] if no two limbs can meet."""
    world = experiment.simulation.world
    # Pairs that touch in the neutral pose have no check of their overlap, so they are named.
    _, touching = candidate_pairs(experiment.creature, world.tree, world.watched)
    names = [f"{world.tree.names[i]} and {world.tree.names[j]}" for i, j in sorted(touching)]
    more = [f"{len(names) - _NAMED} more"] if len(names) > _NAMED else []
    passing = ", ".join(names[:_NAMED] + more)
    if not passing and make_pairs(experiment.creature, world.tree, world.watched) is None:
        return []
    deepest = max(found, key=lambda each: each.overlap)
    words = [" in ".join(deepest.overlapping)] if deepest.overlapping else []
    if passing:
        words.append(f"not checked, because they touch in the neutral pose: {passing}")
    return [check("overlap", "overlap of limbs", deepest.overlap, "m", "; ".join(words))]
