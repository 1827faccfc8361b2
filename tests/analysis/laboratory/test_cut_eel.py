"""The spinal cord of the eel of `configs/eel.yaml` is cut at mid-body (Yasui et al. 2025)."""

import itertools

import numpy as np
import pytest

from evo_cpg.analysis.cycles import upward_crossings
from evo_cpg.api.lab import lab


def lags(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the lag of the second signal behind the first in each cycle, degrees, within 180."""
    starts, others = upward_crossings(first), upward_crossings(second)
    found = []
    for start, end in itertools.pairwise(starts):
        late = others[np.argmin(np.abs(others - start))] - start
        found.append(360 * ((late / (end - start) + 0.5) % 1 - 0.5))
    return np.array(found)


@pytest.mark.slow
def test_feedback_brings_a_cut_eel_back_into_phase():
    """The part behind the cut keeps the drive. All oscillators start in phase."""
    knobs = {"cut": ["none", "middle1"], "feedback": [0.0, 1.0]}
    answer = lab("eel", knobs | {"behind": [0.5], "u": [0.5], "b": [6.0]}, seconds=10.0)
    speed = [row["path_speed"] for row in answer.rows]
    lag = []
    for motion in answer.recordings:
        names = list(motion.dof_names)
        pair = (motion.cpg_output[:, names.index(name)] for name in ("trunk10.z", "middle1.z"))
        lag.append(lags(*pair))
    whole, feeling, cut, cut_feeling = range(4)
    # Without feedback the tail keeps a wrong phase, and most of the speed is lost.
    assert speed[cut] < 0.5 * speed[whole]
    assert abs(lag[cut][5:15].mean() - lag[whole][5:15].mean()) > 90
    # With feedback the lag is back after five cycles, within 20 degrees, and the speed stays.
    assert speed[cut_feeling] > 0.7 * speed[feeling]
    assert np.abs(lag[cut_feeling][5:15] - lag[feeling][5:15].mean()).max() < 20
    # Feedback raises the frequency (Pazzaglia et al. 2025).
    assert answer.rows[feeling]["stride_frequency"] > answer.rows[whole]["stride_frequency"]
