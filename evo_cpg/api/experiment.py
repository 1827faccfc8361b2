"""An experiment to be called from Python: individuals first, as NumPy and evosax have them.

Inside the library individuals are the last axis of every array; here, and only here, they are
turned round.
"""

import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from evo_cpg.api.bodies import Bodies, Numbers
from evo_cpg.api.environment import Environment
from evo_cpg.api.fitness import JudgedBy, fitness_function
from evo_cpg.api.progress import working
from evo_cpg.api.record import Record, as_record
from evo_cpg.config.build import build_experiment
from evo_cpg.config.numbers import number_at, with_numbers
from evo_cpg.config.own_checks import described, is_real
from evo_cpg.config.parameters import parametrise
from evo_cpg.config.schema.experiment import ExperimentConfig
from evo_cpg.creature.creature import Creature
from evo_cpg.evolution.strategy import Evaluation
from evo_cpg.physics.world import World
from evo_cpg.simulation.judge import Outcome, no_terms
from evo_cpg.simulation.recording import Recorder, as_recording
from evo_cpg.simulation.rollout import rollout
from evo_cpg.simulation.task import Task
from evo_cpg.training import experiment as training
from evo_cpg.training.devices import population_mesh

Terms = Mapping[str, Float[Array, " *n"]]

# Number of individuals that a fitness function is tried on first.
_SEVERAL = 7


@dataclasses.dataclass(frozen=True)
class Trials:
    """What the trials of a population amounted to, not yet judged.

    Attributes:
        terms: the task's terms by name.
        alive: False where an individual diverged.
    """

    terms: dict[str, np.ndarray]
    alive: np.ndarray

    def __repr__(self) -> str:
        names, (count, trials) = ", ".join(self.terms), self.alive.shape
        return (
            f"Trials(individuals={count}, trials={trials}, diverged={int((~self.alive).sum())}, "
            f"terms: {names})"
        )


class Experiment:
    """A creature in a world with a nervous system and a task; made by `evo_cpg.load`.

    Nothing in it changes: what evaluates, records or replaces gives something new.

    Attributes:
        config: the complete configuration.
        source: file that it came from.
        replaced: what was replaced in Python, and the configuration does not say.
        parts: what it is made of, which is not part of the stable interface.
    """

    def __init__(
        self,
        parts: training.Experiment,
        config: ExperimentConfig,
        source: Path,
        replaced: tuple[str, ...] = (),
    ):
        self.parts, self.config, self.source, self.replaced = parts, config, source, replaced
        self._compiled: set[tuple] = set()

    def __repr__(self) -> str:
        simulation, strategy = self.parts.simulation, self.parts.strategy
        search = f"{type(strategy).__name__} of {self.population} for {self.parts.generations}"
        parts_of = {
            "creature": self.creature,
            "world": self.world,
            "genes": self.gene_count,
            "task": type(self.task).__name__,
            "trials": f"{self.trials} of {simulation.duration:.4g} s",
            "search": f"{search} generations",
        }
        parts = [repr(self.name), *(f"{name}={value}" for name, value in parts_of.items())]
        return f"Experiment({', '.join(parts)})"

    def __getstate__(self) -> dict[str, Any]:
        """Return what it is made of, without compiled programs, which no other process can use."""
        # Measuring the scales again takes a generation, and another machine may round differently.
        kept = ("parts", "config", "source", "replaced", "scales")
        return {name: value for name, value in vars(self).items() if name in kept}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._compiled = set()

    @property
    def name(self) -> str:
        """Name in the configuration."""
        return self.parts.name

    @property
    def creature(self) -> Creature:
        """The animal."""
        return self.parts.creature

    @property
    def world(self) -> World:
        """The animal in its surroundings."""
        return self.parts.simulation.world

    @property
    def task(self) -> Task:
        """The task that gives its fitness."""
        return self.parts.simulation.task

    @property
    def gene_count(self) -> int:
        """Numbers in a genome."""
        return self.parts.simulation.genome.count

    @property
    def population(self) -> int:
        """Individuals in a generation, as the configuration has it."""
        return self.parts.strategy.population

    @property
    def trials(self) -> int:
        """Trials of every individual."""
        return self.parts.trials

    def random_genomes(self, key: ArrayLike, count: int | None = None) -> np.ndarray:
        """Genomes of a first generation, ``(count, genes)``.

        Args:
            key: of all chance: a number, or a key of JAX.
            count: how many; None for the configuration's population.
        """
        shape = (self.population if count is None else count,)
        return np.asarray(self.parts.simulation.genome.random(_key(key), shape)).T.copy()

    def rollout(self, key: ArrayLike, genomes: ArrayLike, bodies: Numbers | None = None) -> Trials:
        """Let every individual live through its trials.

        Args:
            key: of the noise in the trials, if there is any: a number, or a key of JAX.
            genomes: ``(n, genes)``.
            bodies: numbers of the configuration in which individuals differ, such as sizes and
                densities: by their keys, ``(n,)``. One program builds all bodies, and it serves all
                populations with the same keys. Bodies that do not fit its plan are built by
                themselves, which takes some 10 to 50 ms each (see docs/models/bodies.md).

        Returns:
            Terms and survival, ``(n, trials)``.

        Raises:
            ValueError: the genomes, or the numbers of the bodies, are not of that shape.
            ConfigError: numbers that are none of the configuration, that are not allowed, or that
                change more than numbers of the simulation.
        """
        genes = self._genes(genomes)
        count, trials = genes.shape[1], self.trials
        numbers = training.situation_numbers(self.parts)
        given = (
            genes,
            jax.device_get(self._noise(_key(key), count)),
            None if numbers is None else np.tile(numbers, count),
            trials,
        )
        with self._compiling("trials", f"{count} individuals", ("trials", count, *(bodies or ()))):
            own = self._bodies.trials(bodies, count) if bodies else None
            outcome = own[0](*given, own[1]) if own else self._run_trials(*given)
        shaped = jax.tree.map(lambda x: x.reshape(count, trials), outcome)
        return Trials(shaped.terms, shaped.alive)

    def evaluate(
        self, key: ArrayLike, genomes: ArrayLike, bodies: Numbers | None = None
    ) -> Evaluation:
        """Fitness, terms and descriptors of a population, on all cores.

        Args:
            key: as for `rollout`.
            genomes: likewise.
            bodies: likewise.

        Raises:
            ValueError: as `rollout` does.
            ConfigError: likewise.
        """
        trials = self.rollout(key, genomes, bodies)
        outcome = Outcome(*jax.tree.map(jnp.asarray, (trials.terms, trials.alive)))
        fitness, mean, in_trials = self._judge(outcome, self.scales)
        terms = {name: np.asarray(term) for name, term in mean.terms.items()}
        found = training.descriptors(self.parts.simulation, mean.terms)
        descriptors = {name: np.asarray(value) for name, value in found.items()}
        return Evaluation(np.asarray(fitness), terms, descriptors, np.asarray(in_trials))

    @functools.cached_property
    def scales(self) -> dict[str, Float[Array, ""]]:
        """The task's yardsticks, which `train` measures on the first generation.

        They are those of the experiment's own seed (and its first run), so the same genome always
        has the same fitness.
        """
        first = self.parts._replace(runs=1)
        shapes = jax.eval_shape(lambda: self.task.scales(no_terms(self.parts.simulation)))
        if not shapes:
            return {}
        genes = np.asarray(jax.jit(lambda: training.first_population(first))())
        keys = jax.device_get(training.generation_keys(first, 0))
        numbers = training.situation_numbers(first)
        numbers = None if numbers is None else np.tile(numbers, genes.shape[1])
        count = genes.shape[1]
        with self._compiling("trials", "the first generation", ("trials", count)):
            outcome = self._run_trials(genes, keys, numbers, self.trials)
        terms = {n: np.where(outcome.alive, x, np.nan) for n, x in outcome.terms.items()}
        return self.task.scales(jax.tree.map(jnp.asarray, terms))

    def fitness_function(
        self, key: ArrayLike = 0, horizon: float | None = None, numbers: Sequence[str] = ()
    ) -> Callable[..., Float[Array, ""]]:
        """The fitness of one genome, for `jax.grad`, `jax.jit` and `jax.vmap`.

        Args:
            key: of the noise in the trials, if there is any: a number, or a key of JAX.
            horizon: let slopes fade to 1/e within so many seconds, which helps where the motion is
                chaotic (see docs/models/gradients.md), and on the ground are cut as well. None for
                slopes that do not fade: exact in water, cut on the ground. `math.inf` for exact
                slopes on the ground, too.
            numbers: keys of numbers of the configuration, such as sizes and densities, whose values
                the function takes as its second argument: building the animal is then a part of it,
                and as differentiable. A derivative by a number at a kink raises an error, and so do
                values with which the trial would be laid out differently. Checking a value takes
                as long as building one animal.

        Raises:
            ConfigError: numbers that are none of the configuration, or change more than numbers.
        """
        own_task = self.task if "task" in self.replaced else None
        parameters = None
        if numbers:
            parameters = parametrise(self.config, self.source, numbers, smooth=False)
        noise = self._noise(_key(key), 1)
        return fitness_function(self.parts, self.scales, noise, horizon, parameters, own_task)

    def record(self, key: ArrayLike, genome: ArrayLike, trial: int = 0) -> Record:
        """One trial of one individual, step by step, in named columns.

        Args:
            key: as for `evaluate`.
            genome: ``(genes,)``.
            trial: which of its trials, from 0.

        Raises:
            ValueError: the genome is not of that shape, or there is no such trial.
        """
        genes = self._genes(np.asarray(genome)[None])
        if not 0 <= trial < self.trials:
            raise ValueError(f"trial must be from 0 to {self.trials - 1}, got {trial}")
        keys, numbers = self._noise(_key(key), 1), training.situation_numbers(self.parts)
        keys = None if keys is None else keys[:, trial : trial + 1]
        own = None if numbers is None else numbers[trial : trial + 1]
        with self._compiling("recording", "one individual", ("record",)):
            frames = self._record(genes, keys, own)
        names = [body.name for body in self.creature.bodies]
        simulation = self.parts.simulation
        return as_record(simulation, frames, as_recording(simulation, frames, names, trial=trial))

    def environment(self, actions: str = "rates", trial: int = 0) -> Environment:
        """The animal without its controller, for reinforcement learning.

        Args:
            actions: what an action sets: ``rates`` of the joints for the motors to follow (rad/s),
                or ``angles`` for the motors' springs to pull to (rad).
            trial: which of its trials, from 0: where it starts, and where the light is.

        Raises:
            ValueError: there is no such trial; angles, and no motor has a spring.
        """
        if not 0 <= trial < self.trials:
            raise ValueError(f"trial must be from 0 to {self.trials - 1}, got {trial}")
        return Environment(self.parts.simulation, self.scales, actions, trial)

    def with_numbers(self, numbers: Mapping[str, float]) -> "Experiment":
        """The same with other numbers in its configuration, built anew.

        Args:
            numbers: by their keys, such as ``creature.bodies.1.shape.size.0``.

        Raises:
            ConfigError: numbers that are none of the configuration, or are not allowed.
        """
        for key in numbers:
            number_at(self.config, key, self.source)
        values = {key: float(value) for key, value in numbers.items()}
        config = with_numbers(self.config, values, self.source)
        changed = Experiment(build_experiment(config, self.source), config, self.source)
        return changed.with_task(self.task) if "task" in self.replaced else changed

    def with_task(self, task: Task) -> "Experiment":
        """The same with another task."""
        simulation = dataclasses.replace(self.parts.simulation, task=task)
        replaced = tuple(dict.fromkeys((*self.replaced, "task")))
        parts = self.parts._replace(simulation=simulation)
        return Experiment(parts, self.config, self.source, replaced)

    def with_fitness(self, fitness: Callable[[Terms], Float[Array, " *n"]]) -> "Experiment":
        """The same with another fitness, made of the terms of its task and of its measures.

        Args:
            fitness: a JAX function of the terms by name, each ``(n,)`` for a population and ``()``
                for one individual alone, that has the same shape; it is maximised.

        Raises:
            UnknownTermError: a `KeyError`: it takes a term that the task has not.
            ValueError: it is not one real number for each individual.
        """
        task = JudgedBy(self.task.light, self.task, fitness)
        # Here, and not after some seconds of compiling.
        for batch in ((_SEVERAL,), ()):
            terms = jax.eval_shape(lambda batch=batch: no_terms(self.parts.simulation, batch))
            found = jax.eval_shape(lambda terms: task.fitness(terms, {}), terms)
            if getattr(found, "shape", None) != batch or not is_real(found):
                raise ValueError(
                    "fitness must give each individual a real number of its own: from terms of "
                    f"the shape {batch} one of that shape; got {described(found)}"
                )
        return self.with_task(task)

    def _compiling(self, what: str, of: str, program: tuple) -> AbstractContextManager[None]:
        """Tell that a program is compiled, if this call is its first.

        Args:
            what: the program does.
            of: whom it does that for.
            program: what tells it from others of this experiment.
        """
        if program in self._compiled:
            return nullcontext()
        self._compiled.add(program)
        return working(f"compiling the {what} of {self.name!r} for {of} (first call only)")

    @functools.cached_property
    def _run_trials(self) -> Callable[..., Outcome]:
        return training.compile_trials(self.parts.simulation, population_mesh())

    @functools.cached_property
    def _bodies(self) -> Bodies:
        return Bodies(self.parts, self.config, self.source)

    @functools.cached_property
    def _judge(self) -> Callable:
        def judged(*given: Any) -> tuple:
            return *training.judge(self.task, *given), training.judge_each(self.task, *given)

        return jax.jit(judged)

    @functools.cached_property
    def _record(self) -> Callable:
        recorder = Recorder(full=True)
        return jax.jit(functools.partial(rollout, self.parts.simulation, observers=recorder))

    def _genes(self, genomes: ArrayLike) -> np.ndarray:
        """Genomes as the library has them, checked."""
        given = np.asarray(genomes)
        if given.ndim != 2 or given.shape[1] != self.gene_count or not len(given):
            turned = given.ndim == 2 and given.shape[0] == self.gene_count
            hint = "; individuals come first, so transpose them" if turned else ""
            raise ValueError(
                f"genomes must have the shape (n, {self.gene_count}), one row per individual, got "
                f"{given.shape}{hint}"
            )
        if not np.issubdtype(given.dtype, np.number):
            raise ValueError(f"genomes must be numbers, got {given.dtype}")
        return given.T.astype(np.float32)

    def _noise(self, key: Array, count: int) -> Array | None:
        """Raw keys of all trials; None without noise."""
        if self.parts.simulation.noise.silent:
            return None
        individual, trial = np.divmod(np.arange(count * self.trials), self.trials)

        def of_trial(individual: Any, trial: Any) -> Array:
            return jax.random.key_data(
                jax.random.fold_in(jax.random.fold_in(key, individual), trial)
            )

        return jax.vmap(of_trial, out_axes=1)(individual, trial)


def _key(key: ArrayLike) -> Array:
    """A key of JAX, from one or from a number."""
    if isinstance(key, jax.Array) and jnp.issubdtype(key.dtype, jax.dtypes.prng_key):
        return key
    given = np.asarray(key)
    if given.shape == () and np.issubdtype(given.dtype, np.integer):
        return jax.random.key(int(given))
    return jax.random.wrap_key_data(jnp.asarray(key))
