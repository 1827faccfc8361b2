"""Benchmarks in processes of their own. A peer or measurement cannot hang or crash the others."""

import importlib.util

import pytest

from benchmarks import gradient, jax_peers
from benchmarks.exercise import Wave
from benchmarks.jax_peers import WET, entered
from benchmarks.plan import Plan, experiment_of
from benchmarks.worker import WorkerError, started


def test_a_slow_worker_is_given_up():
    with (
        started("gradient", "gradient", "16", "1") as worker,
        pytest.raises(WorkerError, match=r"did not finish compiling in 0\.1 s"),
    ):
        worker.answer(0.1)


@pytest.mark.slow
def test_a_failed_worker_reports_its_error():
    with (
        started("memory", "unicorn", "1") as worker,
        pytest.raises(WorkerError, match="KeyError: 'unicorn'"),
    ):
        worker.answer(60)


@pytest.mark.slow
def test_an_ended_worker_reports_its_last_line():
    with started("memory") as worker:
        with pytest.raises(WorkerError, match=r"ended with code 1: ValueError: not enough values"):
            worker.answer(60)
        with pytest.raises(WorkerError, match="ended with code 1"):
            worker.ask("anything", 1)


def test_an_uncompiled_gradient_gives_a_row():
    rows = list(gradient.measure(Plan(1, limit=0.01)))
    assert [row.size for row in rows] == [16, 112, 1, 16, 16]
    for row in rows:
        assert row.note == "did not finish compiling in 0.05 s"
        assert row.peer_rate is None and row.rate == 0


def test_missing_peers_are_noted(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    exercise = Wave(experiment_of("iwadate2010_swimmer"))
    with entered(WET, exercise, 1, Plan(1)) as entries:
        assert [entry.note for entry in entries] == ["not installed"] * len(WET)
        assert all(entry.contender is None for entry in entries)


@pytest.mark.slow
def test_brax_takes_its_turns():
    pytest.importorskip("brax")
    exercise = Wave(experiment_of("iwadate2010_swimmer"))
    dry = [peer for peer in WET if peer.program == "brax" and not peer.kind.dense]
    with entered(tuple(dry), exercise, 2, Plan(1, call_seconds=0.01)) as (entry,):
        assert entry.contender is not None, entry.note
        assert entry.contender.work % (2 * jax_peers.STEPS) == 0
        entry.contender.call()
        entry.contender.call()
