"""`evo-cpg cpg`: the table of the rhythm, and what it refuses."""

import re

import pytest

from tiny_run import REPOSITORY

SWIMMER = REPOSITORY / "configs" / "iwadate2010_swimmer.yaml"
SMALL = ("creature.bodies.1.repeat=3",)


def test_every_axis_has_a_row(cli):
    code, out, _ = cli("cpg", SWIMMER, *SMALL, "--gain", 4)
    assert code == 0
    found = [float(number) for number in re.findall(r"\+ 2 +([\d.]+)", out)]
    assert len(found) == 3
    assert found == pytest.approx([found[0]] * 3, rel=1e-6)
    # Close to that of nine joints, docs/models/controller.md: 0.30 b^0.55.
    assert found[0] == pytest.approx(0.30 * 4**0.55, rel=0.15)
    assert "b = 4, u = 1" in out and "unstable" not in out


def test_constants_that_cannot_oscillate_are_said_to_rest(cli):
    code, out, _ = cli("cpg", SWIMMER, *SMALL, "controller.cpg.constants=as_printed")
    assert code == 0
    assert out.count("none") == 3
    assert (
        out.count("segment1.x + 2, segment1.y + 2, segment1.z + 2: the network comes to rest") == 1
    )


def test_a_controller_without_oscillators_is_refused(cli):
    code, _, err = cli("cpg", REPOSITORY / "configs" / "fukui2003_model1.yaml")
    assert code == 2
    assert "has no oscillators" in err
