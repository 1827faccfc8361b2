"""The way that audits measure beside the terms of a task."""

import jax.numpy as jnp
import numpy as np

from evo_cpg.simulation.way import WAY, WithWay, _Way
from trials import OneTerm


def test_a_term_of_the_task_that_is_called_way_stays_what_it_is():
    """An audit of such a run once said that its fitness does not come out as recorded."""
    start, place = np.zeros((2, 3)), np.array([[3.0, 0, 0], [4, 0, 1]])
    tally = _Way(jnp.array([0.5, 1.5, 2.5]), jnp.asarray(start), jnp.asarray(place))
    task = WithWay(None, OneTerm("way"))
    terms = task.terms(tally, 10)
    np.testing.assert_allclose(terms[WAY], [5, 0, 1])
    np.testing.assert_allclose(task.fitness(terms, {}), [0.5, 1.5, 2.5])
