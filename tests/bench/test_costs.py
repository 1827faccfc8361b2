"""The summary of a test run's cost."""

from costs import processor_seconds, unit


def test_the_unit_takes_processor_time():
    before = processor_seconds()
    assert 0 < unit() < processor_seconds() - before
