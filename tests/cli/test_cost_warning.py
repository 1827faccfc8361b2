"""Warnings of high costs: they name the main cause and the keys to change."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from evo_cpg.cli import advice
from evo_cpg.cli.advice import animal_digest
from evo_cpg.config.load import load_config
from evo_cpg.fusion.engine import Engine, EngineName
from evo_cpg.simulation.operations import Operations
from tiny_run import CONFIG, PAIR

_SMALL = Operations(3000.0, 2000.0, 0.0, 1000.0, 0.0, 100.0, 0.0)


@pytest.fixture
def warning(monkeypatch, capsys):
    """Return a function from numbers of operations to the printed warning."""

    def of(operations: Operations, measured: float | None = None, name: EngineName = "auto") -> str:
        monkeypatch.setattr(advice, "estimate_operations", lambda simulation: operations)
        monkeypatch.setattr(advice, "expected_seconds", lambda operations: measured)
        simulation: Any = SimpleNamespace(engine=Engine(name))
        monkeypatch.setattr(advice, "about_oscillators", lambda simulation: [])
        advice.advise(Path("a.yaml"), simulation)
        return capsys.readouterr().err

    return of


def test_a_small_animal_has_no_warning(warning):
    assert warning(_SMALL) == ""


def test_the_warning_names_the_main_cause(warning):
    assert warning(_SMALL._replace(pairs=240_000.0)) == (
        "evo-cpg: warning: a.yaml: a trial has about 250,000 operations, 14 times as many as "
        "iwadate2010_swimmer. 98% of them are for bodies that may touch each other. To lower the "
        "cost: more pairs in creature.self_collision.exclude, or creature.self_collision=false\n"
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
def test_every_cause_has_its_cure(warning, part, cure):
    assert cure in warning(_SMALL._replace(**{part: 300_000.0}))


def test_the_time_to_compile_is_shown_if_it_was_measured(warning):
    large = _SMALL._replace(bodies=300_000.0)
    assert "On this machine they take about 71 s to compile" in warning(large, 71.3)
    assert "compile" not in warning(large)


def test_the_warning_names_the_limit_of_native_code(warning):
    near, beyond = (_SMALL._replace(bodies=count) for count in (550_000.0, 720_000.0))
    limit = "Native code is limited to 600,000, so plain JAX"
    assert f"{limit} may have to compute the trial, many times" in warning(near, 71.3)
    assert f"{limit} will compute the trial, many times more slowly" in warning(beyond, 71.3)
    assert warning(beyond, name="jax") == ""


def test_the_same_animal_has_the_same_digest():
    """The digest depends on the body, and not on the search."""

    def digest(*overrides: str) -> str:
        return animal_digest(load_config(CONFIG, [*PAIR, *overrides]))

    assert digest() == digest("seed=7", "name=other", "evolution.generations=9")
    others = [
        "simulation.seconds=1.01667",
        "creature.bodies.1.repeat=3",
        "controller.brain.hidden=[5]",
    ]
    assert len({digest(), *map(digest, others)}) == 4
