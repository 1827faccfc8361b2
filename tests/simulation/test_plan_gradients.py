"""Gradients through body plans, their brains and the physics, against central differences."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from creatures import quick_jit
from evo_cpg.control.body_brain import newborn_weights
from evo_cpg.creature.development import developed
from evo_cpg.io.plans import EvolvedPlans
from evo_cpg.simulation.backward import Backward
from evo_cpg.simulation.judge import Scored
from evo_cpg.simulation.planned import numbers_of
from evo_cpg.simulation.rollout import rollout
from evo_cpg.studies.nursery import AWAY, Nursery, bearings
from plans import WATER, plans_of, random_genes

SECONDS, COUNT = 0.1, 8
# Standard deviations of changes: of the logarithm of a size, of a place (m), a strength, a weight.
SPREAD = {"size": 0.3, "place": 0.02, "strength": 0.1, "brain": 0.1}


@pytest.fixture(autouse=True)
def double_precision():
    with jax.enable_x64(True):
        yield


def fitness_of(nursery: Nursery):
    """Return the fitness of a plan with changes in float64."""
    inputs, scored = nursery.inputs(nursery.sizes[-1]), Scored({"energy": jnp.ones(())})

    def fitness(changes, plan, light):
        factor = jnp.exp(changes["size"])
        place = plan.place * factor[jnp.maximum(plan.parent, 0)] + changes["place"]
        plan = plan._replace(
            half=plan.half * factor,
            place=jnp.where((plan.parent >= 0)[:, None], place, 0.0),
            strength=plan.strength + changes["strength"],
        )
        numbers = numbers_of(plan, nursery.physics)
        rows = [x.reshape(-1) for x in jax.tree.leaves(numbers)]
        weights = newborn_weights() + changes["brain"]
        own = inputs.put(inputs.common, [jnp.concatenate([*rows, light, jnp.ones(1), weights])])
        genes = jnp.full(inputs.common.genome.count, 0.5)
        return rollout(own, genes, observers=scored, backward=Backward())

    return jax.vmap(fitness)


def with_absent_body(plan):
    """Return a plan with one more place for a body, as the largest program has."""
    more = jax.tree.map(lambda x: np.concatenate([x, np.zeros_like(x[:1])]), plan)
    for name, value in (("parent", -1), ("slot", -1), ("mirror", 1), ("rotation", np.eye(3))):
        getattr(more, name)[-1] = value
    return more


@pytest.mark.slow
def test_gradients_of_bodies_and_brains_equal_differences():
    """Sizes, places, strengths and brain change together, to 1e-5.

    The bodies differ a little from random plans, because equal sizes of two parts are a kink.
    """
    nursery, draw = Nursery(3, COUNT, seconds=SECONDS), np.random.default_rng(0)
    plans = [with_absent_body(nursery.plan(own)) for own in nursery.genes.T]
    plan = jax.tree.map(lambda *x: np.stack(x), *plans)
    light = (AWAY * nursery.lengths * bearings(draw, COUNT)).T
    bodies = plan.half.shape[:2]
    shapes = {
        "size": (*bodies, 3),
        "place": (*bodies, 3),
        "strength": bodies,
        "brain": (COUNT, 195),
    }
    start, along = (
        {name: scale * SPREAD[name] * draw.normal(size=shape) for name, shape in shapes.items()}
        for scale in (0.1, 1.0)
    )
    fitness = fitness_of(nursery)
    run, slopes = quick_jit(fitness), quick_jit(jax.grad(lambda *x: fitness(*x).sum()))
    found = slopes(start, plan, light)
    found = sum((found[k] * along[k]).reshape(COUNT, -1).sum(1) for k in along)
    # Differences of the fourth order, because the fitness bends within 1e-5 of a weight.
    step = 1e-6
    one, two = (
        np.subtract(
            *(
                run(jax.tree.map(lambda x, y, s=s: x + s * step * y, start, along), plan, light)
                for s in (far, -far)
            )
        )
        for far in (1, 2)
    )
    expected = (8 * one - two) / (12 * step)
    error = np.abs(found - expected) / np.abs(expected)
    assert error.max() < 1e-5, error


@pytest.mark.slow
def test_derivatives_of_growth_take_no_notice_of_rounding():
    """They are differences over one step of a gene, to the curvature of an exponential."""
    plans: EvolvedPlans = plans_of(WATER, 6, 0.1)
    genes = random_genes(plans, 20)
    graph = plans.layout.unpack(genes[:, 0])

    def grow(graph):
        return developed(graph, plans.layout, plans.bounds)

    grown = quick_jit(grow)
    for name, step in (("size", 1 / 256), ("strength", 1 / 256), ("place", 1 / 128)):
        gene = getattr(graph, name)
        along = np.zeros_like(gene)
        along[0] = 1.0
        tangents = jax.tree.map(np.zeros_like, graph)._replace(**{name: along})
        _, found = quick_jit(lambda *given: jax.jvp(grow, given[:1], given[1:]))(graph, tangents)
        sides = [grown(graph._replace(**{name: gene + s * step * along})) for s in (1, -1)]
        for field in ("half", "place", "strength"):
            high, low = (np.asarray(getattr(side, field)) for side in sides)
            expected = (high - low) / (2 * step)
            np.testing.assert_allclose(getattr(found, field), expected, rtol=0.02, atol=1e-9)
