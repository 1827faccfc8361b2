"""Measurements of studies, for cases with a known answer."""

from unittest import mock

import jax.numpy as jnp
import numpy as np
import pytest

from evo_cpg.control.brain import think
from evo_cpg.control.brain_cpg import BrainCpg, silent_genes
from evo_cpg.control.postures import PostureController, one_posture
from evo_cpg.io.build import build_experiment
from evo_cpg.io.load import load_config
from evo_cpg.io.shipped import shipped
from evo_cpg.studies import controls, fukui2003, search
from evo_cpg.studies.parts import audit_table, evaluate, kept_table
from evo_cpg.studies.study import tabled
from evo_cpg.studies.workshop import Workshop, markdown
from evo_cpg.training.checkpoint import Champion
from evo_cpg.view import search_plots
from tiny_run import CONFIG, PAIR


def test_falls_are_relative_to_the_highest_before():
    best = np.array([[4.0, 1.0], [2.9, 2.0], [4.0, 3.0], [3.1, 4.0], [1.0, 5.0], [1.0, 6.0]])
    falls, share, _ = fukui2003._falls(best)
    # The first run is below 3 m in the generations 1, 4 and 5. The second run only rises.
    np.testing.assert_array_equal(falls, [2, 0])
    assert share == 3 / 12


def test_one_posture_has_equal_genes_for_all_angles():
    path = shipped("fukui2003_model1").path
    controller = build_experiment(load_config(path), path).simulation.controller
    assert isinstance(controller, PostureController)
    genes = one_posture(controller, 170.0)
    # 170 is the fourth of 110, 130, 150 and 170: number 3, bits 011.
    np.testing.assert_array_equal(genes.reshape(-1, 3), np.tile([0, 1, 1], (64, 1)))


def test_overrides_change_springs_and_lengths_of_all_eight_boxes():
    path = shipped("fukui2003_model1").path
    strong = load_config(path, fukui2003._springs(2.0)).creature.bodies
    for body in strong[1:]:
        assert body.joint is not None
        motor = body.joint.actuator
        assert (motor.stiffness, motor.gain, motor.torque_limit) == (300, 6, 80)
    config = load_config(path, fukui2003._legs(0.3))
    standing = build_experiment(config, path).creature
    plain = build_experiment(load_config(path), path).creature
    heavier = 1 + 8 * (0.3 - 0.24) * 0.08**2 / (0.6 * 0.3 * 0.16 + 8 * 0.24 * 0.08**2)
    assert float(standing.mass / plain.mass) == pytest.approx(heavier, rel=1e-5)
    for body in config.creature.bodies[1:]:
        assert body.joint is not None
        assert body.joint.child_at[2] == 0.15
        assert body.joint.at[2] == (-0.15 if body.name.endswith("lower") else -0.08)


def test_an_animal_without_drive_stays_where_it_is():
    config = load_config(CONFIG, [*PAIR, "simulation.seconds=2", "noise.push=0.02"])
    simulation = build_experiment(config, CONFIG).simulation
    controller = simulation.controller
    genes = silent_genes(controller)[:, None]
    assert isinstance(controller, BrainCpg)
    assert np.abs(evaluate(simulation, genes)["distance"] - 1).item() < 1e-3
    inputs = np.linspace(-1, 1, controller.brain.sizes[0], dtype=np.float32)[:, None]
    outputs = think(
        controller.brain, controller.decode(jnp.asarray(genes)).brain, jnp.asarray(inputs)
    )
    assert np.abs(controller.cpg_inputs(outputs)[0]).max() < 1e-12


def test_a_table_without_rows_is_its_title():
    assert markdown(tabled([], "None passed")) == "None passed\n\n"
    assert markdown(tabled([{"a": "1"}])) == "| a |\n| --- |\n| 1 |"


def test_audit_tables_show_fractions_and_reasons():
    displacements = {"own": 2.0, "b": 1.9, "b, hard": 1.0}
    opinions = [
        {"program": name, "way": moved, "upright": 1.0} for name, moved in displacements.items()
    ]
    reason, measured = "half the step: 50 %", {"way": 2.0, "half_step": 0.5, "pose": None}
    row = {"seed": 3, "passed": False, "reasons": [reason]}
    row |= {"measured": measured, "opinions": opinions}
    every = audit_table("", {"animal": [row]})
    expected = ["animal", "3", "2.00", "", "50.0 %", "1.90", "1.00", f"no: {reason}"]
    assert every.rows == [expected] and "b, hard: over ground, m" in every.head
    kept = kept_table("", {"animal": [row, row | {"passed": True}]})
    assert kept.rows[0][:4] == ["animal", "2.00 (2.00 to 2.00)", "", "50 (50 to 50) %"]
    assert kept.rows[0][-2:] == ["50 (50 to 50) %", "1 of 2"]
    alone = kept_table("", {"animal": [row | {"opinions": opinions[:1]}]})
    assert alone.rows[0][-2] == ""


def test_figure_and_table_of_searches_show_expected_fitness(monkeypatch):
    """The history has the luckiest scores instead."""
    terms = {"distance": 0.4}
    champion = Champion(np.zeros(1), 0.9, 1, terms, {}, lives=16, expected=0.7)
    workshop = mock.create_autospec(Workshop, instance=True)
    workshop.member.return_value.experiment.strategy.population = 4
    workshop.column.return_value = np.array([[0.5, 0.6], [0.9, 0.9]])
    workshop.champions.return_value = [champion, champion._replace(expected=0.8)]
    drawn = []
    monkeypatch.setattr(search_plots, "sweep_figure", lambda curves, _: drawn.extend(curves))
    (made,) = search.searches(workshop, "two_eyes")
    assert drawn and all(curve.final.tolist() == [0.7, 0.8] for curve in drawn)
    assert made.rows[0][2] == "0.750 (0.700 to 0.800)"


def test_time_of_learning_leaves_out_compilation():
    """The first generation compiles the trials, and the first round of learning its gradient."""
    usual = np.tile([2.0, 2.0, 2.0, 2.0, 5.0], 4)
    measured = usual.copy()
    measured[[0, 4]] += 60.0
    np.testing.assert_array_equal(controls._clock(measured), usual.cumsum())
    np.testing.assert_array_equal(controls._clock(measured[1:3]), [2.0, 4.0])
