"""An animal that costs much is told so, with what causes it and what to change."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from evo_cpg.cli import advice
from evo_cpg.cli.advice import animal_digest, warn_of_cost
from evo_cpg.config.load import load_config
from evo_cpg.fusion.engine import Engine, EngineName
from evo_cpg.simulation.operations import Operations
from tiny_run import CONFIG, PAIR

_SMALL = Operations(3000.0, 2000.0, 0.0, 1000.0, 0.0, 100.0, 0.0)


@pytest.fixture
def said(monkeypatch, capsys):
    """What is said of an animal."""

    def of(operations: Operations, measured: float | None = None, name: EngineName = "auto") -> str:
        monkeypatch.setattr(advice, "estimate_operations", lambda simulation: operations)
        monkeypatch.setattr(advice, "expected_seconds", lambda operations: measured)
        simulation: Any = SimpleNamespace(engine=Engine(name))
        warn_of_cost(Path("a.yaml"), simulation)
        return capsys.readouterr().err

    return of


def test_a_small_animal_is_not_mentioned(said):
    assert said(_SMALL) == ""


def test_a_large_animal_is_told_its_main_cause(said):
    assert said(_SMALL._replace(pairs=240_000.0)) == (
        "evo-cpg: warning: a.yaml: a trial has about 250,000 operations, 14 times those of "
        "iwadate2010_swimmer; 98% of them are for bodies that may touch each other; to lower that: "
        "more pairs in creature.self_collision.exclude, or creature.self_collision=false\n"
    )


@pytest.mark.parametrize(
    ("part", "cure"),
    [
        ("bodies", "fewer creature.bodies and joint axes"),
        ("ground", "capsules and spheres in place of boxes and meshes"),
        ("obstacles", "fewer world.ground.obstacles"),
        ("water", "lower world.water.form_resolution"),
        ("controller", "fewer neurons in controller.brain.hidden"),
        ("noise", "fewer keys in noise"),
    ],
)
def test_every_cause_has_its_cure(said, part, cure):
    assert cure in said(_SMALL._replace(**{part: 300_000.0}))


def test_the_time_is_said_where_it_was_measured(said):
    large = _SMALL._replace(bodies=300_000.0)
    assert "on this machine they take about 71 s to compile" in said(large, 71.3)
    assert "compile" not in said(large)


def test_the_limit_of_native_code_is_said(said):
    near, beyond = (_SMALL._replace(bodies=count) for count in (550_000.0, 720_000.0))
    limit = "native code ends at 600,000, and plain JAX"
    assert f"{limit} may have to compute it, many times more slowly" in said(near, 71.3)
    assert f"{limit} will compute it, many times more slowly" in said(beyond, 71.3)
    assert said(beyond, name="jax") == ""


def test_the_same_animal_has_the_same_digest():
    """The search makes no difference to the code, the body does."""

    def digest(*overrides: str) -> str:
        return animal_digest(load_config(CONFIG, [*PAIR, *overrides]))

    assert digest() == digest("seed=7", "name=other", "evolution.generations=9")
    others = ["simulation.steps=61", "creature.bodies.1.repeat=3", "controller.brain.hidden=[5]"]
    assert len({digest(), *map(digest, others)}) == 4
