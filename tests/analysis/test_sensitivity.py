"""Elasticities of known functions, and their confirmation by finite differences."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

import trials
from evo_cpg.analysis import sensitivity
from evo_cpg.analysis.sensitivity import changed, differentiate, measured, sensitivities
from evo_cpg.physics.contact.contact_model import Ground, make_contact_model
from evo_cpg.simulation import measures as gait
from evo_cpg.simulation.judge import Outcome, finish_tally
from evo_cpg.simulation.measures import Displacement
from trials import OneTerm

KEYS = ("squared", "inverse", "step", "zero", "idle")
VALUES = np.array([3.0, 2.0, 1.0, 0.0, 5.0])


def measure(values):
    """Return a power law with a step, a parameter of 0 and a parameter without effect."""
    squared, inverse, step, zero, _ = values
    return jnp.stack([squared**2 / inverse * (1 + 0.5 * zero) + jnp.where(step > 1.005, 1.0, 0.0)])


@pytest.fixture
def found(x64):
    return ranked(lambda values: True)


def ranked(allowed):
    value, slopes = differentiate(measure, jnp.asarray(VALUES))
    places = changed(VALUES, allowed)
    after = np.array([[measure(place) for place in side] for side in places]).transpose(2, 0, 1)
    steps = np.diagonal(places[1] - places[0])
    (rows,) = sensitivities(KEYS, VALUES, np.asarray(value), np.asarray(slopes), after, steps)
    return rows


def test_elasticities_are_the_exponents_of_a_power_law(found):
    by_key = {row.key: row for row in found}
    assert by_key["squared"].elasticity == pytest.approx(2.0, rel=1e-12)
    assert by_key["inverse"].elasticity == pytest.approx(-1.0, rel=1e-12)
    assert by_key["idle"].elasticity == 0.0
    # For a parameter of 0, the elasticity is the relative change per unit of the parameter.
    assert by_key["zero"].elasticity == pytest.approx(0.5, rel=1e-12)
    assert by_key["squared"].finite == pytest.approx(2.0, rel=1e-3)


def test_differences_at_an_edge_are_one_sided(x64):
    """Bounds: at least 0, at most 2, and no change. The last is not confirmed."""

    def allowed(values):
        squared, inverse, _, zero, _ = values
        return squared == VALUES[0] and inverse <= 2.0 and zero >= 0.0

    rows = {row.key: row for row in ranked(allowed)}
    assert rows["zero"].confirmed and rows["zero"].finite == pytest.approx(0.5, rel=1e-6)
    assert rows["inverse"].confirmed and rows["inverse"].finite == pytest.approx(-1.0, rel=0.02)
    assert not rows["squared"].confirmed and np.isnan(rows["squared"].finite)
    assert rows["squared"].elasticity == pytest.approx(2.0, rel=1e-12)


def test_a_measure_of_zero_has_no_elasticity(x64):
    one = np.ones(1)
    ((row,),) = sensitivities(("p",), one, 1e-17 * one, one[None], np.zeros((1, 2, 1)), one)
    assert np.isnan([row.elasticity, row.finite]).all() and not row.confirmed


def test_a_step_is_not_confirmed_and_ranks_by_its_change(found):
    assert {row.key for row in found if not row.confirmed} == {"step"}
    # The measure changes by 1 / 4.5 for 2 % of the parameter.
    step = next(row for row in found if row.key == "step")
    assert step.elasticity == 0.0 and step.finite == pytest.approx(1 / 4.5 / 0.02)
    assert [row.key for row in found] == ["step", "squared", "inverse", "idle", "zero"]


@pytest.mark.parametrize("names", [(), ("speed",)])
def test_speed_needs_no_term_of_task_or_measures(monkeypatch, names):
    simulation = dataclasses.replace(trials.experiment(steps=91).simulation, task=OneTerm("own"))
    simulation = dataclasses.replace(simulation, measures=gait.measures(*names))
    ground = make_contact_model(trials.swimmer(()), simulation.world.tree, Ground(0.0, 0.6, 0.6))
    world = dataclasses.replace(simulation.world, contact_model=ground)
    start, end = jnp.zeros((3, 1)), jnp.array([[3.0], [4.0], [1.0]])

    def fake_rollout(simulation, genes, keys):
        moved = Displacement(start, end)
        *own, _ = simulation.measures.each
        tallies = *(dict.fromkeys(gait.MEASURES[one.name], moved) for one in own), moved
        return Outcome(finish_tally(simulation, (jnp.array([7.0]), tallies)), jnp.array([True]))

    monkeypatch.setattr(sensitivity, "rollout", fake_rollout)
    # In 1.5 s the displacement is 5 m over ground, without height, and more in water.
    for evaluated, displacement in (
        (simulation, 26**0.5),
        (dataclasses.replace(simulation, world=world), 5),
    ):
        speed, fitness = measured(evaluated, jnp.zeros((2, 1)), {})
        np.testing.assert_allclose([speed[0], fitness[0]], [displacement / 1.5, 7.0], rtol=1e-6)
