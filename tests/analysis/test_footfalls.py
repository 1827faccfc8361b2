"""Footfalls with known times of contact and known speeds of sliding."""

import numpy as np
import pytest

from evo_cpg.analysis import feet as footfalls

STEP = 1 / 60


def square_waves(frequency: float, duty: float, phases: list[float], count: int = 1200, step=STEP):
    """Return contacts that last a fraction of every stride, from each foot's phase on."""
    time = (np.arange(count) + 0.5) * step
    return np.stack([(frequency * time - phase) % 1.0 < duty for phase in phases], -1)


@pytest.mark.parametrize("duty", [0.3, 0.65])
@pytest.mark.parametrize("frequency", [0.7, 1.3])
def test_duty_factors_and_phases_of_square_waves(frequency, duty):
    """A walk of four feet. The sampling grid limits the accuracy to one sample."""
    expected = [0.0, 0.5, 0.75, 0.25]
    touched = square_waves(frequency, duty, expected)
    np.testing.assert_allclose(footfalls.duty_factors(touched), duty, atol=0.02)
    found = footfalls.phases(touched, STEP)
    assert found.reference == 0
    np.testing.assert_allclose(found.phase, expected, atol=STEP * frequency)
    assert (found.regularity > 0.99).all()


def test_touch_downs_and_stances_have_known_instants():
    touched = np.zeros(20, bool)
    touched[:3] = touched[5:9] = touched[15:] = True
    # An initial stance has no touch-down.
    np.testing.assert_allclose(footfalls.touch_downs(touched, 0.1), [0.5, 1.5])
    np.testing.assert_allclose(
        footfalls.stances(touched, 0.1), [[0.0, 0.3], [0.5, 0.9], [1.5, 2.0]]
    )


def test_chatter_is_removed_except_at_the_edges():
    touched = np.zeros((40, 1), bool)
    touched[0] = touched[10:20] = touched[30] = True
    touched[14] = False
    clean = footfalls.settled(touched, 0.01, 0.03)
    assert footfalls.stances(clean[:, 0], 0.01).tolist() == [[0.0, 0.01], [0.1, 0.2]]
    assert footfalls.settled(touched, 0.01, 0.01).sum() == touched.sum()
    assert not touched[14, 0]


@pytest.mark.parametrize("frequency", [1.0, 4.0, 15.0])
def test_strides_of_a_fast_animal_are_no_chatter(frequency):
    """The sampling rate is 240 Hz, and each touch-down bounces for one sample."""
    step = 1 / 240
    touched = square_waves(frequency, 0.6, [0.0, 0.5], 960, step)
    bounced = touched.copy()
    bounced[3:] &= ~(touched[1:-2] & ~touched[:-3])
    found = footfalls.phases(footfalls.settled(bounced, step, footfalls.chatter(frequency)), step)
    np.testing.assert_allclose(found.phase, [0.0, 0.5], atol=step * frequency)
    assert footfalls.chatter(np.nan) == footfalls.chatter(1.0) == 0.05


def test_random_touch_downs_lower_regularity_without_bias():
    generator = np.random.default_rng(1)
    touched = np.zeros((6000, 2), bool)
    for stride in range(99):
        touched[60 * stride : 60 * stride + 30, 0] = True
        late = 60 * stride + 20 + int(generator.integers(-9, 10))
        touched[late : late + 25, 1] = True
    found = footfalls.phases(touched, STEP)
    assert found.reference == 0
    assert found.phase[1] == pytest.approx(1 / 3, abs=0.02)
    assert 0.8 < found.regularity[1] < 0.95


def test_feet_without_touch_down_have_no_phase():
    touched = np.zeros((600, 3), bool)
    touched[:, 1] = True
    duty = footfalls.duty_factors(touched)
    assert np.isnan(duty[[0, 2]]).all() and duty[1] == 1.0
    found = footfalls.phases(touched, STEP)
    assert found.reference is None and np.isnan(found.phase).all()


def test_the_reference_has_at_least_half_the_strides():
    touched = square_waves(1.0, 0.5, [0.3, 0.0])
    touched[150:, 0] = False
    assert footfalls.phases(touched, STEP).reference == 1


def test_a_body_touches_if_a_force_acts_on_its_points():
    force = np.zeros((3, 3, 4))
    force[1, 2, 3] = 5.0
    force[2, 0, 0] = -0.1
    found = footfalls.touching(force, np.array([7, 7, 2, 2]), [2, 7])
    assert found.tolist() == [[False, False], [True, False], [False, True]]
