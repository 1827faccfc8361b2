"""Rhythms of oscillators through the library."""

import pytest

import evo_cpg as evo
from evo_cpg.errors import UserError

SMALL = ("creature.bodies.1.repeat=3",)


def test_rhythms_of_the_library_scale_with_the_time_scale():
    experiment = evo.load("iwadate2010_swimmer", SMALL)
    shown = evo.rhythm(experiment, gain=4.0)
    assert [len(part.oscillators) for part in shown.groups] == [3, 3, 3]
    cycle = shown.groups[0].cycle
    assert cycle is not None and cycle.stable
    found = evo.find_rhythm(experiment, frequency=2 * cycle.frequency, gain=4.0)
    assert found.changes["time_scale"] == pytest.approx(0.5, rel=1e-4)
    with pytest.raises(UserError, match="--lag"):
        evo.find_rhythm(experiment, lag=200.0)
