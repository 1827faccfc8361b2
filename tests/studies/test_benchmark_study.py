"""Benchmarks as a study: parts are the suite's cases, and need no runs."""

import pytest

from benchmarks import study, suite
from benchmarks.rows import Row
from benchmarks.study import STUDY
from evo_cpg.cli.repeat import make
from evo_cpg.studies import provenance


def test_parts_are_the_cases_of_the_suite():
    assert list(STUDY.parts) == list(suite.CASES)
    assert set(study._MOVING) == set(suite.ANIMALS)


def test_a_part_records_its_tables_and_provenance(tmp_path):
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


@pytest.mark.slow
def test_an_interrupt_keeps_finished_parts_and_names_the_rest(tmp_path, monkeypatch, capsys):
    """The second of three parts is interrupted. The first part has a picture."""

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
    assert "Continue with the parts ga brain" in capsys.readouterr().err
    assert set(provenance.read(tmp_path)["quadruped"]["files"]) == {"quadruped.md", "quadruped.png"}
    text = (tmp_path / "quadruped.md").read_text()
    assert "| physics | 120 | 900 k |" in text
    assert "| physics | 120 | MuJoCo | 100 k | 9x (8x to 10x) |" in text
    assert not (tmp_path / "ga.md").exists()
