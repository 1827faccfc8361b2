"""Training of one brain for every body: directions, interruptions, and visits of plans."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from evo_cpg.api.progress import Work
from evo_cpg.control.body_brain import WEIGHTS, newborn_weights
from evo_cpg.io.build import build_experiment
from evo_cpg.io.load import check_config
from evo_cpg.native.jax_internals import quick_jit
from evo_cpg.simulation.rollout import rollout
from evo_cpg.studies.newborns import evolving, trained
from evo_cpg.studies.nursery import AWAY, AllAlike, Nursery, bearings

COUNT = sum(WEIGHTS)
GOAL = np.random.default_rng(0).normal(size=COUNT)


def uphill(draw, weights):
    """Return the direction to `GOAL` with noise."""
    return GOAL - weights + 0.1 * draw.normal(size=COUNT)


def test_training_goes_on_after_an_interruption(tmp_path):
    """A training in two parts has the bits of one without a pause, and reaches the goal."""
    whole, parts = tmp_path / "whole.npz", tmp_path / "parts.npz"
    calls = []

    def counted(draw, weights):
        calls.append(1)
        if len(calls) == 31:
            raise KeyboardInterrupt
        return uphill(draw, weights)

    clock = iter(range(10**6))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("evo_cpg.studies.newborns.time.process_time", lambda: float(next(clock)))
        expected = trained(uphill, 0.1, 2.0, whole, Work())
        with pytest.raises(KeyboardInterrupt):
            trained(counted, 0.1, 2.0, parts, Work())
        found = trained(counted, 0.1, 2.0, parts, Work())
    np.testing.assert_array_equal(found, expected)
    # The first 20 of 30 updates were kept.
    assert len(calls) == 31 + 100
    assert np.abs(found - GOAL).max() < 0.4


def test_evolution_moves_along_the_gradient():
    """For a linear fitness, the direction is the gradient but for noise of 195 numbers."""

    def covered(visits):
        return GOAL @ visits[-COUNT:]

    def visits(plans, lights, weights, sight):
        assert lights.shape == (3, len(plans)) and sight == 1.0
        return np.concatenate([plans[None], lights, np.full((1, len(plans)), sight), weights])

    def lights(draw, plans):
        return bearings(draw, len(plans))

    nursery: Any = SimpleNamespace(
        lengths=np.ones(9), covered=covered, visits=visits, lights=lights
    )
    found = sum(evolving(nursery)(np.random.default_rng(i), np.zeros(COUNT)) for i in range(40))
    cosine = found @ GOAL / np.linalg.norm(found) / np.linalg.norm(GOAL)
    assert cosine > 0.95


def test_bearings_have_no_preferred_side():
    found = bearings(np.random.default_rng(0), 20_000)
    np.testing.assert_allclose(np.linalg.norm(found, axis=0), 1.0)
    np.testing.assert_allclose(found.mean(1), 0.0, atol=0.02)
    np.testing.assert_allclose((found**2).mean(1), 1 / 3, atol=0.02)


@pytest.mark.slow
def test_chains_bend_to_the_sides_behind_a_trunk():
    plans = Nursery(0, 60, seconds=0.5, chains=0.5)
    lights = plans.lights(np.random.default_rng(0), np.arange(60))
    np.testing.assert_allclose(np.linalg.norm(lights, axis=0), 1.0)
    assert (lights[2, plans.chain] == 0).all() and (lights[2, ~plans.chain] != 0).all()
    assert 15 < plans.chain.sum() < 45
    numbers = set()
    for genes in plans.genes[:, plans.chain].T:
        plan, graph = plans.plan(genes), plans.layout.unpack(genes)
        tail = np.isin(plan.label, np.asarray(graph.label)[[1, 3]]) & plan.present
        assert (plan.axes[tail] == [False, False, True]).all()
        assert all(parent == 0 or tail[parent] for parent in plan.parent[tail])
        numbers.add(int(tail.sum()))
    assert min(numbers) < 4 and max(numbers) > 6


@pytest.fixture(scope="module")
def nursery():
    """Trials are short, because the chaos of strokes enlarges rounding."""
    return Nursery(3, 32, seconds=0.5)


@pytest.mark.slow
def test_visits_are_trials_of_own_animals(nursery):
    """The plan as an animal of its own, with its light, covers as much of the distance."""
    lights = bearings(np.random.default_rng(0), 32)
    visits = nursery.visits(np.arange(32), lights, newborn_weights()[:, None])
    covered = nursery.covered(visits)
    assert np.median(covered) > 1e-3
    for i in (0, 7):
        config, genes = nursery.alone(nursery.genes[:, i])
        x, y, z = lights[:, i]
        data = config.model_dump(mode="json")
        data["controller"] = {"type": "body_brain", "brain": "newborn"}
        data["task"]["light"] = {
            "distance": float(AWAY * nursery.lengths[i]),
            "bearing_deg": float(np.degrees(np.arctan2(y, x))),
            "elevation_deg": float(np.degrees(np.arcsin(z))),
        }
        own = build_experiment(check_config(data, "x.yaml"), "x.yaml").simulation
        even = np.full((len(genes), 1), 0.5, np.float32)
        outcome = quick_jit(lambda genes, own=own: rollout(own, genes))(even)
        assert 1 - float(outcome.terms["distance"][0]) == pytest.approx(covered[i], abs=1e-4)


@pytest.mark.slow
def test_alike_axes_do_not_swim():
    alike = Nursery(3, 32, seconds=2.0, brain=AllAlike)
    lights = bearings(np.random.default_rng(0), 32)
    visits = alike.visits(np.arange(32), lights, newborn_weights()[:, None])
    assert np.median(alike.covered(visits)) < 0.02
