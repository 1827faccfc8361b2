"""The physics moves the animals of `benchmarks/traces.json` as before.

If animals move on purpose, `make traces` writes the file anew, and the changelog names them.
"""

import copy

import numpy as np
import pytest

from benchmarks.traces import CONFIGS, INSTANTS, TOLERANCE, animals, moved, stored_traces, trace

ANIMALS = animals()
STORED = stored_traces()
# The cheapest of them has most kinds of joints.
QUICK = "medley"


@pytest.mark.parametrize(
    "animal",
    [
        pytest.param(each, marks=() if each.names[0] == QUICK else pytest.mark.slow)
        for each in ANIMALS
    ],
    ids=lambda animal: animal.names[0],
)
def test_animal_moves_as_stored(animal):
    change = moved(trace(animal)[0], STORED[animal.names[0]])
    assert change is None, (
        f"{', '.join(animal.names)}: {change}. If this is intended, run `make traces` and name the "
        "animals in the changelog"
    )


def test_every_shipped_configuration_has_a_trace():
    evolving = {
        path.stem for path in CONFIGS if path.stem.startswith(("evolving_", "virtual_", "follow_"))
    }
    assert sorted(name for each in ANIMALS for name in each.names) == sorted(
        {path.stem for path in CONFIGS} - evolving
    )
    assert list(STORED) == [each.names[0] for each in ANIMALS]


@pytest.mark.parametrize("name", STORED)
def test_stored_animals_really_move(name):
    joints = np.array(list(STORED[name]["joints"].values()))
    assert joints.shape[1] == len(INSTANTS)
    assert np.ptp(joints, axis=1).max() > 0.01
    assert np.ptp(STORED[name]["root position"], axis=0).max() > 1e-4


def test_a_moved_animal_is_described():
    stored = STORED[QUICK]
    assert moved(stored, stored) is None
    found = copy.deepcopy(stored)
    found["root position"][-2][0] += 0.5 * TOLERANCE
    assert moved(found, stored) is None
    found["root position"][-2][0] += 1e-3
    assert moved(found, stored) == (
        f"moved by up to 1.0e-03 (root position), apart since {stored['time'][-2]:.3g} s"
    )
    found = copy.deepcopy(stored)
    del found["joints"]["tail.z"]
    assert moved(found, stored) == "another joints tail.z"
