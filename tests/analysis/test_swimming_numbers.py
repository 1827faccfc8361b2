"""References of swimming numbers: displacement by the water."""

import numpy as np

from evo_cpg.analysis.gait_quantities import drift
from evo_cpg.physics.water.water import Current, Water

TIME = 0.1 * np.arange(50)


def test_drift_is_the_displacement_by_the_flow():
    """Closed forms for a uniform current and for a shear x' = g y."""
    current = (0.3, -0.1, 0.0)
    carried = TIME[:, None] * current
    found = drift(Water(1000.0, streams=(Current(current),)), carried, TIME)
    np.testing.assert_allclose(found, carried, atol=1e-6)
    gradient = ((0.0, 0.5, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    shear = Water(1000.0, streams=(Current(gradient=gradient),))
    beside = np.column_stack([0.5 * 2.0 * TIME, np.full(50, 2.0), np.zeros(50)])
    np.testing.assert_allclose(drift(shear, beside, TIME)[:, 0], TIME, atol=1e-6)
    assert not drift(Water(1000.0), beside, TIME).any()
