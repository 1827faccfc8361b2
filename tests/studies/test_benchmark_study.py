"""Benchmarks as a study: its parts are the suite's cases, and need no runs."""

import sys

import pytest

import evo_cpg
from benchmarks import suite
from benchmarks.rows import Row
from evo_cpg.cli.reproduce import make
from evo_cpg.studies import benchmarks, provenance
from evo_cpg.studies.benchmarks import STUDY, SuiteError, bench_suite


def test_its_parts_are_the_cases_of_the_suite():
    assert list(STUDY.parts) == list(suite.CASES)
    assert set(benchmarks._MOVING) == set(suite.ANIMALS)


def test_a_part_is_measured_and_tells_how(tmp_path):
    make(STUDY, ["brain"], tmp_path, True, False, 2)
    text = (tmp_path / "brain.md").read_text()
    told = provenance.read(tmp_path)["brain"]
    assert (
        text.startswith("Peak: ")
        and "| network | 200 | " in text
        and "| ours, control steps/s |" in text
    )
    assert provenance.caption("benchmarks", "brain", told) in text
    assert "Made by `evo-cpg reproduce benchmarks brain` with evo-cpg " in text
    assert told["runs"] == {} and told["run_commits"] == [] and told["devices"] == 2
    assert told["engine"] and told["processor"] and told["quick"] is True
    assert provenance.problems(tmp_path) == []


def test_what_moves_is_drawn_and_what_is_left_is_said(tmp_path, monkeypatch, capsys):
    """Stopped in the second of three parts: the first one stays."""

    def moving(plan, peak):
        assert plan.quick is False and plan.cores == 2
        yield Row("quadruped", "physics", 120, 9e5, "steps/s", "a test", peer="MuJoCo",
                  peer_rate=1e5, ratio=9.0, ratio_spread=(8.0, 10.0))  # fmt: skip

    def stopped(plan, peak):
        raise KeyboardInterrupt
        yield

    monkeypatch.setitem(suite.CASES, "quadruped", suite.Case(moving))
    monkeypatch.setitem(suite.CASES, "ga", suite.Case(stopped))
    with pytest.raises(KeyboardInterrupt):
        make(STUDY, ["quadruped", "ga", "brain"], tmp_path, False, False, 2)
    left = f"`evo-cpg reproduce benchmarks ga brain --out {tmp_path}`"
    assert f"interrupted. Make the rest with {left}" in capsys.readouterr().err
    assert set(provenance.read(tmp_path)["quadruped"]["files"]) == {"quadruped.md", "quadruped.png"}
    text = (tmp_path / "quadruped.md").read_text()
    assert "| physics | 120 | 900 k |" in text
    assert "| physics | 120 | MuJoCo | 100 k | 9x (8x to 10x) |" in text
    assert not (tmp_path / "ga.md").exists()


def test_without_a_clone_or_mujoco_it_says_so(tmp_path, monkeypatch):
    monkeypatch.setattr(evo_cpg, "__file__", str(tmp_path / "evo_cpg" / "__init__.py"))
    with pytest.raises(SuiteError, match="part of a checkout of evo_cpg; there is none in"):
        make(STUDY, ["brain"], tmp_path / "out", True, False, 2)
    monkeypatch.undo()
    # As an import fails where something is missing.
    monkeypatch.setitem(sys.modules, "benchmarks.suite", None)
    with pytest.raises(
        SuiteError,
        match=r"suite needs benchmarks.suite, which `.*\[test\]'` installs",
    ):
        bench_suite()
