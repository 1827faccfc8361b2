"""Gaps between rounded boxes against distances by alternating projections, and overlaps."""

import jax.numpy as jnp
import numpy as np
import pytest

from creatures import quick_jit
from evo_cpg.creature.algebra.rotation import euler_to_matrix
from evo_cpg.physics.contact.box_separation import separation_of_boxes, separation_of_flat
from evo_cpg.physics.contact.separation import (
    SAME,
    RoundedBoxes,
    separation_of_line_and_box,
    separation_of_lines,
    separation_of_rounded,
)

COUNT = 400
PROJECTIONS = 20_000


def turned(rng, flat):
    """Return random rotations of boxes. Flat boxes turn about z alone."""
    angles = rng.uniform(-np.pi, np.pi, (COUNT, 3)) * ([0, 0, 1] if flat else [1, 1, 1])
    return np.array([euler_to_matrix(*angle) for angle in angles])


def boxes(centre, rotation, half, radius):
    half = np.tile(half, (COUNT, 1))
    parts = centre.T, np.moveaxis(rotation, 0, -1), half.T, np.full(COUNT, radius)
    return RoundedBoxes(*map(jnp.asarray, parts))


def projected(box, point):
    """Return the nearest point of a box without its radius."""
    centre, half = np.asarray(box.centre).T, np.asarray(box.half_extents).T
    axes = np.moveaxis(np.asarray(box.axes), -1, 0)
    own = np.einsum("pij,pi->pj", axes, point - centre)
    return centre + np.einsum("pij,pj->pi", axes, np.clip(own, -half, half))


def distance(a, b):
    """Return the distance of boxes without their radii."""
    there = np.asarray(b.centre).T
    for _ in range(PROJECTIONS):
        here, before = projected(a, there), there
        there = projected(b, here)
        if np.abs(there - before).max() < 1e-10:
            break
    return np.linalg.norm(here - there, axis=1)


CASES = {
    "lines": (separation_of_lines, (0.14, 0, 0), 0.02, (0.1, 0, 0), 0.03),
    "line and ellipsoid": (separation_of_line_and_box, (0.14, 0, 0), 0.02, (0.1, 0.05, 0), 0.05),
    "line and box": (separation_of_line_and_box, (0.14, 0, 0), 0.02, (0.1, 0.05, 0.03), 0.0),
    "ellipsoids": (separation_of_rounded, (0.14, 0.03, 0), 0.02, (0.1, 0.05, 0), 0.05),
    "ellipsoid and box": (separation_of_rounded, (0.14, 0.03, 0), 0.02, (0.1, 0.05, 0.03), 0.0),
    "boxes": (separation_of_boxes, (0.12, 0.04, 0.04), 0.0, (0.3, 0.15, 0.08), 0.0),
    "flat boxes": (separation_of_flat, (0.12, 0.04, 0.04), 0.0, (0.3, 0.15, 0.08), 0.0),
}


@pytest.fixture(params=CASES)
def case(request, x64):
    find, half, radius, other_half, other_radius = CASES[request.param]
    rng, flat = np.random.default_rng(3), request.param.startswith("flat")
    away = rng.normal(scale=0.16, size=(COUNT, 3)) * ([1, 1, 0.2] if flat else [1, 1, 1])
    a = boxes(np.zeros((COUNT, 3)), turned(rng, flat), half, radius)
    b = boxes(away, turned(rng, flat), other_half, other_radius)
    return request.param, a, b, quick_jit(find)(a, b)


def small_turns(rng, degrees):
    """Return rotations by less than an angle."""
    angles = np.radians(rng.uniform(-degrees, degrees, (COUNT, 3)))
    return np.array([euler_to_matrix(*angle) for angle in angles])


@pytest.mark.slow
@pytest.mark.parametrize(
    "half", [(0.1, 0.3, 0.01), (0.3, 0.01, 0.3), (0.05, 0.05, 0.05), (0.3, 0.05, 0.05)]
)
def test_gaps_of_nearly_parallel_lines_equal_a_search(half, x64):
    """Search along the line: across a beam, over a plate's edge and at its end."""
    rng, most, radius = np.random.default_rng(5), 0.2, 0.02
    turn, away = turned(rng, False), rng.normal(scale=0.1, size=(COUNT, 3))
    line = boxes(np.zeros((COUNT, 3)), turn, (most, 0, 0), radius)
    box_turn = turn @ small_turns(rng, 7.0)
    points = quick_jit(separation_of_line_and_box)(line, boxes(away, box_turn, half, 0.0))
    along = np.linspace(-most, most, 4001)[:, None] * turn[:, None, :, 0]
    own = np.einsum("psi,pij->psj", along - away[:, None], box_turn)
    true = np.linalg.norm(own - np.clip(own, -np.array(half), half), axis=2).min(1)
    apart = true > 1e-4
    gaps = np.array([point.gap for point in points])[:, apart]
    assert apart.sum() > 100 and (gaps.min(0) < 0).any()
    np.testing.assert_allclose(gaps.min(0), true[apart] - radius, atol=2e-4)


def test_gaps_are_distances(case):
    """Gaps are exact for lines, never too large for boxes, never too small otherwise."""
    name, a, b, found = case
    cores = distance(a, b)
    true, apart = cores - np.asarray(a.radius + b.radius), cores > 1e-4
    error = (np.asarray(found[0].gap) - true)[apart]
    assert apart.sum() > COUNT / 20
    if name == "lines":
        assert np.abs(error).max() < 1e-8
    elif "boxes" in name:
        assert error.max() < 1e-8
        assert np.mean(np.abs(error) < 1e-8) > 0.7
    else:
        assert error.min() > -1e-8
        assert np.quantile(error, 0.95) < 4e-4


def test_overlap_of_boxes_is_the_least_separating_displacement(case):
    """No other of many directions separates the boxes by a smaller displacement."""
    name, a, b, found = case
    if "boxes" not in name:
        return
    first, gap = found[0], np.asarray(found[0].gap)
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(4000, 3)) * ([1, 1, 0] if name == "flat boxes" else [1, 1, 1])
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    reach = [
        (np.abs(np.einsum("wi,ijp->wjp", directions, box.axes)) * np.asarray(box.half_extents)).sum(
            1
        )
        for box in (a, b)
    ]
    out = sum(reach) - directions @ np.asarray(b.centre - a.centre)
    overlap = gap < 0
    assert overlap.sum() > COUNT / 10
    assert (-gap <= out.min(0) + 1e-9)[overlap].all()
    # The overlap along the normal equals the reported overlap.
    normal = np.asarray(first.normal)
    own = sum(
        (np.abs(np.einsum("ip,ijp->jp", normal, box.axes)) * np.asarray(box.half_extents)).sum(0)
        for box in (a, b)
    )
    along = own - (normal * np.asarray(b.centre - a.centre)).sum(0)
    np.testing.assert_allclose(-gap[overlap], along[overlap], atol=1e-9)


def test_points_lie_a_gap_apart_along_the_normal(case):
    *_, found = case
    for point in found:
        there = np.asarray(point.gap) < 0.9
        displacement = np.asarray(point.second - point.first)
        normal = np.asarray(point.normal)
        assert there.any()
        np.testing.assert_allclose(np.linalg.norm(normal[:, there], axis=0), 1.0, atol=1e-5)
        gap = (displacement * normal).sum(0)
        np.testing.assert_allclose(gap[there], np.asarray(point.gap)[there], atol=1e-6)


def test_points_lie_on_the_bodies(case):
    """At least one of the two points lies in or on its body, unless the overlap is deep."""
    _, a, b, found = case
    for point in found:
        gap = np.asarray(point.gap)
        there = (gap < 0.9) & (gap > -0.01)
        beyond = []
        for box, place in ((a, point.first), (b, point.second)):
            place = np.asarray(place).T
            beyond.append(np.linalg.norm(place - projected(box, place), axis=1) - box.radius)
        nearer = np.minimum(*map(np.asarray, beyond))[there]
        assert nearer.max() < 1e-5


def test_further_points_of_flat_boxes_lie_on_both(x64):
    """Each point lies on the outline of its rectangle, so its gap is exact too."""
    rng = np.random.default_rng(5)
    away = rng.normal(scale=0.16, size=(COUNT, 3)) * [1, 1, 0.2]
    a = boxes(np.zeros((COUNT, 3)), turned(rng, True), (0.12, 0.04, 0.04), 0.0)
    b = boxes(away, turned(rng, True), (0.3, 0.15, 0.08), 0.0)
    _, further = quick_jit(separation_of_flat)(a, b)
    there = np.asarray(further.gap) < 0.5
    assert there.mean() > 0.1
    for box, place in ((a, further.first), (b, further.second)):
        local = np.einsum("ijn,in->jn", np.asarray(box.axes), np.asarray(place - box.centre))
        outside = (np.abs(local) - np.asarray(box.half_extents))[:2, there]
        np.testing.assert_allclose(outside.max(0), 0, atol=1e-9)


def test_points_of_tilted_overhanging_boxes_are_not_too_deep(x64):
    """The lowest corner of a plate may lie outside the other plate. The point is then higher."""
    rng = np.random.default_rng(6)
    half = np.array([0.18, 0.08, 0.015])
    tilted = np.array(
        [euler_to_matrix(*angle) for angle in rng.normal(scale=0.25, size=(COUNT, 3))]
    )
    level = np.tile(np.eye(3), (COUNT, 1, 1))
    away = rng.uniform(-0.9, 0.9, (COUNT, 3)) * 2 * half
    away[:, 2] = rng.uniform(0.03, 0.12, COUNT)
    a, b = boxes(np.zeros((COUNT, 3)), level, half, 0.0), boxes(away, tilted, half, 0.0)
    first, *others = quick_jit(separation_of_boxes)(a, b)
    for point in others:
        there = np.asarray(point.gap) < 0.9
        assert there.mean() > 0.3
        # If crossing edges are a little farther apart than the face, the points stay on the face.
        assert (np.asarray(point.gap) >= np.asarray(first.gap) - SAME)[there].all()
        # The points lie on the face of one box and on the lowest face of the other.
        off = []
        for box, place in ((a, point.first), (b, point.second)):
            local = np.einsum("ijn,in->jn", np.asarray(box.axes), np.asarray(place - box.centre))
            off.append(np.abs(np.abs(local) - np.asarray(box.half_extents)).min(0)[there])
        np.testing.assert_allclose(off, 0, atol=1e-9)


@pytest.mark.parametrize("find", [separation_of_boxes, separation_of_flat])
def test_points_of_overhanging_boxes_lie_on_both(find, x64):
    """The boxes are parallel, so rounding picks the lowest corner: a bar across or over a beam."""
    rng = np.random.default_rng(4)
    none = np.tile(np.eye(3), (COUNT, 1, 1))
    half = np.array([0.3, 0.1, 0.05])
    other = np.array([0.1, 0.3, 0.05])
    # Flat boxes lie side by side and overlap along z.
    up = 2 if find is separation_of_boxes else 1
    aside = rng.uniform(-0.9, 0.9, (COUNT, 3)) * (half + other)
    aside[:, up] = rng.choice([-1.0, 1.0], COUNT) * ((half + other)[up] - 1e-3)
    a, b = boxes(np.zeros((COUNT, 3)), none, half, 0.0), boxes(aside, none, other, 0.0)
    overlap = np.abs(aside) - half - other
    least = overlap.argmax(1) == up
    found = quick_jit(find)(a, b)
    np.testing.assert_allclose(np.asarray(found[0].gap)[least], -1e-3, atol=1e-9)
    for point in found:
        there = least & (np.asarray(point.gap) < 0.9)
        for box, place in ((a, point.first), (b, point.second)):
            place = np.asarray(place).T[there]
            inside = np.abs(place - np.asarray(box.centre).T[there]) - half * (box is a)
            inside = inside - other * (box is b)
            assert inside.max() < 1e-3 + 1e-9
    # The second points span the common length of the boxes.
    assert (np.asarray(found[1].gap)[least] < 0.9).mean() > 0.9
