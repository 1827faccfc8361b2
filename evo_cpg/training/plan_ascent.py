"""Gradient ascent of body plans: sizes, places and strengths of parts, and their brains.

A gradient has two parts. The gradient of the fitness by the numbers of a plan comes from the
program of the trials (`compile_slopes`). The development of the genes then pulls it back
(`evo_cpg.creature.development`). Growth has no derivative, so no step adds a part on purpose.

Genes of a plan have steps, and a small change of a size may remove a part that overlaps now. So the
value counts that a plan has after rounding. The derivative takes no notice of both.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh
from jaxtyping import Array, Float, UInt32

from evo_cpg.native.machine_constants import LANES
from evo_cpg.simulation.backward import Backward
from evo_cpg.simulation.judge import Scored
from evo_cpg.simulation.planned import PlanBuilder, PlanInputs
from evo_cpg.simulation.rollout import rollout
from evo_cpg.training.ascent import Climbed, ClimbSettings, GuardedAdam
from evo_cpg.training.devices import Layout, run_on, sharded
from evo_cpg.training.experiment import ExperimentParts, mean_of_trials, situation_numbers


def compile_slopes(
    plans: PlanBuilder, mesh: Mesh, trials: int = 1, numbers: Any = None
) -> Callable[..., tuple[Float[np.ndarray, " n"], tuple[Any, ...]]]:
    """Return a function that differentiates the fitness of plans, in the program that fits each.

    Args:
        plans: the plans.
        mesh: the devices.
        trials: number of trials of a plan, over which the fitness is averaged.
        numbers: situation of each trial, or None.

    Returns:
        A function of genes, retentions (`Backward`), the task's scales and keys of noise, all with
        plans on the last axis. It returns the fitness, and its derivatives by the arrays of
        `PlanBuilder.developed` but the first.
    """

    @functools.cache
    def program(size: int) -> Callable[..., Any]:
        return _differentiated(plans.inputs(size), mesh, trials, numbers)

    def slopes(genes: Float[np.ndarray, "g n"], *more: Any) -> tuple[np.ndarray, Any]:
        found = plans.developed(genes)
        sizes = np.array(plans.sizes)[np.searchsorted(plans.sizes, found[0] + 1)]
        value, slope = np.zeros(len(sizes), np.float32), jax.tree.map(np.zeros_like, found[1:])
        for size in np.unique(sizes).tolist():
            own = np.flatnonzero(sizes == size)
            given, pull_back = jax.vjp(
                lambda *x, own=own, size=size: plans.given((found[0], *x), own, size), *found[1:]
            )
            given = jax.tree.map(lambda x: np.asarray(x, np.float32), given)
            picked = jax.tree.map(lambda x, own=own: x[..., own], more)
            value[own], raw = program(size)(given, *picked)
            # Derivatives by the numbers of other plans are 0.
            slope = jax.tree.map(lambda x, y: x + np.asarray(y), slope, pull_back(raw))
        return value, slope

    return slopes


def _differentiated(
    inputs: PlanInputs, mesh: Mesh, trials: int, numbers: Any
) -> Callable[..., tuple[np.ndarray, tuple[np.ndarray, np.ndarray]]]:
    """Return the function of `compile_slopes` for one program, of `PlanBuilder.given`'s arrays."""
    common = inputs.common
    rough, slides = common.world.contact_model is not None, common.world.tree.root_slides

    def fitness(
        given: tuple[Array, Array],
        kept: Float[Array, ""],
        scales: dict[str, Float[Array, ""]],
        keys: UInt32[Array, "w trials"] | None,
    ) -> Float[Array, ""]:
        genes, values = given
        replicas = jnp.broadcast_to(genes[:, None], (len(genes), trials))
        trial, backward = inputs.put(common, [values]), Backward(kept, rough, slides)
        return mean_of_trials(
            rollout(trial, replicas, keys, numbers, Scored(scales), backward=backward)
        )

    program = sharded(jax.vmap(jax.value_and_grad(fitness), -1, -1), mesh, ((2, 2), 1, 1, 3))

    def run(*given: Any) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray]]:
        return run_on(program, Layout(mesh, max(1, LANES // trials)), given)

    return run


class _Loss(NamedTuple):
    """Loss of individuals and its gradient, as `GuardedAdam.query` takes them."""

    f: Float[np.ndarray, " n"]
    grad: Float[np.ndarray, "g n"]


def compile_plan_ascent(
    experiment: ExperimentParts, mesh: Mesh, steps: int
) -> Callable[..., Climbed]:
    """Return the function of `evo_cpg.training.ascent.compile_ascent` for body plans."""
    plans, numbers = experiment.simulation.plans, situation_numbers(experiment)
    assert plans is not None

    slopes = compile_slopes(plans, mesh, experiment.trials, numbers)
    adam = GuardedAdam()
    start = jax.jit(jax.vmap(lambda genes: adam.init(genes, None), -1, -1))
    query = jax.jit(jax.vmap(adam.query, -1, -1))

    def run(
        genes: Float[np.ndarray, "g n"],
        settings: ClimbSettings,
        scales: dict[str, Float[np.ndarray, " n"]],
        keys: UInt32[np.ndarray, "w trials n"] | None = None,
    ) -> Climbed:
        state, place = start(genes), genes
        for _ in range(steps + 1):
            rounded = np.asarray(plans.layout.nearest(place), genes.dtype)
            value, found = slopes(rounded, settings.retentions, scales, keys)
            slope = plans.pulled_back(rounded, found).astype(np.float32)
            # The best point is kept as the rounded genes.
            state = query(rounded, _Loss(-value, -slope), state)
            place = place + settings.sizes[None] * state.move
        best, value = np.asarray(state.best), -np.asarray(state.least)
        return Climbed(best, value, np.asarray(state.finite))

    return run
