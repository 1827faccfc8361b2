"""Learning of elites in the section ``evolution``."""

from pathlib import Path

import pytest

from evo_cpg.io.build import build_experiment
from evo_cpg.io.errors import ConfigError
from evo_cpg.io.load import load_config
from evo_cpg.training.experiment import Learning

CONFIGS = Path(__file__).parents[2] / "configs"
SWIMMER, WALKER = CONFIGS / "iwadate2010_swimmer.yaml", CONFIGS / "fukui2003_model1.yaml"
REAL = ("evolution={type: real, generations: 2, population: 6, elites: 2, learning: {every: 3}}",)


def learning(path, *overrides):
    return build_experiment(load_config(path, overrides), path).learning


def test_elites_learn_only_if_configured():
    assert learning(SWIMMER) is None
    assert learning(SWIMMER, "evolution.learning.every=3") == Learning(3, 16, 5)
    few = ("evolution.elites=4", "evolution.learning.steps=2")
    assert learning(SWIMMER, *few) == Learning(5, 4, 2)


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (["evolution.learning.elites=21"], "at most all 20 elites can learn, got 21"),
        (["evolution.learning.every=2", "evolution.elites=0"], "at least one"),
        (["evolution.learning.stepps=2"], "steps"),
        (["evolution.learning.every=0"], "every"),
    ],
)
def test_invalid_learning_is_rejected(overrides, words):
    with pytest.raises(ConfigError, match=words):
        learning(SWIMMER, *overrides)


def test_postures_learn_only_with_graded_genes():
    with pytest.raises(ConfigError, match=r"or controller.graded to true"):
        learning(WALKER, *REAL)
    assert learning(WALKER, *REAL, "controller.graded=true") == Learning(3, 2, 5)
