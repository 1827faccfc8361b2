"""Swimming numbers of motions with known answers."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from evo_cpg.analysis.body_wave import body_wave, travelling_index
from evo_cpg.analysis.midline import bending_lag, envelope, midline_motion, sway
from evo_cpg.analysis.stride import (
    froude_efficiency,
    path_speed,
    reynolds_number,
    slip,
    stride_frequency,
    strouhal_number,
    swimming_number,
)

STEP = 1 / 60
TIME = STEP * np.arange(600)
PLACE = np.linspace(0.0, 1.0, 101)


def moved(lateral, speed=0.5, course=0.0):
    """Return a midline along -x that sways by ``lateral`` (t, p), and moves ahead at an angle."""
    along = -np.broadcast_to(PLACE[: lateral.shape[1]], lateral.shape)
    points = np.stack([along + speed * TIME[:, None], lateral, 0 * lateral], -1)
    return points @ Rotation.from_euler("z", course).as_matrix().T


def wave(frequency=1.0, waves=1.0, growth=0.0, size=0.05, back=0.0, place=PLACE):
    """Return size exp(growth (x - 1)) sin(k x - w t), plus a reflection."""
    k, w = 2 * np.pi * waves, 2 * np.pi * frequency
    phase = k * place - w * TIME[:, None]
    other = k * place + w * TIME[:, None]
    return size * np.exp(growth * (place - 1)) * (np.sin(phase) + back * np.sin(other))


def swimming(points, frequency, speed=None):
    """Return the numbers of a swimmer by name, NaN for those that do not exist."""
    speed = path_speed(points.mean(1), STEP, frequency) if speed is None else speed
    names = "tail_amplitude", "wave_speed", "wave_count", "travelling", "lag"
    found, motion = dict.fromkeys(names, math.nan), midline_motion(points, STEP, frequency)
    if motion is not None:
        wave, tail = motion.wave, motion.tail_amplitude
        values = tail, wave.speed, wave.count, wave.travelling, motion.lag.mean
        found = dict(zip(names, values, strict=True))
    strouhal = strouhal_number(frequency, found["tail_amplitude"], speed)
    return found | {"speed": speed, "strouhal": strouhal, "slip": slip(speed, found["wave_speed"])}


@pytest.mark.parametrize("waves", [0.6, 1.0, 1.7, -1.2])
def test_numbers_of_a_wave_with_known_amplitude_and_speed(waves):
    """2 Hz, a 0.05 m to each side, U 0.5 m/s: St = 2 f a / U, V = w / k, and slip U / |V|."""
    points = moved(wave(2.0, waves))
    segments = np.diff(points, axis=1)
    turns = np.cross(segments[:, :-1], segments[:, 1:]).reshape(len(points), -1)
    assert stride_frequency(turns, STEP) == pytest.approx(2.0, rel=0.01)
    found = swimming(points, 2.0)
    speed = 2.0 / waves
    expected = {"speed": 0.5, "wave_speed": speed, "wave_count": waves, "slip": 0.5 / abs(speed)}
    assert {key: found[key] for key in expected} == pytest.approx(expected, rel=1e-3)
    # Samples miss up to (pi f h)^2 / 2 of a peak, here 0.5 %.
    assert found["tail_amplitude"] == pytest.approx(0.1, rel=5e-3)
    assert found["strouhal"] == pytest.approx(0.4, rel=5e-3)
    assert math.isnan(slip(0.3, math.nan))


def test_a_standing_wave_has_no_speed():
    standing = wave(1.0, 1.0, back=1.0)
    found = swimming(moved(standing), 1.0)
    assert found["travelling"] == pytest.approx(0.0, abs=1e-6)
    assert np.isnan([found["wave_speed"], found["wave_count"], found["slip"]]).all()
    assert found["strouhal"] > 0


@pytest.mark.parametrize("back", [0.0, 0.25, 0.5, 1.0])
def test_travelling_index_of_a_reflected_wave(back):
    """(1 - b) / (1 + b) on two wave lengths, without the last point, which repeats the first."""
    signals = wave(1.0, 2.0, back=back)[:, :-1]
    expected = (1 - back) / (1 + back)
    assert travelling_index(signals, STEP, 1.0) == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("waves", [0.4, 0.75, 1.3])
def test_travelling_index_of_a_part_of_a_wave(waves):
    """sqrt((1 - s) / (1 + s)) with s = |sin kL / kL|. 0.75 waves have 0.81."""
    middles = (np.arange(200) + 0.5) / 200
    found = travelling_index(wave(1.0, waves, place=middles), STEP, 1.0)
    s = abs(math.sin(2 * math.pi * waves) / (2 * math.pi * waves))
    assert found == pytest.approx(math.sqrt((1 - s) / (1 + s)), rel=1e-4)
    if waves == 0.75:
        assert found == pytest.approx(0.81, abs=0.005)


def test_growing_wave_has_index_0_73_and_lag_of_a_tenth():
    """Growth exp(3.4 x / L) and wave length 0.6 L, as in eels."""
    found = swimming(moved(wave(1.0, 1 / 0.6, growth=3.4)), 1.0)
    assert found["travelling"] == pytest.approx(0.73, abs=0.005)
    assert found["lag"] == pytest.approx(0.1, abs=0.001)


@pytest.mark.parametrize("growth", [0.0, 1.0, 3.4, -2.0])
def test_lag_of_displacement_on_bending(growth):
    """Bending leads by atan(a / k) / pi at every point."""
    swaying = sway(moved(wave(1.0, 1.5, growth)), STEP, 1.0)
    found = bending_lag(swaying)
    expected = math.atan(growth / (2 * np.pi * 1.5)) / math.pi
    np.testing.assert_allclose(found.each[1:-1], expected, atol=1e-4)
    assert found.mean == pytest.approx(expected, abs=1e-4)


def test_envelope_is_a_quadratic():
    """The amplitude 0.02 - 0.05 s + 0.11 s^2 of a body of 1 m is found again."""
    amplitude = 0.02 - 0.05 * PLACE + 0.11 * PLACE**2
    lateral = amplitude * np.sin(2 * np.pi * (1.2 * PLACE - 1.0 * TIME[:, None]))
    found = envelope(sway(moved(lateral), STEP, 1.0), PLACE, 1.0)
    np.testing.assert_allclose(found.amplitude, amplitude, rtol=2e-3)
    np.testing.assert_allclose(found.quadratic, [0.02, -0.05, 0.11], atol=3e-4)
    assert found.fitted > 0.9999


def test_swimming_number_over_reynolds_number():
    """Both have the amplitude from side to side, so Sw / Re = 2 pi St."""
    assert swimming_number(2.0, 0.1, 0.5, 1e-6) == pytest.approx(2 * math.pi * 1e5)
    assert reynolds_number(0.5, 0.5, 1e-6) == pytest.approx(2.5e5)
    ratio = swimming_number(2.0, 0.1, 0.5, 1e-6) / reynolds_number(0.5, 0.5, 1e-6)
    assert ratio == pytest.approx(2 * math.pi * strouhal_number(2.0, 0.1, 0.5))
    assert math.isnan(reynolds_number(0.5, 0.5, math.nan))


@pytest.mark.parametrize("ratio", [0.3, 0.5, 0.9])
def test_froude_efficiency_of_elongated_body_theory(ratio):
    """Mean thrust and power of Lighthill 1960 with zero slope of the tail give (1 + U/V) / 2.

    The envelope is level at the tail, so h = sin(w t - k x) with the mean rates below.
    """
    speed, wave_speed, mass = ratio * 2.0, 2.0, 3.0
    beat = 2 * np.pi * np.arange(64) / 64
    rate = 0.4 * np.cos(beat)
    slope = -rate / wave_speed
    thrust = mass / 2 * np.mean(rate**2 - speed**2 * slope**2)
    power = mass * speed * np.mean(rate * (rate + speed * slope))
    assert froude_efficiency(thrust, speed, power) == pytest.approx((1 + ratio) / 2)
    assert math.isnan(froude_efficiency(thrust, speed, 0.0))


@pytest.mark.parametrize("course", [0.7, 2.5])
def test_numbers_do_not_depend_on_the_course(course):
    one = swimming(moved(wave(1.0, 1.3, 2.0)), 1.0)
    two = swimming(moved(wave(1.0, 1.3, 2.0), course=course), 1.0)
    assert two == pytest.approx(one, rel=1e-6, abs=1e-9, nan_ok=True)


def test_a_turn_of_the_animal_does_not_count():
    """The animal swims in a circle of 5 m at 0.5 m/s."""
    body = moved(wave(1.0, 1.3, 2.0), speed=0.0)
    angle = 0.1 * TIME
    cos, sin = np.cos(angle), np.sin(angle)
    turn = np.array([[cos, -sin, 0 * cos], [sin, cos, 0 * cos], [0 * cos, 0 * cos, 1 + 0 * cos]])
    points = np.einsum("ijt,tpj->tpi", turn, body + np.array([0.0, 5.0, 0.0]))
    found = swimming(points, 1.0, speed=0.5)
    straight = swimming(moved(wave(1.0, 1.3, 2.0)), 1.0)
    assert found["tail_amplitude"] == pytest.approx(straight["tail_amplitude"], rel=0.01)
    assert found["wave_speed"] == pytest.approx(straight["wave_speed"], rel=0.01)


@pytest.mark.parametrize("frequency", [math.nan, 0.1, 0.15])
def test_less_than_two_cycles_have_no_numbers(frequency):
    found = swimming(moved(wave(1.0)), frequency)
    assert np.isnan(
        [found["strouhal"], found["wave_speed"], found["travelling"], found["lag"]]
    ).all()


def test_a_stiff_body_has_no_wave_and_no_lag():
    found = swimming(moved(0 * wave(1.0)), 1.0)
    assert found["tail_amplitude"] == pytest.approx(0.0, abs=1e-12)
    assert np.isnan([found["wave_speed"], found["travelling"], found["lag"]]).all()


def test_a_coiled_body_has_no_wave():
    """A ring of points that beats."""
    angle = 1.9 * np.pi * PLACE
    ring = np.stack([np.cos(angle), np.sin(angle), 0 * angle], -1)
    points = ring * (1 + 0.05 * np.sin(2 * np.pi * TIME))[:, None, None]
    found = swimming(points, 1.0)
    assert np.isnan([found["tail_amplitude"], found["wave_speed"], found["lag"]]).all()


def test_a_still_place_does_not_hide_the_wave():
    """The nose is at rest."""
    lateral = PLACE * wave(1.0, 1.2)
    found = body_wave(lateral, PLACE, 1.0, STEP, 1.0)
    assert found.count == pytest.approx(1.2, rel=0.01)
    assert math.isnan(found.phase[0]) and np.isfinite(found.phase[1:]).all()
