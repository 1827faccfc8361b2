"""The shipped insect steps: its feet stand for over half of a stride, and hardly slide."""

import numpy as np
import pytest

import evo_cpg as evo
from creatures import quick_jit
from evo_cpg.control.brain_cpg import BrainCpg
from evo_cpg.simulation.rollout import rollout

SECONDS = 6


def constant_drive(controller: BrainCpg, outputs) -> np.ndarray:
    """Return genes of a brain whose outputs are constant: weights of 0, and biases."""
    *_, hidden, count = controller.brain.sizes
    genes = np.zeros((controller.gene_count, 1), np.float32)
    odds = np.array(outputs) / (1 - np.array(outputs))
    genes[-count * (hidden + 1) :].reshape(count, hidden + 1)[:, -1] = np.log(odds)
    return genes


@pytest.mark.slow
def test_tripods_stand_for_over_half_of_a_stride():
    """The drive is full, without steering, in the middle of the tempi."""
    changes = [f"simulation.steps={60 * SECONDS}", "simulation.trials=1", "measures=[duty_factor]"]
    experiment = evo.load("hexapod_tripod", changes)
    simulation = experiment.parts.simulation
    assert isinstance(simulation.controller, BrainCpg)
    genes = constant_drive(simulation.controller, [0.8, 0.999, 0.5, 0.5, 0.4])
    outcome = quick_jit(lambda genes: rollout(simulation, genes))(genes)
    terms = {name: float(values[0]) for name, values in outcome.terms.items()}
    assert outcome.alive.all()
    assert terms["duty_factor"] > 0.5
    assert terms["slip"] < 0.15 * terms["forward"]
    assert terms["forward"] / SECONDS > 0.3
    assert terms["airborne"] < 0.01
