"""Gradients of the fitness by the genes, against central differences, and float32 against float64.

The whole trial is differentiated: senses, brain, cord, motors, water or ground, and fitness.
`tests/simulation/test_kinks.py` shows the points without a derivative.
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
from evo_cpg.control.postures import PostureController, PostureSettings, build_posture_controller
from evo_cpg.io.build import build_experiment
from evo_cpg.io.load import load_config
from evo_cpg.simulation.backward import Backward
from evo_cpg.simulation.judge import Scored, score
from evo_cpg.simulation.rollout import rollout
from evo_cpg.simulation.simulation import Simulation
from evo_cpg.simulation.task import Task, Transition
from evo_cpg.simulation.tasks import ReachLight
from trials import experiment

CONFIGS = Path(__file__).parents[2] / "configs"
SECONDS = (0.5, 1.0, 2.0)
SEEDS = 16
# Time at the end of a trial over which the task averages the distance, s.
FINAL_SECONDS = 0.25
# Scale of the energy, J. It exceeds the energy of every animal, because gradients vanish beyond it.
ENERGY = 5000.0

# Largest relative error in float64.
TOLERANCE = 1e-5

# Numbers of individuals and directions for differences, and half-widths of the differences.
TRIED, RANDOM_DIRECTIONS, SINGLE_GENES = 3, 4, 4
WIDTHS = 10.0 ** -np.arange(4, 11)

# The initial tally has a different stop for each individual, which no native program of a trial
# supports. So JAX runs the trial, and its parts are native.
pytestmark = pytest.mark.filterwarnings("ignore:a trial runs on plain JAX")


class Until(Task):
    """A task that scores the first part of a trial, with a different length in each lane.

    Attributes:
        task: task that scores this part.
        stop: number of control steps that count in each lane.
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
        # Step numbers end at ``steps``, as in a trial of this length.
        number = jnp.where(transition.step == 0, 0, transition.step + steps - stop)
        inner = self.task.update(inner, transition._replace(step=number), steps)
        new = inner, transition.before.state.position[2], airborne + transition.airborne, stop
        counts = transition.step < stop

        def choose(old: jax.Array, new: jax.Array) -> jax.Array:
            return jnp.where(jnp.broadcast_to(counts, new.shape), new, old)

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
    """The postures of Fukui 2003, with angles in rad as genes."""

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
    # The body is 9 cm thick.
    "salamander at the surface": lambda: configured(SALAMANDER, "world.water.surface=0.05"),
    "quadruped": quadruped,
}


class Animal(NamedTuple):
    """An animal whose fitness is differentiated.

    Attributes:
        outcome: function that returns fitness and terms from genes ``(g, n)`` and stops ``(n,)``.
        genes: genes of some individuals, ``(g, SEEDS)``, all exact in float32.
        stops: control steps of each of `SECONDS`.
        slopes: gradients of the fitness by the genes in float64, ``(g, SEEDS, seconds)``.
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
    """Return gradients for every individual and number of control steps, with a lane for each."""
    each = jnp.asarray(np.tile(stops, genes.shape[1]))
    every = jnp.asarray(np.repeat(genes, len(stops), 1), dtype)
    slopes = quick_jit(jax.grad(lambda g: outcome(g, each)[0].sum()))(every)
    assert slopes.dtype == dtype
    return np.asarray(slopes, float).reshape(*genes.shape, len(stops))


# All animals except the pair take minutes to compile.
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
    """Return the most certain of central differences ``(k, widths)``, and its relative error.

    Wide differences bend with the function, or span kinks. At a motor's limit, several have an
    equal error. Narrow differences have rounding errors. So the narrowest difference is taken that
    agrees with the next narrower one and exceeds the noise. The noise of the fitness is the scatter
    of the narrowest differences, or rounding of a number of about 1. The gradient is not used.
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
    """Return central differences ``(k, widths)`` along directions ``(g, k)``, from one run."""
    moves = directions[:, :, None, None] * (WIDTHS[:, None] * np.array([1.0, -1.0]))
    genes = animal.genes[:, individual, None, None, None] + moves
    flat = jnp.asarray(genes.reshape(len(genes), -1))
    stops = jnp.full(flat.shape[1], animal.stops[seconds])
    fitness, terms = program(flat, stops)
    up, down = np.moveaxis(np.asarray(fitness).reshape(genes.shape[1:]), -1, 0)
    return (up - down) / (2 * WIDTHS), terms


@pytest.mark.slow
def test_a_trial_that_stops_early_equals_a_short_trial(x64):
    """The fitness equals the fitness of a trial of that length."""
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
    """Gradients equal all certain differences. Most differences are certain in water.

    After 2 s on land, the quadruped's gradient is thousands of metres per radian, and differences
    do not converge (see docs/models/gradients.md).
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
            expected, uncertainty = closest(differences)
            assert ((terms["airborne"] < 1) == on_land).all()
            assert np.linalg.norm(slope) > 1e-3
            error = np.abs(directions.T @ slope / expected - 1)
            sure.append(uncertainty < TOLERANCE)
            assert (error[sure[-1]] < TOLERANCE).all()
    # In water, differences are uncertain only if derivatives of many genes cancel.
    assert np.mean(sure) > (0.75 if on_land else 0.95)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:A program has more than")
@pytest.mark.filterwarnings("ignore:the derivative of a trial runs on plain JAX")
@pytest.mark.parametrize("name", sorted(path.stem for path in CONFIGS.glob("*.yaml")))
def test_gradients_of_shipped_animals_equal_differences(name, x64):
    """The trial of a fifth of a second and its backward pass are one program, as in `refine`.

    On the ground, and for small gradients, differences are less certain than the gradient.
    """
    simulation = configured(name)
    if simulation.genome.binary:
        simulation = configured(name, "controller.graded=true")
    steps = round(0.2 * simulation.control_rate)
    simulation = dataclasses.replace(simulation, steps=steps)
    genes = np.asarray(simulation.genome.random(jax.random.key(0), (TRIED,), np.float32), float)

    observer = Scored(scales(genes))
    fitness = jax.jit(
        lambda genes: rollout(simulation, genes, observers=observer, backward=Backward())
    )
    slopes = np.asarray(jax.jit(jax.grad(lambda genes: fitness(genes).sum()))(genes))
    directions = np.random.default_rng(0).normal(size=(RANDOM_DIRECTIONS, *genes.shape))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    moves = np.multiply.outer(WIDTHS, directions)
    moved = np.moveaxis(np.stack([genes + moves, genes - moves]), -2, 0)
    up, down = np.asarray(fitness(moved.reshape(len(genes), -1))).reshape(moved.shape[1:])
    differences = np.moveaxis((up - down).T / (2 * WIDTHS), -1, 0)
    expected, uncertainty = closest(differences.reshape(len(WIDTHS), -1).T)
    found = (directions * slopes).sum(1).T.ravel()
    # Near a kink, an error may be several times the change from one width to the next.
    limit = np.maximum(TOLERANCE, 10 * uncertainty)
    assert (np.abs(found - expected) < limit * np.abs(expected)).all()
    # Most differences are certain enough to show a missing term.
    assert np.median(uncertainty) < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("animal", ["pair", "swimmer"], indirect=True)
def test_gradients_in_float32(animal):
    """The median error of gradients is below the sum of one rounding error per step.

    Individuals have larger errors if derivatives nearly cancel, or rounding crosses a kink.
    """
    _, animal = animal
    single = slopes_of(animal.outcome, animal.genes, animal.stops, np.float32)
    size = np.linalg.norm(animal.slopes, axis=0)
    error = np.linalg.norm(single - animal.slopes, axis=0) / size
    steps = np.array(SECONDS) * 120
    assert (np.median(error, 0) < steps * np.finfo(np.float32).eps / 2).all()
    assert error.max() < 1e-3
    # The computation did use float32.
    assert np.median(error) > 1e-8
