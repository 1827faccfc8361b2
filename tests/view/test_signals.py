"""The strip of signals under a film."""

import numpy as np
import pytest
import synthetic

from evo_cpg.view.look import STYLES
from evo_cpg.view.signals import Strip, signals_of
from films import film

SIZE = (640, 108)


@pytest.fixture(scope="module")
def recording():
    return synthetic.swim(10.0)


@pytest.fixture(scope="module")
def walk():
    return synthetic.walk(4.0)


def bright(picture):
    """Columns of the cursor, which has the colour of the text over the full height of the axes."""
    ink = (np.abs(picture.astype(int) - [242, 251, 255]).max(-1) < 30).mean(0)
    return np.flatnonzero(ink > 0.6)


def part_of(recording, names, columns):
    """The recording with other names of its axes, and only some of them."""
    return recording._replace(
        joint_angle=recording.joint_angle[:, columns],
        cpg_output=recording.cpg_output[:, columns],
        dof_names=tuple(names[i] for i in columns),
    )


def test_one_axis_of_every_moving_joint_is_shown(recording):
    shown = signals_of(recording, "CPG output")
    assert shown.names == tuple(f"b{i}.z" for i in range(1, 10))
    np.testing.assert_array_equal(shown.angle, recording.joint_angle[:, 2::3])
    np.testing.assert_array_equal(shown.signal, recording.cpg_output[:, 2::3])
    still = recording.joint_angle.copy()
    still[:, :3] = 0.3
    assert signals_of(recording._replace(joint_angle=still), "").names[0] == "b2.z"
    # One joint lacks the axis about which the others bend.
    other = part_of(recording, recording.dof_names, [0, 1, *range(3, 27)])
    assert signals_of(other, "").names[:2] == ("b1.y", "b2.z")


def test_slides_have_a_scale_in_metres(recording):
    """The first body slides by up to 0.5 m, and turns by less than the others."""
    names = ("b1.slide_x", *recording.dof_names[1:])
    angle = recording.joint_angle.copy()
    angle[:, :3] = 0.0
    angle[:, 0] = 0.5 * np.sin(np.linspace(0, 60, len(angle)))
    slid = recording._replace(joint_angle=angle, dof_names=names)
    shown = signals_of(slid, "CPG output")
    assert shown.names[:2] == ("b2.z", "b3.z") and not shown.slides.any()
    shown = signals_of(part_of(slid, names, [0, *range(3, 27)]), "CPG output")
    assert shown.names[:2] == ("b1.slide_x", "b2.z")
    assert shown.slides.tolist() == [True] + [False] * 8
    turning = signals_of(recording, "CPG output").highest[0]
    assert shown.highest[0] == pytest.approx(turning, rel=0.05)
    assert shown.highest[2] == pytest.approx(0.5, rel=0.01)


def test_the_cursor_moves_with_time_and_pages_turn(recording):
    strip = Strip(signals_of(recording, "CPG output"), STYLES["water"], SIZE, 1.0)
    assert strip.at(0.0).shape == (108, 640, 3) and strip.height == 108
    # 10 s in two pages of 5 s.
    places = [bright(strip.at(instant)).mean() for instant in (0.5, 2.5, 4.5)]
    assert np.diff(places) == pytest.approx([np.diff(places)[0]] * 2, abs=1.5)
    assert 150 < np.diff(places)[0] < 320
    again = strip.at(5.5)
    assert bright(again).mean() == pytest.approx(places[0], abs=1.5)
    assert np.abs(again.astype(int) - strip.at(0.5)).max() > 60
    assert bright(strip.at(99.0)).mean() > 600


@pytest.mark.parametrize(("height", "rows"), [(216, 5), (70, 2), (40, 1)])
def test_joints_with_room_lie_evenly_along_the_body(recording, height, rows):
    strip = Strip(signals_of(recording, "CPG output"), STYLES["water"], (640, height), 1.0)
    numbers = [int(name[1:-2]) for name in strip._signals.names]
    assert len(numbers) == rows
    assert len(set(np.diff(numbers))) <= 1 and numbers[0] == 1
    assert strip._signals.angle.shape[1] == rows


def test_feet_that_touch_down_have_bars(walk):
    touched = synthetic.lowest_points(synthetic.walker(), walk)[:, 2::2] < 1e-6
    touched = np.column_stack([touched, np.arange(len(touched)) < 3])
    feet = (*synthetic.HIPS, "tail")
    shown = signals_of(walk, "posture", True, feet, touched)
    strip = Strip(shown, STYLES["land"], (640, 216), 1.0)
    # The tail rests only at the start.
    assert strip._signals.feet == tuple(synthetic.HIPS)
    green = np.abs(strip.at(0.0).astype(int) - [47, 125, 79]).max(-1) < 40
    below = green[: 216 // 2]
    # All four feet rest for 60 % of the time.
    assert below[:, 160:620].max(0).mean() > 0.9
    without = Strip(signals_of(walk, "posture", True), STYLES["land"], (640, 216), 1.0).at(0.0)
    assert np.abs(without.astype(int) - [47, 125, 79]).max(-1)[:100].min() >= 10
    only = shown._replace(names=(), angle=shown.angle[:, :0], signal=shown.signal[:, :0])
    assert Strip(only, STYLES["land"], (640, 100), 1.0).at(1.0).std() > 10


@pytest.mark.slow
def test_a_film_has_the_strip_at_its_lower_edge(recording, tmp_path):
    shown = signals_of(recording, "CPG output")
    settings = {"size": (320, 180), "seconds": 3, "title": ""}
    plain = film(synthetic.swimmer(), recording, tmp_path / "a.png", **settings)
    with_strip = film(synthetic.swimmer(), recording, tmp_path / "b.png", signals=shown, **settings)
    image = synthetic.read(with_strip)
    assert image.shape == synthetic.read(plain).shape == (180, 320, 3)
    # Blue-white and orange curves are below, and the sea is above.
    foot = image[130:]
    assert ((foot[..., 2] > 200) & (foot[..., 0] < 190)).sum() > 300
    assert ((foot[..., 0] > 180) & (foot[..., 2] < 130)).sum() > 60
    assert np.ptp(image[:120].mean((0, 1))) > 20
