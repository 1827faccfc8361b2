"""`evo-cpg cpg`: the table of the rhythm, and errors."""

import re

import pytest

from tiny_run import REPOSITORY

SWIMMER = REPOSITORY / "configs" / "iwadate2010_swimmer.yaml"
SMALL = ("creature.bodies.1.repeat=3",)


@pytest.mark.slow
def test_every_axis_has_a_row(cli):
    out, _ = cli.passes("cpg", SWIMMER, *SMALL, "--gain", 4)
    found = [float(number) for number in re.findall(r"\+ 2 +([\d.]+)", out)]
    assert len(found) == 3
    assert found == pytest.approx([found[0]] * 3, rel=1e-6)
    # Nine joints have 0.30 b^0.55 Hz (docs/models/controller.md). Three joints are close to this.
    assert found[0] == pytest.approx(0.30 * 4**0.55, rel=0.15)
    assert "b = 4, u = 1" in out and "unstable" not in out


def test_constants_that_cannot_oscillate_are_reported_at_rest(cli):
    out, err = cli.passes("cpg", SWIMMER, *SMALL, "controller.cpg.constants=as_printed")
    assert f"evo-cpg: warning: {SWIMMER}: at rest under a constant drive: segment1.x, " in err
    assert len(re.findall(r" rest +$", out, re.MULTILINE)) == 3
    assert (
        out.count("segment1.x + 2, segment1.y + 2, segment1.z + 2: the network comes to rest") == 1
    )


@pytest.mark.slow
@pytest.mark.parametrize("gain", [1, 4])
def test_the_lags_around_a_ring_are_shown(cli, gain):
    out, _ = cli.passes("cpg", REPOSITORY / "configs" / "starfish.yaml", "--gain", gain)
    names = ", ".join(f"arm{j}_1.y" for j in range(1, 6))
    words = "each lags behind the one before by 72.0, 72.0, 72.0, 72.0, 72.0 deg"
    assert f"ring of {names}: {words}" in out


def test_lags_of_legs_are_listed_one_by_one(cli):
    out, _ = cli.passes("cpg", REPOSITORY / "configs" / "turtle.yaml")
    assert re.search(r"left_flipper\.x \+ 3 +1\.2832 +below ", out)
    listed = "left_flipper.y 0, right_flipper.x 0, right_flipper.y 0"
    assert f"lag of each oscillator behind left_flipper.x, deg: {listed}\n" in out


def test_a_controller_without_oscillators_is_refused(cli):
    assert "has no oscillators" in cli.refuses("cpg", "fukui2003_model1")


def test_oscillators_without_drive_are_reported(cli):
    out, _ = cli.passes("cpg", SWIMMER, *SMALL, "--tonic-input", 0)
    assert "nothing drives the network" in out


def test_a_failed_search_is_not_reported_as_rest(cli, monkeypatch):
    monkeypatch.setattr("evo_cpg.analysis.limit_cycle._LONGEST", 0.0)
    code, out, err = cli("cpg", SWIMMER, *SMALL)
    assert code == 1
    assert out.count("not found") == 3 and "rest" not in out
    assert err.count("nothing is known") == 3
