"""The worm of `configs/worm.yaml` against resistive-force theory (Gray and Hancock 1955)."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from evo_cpg.api.lab import lab

# 20 capsules with a distance of 1 mm, 1.4 mm thick. Drag does not depend on the viscosity's size.
_LINKS, _LINK, _THICK = 20, 1.0, 1.4


def drag_per_length() -> tuple[float, float]:
    """Return the drag along and across of a spheroid in creeping flow (Chwang and Wu 1975)."""
    slender = ((_LINKS - 1) * _LINK + 2.4) / _THICK
    e = np.sqrt(1 - 1 / slender**2)
    log = np.log((1 + e) / (1 - e))
    return 1 / ((1 + e**2) * log - 2 * e), 2 / ((3 * e**2 - 1) * log + 2 * e)


def resistive_path(time: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Return the path of the middle of a worm without inertia that bends with these angles, mm.

    The velocity of the head leaves no force and no moment.
    """
    along, across = drag_per_length()
    spline = CubicSpline(time, angles)
    rates, pieces = spline.derivative(), 4
    offsets = (np.arange(pieces) + 0.5) / pieces - 0.5

    def points_of(place, bends):
        turns = place[2] + np.concatenate([[0.0], np.cumsum(bends)])
        ahead = np.stack([np.cos(turns), np.sin(turns)], 1)
        centres = place[:2] - _LINK * np.concatenate(
            [[[0.0, 0.0]], np.cumsum(0.5 * (ahead[1:] + ahead[:-1]), 0)]
        )
        points = centres[:, None] + _LINK * offsets[:, None] * ahead[:, None]
        return points.reshape(-1, 2), np.repeat(ahead, pieces, 0), centres.mean(0)

    def velocity(t, place):
        points, tangents, _ = points_of(place, spline(t))
        change = 1e-4
        ahead, behind = (points_of(place, spline(t) + s * change * rates(t))[0] for s in (1, -1))
        bending = (ahead - behind) / (2 * change)
        resist = across * np.eye(2) + (along - across) * np.einsum("pi,pj->pij", tangents, tangents)
        arm = points - place[:2]
        moves = np.zeros((len(points), 2, 3))
        moves[:, :, :2], moves[:, 0, 2], moves[:, 1, 2] = np.eye(2), -arm[:, 1], arm[:, 0]
        whole = np.einsum("pji,pjk,pkl->il", moves, resist, moves)
        return -np.linalg.solve(whole, np.einsum("pji,pjk,pk->i", moves, resist, bending))

    place, path, h = np.zeros(3), [], time[1] - time[0]
    for t in time[:-1]:
        path.append(points_of(place, spline(t))[2])
        half = place + 0.5 * h * velocity(t, place)
        place = place + h * velocity(t + 0.5 * h, half)
    return np.array(path)


@pytest.mark.slow
def test_worm_swims_as_in_resistive_force_theory():
    """Its own bending gives its speed within 10 %. It is slower than an endless worm.

    Endless: U/V = (K - 1) s / (1 + K s), where s = 2 pi^2 b^2 / l^2 is the mean squared slope. Head
    and tail of a finite worm swing, which takes 15 to 35 % of this speed.
    """
    answer = lab("worm", {"u": [0.3, 0.6], "b": [3.0]}, seconds=6.0)
    along, across = drag_per_length()
    ratio = across / along
    for row, motion in zip(answer.rows, answer.recordings, strict=True):
        assert row["reynolds"] < 1
        last = slice(len(motion.time) // 2, None)
        path = motion.position[last].mean(1)[:, :2]
        theory = resistive_path(motion.time[last], motion.joint_angle[last])
        found = np.linalg.norm(path[-2] - path[0])
        expected = 1e-3 * np.linalg.norm(theory[-1] - theory[0])
        forward = path[-1] - path[0]
        heading = motion.rotation[last, :, :, 0]
        turn = np.arctan2(heading[..., 1], heading[..., 0]) - np.arctan2(forward[1], forward[0])
        slope = (np.tan(turn) ** 2).mean()
        endless = (ratio - 1) * slope / (1 + ratio * slope)
        assert found == pytest.approx(expected, rel=0.1), (found, expected)
        assert 0.65 < row["wave_slip"] / endless < 0.85, (row["wave_slip"], endless)
