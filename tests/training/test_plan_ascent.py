"""Body plans climb the gradient of their fitness: in steps of genes, and never down."""

import numpy as np
import pytest

from evo_cpg.simulation.judge import score
from evo_cpg.training.ascent import draw_settings
from evo_cpg.training.devices import population_mesh
from evo_cpg.training.evaluate import compile_trials
from evo_cpg.training.plan_ascent import compile_plan_ascent
from plans import WATER, plan_experiment, random_genes

COUNT, STEPS = 16, 4


@pytest.mark.slow
def test_plans_climb_and_keep_what_trials_confirm():
    """The fitness of the best genes is that of a trial, and most plans gain by more than rounding.

    The gradient moves sizes, places, strengths and control genes, and no gene that is a choice.
    """
    made = plan_experiment(WATER, 4, 1.0)
    plans = made.simulation.plans
    genes = random_genes(plans, COUNT).astype(np.float32)
    settings = draw_settings(np.random.default_rng(0), made.simulation, COUNT)
    climbed = compile_plan_ascent(made, population_mesh(), STEPS)(genes, settings, {})
    np.testing.assert_array_equal(climbed.finite, STEPS + 1)
    np.testing.assert_array_equal(plans.layout.nearest(climbed.genes), climbed.genes)
    run = compile_trials(made.simulation, population_mesh())
    before, after = (
        np.asarray(score(made.simulation.task, run(each), {})) for each in (genes, climbed.genes)
    )
    np.testing.assert_allclose(climbed.fitness, after, rtol=1e-3, atol=1e-6)
    assert (after >= before - 1e-6).all() and np.mean(after > 1.01 * before) > 0.7
    first, last = (plans.layout.unpack(each)._asdict() for each in (genes, climbed.genes))
    changed = {name for name, gene in first.items() if (gene != last[name]).any()}
    assert changed == {"size", "place", "strength", "limits", "control"}
