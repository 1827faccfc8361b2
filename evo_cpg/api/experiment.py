"""Experiment for use from Python, with individuals on the first axis, as in NumPy and evosax.

Inside the library individuals are on the last axis of every array. This module and
`evo_cpg.api.training` transpose.
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

from evo_cpg.api.bodies import Numbers, VariedBodies
from evo_cpg.api.environment import Environment
from evo_cpg.api.fitness import JudgedBy, fitness_function
from evo_cpg.api.machine import warn_of_gpu
from evo_cpg.api.progress import working
from evo_cpg.api.record import Record, as_record
from evo_cpg.api.runs import build
from evo_cpg.evolution.strategy import Evaluation
from evo_cpg.io.build import build_experiment
from evo_cpg.io.errors import KeyProblem
from evo_cpg.io.load import as_overrides, complete_config, load_config
from evo_cpg.io.numbers import number_at, with_numbers
from evo_cpg.io.own_checks import described, is_real, require_separate
from evo_cpg.io.parameters import parametrise
from evo_cpg.io.run import class_folders, own_body
from evo_cpg.io.schema.experiment import ExperimentConfig
from evo_cpg.io.shipped import find_config
from evo_cpg.io.trust import trusting
from evo_cpg.simulation.judge import Outcome, no_terms
from evo_cpg.simulation.noise import raw_keys
from evo_cpg.simulation.recording import Recorder, as_recording
from evo_cpg.simulation.task import Task
from evo_cpg.training import devices
from evo_cpg.training import experiment as training
from evo_cpg.training.devices import population_mesh
from evo_cpg.training.evaluate import compile_trials, of_course
from evo_cpg.training.run_folder import RunFolder

Terms = Mapping[str, Float[Array, " *n"]]

Overrides = Sequence[str] | Mapping[str, Any]

# Source of a configuration that was not read from a file.
_NO_FILE = Path("configuration")

# Number of individuals that a new fitness function is checked with.
_SEVERAL = 7


@dataclasses.dataclass(frozen=True)
class Trials:
    """Results of the trials of a population, without fitness.

    Attributes:
        terms: task's terms by name, each ``(n, trials)``.
        alive: False where an individual diverged, ``(n, trials)``.
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
    """Creature in a world, with a nervous system and a task. `evo_cpg.load` makes it.

    Experiments are immutable. Methods that evaluate, record or replace return new objects.

    Attributes:
        name: name in the configuration.
        creature: simulated animal.
        world: physical model of the animal and its environment.
        task: task that defines the fitness.
        trials: count of trials of every individual.
        gene_count: count of numbers in a genome.
        population: count of individuals in a generation.
        config: complete configuration.
        source: file of the configuration.
        replaced: names of parts that were replaced in Python. The configuration does not describe
            them.
        parts: internal parts of the experiment, not part of the stable interface.
    """

    def __init__(
        self,
        parts: training.ExperimentParts,
        config: ExperimentConfig,
        source: Path,
        replaced: tuple[str, ...] = (),
    ):
        self.parts, self.config, self.source, self.replaced = parts, config, source, replaced
        self.name, self.creature, self.trials = parts.name, parts.creature, parts.trials
        self.world, self.task = parts.simulation.world, parts.simulation.task
        self.gene_count = parts.simulation.genome.count
        self.population = parts.strategy.population
        self._bodies = VariedBodies(parts, config, source)
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
        """Return the state without compiled programs, which no other process can use."""
        # Keep the scales: measuring them again costs a generation, and another machine may round
        # differently.
        kept = ("parts", "config", "source", "replaced", "scales")
        return {name: value for name, value in vars(self).items() if name in kept}

    def __setstate__(self, state: dict[str, Any]) -> None:
        measured = {name: state.pop(name) for name in ("scales",) if name in state}
        self.__init__(**state)
        vars(self).update(measured)

    def random_genomes(self, key: ArrayLike, count: int | None = None) -> np.ndarray:
        """Return random genomes of a first generation, ``(count, genes)``.

        Args:
            key: seed of all random draws: a number or a JAX key.
            count: number of genomes, or None for the configuration's population.
        """
        shape = (self.population if count is None else count,)
        return np.asarray(self.parts.simulation.genome.random(_key(key), shape)).T.copy()

    def rollout(self, key: ArrayLike, genomes: ArrayLike, bodies: Numbers | None = None) -> Trials:
        """Simulate all trials of every individual.

        Args:
            key: seed of the noise in the trials, if there is any: a number or a JAX key.
            genomes: genomes of the individuals, ``(n, genes)``.
            bodies: numbers of the configuration in which individuals differ, such as sizes and
                densities: arrays ``(n,)`` by key. One program builds all bodies, and serves all
                populations with the same keys. Bodies that do not fit its plan are built one by
                one, which takes some 10 to 50 ms each (see docs/models/bodies.md).

        Returns:
            Terms and survival, ``(n, trials)``.

        Raises:
            ValueError: genomes or numbers have another shape.
            ConfigError: a number is not in the configuration, is not allowed, or changes more than
                numbers of the simulation.
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
            if bodies and self.parts.simulation.has_own_bodies:
                raise ValueError("bodies: the genomes define the bodies. Leave bodies out")
            if bodies and self.parts.simulation.draws is not None:
                raise ValueError("bodies: trials draw numbers (courses.draw). Leave bodies out")
            own = self._bodies.trials(bodies, count) if bodies else None
            outcome = own[0](*given, own[1]) if own else self._run_trials(*given)
        shaped = jax.tree.map(lambda x: x.reshape(count, trials), outcome)
        return Trials(shaped.terms, shaped.alive)

    def evaluate(
        self, key: ArrayLike, genomes: ArrayLike, bodies: Numbers | None = None
    ) -> Evaluation:
        """Evaluate fitness, terms and descriptors of a population, on all cores.

        Args:
            key: seed of the noise in the trials: a number or a JAX key.
            genomes: genomes of the individuals, ``(n, genes)``.
            bodies: numbers in which individuals differ, by key (see `rollout`).

        Raises:
            ValueError: the genomes or the numbers of the bodies have another shape.
            ConfigError: a number of the bodies is wrong (see `rollout`).
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
        """Scales of the task, which `train` measures on the first generation.

        They are measured with the experiment's own seed, in its first run. So the fitness of a
        genome is always the same.
        """
        first = self.parts._replace(runs=1)
        shapes = jax.eval_shape(lambda: self.task.scales(no_terms(self.parts.simulation)))
        if not shapes:
            return {}
        genes = np.asarray(jax.jit(lambda: training.begin(first)[0])())
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
        """Return the fitness of one genome as a function, for `jax.grad`, `jax.jit` and `jax.vmap`.

        Args:
            key: seed of the noise in the trials, if there is any: a number or a JAX key.
            horizon: time constant of the decay of gradients, s. The decay helps with chaotic motion
                (see docs/models/gradients.md). None gives gradients without decay. On the ground,
                gradients are clipped, with or without a decay. Only `math.inf` gives exact
                gradients there.
            numbers: keys of numbers of the configuration, such as sizes and densities. The function
                takes their values as its second argument, builds the animal from them, and is
                differentiable with respect to them. A derivative by a number at a kink raises an
                error. So do values that change the layout of the trial. Checking a value takes
                as long as building one animal.

        Raises:
            ConfigError: a number is not in the configuration, or changes more than numbers.
        """
        own_task = self.task if "task" in self.replaced else None
        parameters = None
        if numbers and self.parts.simulation.has_own_bodies:
            raise ValueError("numbers: the genome defines the body. Leave numbers out")
        if numbers and self.parts.simulation.draws is not None:
            raise ValueError("numbers: trials draw numbers (courses.draw). Leave numbers out")
        if numbers:
            parameters = parametrise(self.config, self.source, numbers, smooth=False)
        noise = self._noise(_key(key), 1)
        return fitness_function(self.parts, self.scales, noise, horizon, parameters, own_task)

    def record(self, key: ArrayLike, genome: ArrayLike, trial: int = 0) -> Record:
        """Record one trial of one individual, step by step, in named columns.

        Args:
            key: seed of the noise in the trial: a number or a JAX key.
            genome: genome of the individual, ``(genes,)``.
            trial: number of the individual's trial, from 0.

        Raises:
            ValueError: the genome has another shape, or there is no such trial.
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
        simulation = self.with_body(genome).parts.simulation
        if keys is not None:
            simulation = of_course(simulation, np.asarray(keys)[:, 0])
        return as_record(simulation, frames, as_recording(simulation, frames, names, trial=trial))

    def environment(self, actions: str = "rates", trial: int = 0) -> Environment:
        """Return the animal without its controller, for reinforcement learning.

        Args:
            actions: quantity that an action sets. Motors follow ``rates`` of the joints (rad/s).
                Their springs pull to ``angles`` (rad). Torque motors exert ``torques`` (N m).
                Muscles have ``activations`` (0 to 1).
            trial: number of the trial, from 0, which sets the start and the place of the light.

        Raises:
            ValueError: there is no such trial. No motor has a spring for ``angles``, or no joint
                has muscles for ``activations`` or a torque motor for ``torques``.
        """
        if not 0 <= trial < self.trials:
            raise ValueError(f"trial must be from 0 to {self.trials - 1}, got {trial}")
        return Environment(self.parts.simulation, self.scales, actions, trial)

    def with_numbers(self, numbers: Mapping[str, float]) -> "Experiment":
        """Return the experiment rebuilt with other numbers in its configuration.

        Args:
            numbers: values by key, such as ``creature.bodies.1.shape.size.0``.

        Raises:
            ConfigError: a number is not in the configuration, or is not allowed.
        """
        for key in numbers:
            number_at(self.config, key, self.source)
        values = {key: float(value) for key, value in numbers.items()}
        config = with_numbers(self.config, values, self.source)
        changed = Experiment(build_experiment(config, self.source), config, self.source)
        return changed.with_task(self.task) if "task" in self.replaced else changed

    def with_body(self, genome: ArrayLike) -> "Experiment":
        """Return the experiment with the body of a genome, which does not evolve any more.

        Its genomes are those of the controller, the first genes of ``genome``.
        """
        simulation = self.parts.simulation
        if not simulation.has_own_bodies:
            return self
        config, _ = own_body(self.config, simulation, np.asarray(genome), self.source)
        changed = Experiment(build_experiment(config, self.source), config, self.source)
        return changed.with_task(self.task) if "task" in self.replaced else changed

    def with_task(self, task: Task) -> "Experiment":
        """Return the experiment with another task."""
        simulation = dataclasses.replace(self.parts.simulation, task=task)
        replaced = tuple(dict.fromkeys((*self.replaced, "task")))
        parts = self.parts._replace(simulation=simulation)
        return Experiment(parts, self.config, self.source, replaced)

    def with_fitness(self, fitness: Callable[[Terms], Float[Array, " *n"]]) -> "Experiment":
        """Return the experiment with another fitness, a function of its terms and measures.

        Args:
            fitness: JAX function of the terms by name, to be maximised. Terms and result have the
                shape ``(n,)`` for a population and ``()`` for one individual.

        Raises:
            UnknownTermError: the function reads a term that the task lacks (a `KeyError`).
            ValueError: the result is not one real number for each individual, or mixes individuals.
        """
        task = JudgedBy(self.task.light, self.task, fitness)
        # Check here, not after some seconds of compiling.
        for batch in ((_SEVERAL,), ()):
            terms = jax.eval_shape(lambda batch=batch: no_terms(self.parts.simulation, batch))
            found = jax.eval_shape(lambda terms: task.fitness(terms, {}), terms)
            if getattr(found, "shape", None) != batch or not is_real(found):
                raise ValueError(
                    "fitness must return one real number for each individual: the shape "
                    f"{batch} from terms of the shape {batch}, got {described(found)}"
                )
        terms = jax.eval_shape(lambda: no_terms(self.parts.simulation, (_SEVERAL,)))
        try:
            require_separate(lambda terms: {((), "fitness"): task.fitness(terms, {})}, terms)
        except KeyProblem as error:
            raise ValueError(error.problem) from None
        return self.with_task(task)

    def _compiling(self, what: str, of: str, program: tuple) -> AbstractContextManager[object]:
        """Show that a program is being compiled, if this call is its first.

        Args:
            what: name of the program's task.
            of: name of the individuals.
            program: key of the program in this experiment.
        """
        if program in self._compiled:
            return nullcontext()
        self._compiled.add(program)
        warn_of_gpu()
        return working(f"compiling the {what} of {self.name!r} for {of} (first call only)")

    @functools.cached_property
    def _run_trials(self) -> Callable[..., Outcome]:
        return compile_trials(self.parts.simulation, population_mesh())

    @functools.cached_property
    def _judge(self) -> Callable:
        def judged(*given: Any) -> tuple:
            return *training.judge(self.task, *given), training.judge_each(self.task, *given)

        return jax.jit(judged)

    @functools.cached_property
    def _record(self) -> Callable:
        recorder = Recorder(full=True)
        return compile_trials(self.parts.simulation, population_mesh(1), observers=recorder)

    def _genes(self, genomes: ArrayLike) -> np.ndarray:
        """Check genomes and return them transposed, ``(genes, n)``, in float32."""
        given = np.asarray(genomes)
        if given.ndim != 2 or given.shape[1] != self.gene_count or not len(given):
            turned = given.ndim == 2 and given.shape[0] == self.gene_count
            hint = ". Transpose them: individuals come first" if turned else ""
            raise ValueError(
                f"genomes must have the shape (n, {self.gene_count}), one row per individual, got "
                f"{given.shape}{hint}"
            )
        if not np.issubdtype(given.dtype, np.number):
            raise ValueError(f"genomes must be numbers, got {given.dtype}")
        return given.T.astype(np.float32)

    def _noise(self, key: Array, count: int) -> Array | None:
        """Return raw keys of all trials, ``(words, count x trials)``, or None without noise."""
        if self.parts.simulation.silent:
            return None
        individual, trial = np.divmod(np.arange(count * self.trials), self.trials)
        keys = jax.vmap(jax.random.fold_in, (None, 0))(key, individual)
        return raw_keys(jax.vmap(jax.random.fold_in)(keys, trial))


def load(
    config: Path | str | Mapping[str, Any],
    overrides: Overrides = (),
    cores: int | None = None,
    trust: bool = False,
) -> Experiment:
    """Read a configuration and build its experiment.

    Args:
        config: path of a YAML file, or of a run folder with a ``config.yaml``. A name such as
            ``hexapod`` means the shipped configuration, if the working folder has no such file.
            A dictionary holds the contents of a file. Its file names are relative to the working
            folder.
        overrides: settings to change: ``["seed=3", "world.gravity=1.6"]`` as on the command line,
            or ``{"seed": 3, "world.gravity": 1.6}``.
        cores: number of cores that share a population, or None for all cores. If JAX has already
            computed something, its devices are kept.
        trust: whether you trust the configuration. A trusted configuration may name files outside
            its folder, and run code of modules in its folder. Without trust, it may run only
            installed modules and modules in the working folder.

    Raises:
        ConfigError: the configuration is wrong.
    """
    if isinstance(overrides, str):
        raise TypeError(f"overrides must be a list of settings, such as [{overrides!r}]")
    mapped = isinstance(overrides, Mapping)
    changed = as_overrides(overrides) if mapped else list(overrides)
    folders: list[Path] = []
    with trusting(trust):
        if isinstance(config, Mapping):
            source = _NO_FILE
            read = complete_config(dict(config), source, changed)
        else:
            source = find_config(config, folders=True)
            if source.is_dir():
                folders = class_folders(RunFolder(source))
                source = source / "config.yaml"
            read = load_config(source, changed)
        devices.use_cores(cores)
        return Experiment(build(read, source, folders), read, source)


def _key(key: ArrayLike) -> Array:
    """Return a JAX key, from a key or a number."""
    if isinstance(key, jax.Array) and jnp.issubdtype(key.dtype, jax.dtypes.prng_key):
        return key
    given = np.asarray(key)
    if given.shape == () and np.issubdtype(given.dtype, np.integer):
        return jax.random.key(int(given))
    return jax.random.wrap_key_data(jnp.asarray(key))
