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


def test_a_fit_through_the_library_refuses_an_unknown_key(tmp_path):
    table = tmp_path / "data.csv"
    table.write_text("time,x\n0,0\n0.1,0\n0.2,0\n")
    with pytest.raises(UserError, match="form_drag"):
        evo.fit("iwadate2010_swimmer", table, ["world.water.form_darg"])
