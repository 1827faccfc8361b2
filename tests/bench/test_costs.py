"""The summary of a test run's cost."""

from collections import Counter

from costs import Costs, processor_seconds, unit


def test_costs_are_summed_and_sorted():
    costs = object.__new__(Costs)
    costs.tests = {
        "cheap": Counter(processor=1.0, compilations=2, compiling=0.5),
        "dear": Counter(processor=3.0, compilations=4, compiling=1.5),
    }
    costs.workers = [
        {"processor": 4.0, "memory": 700.0, "unit": 0.5},
        {"processor": 6.0, "memory": 900.0, "unit": 0.4},
    ]
    lines = costs.summary()
    assert [line.split()[-1] for line in lines[:2]] == ["dear", "cheap"]
    assert lines[2].startswith("2 tests: 4 s of processor time, 6 compilations")
    assert lines[3].startswith("with importing and collecting 10 s: 25 times")
    assert lines[4].endswith("700 and 900 MiB")


def test_the_unit_takes_processor_time():
    before = processor_seconds()
    assert 0 < unit() < processor_seconds() - before
