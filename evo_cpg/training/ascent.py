"""Gradient ascent on the fitness: optax's Adam in an optimistix solver, many individuals at once.

The fitness of a whole trial is rough: its gradient may change sign within a hundredth of a gene's
range. A solver that must improve at every step soon stops on a small bump (L-BFGS with a line
search did). Adam's steps pass over bumps, and the best visited point is kept. No single step size
or gradient horizon (see `evo_cpg.simulation.backward`) suits all, so each individual draws its own.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
import optimistix
from jax.sharding import Mesh
from jaxtyping import Array, Float, Int, UInt32

from evo_cpg.native.machine_constants import LANES
from evo_cpg.simulation.backward import Backward, retention
from evo_cpg.simulation.judge import Scored
from evo_cpg.simulation.rollout import rollout
from evo_cpg.simulation.simulation import Simulation
from evo_cpg.training.devices import Layout, run_on, sharded
from evo_cpg.training.experiment import ExperimentParts, mean_of_trials, situation_numbers

# Range of step sizes in water, in units of genes. They are drawn evenly on a logarithmic scale.
_STEP_SIZES = 3e-4, 1e-2
# Factor on step sizes on the ground, where a gradient is valid over a shorter distance. Most
# champions of five walkers gained fitness with a step size of 1e-4.
_FINER_ON_GROUND = 0.1
# Factor on step sizes of body plans, because smaller changes than half a step of a gene are lost.
_COARSER_IN_PLANS = 4.0
# Lower bound of the random gradient horizons, s, in water and on the ground. On the ground,
# gradients grow a hundredfold in half a second.
_SHORTEST_HORIZON, _SHORTEST_ON_GROUND = 1.0, 0.1
# Fraction of individuals with an infinite horizon: their gradients do not decay back in time.
_EXACT = 0.25

# A longer gradient is scaled down to this multiple of the mean length (norm) of earlier gradients.
_LONGEST = 10.0
# Weight of the old value in that moving average.
_LENGTH_DECAY = 0.9


# Adam's mean of squares decays faster than usual (b2 = 0.999), because an ascent has few steps.
_ADAM = optax.scale_by_adam(b1=0.9, b2=0.99, eps=1e-12)


class _Descended(eqx.Module):
    """State of `GuardedAdam`.

    Attributes:
        best: parameters at the best point.
        least: value of the objective at the best point.
        length: exponential moving average of the gradients' norm after the guard, or 0 before the
            first gradient.
        finite: number of finite gradients.
        adam: state of Adam.
        move: next change of the parameters, for a step size of 1.
    """

    best: Any
    least: Array
    length: Array
    finite: Array
    adam: Any
    move: Any


class GuardedAdam(optimistix.AbstractDescent):
    """Descent direction of Adam (Kingma and Ba 2015) by optax, guarded against long gradients.

    Exploding gradients would dominate Adam's moments. A gradient that is not finite counts as zero.
    A gradient much longer than earlier ones is scaled down. (`optax.adaptive_grad_clip` compares a
    gradient with the parameters. Their size says nothing about cliffs of the fitness.)
    """

    def init(self, y: Any, f_info_struct: Any) -> _Descended:
        """Return the initial state, with an infinite best loss."""
        del f_info_struct
        move = jax.tree.map(jnp.zeros_like, y)
        none, count = jnp.zeros(()), jnp.zeros((), jnp.int32)
        return _Descended(y, jnp.full((), jnp.inf), none, count, _ADAM.init(y), move)

    def query(self, y: Any, f_info: Any, state: _Descended) -> _Descended:
        """Update the state with the value and the gradient at ``y``."""
        length = optax.tree.norm(f_info.grad)
        finite, first = jnp.isfinite(length), state.length == 0
        longest = jnp.where(first, length, _LONGEST * state.length)
        factor = jnp.minimum(1.0, longest / jnp.maximum(length, jnp.finfo(length.dtype).tiny))
        kept = jax.tree.map(lambda x: jnp.where(finite, factor * x, 0.0), f_info.grad)
        usual = _LENGTH_DECAY * state.length + (1 - _LENGTH_DECAY) * factor * length
        mean = jnp.where(finite, jnp.where(first, length, usual), state.length)
        ascent, adam = _ADAM.update(kept, state.adam, y)
        move = jax.tree.map(lambda x: -1.0 * x, ascent)
        better = f_info.f < state.least
        best = jax.tree.map(lambda new, old: jnp.where(better, new, old), y, state.best)
        least, count = jnp.where(better, f_info.f, state.least), state.finite + finite
        return _Descended(best, least, mean, count, adam, move)

    def step(self, step_size: Array, state: _Descended) -> tuple[Any, optimistix.RESULTS]:
        """Return the next move: about ``step_size`` for each gene whose gradient keeps its sign."""
        return jax.tree.map(lambda x: step_size * x, state.move), optimistix.RESULTS.successful


class Climber(optimistix.AbstractGradientDescent):
    """Minimiser with a fixed number of Adam steps of a given size, without a convergence test.

    The result is the best of all points at which value and gradient were computed.
    (`optimistix.BestSoFarMinimiser` compares points one step late and would leave out the last.)
    """

    search: optimistix.LearningRate
    descent: GuardedAdam = GuardedAdam()
    rtol: float = 0.0
    atol: float = 0.0
    norm: Callable = optimistix.max_norm

    def postprocess(self, *given: Any) -> tuple[Any, Any, dict[str, Any]]:
        """Return the best point instead of the last."""
        _, _, aux, _, _, state, _, _ = given
        return state.descent_state.best, aux, {}


class ClimbSettings(NamedTuple):
    """Settings of the ascent of each individual.

    Attributes:
        sizes: step sizes, in units of genes.
        retentions: fraction of a gradient that is left one control step further back, see
            `evo_cpg.simulation.backward.Backward`.
    """

    sizes: Float[np.ndarray, " n"]
    retentions: Float[np.ndarray, " n"]


def draw_settings(
    rng: np.random.Generator, simulation: Simulation, count: int, stretched: float = 1.0
) -> ClimbSettings:
    """Draw a step size and a gradient horizon for each individual.

    Horizons lie between the shortest horizon, times ``stretched``, and ten times the trial's
    duration, or are infinite.
    """
    duration = simulation.duration
    rough = simulation.world.contact_model is not None
    shortest = stretched * (_SHORTEST_ON_GROUND if rough else _SHORTEST_HORIZON)
    horizons = log_uniform(rng, min(shortest, duration), 10 * duration, count)
    horizons[rng.random(count) < _EXACT] = np.inf
    sizes = reach(simulation) * log_uniform(rng, *_STEP_SIZES, count)
    return ClimbSettings(sizes, retention(horizons, simulation.control_rate))


def reach(simulation: Simulation) -> float:
    """Return the factor on step sizes and kicks: 1 in water for a fixed body."""
    finer = 1.0 if simulation.world.contact_model is None else _FINER_ON_GROUND
    return finer * (_COARSER_IN_PLANS if simulation.plans else 1.0)


def log_uniform(
    rng: np.random.Generator, low: float, high: float, count: int
) -> Float[np.ndarray, " n"]:
    """Draw numbers between two bounds, evenly on a logarithmic scale."""
    return np.exp(rng.uniform(np.log(low), np.log(high), count)).astype(np.float32)


class Climbed(NamedTuple):
    """Results of the ascent of individuals.

    Attributes:
        genes: best genes of each individual, then its shifts of `Free` numbers. Genes are cut to
            the strategy's bound.
        fitness: fitness of the best genes before the cut, or -inf if it was never finite.
        finite: number of finite gradients of each individual. Other gradients count as zero.
    """

    genes: Float[np.ndarray, "g n"]
    fitness: Float[np.ndarray, " n"]
    finite: Int[np.ndarray, " n"]


class Free(NamedTuple):
    """Numbers of an experiment that are refined together with the genes.

    Attributes:
        values: initial values of the numbers.
        simulation: function that returns the simulation at other values, which may be traced.
        rebuild: function that builds the experiment at other values. It returns None if the values
            are not allowed.
    """

    values: Float[np.ndarray, " k"]
    simulation: Callable[[Float[Array, " k"]], Simulation]
    rebuild: Callable[[Float[np.ndarray, " k"]], ExperimentParts | None]

    def at(self, shifts: Any) -> Any:
        """Return the values after shifts. A small shift is a relative change.

        A positive value is multiplied by ``exp(shift)``, so it stays positive. To a negative value,
        the shift times its size is added. To zero, the shift is added.
        """
        size = np.where(self.values, np.abs(self.values), 1.0)
        positive = self.values > 0
        factor = jnp.exp(jnp.where(positive, shifts, 0.0))
        return jnp.where(positive, self.values * factor, self.values + size * shifts)


def compile_ascent(
    experiment: ExperimentParts, mesh: Mesh, steps: int, free: Free | None = None
) -> Callable[..., Climbed]:
    """Return a function that runs the ascent of any number of individuals on a mesh.

    Args:
        experiment: experiment of the individuals.
        mesh: the devices.
        steps: number of moves of each individual.
        free: numbers of the experiment whose shifts (see `Free.at`) follow the genes.

    Returns:
        A function of host arrays, compiled at its first call. Arguments: genes, settings, the
        task's scales and, with noise, the keys of every individual's trials. Individuals are on
        the last axis.
    """
    simulation, gene_count = experiment.simulation, experiment.simulation.genome.count
    numbers: Any = situation_numbers(experiment)
    width = max(1, LANES // experiment.trials)
    # Gradients pass through ground contact (`evo_cpg.simulation.backward`).
    rough = simulation.world.contact_model is not None

    def fitness(
        genes: Float[Array, " g"],
        scales: dict[str, Float[Array, ""]],
        kept: Float[Array, ""],
        keys: UInt32[Array, "w trials"] | None,
    ) -> Float[Array, ""]:
        own, shifts = genes[:gene_count], genes[gene_count:]
        replicas = jnp.broadcast_to(own[:, None], (gene_count, experiment.trials))
        trial = simulation
        if free:
            trial = free.simulation(free.at(shifts).astype(genes.dtype))
        backward = Backward(kept, rough, simulation.world.tree.root_slides)
        found = rollout(trial, replicas, keys, numbers, Scored(scales), backward=backward)
        return mean_of_trials(found)

    def climb(
        genes: Array, settings: Any, scales: dict[str, Array], keys: Array | None
    ) -> tuple[Array, Array, Array]:
        solution = optimistix.minimise(
            lambda genes, _: -fitness(genes, scales, settings.retentions, keys),
            Climber(search=optimistix.LearningRate(settings.sizes)),
            genes,
            # One evaluation at the start, and one after each move.
            max_steps=steps + 1,
            throw=False,
        )
        memory = solution.state.descent_state
        return memory.best, -memory.least, memory.finite

    program = sharded(jax.vmap(climb, in_axes=-1, out_axes=-1), mesh, (2, 1, 1, 3))

    def run(
        genes: Float[np.ndarray, "g n"],
        settings: ClimbSettings,
        scales: dict[str, Float[np.ndarray, " n"]],
        keys: UInt32[np.ndarray, "w trials n"] | None = None,
    ) -> Climbed:
        given = genes, settings, scales, keys
        best, value, finite = run_on(program, Layout(mesh, width), given)
        bound = getattr(experiment.strategy, "gene_bound", None)
        if bound is not None:
            bounded = np.clip(best[:gene_count], -bound, bound)
            best = np.concatenate([bounded, best[gene_count:]])
        return Climbed(best, value, finite)

    return run
