"""The displacement that audits measure in addition to the terms of a task."""

import dataclasses

import jax.numpy as jnp
import numpy as np

from evo_cpg.simulation.judge import finish_tally
from evo_cpg.simulation.measures import DISPLACEMENT, Displacement
from evo_cpg.simulation.simulation import with_displacement
from trials import OneTerm, experiment


def test_a_term_of_the_task_named_way_is_not_overwritten():
    """An audit of such a run once reported that its fitness differs from the recorded fitness."""
    start, place = np.zeros((2, 3)), np.array([[3.0, 0, 0], [4, 0, 1]])
    simulation = with_displacement(
        dataclasses.replace(experiment().simulation, task=OneTerm("way"))
    )
    own = jnp.array([0.5, 1.5, 2.5])
    terms = finish_tally(simulation, (own, (Displacement(jnp.asarray(start), jnp.asarray(place)),)))
    np.testing.assert_allclose(terms[DISPLACEMENT], [5, 0, 1])
    np.testing.assert_allclose(simulation.task.fitness(terms, {}), own)
