"""The cases with a moving animal: swimmer, salamander, quadruped, animals of gymnasium.

Each case measures physics alone, with the commands of an `Exercise`. It also measures the whole
stack (brain, oscillators, sensors, physics, fitness) of a trial, as in training. Both are compared
with the physics of the peers.
"""

import dataclasses
import functools
import statistics
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from jax.sharding import Mesh

from benchmarks.accuracy import mujoco_error, our_error
from benchmarks.exercise import Exercise
from benchmarks.jax_peers import Entry, JaxPeer, entered
from benchmarks.memory import peak_of_motion
from benchmarks.mujoco_peer import Kind, Motion, kinds, stopped
from benchmarks.ours import Program, compile_motion, full_lanes
from benchmarks.plan import Plan, random_genes
from benchmarks.rows import Row, finite
from benchmarks.timing import Contender, count_lasting, race, ratio_quartiles, seconds
from evo_cpg.simulation.judge import Outcome
from evo_cpg.training.devices import population_mesh
from evo_cpg.training.evaluate import compile_trials

UNIT = "steps/s"
PHYSICS, WHOLE = "physics", "whole stack"
# Fewest and most physics steps of a call, and the fewest of ours. Every block of ours takes some
# milliseconds to start, which is negligible in a trial of thousands of steps.
_FEWEST, _MOST = 10, 20_000
_FEWEST_OF_OURS = 1000
# Least number of control steps of a trial in a quick run. The fitness of a shorter trial means
# little, and some tasks refuse to compute it.
_FEWEST_CONTROL_STEPS = 60
# Speed of the whole stack relative to the physics, for the length of its calls. A measurement would
# need another compilation. Calls are no shorter than the config's trial, unless the run is quick.
_TRIAL_FRACTION = 0.6
# Start of MuJoCo's timing, s, because its cost depends on contacts at that time. This number of
# individuals moves until then, and the others start from copies of them.
_SETTLED, _SETTLING = 1.0, 64
# Population whose cost per individual is compared with the cost in the largest population.
_USUAL = 200


class Animal(NamedTuple):
    """A case with a moving animal.

    Attributes:
        case: name of the case.
        exercise: exercise of the animal.
        sizes: sizes of its populations, the usual one first.
        guests: peers in JAX, which compile long, only with the size nearest to the usual one.
        flops: scalar operations in a physics step of one individual, or None if not counted.
        memory_sizes: populations whose peak memory is measured, unless the run is quick.
    """

    case: str
    exercise: Exercise
    sizes: tuple[int, ...]
    guests: tuple[JaxPeer, ...] = ()
    flops: int | None = None
    memory_sizes: tuple[int, ...] = ()


class _Ours(NamedTuple):
    """Results of our physics, or of our whole stack."""

    part: str
    contender: Contender
    compile_seconds: float
    lost: int
    temporary: int | None = None
    memory: int | None = None
    error: float | None = None
    flops: int | None = None


class _Theirs(NamedTuple):
    """Results of one peer."""

    name: str
    contender: Contender | None
    error: float | None
    note: str | None
    how: str


def measure(animal: Animal, plan: Plan, peak: float) -> Iterator[Row]:
    """Yield all rows of an animal, size by size, as soon as a size is measured.

    Args:
        animal: the animal.
        plan: settings of the measurement.
        peak: rate of the machine's float32 matrix product, 1/s.
    """
    mesh, sizes = population_mesh(), plan.sizes_or(*animal.sizes)
    guest_size = min(sizes, key=lambda size: abs(size - animal.sizes[0]))
    rows: list[Row] = []
    plan.say(f"{animal.case}: accuracy")
    errors = _errors(animal.exercise, mesh, plan.cores)
    for size in sorted(sizes):
        plan.say(f"{animal.case}, {size} individuals: compiling")
        program = compile_motion(
            animal.exercise, animal.exercise.lanes(full_lanes(size, mesh)), mesh
        )
        guests = animal.guests if size == guest_size else ()
        with entered(guests, animal.exercise, size, plan) as entries:
            found = _at_size(animal, size, program, errors, entries, mesh, plan, peak)
        rows += found
        yield from found
    yield from _growth(animal.case, rows)


def _errors(exercise: Exercise, mesh: Mesh, threads: int) -> dict[str, float | None]:
    """Return the errors of MuJoCo's kinds by name, and ours under the empty name.

    Errors are in body lengths, None if they are not finite.
    """
    theirs = {kind.name: finite(mujoco_error(exercise, kind, threads)) for kind in kinds(exercise)}
    return {"": finite(our_error(exercise, mesh)), **theirs}


def _at_size(
    animal: Animal,
    size: int,
    program: Program,
    errors: dict[str, float | None],
    entries: list[Entry],
    mesh: Mesh,
    plan: Plan,
    peak: float,
) -> list[Row]:
    """Return all rows of one population size, raced together."""
    steps = count_lasting(
        lambda count: functools.partial(program.run, count),
        plan.call_seconds,
        _FEWEST_OF_OURS,
        _MOST,
    )
    measured = size in animal.memory_sizes and not plan.quick
    ours = [
        _Ours(
            PHYSICS,
            Contender(PHYSICS, size * steps, functools.partial(program.run, steps)),
            program.compile_seconds,
            int((~np.isfinite(program.run(steps)[:, :size])).any(0).sum()),
            program.temporary,
            peak_of_motion(animal.case, size, plan) if measured else None,
            errors[""],
            animal.flops,
        ),
        _whole_stack(animal.exercise, size, steps, mesh, plan.quick),
    ]
    theirs = [
        _mujoco(animal.exercise, kind, size, errors[kind.name], plan)
        for kind in kinds(animal.exercise)
    ]
    for entry in entries:
        how = f"float32, {entry.peer.integrator}, jit(vmap(scan))"
        if entry.compile_seconds is not None:
            how += f" that took {entry.compile_seconds:.0f} s to build"
        theirs.append(_Theirs(entry.peer.name, entry.contender, None, entry.note, how))
    plan.say(f"{animal.case}, {size} individuals: racing")
    present = [their.contender for their in theirs if their.contender is not None]
    rates = race([*(our.contender for our in ours), *present], plan.repeats)
    h = animal.exercise.experiment.simulation.step_length
    return [
        _row(animal.case, size, our, their, rates, h, plan, peak)
        for our in ours
        for their in theirs
        if our.part == PHYSICS or their.contender is not None
    ]


def _whole_stack(exercise: Exercise, size: int, steps: int, mesh: Mesh, quick: bool) -> _Ours:
    simulation = exercise.experiment.simulation
    fewest = _FEWEST_CONTROL_STEPS if quick else simulation.steps
    trial = max(round(_TRIAL_FRACTION * steps / simulation.substeps), fewest)
    simulation = dataclasses.replace(simulation, steps=trial)
    genes = random_genes(simulation, size)
    live: Callable[[], Outcome] = functools.partial(compile_trials(simulation, mesh), genes)
    first = seconds(live)
    lost = int((~live().alive).sum())
    contender = Contender(WHOLE, size * trial * simulation.substeps, live)
    return _Ours(WHOLE, contender, max(first - seconds(live), 0.0), lost)


def _mujoco(exercise: Exercise, kind: Kind, size: int, error: float | None, plan: Plan) -> _Theirs:
    h = exercise.experiment.simulation.step_length
    few = Motion(exercise, kind, exercise.lanes(min(size, _SETTLING)), plan.cores)
    first = round(_SETTLED / h)
    settled = few.states(few.rest(), few.signals(first))[:, -1]
    motion = Motion(exercise, kind, exercise.lanes(size), plan.cores)
    start = settled[np.arange(size) % len(settled)]

    def prepare(count: int) -> Callable[[], np.ndarray]:
        return functools.partial(motion.states, start, motion.signals(count, first))

    steps = count_lasting(prepare, plan.call_seconds, _FEWEST, _MOST)
    call = prepare(steps)
    lost = int(stopped(call(), (first + steps) * h).sum())
    note = f"{lost} of {size} diverged" if lost else None
    how = f"float64, implicitfast, mujoco.rollout with {plan.cores} threads, {steps} steps"
    return _Theirs(kind.name, Contender(kind.name, size * steps, call), error, note, how)


def _row(
    case: str,
    size: int,
    our: _Ours,
    their: _Theirs,
    rates: dict[str, list[float]],
    h: float,
    plan: Plan,
    peak: float,
) -> Row:
    rate = statistics.median(rates[our.part])
    flops = rate * our.flops if our.flops else None
    steps = round(our.contender.work / size)
    row = Row(
        case,
        our.part,
        size,
        rate,
        UNIT,
        f"h = 1/{round(1 / h)} s, {plan.cores} cores each, median of {plan.repeats} rounds in "
        f"turn. Ours: float32, {steps} steps, {our.lost} diverged. {their.name}: {their.how}",
        our.compile_seconds,
        our.temporary,
        our.memory,
        our.error,
        flops,
        flops / peak if flops else None,
        their.name,
        peer_error=their.error if our.part == PHYSICS else None,
        note=their.note,
    )
    if their.contender is None:
        return row
    low, ratio, high = ratio_quartiles(rates, our.part, their.name)
    return dataclasses.replace(
        row, peer_rate=statistics.median(rates[their.name]), ratio=ratio, ratio_spread=(low, high)
    )


def _growth(case: str, rows: list[Row]) -> list[Row]:
    """Return a row per part, which compares the largest population with the usual one.

    A ratio of 1 is an equal cost per individual.
    """
    found = []
    for part in (PHYSICS, WHOLE):
        rates = {row.size: row.rate for row in rows if row.part == part}
        most = max(rates)
        if _USUAL in rates and most > _USUAL:
            how = "rates of two races of the same run, so the ratio has no spread"
            found.append(
                Row(
                    case,
                    f"{part}, large",
                    most,
                    rates[most],
                    UNIT,
                    how,
                    peer=f"ours, {_USUAL} individuals",
                    peer_rate=rates[_USUAL],
                    ratio=rates[most] / rates[_USUAL],
                )
            )
    return found
