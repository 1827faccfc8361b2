"""Surface points that are exposed to the water."""

import numpy as np
import pytest

from creatures import box_chain, hinge
from evo_cpg.creature.creature import Body, Creature, Material
from evo_cpg.creature.shapes import Box
from evo_cpg.creature.surface import outer_surfaces, random_surfaces

SIZE = (0.2, 0.1, 0.1)
FACES = {
    "front": (0, 1),
    "back": (0, -1),
    "left": (1, 1),
    "right": (1, -1),
    "top": (2, 1),
    "bottom": (2, -1),
}


def face_areas(surface) -> dict[str, float]:
    """Return the exposed area of each face of a box."""
    return {
        name: surface.areas[surface.normals[:, axis] * sign > 0.5].sum()
        for name, (axis, sign) in FACES.items()
    }


@pytest.mark.parametrize("gap", [0.0, 0.02])
@pytest.mark.parametrize("resolution", [2, 3])
def test_shelter_drops_exactly_the_facing_ends_of_a_chain(gap, resolution):
    """Four boxes in a row lose the inner end faces, and keep the other faces."""
    surfaces = outer_surfaces(box_chain(4, "z", size=SIZE, gap=gap), resolution)
    side, end = SIZE[0] * SIZE[1], SIZE[1] * SIZE[2]
    for i, surface in enumerate(surfaces):
        expected = dict.fromkeys(("left", "right", "top", "bottom"), side)
        expected |= {"front": end if i == 0 else 0.0, "back": end if i == 3 else 0.0}
        assert face_areas(surface) == pytest.approx(expected)


@pytest.mark.parametrize("resolution", [8, 16, 32])
def test_a_common_surface_of_two_bodies_counts_once(resolution):
    """Three boxes 0.2 m long at distances of 0.15 m form a box of 0.5 m."""
    chain = box_chain(3, "z", size=(0.2, 0.1, 0.1), gap=-0.05)
    area = sum(surface.areas.sum() for surface in outer_surfaces(chain, resolution))
    whole = 4 * 0.5 * 0.1 + 2 * 0.1 * 0.1
    # A point covers a piece of the length, so each of four ends has an error of up to half a piece.
    assert area == pytest.approx(whole, abs=4 * 4 * 0.1 * 0.2 / resolution / 2)


def test_unsheltered_counts_every_face():
    """The literal reading keeps the whole surface of every body."""
    for surface in outer_surfaces(box_chain(3, "z", size=SIZE), 2, sheltered=False):
        assert surface.areas.sum() == pytest.approx(2 * (0.02 + 0.02 + 0.01))


def test_points_inside_another_body_are_dropped():
    """A fin halfway inside a hull loses the half of its surface that is inside.

    The hull loses only the points under the fin.
    """
    hull = Body("hull", Box((0.4, 0.2, 0.2)), Material(1000.0))
    joint = hinge("hull", (0.0, 0.1, 0.0), (0.0, 0.0, 0.0))
    fin = Body("fin", Box((0.05, 0.2, 0.05)), Material(1000.0), joint)
    covered, half = outer_surfaces(Creature("fish", (hull, fin)), 40)
    # The fin's outer half: four sides of 0.05 x 0.1 and one end of 0.05 x 0.05.
    assert half.areas.sum() == pytest.approx(4 * 0.005 + 0.0025, rel=0.02)
    whole = 2 * (0.08 + 0.08 + 0.04)
    assert covered.areas.sum() == pytest.approx(whole - 0.0025, rel=0.005)


def test_random_points_are_proportional_to_area():
    """All points have equal areas, and each face gets points in proportion to its area.

    A face with a fraction p of the area gets 20000 p of 20000 points, within 5 standard deviations.
    """
    surfaces = outer_surfaces(box_chain(1, "z", size=SIZE), 3)
    count = 20_000
    (drawn,) = random_surfaces(surfaces, count, np.random.default_rng(0))
    total = surfaces[0].areas.sum()
    np.testing.assert_allclose(drawn.areas, total / count)
    expected = {name: area / total for name, area in face_areas(surfaces[0]).items()}
    for name, area in face_areas(drawn).items():
        fraction = expected[name]
        deviation = np.sqrt(fraction * (1 - fraction) / count)
        assert abs(area / total - fraction) < 5 * deviation, name


def test_a_covered_body_has_no_random_points():
    """An empty surface stays empty."""
    outer = Body("outer", Box((0.4, 0.4, 0.4)), Material(1000.0))
    joint = hinge("outer", (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    inner = Body("inner", Box((0.1, 0.1, 0.1)), Material(1000.0), joint)
    surfaces = outer_surfaces(Creature("nested", (outer, inner)), 2)
    drawn = random_surfaces(surfaces, 5, np.random.default_rng(0))
    assert len(drawn[0].areas) == 5
    assert len(drawn[1].areas) == 0
