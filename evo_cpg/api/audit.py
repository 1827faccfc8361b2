"""Audit of a champion: real gait or artefact of the simulation?"""

import dataclasses
import math
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from evo_cpg.analysis.energy import Ledger, ledger
from evo_cpg.analysis.excursions import Excursions, displacement, excursions
from evo_cpg.analysis.second_opinion import (
    Brain,
    DivergedError,
    Opinion,
    own_opinion,
    second_opinion,
)
from evo_cpg.analysis.verdict import KEPT, Check, Verdict, shown
from evo_cpg.creature.creature import Creature, length_of
from evo_cpg.creature.self_collision import pairs_that_touch_at_rest
from evo_cpg.io.build import build_experiment
from evo_cpg.io.models.refusals import ExchangeError
from evo_cpg.io.schema.experiment import ExperimentConfig
from evo_cpg.io.schema.limits import Limits
from evo_cpg.native.engine import Engine, described
from evo_cpg.physics.contact.pairs import make_pairs
from evo_cpg.simulation.observers import EachPhysicsStep, PhysicsSteps
from evo_cpg.simulation.simulation import Simulation
from evo_cpg.training import conditions
from evo_cpg.training.checkpoint import Champion
from evo_cpg.training.conditions import Variation, Varied, blinded
from evo_cpg.training.devices import population_mesh
from evo_cpg.training.evaluate import compile_trials
from evo_cpg.training.experiment import ExperimentParts, champion_keys, situation_numbers

# Largest number of unchecked body pairs that are listed by name.
_NAMED = 5

# Relative change of friction and drag in the conditions.
_CHANGE = 0.1

# Variation of the initial pose: standard deviation of joint angles, roll and pitch, rad, and number
# of draws.
_SHAKE, _DRAWS = 0.01, 8

# With noise: number of fresh trials that a displacement is averaged over, and key of the check that
# compares these trials with the champion's own trials in training.
_TRIALS, _CHANCE = 16, "pose"

# Unaccounted energy is summed over stretches of this length, s. In single steps much of the energy
# only fluctuates.
_STRETCH = 0.25

# Shortest displacement, in lengths of the animal, for which variations are evaluated.
_LEAST_DISPLACEMENT = 0.1

# The time upright in a second opinion is named if it is shorter than ours by more than this
# fraction of the trial.
_LESS_UPRIGHT = 0.1

# Largest allowed relative error of the replayed fitness.
_REPLAY = 1e-3


class Trial(NamedTuple):
    """Step-by-step results of one trial of the champion.

    Attributes:
        steps: all physics steps of the trial.
        ledger: balance of energy and momentum.
        excursions: extremes that are compared with the limits.
    """

    steps: PhysicsSteps
    ledger: Ledger
    excursions: Excursions


@dataclasses.dataclass(frozen=True)
class Audit:
    """Result of an audit.

    Attributes:
        verdict: all checks, with their results.
        trials: trials of the champion in the unchanged simulation.
        step_length: duration of a physics step, s.
        opinions: results of the first trial: ours, then MuJoCo's. Empty without MuJoCo's.
        missing: reason why second opinions are missing, or empty if none is missing.
    """

    verdict: Verdict
    trials: tuple[Trial, ...]
    step_length: float
    opinions: tuple[Opinion, ...] = ()
    missing: str = ""

    @property
    def measured(self) -> dict[str, float]:
        """Results of the checks by key."""
        return {check.key: float(check.measured) for check in self.verdict.checks}

    def as_dict(self, champion: Champion) -> dict[str, Any]:
        """Return the contents of ``audit.json``."""
        return {
            "passed": self.verdict.passed,
            "confirmed": self.verdict.confirmed,
            "confirmation": self.verdict.confirmation,
            "reasons": self.verdict.reasons,
            "run": champion.run,
            "generation": champion.generation,
            "fitness": champion.fitness,
            "expected": champion.expected,
            "checks": [
                check._asdict() | {"measured": float(check.measured), "passed": check.passed}
                for check in self.verdict.checks
            ],
            "energy": [_energy(trial.ledger) for trial in self.trials],
            "second_opinion": [
                {
                    "program": one.program,
                    "way_m": one.displacement,
                    "heading_deg": math.degrees(one.heading),
                    "upright": one.upright,
                    "nothing_touches": one.airborne,
                }
                for one in self.opinions
            ]
            or self.missing,
        }


def audits(
    experiment: ExperimentParts,
    champions: Sequence[Champion],
    limits: Limits,
    config: ExperimentConfig,
    source: Path,
    folders: Iterable[Path] = (),
    tell: Callable[[str, int, int], None] = lambda what, done, total: None,
) -> list[Audit]:
    """Audit champions. Each program is compiled once for all champions.

    Args:
        experiment: experiment that the champions evolved in.
        champions: individuals to audit.
        limits: limits of the checks.
        config: configuration that the experiment was built from.
        source: file of the configuration.
        folders: folders of a user's classes, see `evo_cpg.io.build.build_experiment`.
        tell: called with the name and number of the next step, and the number of steps.
    """
    simulation = experiment.simulation
    own = Variation("as it evolved", (simulation,))
    others = _variations(experiment, config, source, tuple(folders))
    total = len(others) + 3
    tell("replaying the champions", 0, total)
    live = conditions.compile_variation(experiment, own)
    replayed = [live(champion) for champion in champions]
    champions = [_complete(*both) for both in zip(champions, replayed, strict=True)]
    tell("step by step", 1, total)
    step_by_step = compile_steps(experiment)
    trials = [step_by_step(champion) for champion in champions]
    kept: list[dict[str, tuple[Variation, Varied]]] = [{} for _ in champions]
    for done, (key, other) in enumerate(others.items(), 2):
        tell(other.name, done, total)
        live = conditions.compile_variation(experiment, other)
        for champion, found in zip(champions, kept, strict=True):
            found[key] = other, live(champion)
    tell("in MuJoCo", total - 1, total)
    made = []
    for champion, alive, steps, found in zip(champions, replayed, trials, kept, strict=True):
        opinions, diverged, missing = _opinions(experiment, champion, steps[0].steps)
        checks = [
            _replay(champion, alive),
            *_kept(
                float(np.nanmean(alive.displacement)),
                found,
                limits,
                experiment.creature,
                _carried(experiment, steps),
            ),
            *_seconds(experiment, opinions, diverged),
            *books(experiment, champion, steps, limits),
        ]
        verdict = Verdict(tuple(checks))
        made.append(Audit(verdict, steps, simulation.step_length, opinions, missing))
    return made


def _complete(champion: Champion, replayed: Varied) -> Champion:
    """Return a champion with all its terms. A map keeps only the terms of its axes."""
    terms = {name: float(values[0]) for name, values in replayed.terms.items()}
    return champion._replace(terms=terms | champion.terms)


def _opinions(
    experiment: ExperimentParts, champion: Champion, steps: PhysicsSteps
) -> tuple[tuple[Opinion, ...], list[str], str]:
    """Return opinions on the first trial, and why some of them are missing.

    Returns:
        Our opinion and MuJoCo's, the names of those in which the animal diverged, and the reasons.
    """
    simulation, creature = experiment.simulation, experiment.creature
    modes: list[tuple[bool, Brain | None]] = [(False, None)]
    if simulation.world.contact_model is not None:
        modes.append((True, None))
        if simulation.controller.uses_senses:
            modes.append((True, _brain(experiment, champion)))
    opinions, diverged, missing = [own_opinion(simulation, steps)], list[str](), list[str]()
    for hard, brain in modes:
        try:
            opinions.append(second_opinion(simulation, creature, steps, hard, brain))
        except ExchangeError as error:
            missing.append(str(error))
            if isinstance(error, DivergedError):
                diverged.append(error.program)
    found = tuple(opinions) if len(opinions) > 1 else ()
    return found, diverged, "; ".join(dict.fromkeys(missing))


def _seconds(
    experiment: ExperimentParts, opinions: Sequence[Opinion], diverged: Sequence[str]
) -> list[Check]:
    """Return the displacements in the first trial that second opinions keep.

    If the task rewards only displacement along x, only this displacement counts. A displacement
    backwards counts as 0. There are no checks if our animal hardly moves, because fractions of its
    displacement mean nothing then.
    """
    checks = [Check(_key(name), KEPT + name, math.nan, None, True, "%") for name in diverged]
    if not opinions:
        return checks
    light, forward = experiment.simulation.lights[0], experiment.simulation.task.heading
    own, *others = (
        float(one.path[0, -1] - one.path[0, 0])
        if light is None and forward == "forward"
        else displacement(one.path, light)
        for one in opinions
    )
    if not own > _LEAST_DISPLACEMENT * length_of(experiment.creature):
        return []
    for one, theirs in zip(opinions[1:], others, strict=True):
        question, upright = KEPT + one.program, one.upright
        # Only on the ground, because swimmers may roll.
        if one.airborne is not None and upright < opinions[0].upright - _LESS_UPRIGHT:
            question += f" (upright {shown(upright, '%')} of the time)"
        fraction, detail = float(np.clip(theirs / own, 0.0, 1.0)), f"{theirs:.3g} of {own:.3g} m"
        checks.append(Check(_key(one.program), question, fraction, None, True, "%", detail))
    return checks


def _key(program: str) -> str:
    return program.lower().replace(", ", "_").replace(" ", "_")


def _brain(experiment: ExperimentParts, champion: Champion) -> Brain:
    """Return the brain that drives the champion in its first trial."""
    keys, numbers = champion_keys(experiment, champion), situation_numbers(experiment)
    own = None if keys is None else keys[:, :1]
    first = None if numbers is None else jnp.asarray(numbers[:1])
    return Brain(experiment.simulation, champion.genes, own, first)


def compile_first_look(
    experiment: ExperimentParts, least: float
) -> Callable[[Champion, float | None], Check]:
    """Compile the only check that `train` makes, before there is a champion.

    Args:
        experiment: experiment that is being evolved.
        least: smallest allowed fraction of the displacement that is kept at half the physics step.

    Returns:
        A function of a champion and its displacement, m. Pass None with noise: the function then
        measures the displacement with fresh noise.
    """
    own = experiment.simulation
    simulations = [conditions.finer(own, 2)]
    if not own.noise.silent:
        simulations.insert(0, own)
    places = [Variation("", (simulation,), draws_of(own)) for simulation in simulations]
    programs = [conditions.compile_variation(experiment, place) for place in places]
    shortest = _LEAST_DISPLACEMENT * length_of(experiment.creature)

    def look(champion: Champion, own_displacement: float | None) -> Check:
        displacements = [
            float(live(champion).mean_displacements(place)[0])
            for live, place in zip(programs, places, strict=True)
        ]
        if own_displacement is not None:
            displacements.insert(0, own_displacement)
        displacement, half = displacements
        question, detail = "displacement kept: half the step", f"{half:.3g} of {displacement:.3g} m"
        if not displacement > shortest:
            return Check("half_step", question, 1.0, detail=detail)
        fraction = float(np.clip(half / displacement, 0.0, 1.0))
        return Check("half_step", question, fraction, least, True, "%", detail)

    return look


def compile_steps(experiment: ExperimentParts) -> Callable[[Champion], tuple[Trial, ...]]:
    """Return a function that replays all trials of a champion, step by step."""
    simulation, numbers = experiment.simulation, situation_numbers(experiment)
    live = compile_trials(simulation, population_mesh(1), observers=EachPhysicsStep())

    def of(champion: Champion) -> tuple[Trial, ...]:
        keys = jax.device_get(champion_keys(experiment, champion))
        genes = np.asarray(champion.genes, np.float32)[:, None]
        trials = []
        for i in range(experiment.trials):
            own = None if keys is None else keys[:, i : i + 1]
            number = None if numbers is None else numbers[i : i + 1]
            steps = live(genes, own, number)
            place = 0 if numbers is None else i
            trials.append(
                Trial(
                    steps,
                    ledger(simulation.world, steps, simulation.step_length),
                    excursions(simulation, experiment.creature, steps, place),
                )
            )
        return tuple(trials)

    return of


def books(
    experiment: ExperimentParts, champion: Champion, trials: tuple[Trial, ...], limits: Limits
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

    checks = [
        check(
            "simulator_energy",
            "unaccounted energy / motors' work",
            max(_energy_gain(one, h) / _effort(one) for one in ledgers),
            detail=_ledger_words(ledgers[0]),
        ),
        *_of_momentum(simulation, ledgers, check),
        check(
            "limit_energy",
            "work of joint limits / motors' work",
            max(_given(one, one.limits) for one in ledgers),
        ),
        check("speed", "highest speed of the root", worst("peak_speed") / length, "lengths/s"),
        check("power", "peak power of all motors", worst("peak_power") / mass, "W/kg"),
        Check("peak_torque", "peak torque of a motor", worst("peak_torque"), unit="N m"),
        Check("mean_power", "mean power of all motors", worst("mean_power") / mass, unit="W/kg"),
        Check("peak_rate", "highest joint rate", worst("peak_rate"), unit="rad/s"),
    ]
    world = simulation.world
    if np.isfinite(world.tree.torque_limit).any():
        checks.append(check("overload", "torque above its limit", worst("overload")))
    checks += _between_limbs(experiment, found, ledgers, check)
    if world.contact_model is not None:
        checks += [
            check("penetration", "penetration of the ground", worst("penetration"), "m"),
            check(
                "push_out_energy",
                "push-out work / motors' work",
                max(one.push_out.sum() / _effort(one) for one in ledgers),
            ),
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
    lit = any(light is not None for light in simulation.lights)
    if lit and simulation.sensors.eye_bodies and world.contact_model is not None:
        seen = worst("seen_through_ground")
        checks.append(check("seen_through_ground", "light seen through the ground", seen))
    for name, excess in simulation.task.beyond_scales(champion.terms, champion.scales).items():
        checks.append(check(f"free_{name}", f"{name} without cost to fitness", excess))
    return checks


def _of_momentum(
    simulation: Simulation, ledgers: Sequence[Ledger], check: Callable[..., Check]
) -> list[Check]:
    """Return the check of momentum, or [] if the fixed world holds the root by a joint."""
    if simulation.world.tree.hanging is not None:
        return []
    measured = max(_momentum_fraction(one) for one in ledgers)
    return [check("simulator_momentum", "unaccounted momentum / impulses", measured)]


def _between_limbs(
    experiment: ExperimentParts,
    found: Sequence[Excursions],
    ledgers: Sequence[Ledger],
    check: Callable[..., Check],
) -> list[Check]:
    """Return the checks of limbs that may touch, or [] if no two limbs can meet."""
    checks, world = [], experiment.simulation.world
    if world.pairs is not None or any(np.any(one.limbs) for one in ledgers):
        pushed = max(_given(one, one.limbs) for one in ledgers)
        checks.append(check("limb_energy", "work between limbs / motors' work", pushed))
    passing = _pairs_that_pass(experiment)
    if passing or make_pairs(experiment.creature, world.tree, world.watched) is not None:
        deepest = max(found, key=lambda each: each.overlap)
        words = [" in ".join(deepest.overlapping)] if deepest.overlapping else []
        if passing:
            words.append(f"not checked, because they touch in the neutral pose: {passing}")
        words = "; ".join(words)
        checks.append(check("overlap", "overlap of limbs", deepest.overlap, "m", words))
    return checks


def _pairs_that_pass(experiment: ExperimentParts) -> str:
    """Name the body pairs that touch in the neutral pose. Their overlap is not checked."""
    world = experiment.simulation.world
    found = pairs_that_touch_at_rest(experiment.creature, world.tree, world.watched)
    names = [f"{world.tree.names[i]} and {world.tree.names[j]}" for i, j in found]
    more = [f"{len(names) - _NAMED} more"] if len(names) > _NAMED else []
    return ", ".join(names[:_NAMED] + more)


def _variations(
    experiment: ExperimentParts, config: ExperimentConfig, source: Path, folders: tuple[Path, ...]
) -> dict[str, Variation]:
    """Return variations of the simulation, by the key of the limit that each is checked against.

    Under noise, the champion was selected partly for its luck. So all variations except
    `precision` and `other_engine` use the same fresh noise, and are compared with the variation
    `_CHANCE`.
    """
    simulation = experiment.simulation
    draws = draws_of(simulation)

    def drawn(name: str, *sims: Simulation) -> Variation:
        return Variation(name, sims, draws)

    found = {
        _CHANCE: drawn("new draws of the noise", simulation)
        if draws > 1
        else Variation("other poses", (conditions.shaken(simulation, _SHAKE),), _DRAWS),
        "half_step": drawn("half the step", conditions.finer(simulation, 2)),
        "quarter_step": drawn("a quarter of the step", conditions.finer(simulation, 4)),
        "limp_way": drawn("limp motors", conditions.limp(simulation)),
        "precision": Variation("float64", (simulation,), double=True),
    }
    more_and_less = (1 + _CHANGE, 1 - _CHANGE)
    if simulation.world.contact_model is not None:
        sims = [conditions.with_friction(simulation, x) for x in more_and_less]
        found["friction"] = drawn("friction 10 % up and down", *sims)
    if simulation.world.water is not None:
        sims = [conditions.with_drag(simulation, x) for x in more_and_less]
        found["drag"] = drawn("drag 10 % up and down", *sims)
        other = _other_points(config, source, folders)
        found["surface_points"] = drawn("other surface points", other)
    if described(simulation.engine)["engine"] == "native":
        plain = dataclasses.replace(simulation, engine=Engine("jax"))
        found["other_engine"] = Variation("plain JAX", (plain,))
    if simulation.lights[0] is not None and simulation.sensors.eye_bodies:
        found["blind"] = drawn("blind", blinded(simulation))
    return found


def draws_of(simulation: Simulation) -> int:
    """Return the number of trials that a displacement is averaged over: one without noise."""
    return 1 if simulation.noise.silent else _TRIALS


def _other_points(config: ExperimentConfig, source: Path, folders: tuple[Path, ...]) -> Simulation:
    """Return the simulation with other surface points for the water."""
    water = config.world.water
    assert water is not None
    if water.points == "random":
        changed = {"points_seed": water.points_seed + 1}
    else:
        changed = {
            "form_resolution": water.form_resolution + 1,
            "skin_resolution": water.skin_resolution + 1,
        }
    world = config.world.model_copy(update={"water": water.model_copy(update=changed)})
    changed = config.model_copy(update={"world": world})
    return build_experiment(changed, source, folders).simulation


def _replay(champion: Champion, replayed: Varied) -> Check:
    off = abs(float(replayed.fitness[0]) - champion.fitness) / max(abs(champion.fitness), _REPLAY)
    return Check("replay", "error of the replayed fitness", off, _REPLAY, unit="%")


def _carried(experiment: ExperimentParts, trials: Sequence[Trial]) -> float:
    """Return the displacement of a point that keeps the flow's velocity at the start, m.

    The result is the mean over trials.
    """
    simulation, numbers = experiment.simulation, situation_numbers(experiment)
    water, displacements = simulation.world.water, []
    if water is None:
        return 0.0
    for i, trial in enumerate(trials):
        start = np.asarray(trial.steps.before.position[:, :1], float)
        flow = water.velocity(jnp.asarray(start))
        flow = np.broadcast_to(np.asarray(flow, float), start.shape)
        if start[2] > simulation.world.water_level:
            flow = 0.0 * flow
        light = simulation.lights[0 if numbers is None else i]
        displacements.append(
            displacement(np.hstack([start, start + simulation.duration * flow]), light)
        )
    return float(np.mean(displacements))


def _kept(
    own: float,
    kept: dict[str, tuple[Variation, Varied]],
    limits: Limits,
    creature: Creature,
    carried: float = 0.0,
) -> list[Check]:
    """Return checks of the displacement that a champion keeps in conditions.

    Args:
        own: displacement in the unchanged simulation, m.
        kept: results of the variations, by the key of the limit.
        limits: smallest allowed fractions.
        creature: the animal.
        carried: displacement by the water alone, m.
    """
    checks = [Check("way", "displacement in its own trials", own, unit="m")]
    if not own > _LEAST_DISPLACEMENT * length_of(creature):
        return checks
    chance, drawn = kept[_CHANCE]
    # Mean displacement with fresh noise: the reference of the other variations with several draws.
    # Without noise, only the variation of poses has several draws.
    usual = float(drawn.mean_displacements(chance)[0])
    for key, (variation, one) in kept.items():
        of_own = variation.draws == 1 or key == _CHANCE
        reference = own if of_own else usual
        displacements = one.mean_displacements(variation)
        detail = ", ".join(f"{x:.3g}" for x in displacements) + f" of {reference:.3g} m"
        if key == "limp_way":
            # Subtract the displacement by the flow. From the limp animal's displacement, subtract
            # it only if it is positive.
            swum, limp = reference - carried, float(displacements.max()) - max(0.0, carried)
            if carried > 0 and swum <= _LEAST_DISPLACEMENT * length_of(creature):
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


def _energy_gain(one: Ledger, h: float) -> float:
    """Return the unaccounted energy, J, summed over the stretches in which energy is gained."""
    length = max(1, round(_STRETCH / h))
    starts = np.arange(0, len(one.stored), length)
    return float(np.maximum(np.add.reduceat(one.left_over, starts), 0.0).sum())


def _given(one: Ledger, work: np.ndarray) -> float:
    """Return the positive net work of a constraint, relative to the motors' work."""
    return max(0.0, float(work.sum())) / _effort(one)


def _momentum_fraction(one: Ledger) -> float:
    given = one.given.sum()
    return float(np.linalg.norm(one.impulse.sum(1)) / given) if given > 0 else 0.0


def _effort(one: Ledger) -> float:
    """Return the motors' work, J. If that is zero, return all work, or infinity."""
    done = sum(np.abs(each).sum() for each in one.work.values())
    return one.effort or float(done) or np.inf


def _energy(one: Ledger) -> dict[str, float]:
    """Return the energies of a trial by name, J."""
    parts = {name: float(value.sum()) for name, value in one.work.items()}
    left_over = float(one.left_over.sum())
    return {"stored": float(one.stored.sum()), **parts, "left_over": left_over}


def _ledger_words(one: Ledger) -> str:
    parts = [f"{name} {value.sum():.3g}" for name, value in one.work.items() if np.any(value)]
    return f"{', '.join(parts)}, left over {one.left_over.sum():.3g} J"
