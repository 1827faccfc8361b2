"""The fitness by the genes: reverse mode against central differences, and float32 against float64.

All that happens in a trial lies between the two: senses, brain, cord, motors, water or ground,
fitness. The places where there is no slope are shown in `tests/simulation/test_kinks.py`.
"""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from creatures import quick_jit
from evo_cpg.config.build import build_experiment
from evo_cpg.config.load import load_config
from evo_cpg.control.postures import PostureController, PostureSettings, build_posture_controller
from evo_cpg.simulation.judge import score
from evo_cpg.simulation.reach_light import ReachLight
from evo_cpg.simulation.rollout import rollout
from evo_cpg.simulation.simulation import Simulation
from evo_cpg.simulation.task import Task, Transition
from trials import experiment

CONFIGS = Path(__file__).parents[2] / "configs"
SECONDS = (0.5, 1.0, 2.0)
SEEDS = 16
# Of the fitness, over the shortest trial's end, s.
FINAL_SECONDS = 0.25
# The yardstick of energy, J: more than any of the animals spends, or it would have no slope.
ENERGY = 5000.0

# Relative, of float64.
TOLERANCE = 1e-5

# Individuals and directions for differences, and their half-widths.
TRIED, RANDOM_DIRECTIONS, SINGLE_GENES = 3, 4, 4
WIDTHS = 10.0 ** -np.arange(4, 11)

# Its task knows from the start when each individual stops, which no program for one individual can:
# JAX goes through the trial, and its parts are native.
pytestmark = pytest.mark.filterwarnings("ignore:a trial runs on plain JAX")


class Until(Task):
    """A task that looks at the first part of a trial, in every lane as long as is said.

    Attributes:
        task: that judges.
        stop: control steps that count.
    """

    task: Task
    stop: jax.Array

    @property
    def light(self):
        return self.task.light

    def begin(self, batch, dtype, steps):
        height, airborne = jnp.zeros((2, *batch), dtype)
        stop = jnp.broadcast_to(self.stop, batch)
        return self.task.begin(batch, dtype, steps), height, airborne, stop

    def update(self, tally, transition: Transition, steps):
        inner, _, airborne, stop = tally
        # The task is told that its trial ends where it does.
        number = jnp.where(transition.step == 0, 0, transition.step + steps - stop)
        inner = self.task.update(inner, transition._replace(step=number), steps)
        new = inner, transition.before.state.position[2], airborne + transition.airborne, stop
        goes_on = transition.step < stop

        def choose(old: jax.Array, new: jax.Array) -> jax.Array:
            return jnp.where(jnp.broadcast_to(goes_on, new.shape), new, old)

        return jax.tree.map(choose, tally, new)

    def terms(self, tally, steps):
        inner, height, airborne, stop = tally
        terms = self.task.terms(inner, steps)
        if "light" in terms:
            terms["light"] = terms["light"] * steps / stop
        return terms | {"height": height, "airborne": airborne / stop}

    def fitness(self, terms, scales):
        return self.task.fitness(terms, scales)


class Angles(PostureController):
    """The postures of Fukui 2003 with the angles themselves, in rad, for genes."""

    def random_genes(self, key, batch, dtype):
        return jax.random.uniform(key, (self.gene_count, *batch), dtype, -0.4, 0.4)

    def decode(self, genes):
        return genes.reshape(self.postures, self.dof_count, *genes.shape[1:])


def configured(name: str, *overrides: str) -> Simulation:
    path = CONFIGS / f"{name}.yaml"
    return build_experiment(load_config(path, overrides), path).simulation


def quadruped() -> Simulation:
    simulation = configured("fukui2003_model1")
    given = build_posture_controller(simulation.world.tree, PostureSettings(), 1 / 60)
    fields = {field.name: getattr(given, field.name) for field in dataclasses.fields(given)}
    angles = given.postures * given.dof_count
    controller = Angles(**fields | {"gene_count": angles})
    return dataclasses.replace(simulation, controller=controller)


SALAMANDER = "iwadate2010_salamander_water"
ANIMALS = {
    "pair": lambda: experiment().simulation,
    "swimmer": lambda: configured("iwadate2010_swimmer"),
    "salamander in water": lambda: configured(SALAMANDER),
    # Its body is 9 cm thick.
    "salamander at the surface": lambda: configured(SALAMANDER, "world.water.surface=0.05"),
    "quadruped": quadruped,
}


class Animal(NamedTuple):
    """What is tried.

    Attributes:
        outcome: fitness and terms of genes ``(g, n)``, tried for control steps ``(n,)``.
        genes: of some individuals, ``(g, SEEDS)``; all of them numbers of float32.
        stops: control steps of each of `SECONDS`.
        slopes: of the fitness by the genes in float64, ``(g, SEEDS, seconds)``.
    """

    outcome: Callable
    genes: np.ndarray
    stops: np.ndarray
    slopes: np.ndarray


def scales(genes: jax.Array) -> dict[str, jax.Array]:
    return {"energy": jnp.asarray(ENERGY, genes.dtype)}


def outcome_of(simulation: Simulation) -> Callable:
    def outcome(genes, stops):
        task = Until(simulation.task, stops)
        found = rollout(dataclasses.replace(simulation, task=task), genes)
        return score(task, found, scales(genes)), found.terms

    return outcome


def slopes_of(outcome: Callable, genes: np.ndarray, stops: np.ndarray, dtype: type) -> np.ndarray:
    """For every individual and number of control steps, a lane each."""
    each = jnp.asarray(np.tile(stops, genes.shape[1]))
    every = jnp.asarray(np.repeat(genes, len(stops), 1), dtype)
    slopes = quick_jit(jax.grad(lambda g: outcome(g, each)[0].sum()))(every)
    assert slopes.dtype == dtype
    return np.asarray(slopes, float).reshape(*genes.shape, len(stops))


# All but the pair take minutes to compile.
TRIALS = [
    name if name == "pair" else pytest.param(name, marks=pytest.mark.slow) for name in ANIMALS
]


@pytest.fixture(scope="module", params=TRIALS)
def animal(request):
    with jax.enable_x64(True):
        simulation = ANIMALS[request.param]()
        stops = np.round(np.array(SECONDS) * simulation.control_rate).astype(int)
        simulation = dataclasses.replace(simulation, steps=int(stops.max()))
        if isinstance(simulation.task, ReachLight):
            final = round(FINAL_SECONDS * simulation.control_rate)
            task = dataclasses.replace(simulation.task, final_steps=final)
            simulation = dataclasses.replace(simulation, task=task)
        draw = simulation.genome.random(jax.random.key(0), (SEEDS,), np.float32)
        genes = np.asarray(draw, float)
        outcome = outcome_of(simulation)
        slopes = slopes_of(outcome, genes, stops, np.float64)
        yield request.param, Animal(outcome, genes, stops, slopes)


def closest(differences: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of central differences ``(k, widths)`` the surest, and what they may be off by.

    Wide ones bend with the function, and have kinks between their ends: where a motor comes to its
    limit several miss the slope by as much, all alike. Narrow ones are rounded. So those are taken
    that agree with the next narrower ones and are more than noise, and of these the narrowest. The
    fitness has the noise that the narrowest differences scatter by, or that of a number of about
    1. All is decided without looking at the gradient.
    """
    pairs = np.stack([differences[:, :-1], differences[:, 1:]])
    size = np.maximum(np.abs(pairs).mean(0), 1e-300)
    scatter = np.abs(pairs[1] - pairs[0])
    noise = max((scatter[:, -1] * WIDTHS[-1]).max(), 4 * np.finfo(float).eps)
    change = np.maximum(scatter, noise / WIDTHS[1:]) / size
    agree = change < TOLERANCE
    narrowest = agree.shape[1] - 1 - agree[:, ::-1].argmax(1)
    best = np.where(agree.any(1), narrowest, change.argmin(1))
    rows = np.arange(len(best))
    return pairs.mean(0)[rows, best], change[rows, best]


def differences_of(animal: Animal, program: Callable, individual: int, seconds: int, directions):
    """Central differences ``(k, widths)`` along directions ``(g, k)``, in one run."""
    moves = directions[:, :, None, None] * (WIDTHS[:, None] * np.array([1.0, -1.0]))
    genes = animal.genes[:, individual, None, None, None] + moves
    flat = jnp.asarray(genes.reshape(len(genes), -1))
    stops = jnp.full(flat.shape[1], animal.stops[seconds])
    fitness, terms = program(flat, stops)
    up, down = np.moveaxis(np.asarray(fitness).reshape(genes.shape[1:]), -1, 0)
    return (up - down) / (2 * WIDTHS), terms


def test_a_trial_cut_short_is_a_short_trial(x64):
    """What stops early has the fitness of a trial of that length."""
    stops = np.array([20, 45])
    genes = jnp.array([[3.0, 2.0], [1.0, 2.0]])
    simulation = experiment(int(stops.max())).simulation
    task = dataclasses.replace(simulation.task, final_steps=15)
    simulation = dataclasses.replace(simulation, task=task)

    def short(steps: int) -> Simulation:
        return dataclasses.replace(simulation, steps=steps)

    def fitness(genes):
        cut = outcome_of(simulation)(genes, jnp.asarray(stops))[0]
        whole = [
            score(task, rollout(simulation, genes), scales(genes))
            for simulation in (short(n) for n in stops.tolist())
        ]
        return cut, jnp.stack(whole)

    cut, whole = quick_jit(fitness)(genes)
    assert abs(whole[0, 0] - whole[1, 0]) > 1e-3
    np.testing.assert_allclose(cut, np.diagonal(whole), rtol=1e-12)


def test_gradients_equal_central_differences(animal):
    """Where the differences are sure of themselves, which they are in water.

    After 2 s of pushing itself about, the quadruped's gradient is thousands of metres per radian
    and differences settle on nothing: see docs/models/gradients.md.
    """
    name, animal = animal
    on_land = name == "quadruped"
    rng = np.random.default_rng(0)
    program = quick_jit(animal.outcome)
    sure = []
    for individual in range(TRIED):
        for seconds in range(len(SECONDS) - on_land):
            slope = animal.slopes[:, individual, seconds]
            random = rng.normal(size=(len(slope), RANDOM_DIRECTIONS))
            largest = np.argsort(-np.abs(slope))[: 2 * SINGLE_GENES : 2]
            single = np.eye(len(slope))[:, largest[: len(slope)]]
            directions = np.concatenate([random / np.linalg.norm(random, axis=0), single], 1)
            differences, terms = differences_of(animal, program, individual, seconds, directions)
            wanted, doubt = closest(differences)
            assert ((terms["airborne"] < 1) == on_land).all()
            assert np.linalg.norm(slope) > 1e-3
            error = np.abs(directions.T @ slope / wanted - 1)
            sure.append(doubt < TOLERANCE)
            assert (error[sure[-1]] < TOLERANCE).all()
    # In water, all but directions in which the slopes of many genes cancel.
    assert np.mean(sure) > (0.75 if on_land else 0.95)


@pytest.mark.parametrize(
    "animal", ["pair", pytest.param("swimmer", marks=pytest.mark.slow)], indirect=True
)
def test_gradients_in_float32(animal):
    """Of whole gradients: one rounding a step, all adding up, is more than the median error.

    Individuals whose slopes nearly cancel, or that step over a kink by rounding, are farther off.
    """
    _, animal = animal
    single = slopes_of(animal.outcome, animal.genes, animal.stops, np.float32)
    size = np.linalg.norm(animal.slopes, axis=0)
    error = np.linalg.norm(single - animal.slopes, axis=0) / size
    steps = np.array(SECONDS) * 120
    assert (np.median(error, 0) < steps * np.finfo(np.float32).eps / 2).all()
    assert error.max() < 1e-3
    # It is float32 indeed.
    assert np.median(error) > 1e-8
