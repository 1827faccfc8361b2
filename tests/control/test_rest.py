"""Oscillators reported to rest, compared with the orbits that `limit_cycle` finds."""

import dataclasses

import numpy as np
import pytest

from creatures import box_chain
from evo_cpg.analysis.limit_cycle import NoRhythmError, limit_cycle, parts
from evo_cpg.control.couplings import Coupling
from evo_cpg.control.matsuoka import TIME_CONSTANTS, CpgSettings, MatsuokaNetwork, build_network
from evo_cpg.control.rest import resting
from evo_cpg.creature.tree import build_tree

# 1 + T_r / T_a of the default constants (docs/models/controller.md).
LEAST = 1 + TIME_CONSTANTS["swapped"][0] / TIME_CONSTANTS["swapped"][1]
GAINS = 1.0, 10.0


def chain(joints: int, **settings) -> MatsuokaNetwork:
    return build_network(build_tree(box_chain(joints + 1, "z")), CpgSettings(**settings))


@pytest.mark.parametrize("weight", [0.5, LEAST - 0.05, LEAST + 0.05, 1.8])
def test_a_single_oscillator_swings_above_the_critical_weight(weight):
    found = resting(chain(1, pair_weight=weight), 1.0, *GAINS)
    assert found == ([0] if weight < LEAST else [])


def test_an_oscillator_with_one_silent_side_is_at_rest():
    """The weight exceeds 1 + b for every b. It swings if one gain is large enough."""
    network = chain(1, pair_weight=12.0)
    assert resting(network, 1.0, *GAINS) == [0]
    assert resting(network, 1.0, 1.0, 13.0) == []


def test_all_rest_without_a_positive_drive():
    swinging = chain(3)
    assert resting(swinging, 1.0, *GAINS) == []
    assert resting(swinging, 1e-3, *GAINS) == []
    assert resting(dataclasses.replace(swinging, constant_input=-1.0), 1.0, *GAINS) == [0, 1, 2]


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"constants": "as_printed"},
        {"pair_weight": 0.6},
        {"couplings": (Coupling("b2.z", "b3.z", 0.0), Coupling("b3.z", "b2.z", 0.0))},
    ],
    ids=["default", "as_printed", "weak", "cut"],
)
def test_parts_at_rest_are_the_parts_without_an_orbit(settings):
    network, gain = chain(3, **settings), 5.5
    still = resting(network, 1.0, gain, gain)
    without = []
    for part in parts(network):
        try:
            limit_cycle(network, np.ones((2, 3)), np.full(3, gain), part)
        except NoRhythmError:
            without += part
    assert still == sorted(without)


@pytest.mark.parametrize("settings", [{}, {"pair_weight": 0.6}])
def test_large_parts_give_the_result_of_small_ones(monkeypatch, settings):
    small = resting(chain(3, **settings), 1.0, *GAINS)
    monkeypatch.setattr("evo_cpg.control.rest._LARGE", 0)
    assert resting(chain(3, **settings), 1.0, *GAINS) == small
