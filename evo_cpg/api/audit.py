"""Audit of a champion: real gait or artefact of the simulation?"""

import dataclasses
import functools
import math
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from evo_cpg.analysis.energy import ledger
from evo_cpg.analysis.excursions import excursions
from evo_cpg.analysis.second_opinion import (
    ControllerInLoop,
    DivergedError,
    Opinion,
    own_opinion,
    second_opinion,
)
from evo_cpg.analysis.verdict import Check, Verdict, limits_from
from evo_cpg.api.audit_checks import (
    CHANCE,
    LEAST_DISPLACEMENT,
    AuditedTrial,
    books,
    carried_by_flow,
    displacement_checks,
    opinion_checks,
)
from evo_cpg.api.progress import working
from evo_cpg.api.run_start import now
from evo_cpg.api.runs import REPLAY_TOLERANCE, open_champion
from evo_cpg.creature.creature import length_of
from evo_cpg.errors import UsageError, advise
from evo_cpg.files import make_folder
from evo_cpg.io.build import build_experiment
from evo_cpg.io.models.refusals import ExchangeError
from evo_cpg.io.run import Run, class_folders
from evo_cpg.io.schema.experiment import ExperimentConfig
from evo_cpg.io.trust import trusting
from evo_cpg.native.engine import Engine, described
from evo_cpg.simulation.limits import Limits
from evo_cpg.simulation.observers import EachPhysicsStep, PhysicsSteps
from evo_cpg.simulation.rollout import rollout
from evo_cpg.simulation.simulation import Simulation
from evo_cpg.training import conditions
from evo_cpg.training.checkpoint import Champion
from evo_cpg.training.conditions import Variation, Varied, blinded
from evo_cpg.training.experiment import ExperimentParts, champion_keys, situation_numbers
from evo_cpg.training.run_folder import RunFolder

# Relative change of friction and drag in the conditions.
_CHANGE = 0.1

# Variation of the initial pose: standard deviation of joint angles, roll and pitch, rad, and number
# of draws.
_SHAKE, _DRAWS = 0.01, 8

# With noise: number of fresh trials that a displacement is averaged over.
_TRIALS = 16


@dataclasses.dataclass(frozen=True)
class Audit:
    """Result of an audit.

    Attributes:
        champion: audited individual.
        verdict: all checks, with their results.
        trials: trials of the champion in the unchanged simulation.
        step_length: duration of a physics step, s.
        opinions: results of the first trial: ours, then MuJoCo's. Empty without MuJoCo's.
        missing: reason why second opinions are missing, or empty if none is missing.
    """

    champion: Champion
    verdict: Verdict
    trials: tuple[AuditedTrial, ...]
    step_length: float
    opinions: tuple[Opinion, ...] = ()
    missing: str = ""

    def __repr__(self) -> str:
        return f"Audit(passed={self.verdict.passed}, {len(self.verdict.checks)} checks)"

    @property
    def passed(self) -> bool:
        """Whether no check fails."""
        return self.verdict.passed

    @property
    def measured(self) -> dict[str, float]:
        """Results of the checks by key."""
        return {check.key: float(check.measured) for check in self.verdict.checks}

    def as_dict(self) -> dict[str, Any]:
        """Return the contents of ``audit.json``."""
        champion, verdict = self.champion, self.verdict
        ledgers = [trial.ledger for trial in self.trials]
        return {
            "passed": verdict.passed,
            "confirmed": verdict.confirmed,
            "confirmation": verdict.confirmation,
            "reasons": verdict.reasons,
            "run": champion.run,
            "generation": champion.generation,
            "fitness": champion.fitness,
            "expected": champion.expected,
            "checks": [
                check._asdict() | {"measured": float(check.measured), "passed": check.passed}
                for check in verdict.checks
            ],
            # Energies of each trial by name, J.
            "energy": [
                {"stored": float(one.stored.sum())}
                | {name: float(value.sum()) for name, value in one.work.items()}
                | {"left_over": float(one.left_over.sum())}
                for one in ledgers
            ],
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

    def save(self, folder: Path | str, name: str = "audit", title: str = "") -> list[Path]:
        """Write the results as JSON and draw energy and paths, and return the paths of both files.

        Raises:
            OutputError: the files cannot be written.
        """
        from evo_cpg.view.answer_plots import audit_figure
        from evo_cpg.view.figure import save_figure

        table = make_folder(Path(folder)) / f"{name}.json"
        RunFolder(folder).write_json(table.name, self.as_dict() | {"made": now()})
        figure = audit_figure(
            self.trials[0].ledger,
            self.step_length,
            [
                check
                for check in self.verdict.checks
                if check.unit == "%" and (check.least or check.key.endswith("_way"))
            ],
            {one.program: one.path for one in self.opinions},
            title + (", not confirmed" if self.verdict.confirmed is False else ""),
        )
        return [table, save_figure(figure, Path(folder) / "plots" / f"{name}.png")]


def audit(
    run: Path | str,
    limits: Sequence[str] = (),
    number: int | None = None,
    cell: str | None = None,
    trust: bool = False,
) -> Audit:
    """Check whether a run's champion exploits the simulation.

    Args:
        run: run folder.
        limits: limits to change, such as ``["half_step=0.8"]``.
        number: number of one of several runs side by side, or None for the best.
        cell: audit the elite of this cell of the run's map, such as ``3,0,7``.
        trust: whether to trust the configuration, see `load`.

    Raises:
        LimitError: there is no such limit, or its value is wrong.
        RunFolderError: there is no run, or it has no champion.
        UsageError: the run has no such champion or cell.
    """
    limits_from(limits)
    with trusting(trust):
        opened = open_champion(run, number, cell=cell)
        (made,) = audited(opened, [opened.champion], limits)
    return made


def audit_runs(run: Path | str, limits: Sequence[str] = (), trust: bool = False) -> list[Audit]:
    """Audit the champions of all runs side by side, with one program for each variation.

    Raises:
        LimitError: there is no such limit, or its value is wrong.
        RunFolderError: there is no run.
        UsageError: no run has a champion.
    """
    limits_from(limits)
    with trusting(trust):
        opened = open_champion(run)
        checkpoint = opened.folder.load()
        champions = checkpoint.champions if checkpoint else ()
        found = [champion for champion in champions if champion is not None]
        if not found:
            raise UsageError(f"{run} has no champion in its checkpoints")
        for number, champion in enumerate(champions):
            if champion is None:
                advise(f"{run}: run {number} has no champion to audit: every individual diverged")
        return audited(opened, found, limits)


def audited(opened: Run, champions: Sequence[Champion], limits: Sequence[str] = ()) -> list[Audit]:
    """Audit individuals of a run, each with the fitness that it had there, in their order.

    Raises:
        LimitError: there is no such limit, or its value is wrong.
    """
    opened.require_configured()
    allowed = limits_from(limits, opened.config.audit.limits())
    source, folders = opened.folder.config, class_folders(opened.folder)
    with working("auditing: compiling for each of several simulations") as work:

        def tell(what: str, done: int, total: int) -> None:
            work.doing(f"auditing, {done + 1} of {total}: {what}")

        groups, found = [(opened, champions, ())], []
        simulation = opened.experiment.simulation
        if simulation.has_own_bodies or simulation.draws is not None:
            # Each body and course has an experiment of its own. The numbers of its replay are no
            # constants, as in training, because a walker's path depends on their rounding.
            replayed = _replay(opened.experiment, champions)
            runs = (dataclasses.replace(opened, individual=one) for one in champions)
            owns = [run.on_course() for run in runs]
            if simulation.draws is not None:
                # Displacements are compared on the first course. Fitness is that of all courses.
                alone = [_replay(own.experiment, [own.champion])[0] for own in owns]
                replayed = [
                    whole._replace(displacement=one.displacement)
                    for whole, one in zip(replayed, alone, strict=True)
                ]
            pairs = zip(owns, replayed, strict=True)
            groups = [(own, [own.champion], [one]) for own, one in pairs]
        for own, some, before in groups:
            given = allowed, own.config, source, folders, tell, before
            found += audits(own.experiment, some, *given)
        return found


def audits(
    experiment: ExperimentParts,
    champions: Sequence[Champion],
    limits: Limits,
    config: ExperimentConfig,
    source: Path,
    folders: Iterable[Path] = (),
    tell: Callable[[str, int, int], None] = lambda what, done, total: None,
    replayed: Sequence[Varied] = (),
) -> list[Audit]:
    """Audit champions. Each program is compiled once for all champions.

    The results of a replay as they evolved (`_replay`) can be given.
    """
    simulation = experiment.simulation
    others = _variations(experiment, config, source, tuple(folders))
    total = len(others) + 3
    tell("replaying the champions", 0, total)
    replayed = replayed or _replay(experiment, champions)
    champions = [with_all_terms(*both) for both in zip(champions, replayed, strict=True)]
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
        off = abs(float(alive.fitness[0]) - champion.fitness)
        off /= max(abs(champion.fitness), REPLAY_TOLERANCE)
        checks = [
            Check("replay", "error of the replayed fitness", off, REPLAY_TOLERANCE, unit="%"),
            *displacement_checks(
                float(np.nanmean(alive.displacement)),
                found,
                limits,
                experiment.creature,
                carried_by_flow(experiment, steps),
            ),
            *opinion_checks(experiment, opinions, diverged),
            *books(experiment, champion, steps, limits),
        ]
        verdict = Verdict(tuple(checks))
        made.append(Audit(champion, verdict, steps, simulation.step_length, opinions, missing))
    return made


def _replay(experiment: ExperimentParts, champions: Sequence[Champion]) -> list[Varied]:
    own = Variation("as it evolved", (experiment.simulation,))
    live = conditions.compile_variation(experiment, own)
    return [live(champion) for champion in champions]


def with_all_terms(champion: Champion, replayed: Varied) -> Champion:
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
    keys, numbers = champion_keys(experiment, champion), situation_numbers(experiment)
    own = None if keys is None else keys[:, :1]
    first = None if numbers is None else jnp.asarray(numbers[:1])
    # Drives the champion in its first trial.
    brain = ControllerInLoop(simulation, champion.genes, own, first)
    modes: list[tuple[bool, ControllerInLoop | None]] = [(False, None)]
    if simulation.world.contact_model is not None:
        modes.append((True, None))
        if simulation.controller.uses_senses:
            modes.append((True, brain))
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
    simulations = [dataclasses.replace(own, substeps=2 * own.substeps)]
    if not own.silent:
        simulations.insert(0, own)
    places = [Variation("", (simulation,), draws_of(own)) for simulation in simulations]
    programs = [conditions.compile_variation(experiment, place) for place in places]
    shortest = LEAST_DISPLACEMENT * length_of(experiment.creature)

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


def compile_steps(experiment: ExperimentParts) -> Callable[[Champion], tuple[AuditedTrial, ...]]:
    """Return a function that replays all trials of a champion, step by step."""
    simulation, numbers = experiment.simulation, situation_numbers(experiment)
    live = jax.jit(functools.partial(rollout, simulation, observers=EachPhysicsStep()))

    def of(champion: Champion) -> tuple[AuditedTrial, ...]:
        keys = jax.device_get(champion_keys(experiment, champion))
        genes = np.asarray(champion.genes, np.float32)[:, None]
        trials = []
        for i in range(experiment.trials):
            own = None if keys is None else keys[:, i : i + 1]
            number = None if numbers is None else numbers[i : i + 1]
            steps = jax.device_get(live(genes, own, number))
            place = 0 if numbers is None else i
            trials.append(
                AuditedTrial(
                    steps,
                    ledger(simulation.world, steps, simulation.step_length),
                    excursions(simulation, experiment.creature, steps, place),
                )
            )
        return tuple(trials)

    return of


def _variations(
    experiment: ExperimentParts, config: ExperimentConfig, source: Path, folders: tuple[Path, ...]
) -> dict[str, Variation]:
    """Return variations of the simulation, by the key of the limit that each is checked against.

    Under noise, the champion was selected partly for its luck. So all variations except
    `precision` and `other_engine` use the same fresh noise, and are compared with the variation
    `CHANCE`.
    """
    simulation = experiment.simulation
    draws, noise = draws_of(simulation), simulation.noise
    # In every draw, the angles of the joints and the root's roll and pitch start differently.
    angles = {"joint_angle": max(noise.joint_angle, _SHAKE), "tilt": max(noise.tilt, _SHAKE)}
    shaken = dataclasses.replace(simulation, noise=dataclasses.replace(noise, **angles))
    half, quarter = (
        dataclasses.replace(simulation, substeps=times * simulation.substeps) for times in (2, 4)
    )
    found = {
        CHANCE: Variation("new draws of the noise", (simulation,), draws)
        if draws > 1
        else Variation("other poses", (shaken,), _DRAWS),
        "half_step": Variation("half the step", (half,), draws),
        "quarter_step": Variation("a quarter of the step", (quarter,), draws),
        "limp_way": Variation("limp motors", (conditions.limp(simulation),), draws),
        "precision": Variation("float64", (simulation,), double=True),
    }
    more_and_less = (1 + _CHANGE, 1 - _CHANGE)
    if simulation.world.contact_model is not None:
        worlds = (simulation.world.with_friction(x) for x in more_and_less)
        sims = tuple(dataclasses.replace(simulation, world=world) for world in worlds)
        found["friction"] = Variation("friction 10 % up and down", sims, draws)
    if simulation.world.water is not None:
        worlds = (simulation.world.with_drag(x) for x in more_and_less)
        sims = tuple(dataclasses.replace(simulation, world=world) for world in worlds)
        found["drag"] = Variation("drag 10 % up and down", sims, draws)
        settings = config.world.water
        assert settings is not None
        changed = {"points_seed": settings.points_seed + 1}
        if settings.points != "random":
            changed = {
                "form_resolution": settings.form_resolution + 1,
                "skin_resolution": settings.skin_resolution + 1,
            }
        water = settings.model_copy(update=changed)
        world = config.world.model_copy(update={"water": water})
        other = config.model_copy(update={"world": world})
        moved = build_experiment(other, source, folders).simulation
        found["surface_points"] = Variation("other surface points", (moved,), draws)
    if described(simulation.engine)["engine"] == "native":
        plain = dataclasses.replace(simulation, engine=Engine("jax"))
        found["other_engine"] = Variation("plain JAX", (plain,))
    # A blind animal may swim as far as others and still miss every light that moves.
    moves = simulation.task.moves_light
    if simulation.lights[0] is not None and simulation.sensors.eye_bodies and not moves:
        found["blind"] = Variation("blind", (blinded(simulation),), draws)
    return found


def draws_of(simulation: Simulation) -> int:
    """Return the number of trials that a displacement is averaged over: one without noise."""
    return 1 if simulation.silent else _TRIALS
