"""The outline of bodies in line feels the water like one body."""

from collections.abc import Sequence

import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull

from creatures import hinge
from evo_cpg.creature.creature import Body, Creature, Material, neutral_pose
from evo_cpg.creature.mesh import convex_mesh
from evo_cpg.creature.shapes import Box, Capsule, Ellipsoid, Shape, Sphere
from evo_cpg.creature.surface import outer_surfaces

R, L = 0.05, 0.1
CAPSULE = Capsule(R, L)
BOX = Box((0.2, 0.1, 0.1))

# Default coefficients and resolutions of form drag and skin friction.
FORM, SKIN = (1.0, 2), (0.02, 1)

ALONG, ASKEW, ACROSS, UP = (1.0, 0.0, 0.0), (0.8**0.5, 0.2**0.5, 0.0), (0.0, 1.0, 0.0), (0, 0, 1.0)
TOWED = {"along": ALONG, "45 degrees": (0.5**0.5, 0.5**0.5, 0.0), "across": ACROSS, "up": UP}


def turned(degrees: float) -> tuple:
    """Rotation about z."""
    cos, sin = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    return ((cos, -sin, 0.0), (sin, cos, 0.0), (0.0, 0.0, 1.0))


def joined(name, shape, parent, at, child_at, degrees=0.0) -> Body:
    joint = hinge(parent, at, child_at, orientation=turned(degrees))
    return Body(name, shape, Material(1000.0), joint)


def pair(one, two, at, child_at, degrees=0.0) -> Creature:
    root = Body("one", one, Material(1000.0))
    return Creature("pair", (root, joined("two", two, "one", at, child_at, degrees)))


def chain(shapes: Sequence[Shape], gap: float) -> Creature:
    """Bodies in a row along -x, with a gap (m) between their ends."""
    bodies = [Body("0", shapes[0], Material(1000.0))]
    for k in range(1, len(shapes)):
        one, two = (float(shape.half_extents[0]) for shape in shapes[k - 1 : k + 1])
        at, child_at = (-one - gap / 2, 0.0, 0.0), (two + gap / 2, 0.0, 0.0)
        bodies.append(joined(str(k), shapes[k], str(k - 1), at, child_at))
    return Creature("chain", tuple(bodies))


def alone(shape: Shape) -> Creature:
    return Creature("alone", (Body("body", shape, Material(1000.0)),))


def normals_and_areas(creature: Creature, resolution: int, **options):
    _, rotations = neutral_pose(creature)
    surfaces = outer_surfaces(creature, resolution, **options)
    normals = [s.normals @ turn.T for s, turn in zip(surfaces, rotations, strict=True)]
    return np.concatenate(normals), np.concatenate([surface.areas for surface in surfaces])


def form_of(normals, areas, direction) -> float:
    """Form drag over the dynamic pressure, at C_d = 1, m^2."""
    speed = normals @ np.asarray(direction)
    return float(areas @ np.abs(speed) ** 3)


def skin_of(normals, areas, direction) -> float:
    """Skin friction over the dynamic pressure, at C_f = 1, m^2."""
    speed = normals @ np.asarray(direction)
    return float(areas @ np.maximum(1 - speed**2, 0.0) ** 1.5)


def drag(creature: Creature, direction, **options) -> float:
    """Drag area at the default law and resolutions, m^2."""
    form = form_of(*normals_and_areas(creature, FORM[1], **options), direction)
    skin = skin_of(*normals_and_areas(creature, SKIN[1], **options), direction)
    return FORM[0] * form + SKIN[0] * skin


def capsule_drag(length: float, direction) -> float:
    """Closed form of the drag area of a capsule of radius R along or across its axis, m^2."""
    cylinder = length - 2 * R
    ends = np.pi * R**2
    skin = SKIN[0] * 4 * np.pi * R**2 * 3 * np.pi / 16
    if direction == ALONG:
        return ends + skin + SKIN[0] * 2 * np.pi * R * cylinder
    return ends + skin + (FORM[0] + SKIN[0]) * 8 / 3 * R * cylinder


def hull_drag(creature: Creature, direction) -> float:
    """Drag area of the facets of the convex hull of all bodies, m^2."""
    points = []
    for body, centre, turn in zip(creature.bodies, *neutral_pose(creature), strict=True):
        own = body.shape.skin().points if body.shape.corners is None else body.shape.corners
        points.append(own @ turn.T + centre)
    corners = np.concatenate(points)
    hull = ConvexHull(corners)
    first, second, third = corners[hull.simplices].transpose(1, 0, 2)
    areas = np.linalg.norm(np.cross(second - first, third - first), axis=1) / 2
    normals = hull.equations[:, :3]
    return form_of(normals, areas, direction) + SKIN[0] * skin_of(normals, areas, direction)


@pytest.mark.slow
@pytest.mark.parametrize("direction", [ALONG, ACROSS, UP], ids=["along", "across", "up"])
@pytest.mark.parametrize(
    ("shape", "gap"),
    [
        # End balls coincide or nearly so, capsules touch or nearly so, and cylinders overlap.
        *((CAPSULE, x * R) for x in (-2.0, -1.8, 0.0, 0.2, -2.5)),
        *((Sphere(R), x * R) for x in (0.0, -0.5)),
    ],
)
def test_round_chain_has_the_drag_of_one_capsule(shape, gap, direction):
    """The closed form of one capsule as long as the chain."""
    creature = chain([shape] * 14, gap)
    expected = capsule_drag(28 * float(shape.half_extents[0]) + 13 * gap, direction)
    assert drag(creature, direction) == pytest.approx(expected, rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("direction", TOWED.values(), ids=TOWED)
@pytest.mark.parametrize(
    ("creature", "tolerance"),
    [
        (chain([Ellipsoid((2 * R, R, R))] * 14, -4 / 3 * R), 0.02),
        (chain([Ellipsoid((2 * R, 0.6 * R, 1.1 * R))] * 10, -R), 0.02),
        (chain([Capsule(R * 0.95**k, L) for k in range(10)], -1.2 * R), 0.1),
        (chain([BOX] * 10, 0.02), 0.1),
        (chain([CAPSULE, BOX, CAPSULE], 0.0), 0.1),
    ],
    ids=["ellipsoids", "flat ellipsoids", "tapered capsules", "boxes", "capsule, box, capsule"],
)
def test_chain_has_the_drag_of_its_hull(creature, tolerance, direction):
    """The hull spans from a box's corners to round neighbours, which their outline does not."""
    assert drag(creature, direction) == pytest.approx(hull_drag(creature, direction), rel=tolerance)


def test_limb_across_keeps_its_side():
    """A limb that stands at 90 degrees on a trunk loses the half-ball inside the trunk only.

    The trunk loses at most a few footprints.
    """
    trunk, limb = Capsule(R, 0.6), Capsule(0.018, 0.09)
    creature = pair(trunk, limb, (0.03, R, 0.0), (-0.045, 0.0, 0.0), 90.0)
    own, free = (outer_surfaces(alone(shape), 6)[0] for shape in (trunk, limb))
    both = outer_surfaces(creature, 6)
    assert own.areas.sum() - both[0].areas.sum() < 4 * np.pi * 0.018**2
    side, ends = 2 * np.pi * 0.018 * 0.09, 2 * np.pi * 0.018**2
    assert both[1].areas.sum() == pytest.approx(side + ends, abs=0.4 * ends)
    assert free.areas.sum() == pytest.approx(side + 2 * ends)


def test_sunken_limb_loses_its_hidden_area():
    """A limb whose half is inside a trunk keeps the other half."""
    limb = Capsule(0.018, 0.2)
    creature = pair(Capsule(0.1, 0.6), limb, (0.0, 0.1, 0.0), (0.0, 0.0, 0.0), 90.0)
    kept = outer_surfaces(creature, 12)[1].areas.sum()
    assert kept == pytest.approx(outer_surfaces(alone(limb), 12)[0].areas.sum() / 2, rel=0.1)


def test_thin_capsule_leaves_the_face_of_a_box_exposed():
    creature = pair(Box((0.2, 0.2, 0.2)), Capsule(0.02, L), (-0.1, 0.0, 0.0), (0.07, 0.0, 0.0))
    box = outer_surfaces(creature, 8)[0]
    rear = box.areas[box.normals[:, 0] < -0.5].sum()
    assert rear == pytest.approx(0.04, abs=0.1 * 0.04)


def test_box_of_similar_width_shelters_a_round_end():
    box, capsule = outer_surfaces(pair(BOX, CAPSULE, (-0.1, 0, 0), (L / 2 + R, 0, 0)), 4)
    assert box.areas[box.normals[:, 0] < -0.5].sum() == pytest.approx(0.0, abs=1e-12)
    assert capsule.areas[capsule.normals[:, 0] > 0.01].sum() == pytest.approx(0.0, abs=1e-12)
    side = capsule.areas[np.abs(capsule.normals[:, 0]) < 1e-9].sum()
    assert side == pytest.approx(2 * np.pi * R * (L + R / 2))


def test_mesh_shelters_like_the_box_it_is():
    box = trimesh.creation.box(BOX.size)
    mesh, _ = convex_mesh(box.vertices, box.faces)
    both = [
        normals_and_areas(pair(shape, CAPSULE, (-0.1, 0, 0), (L / 2 + R, 0, 0)), 2)
        for shape in (BOX, mesh)
    ]
    for direction in (ALONG, ACROSS, UP):
        expected, found = (form_of(*each, direction) for each in both)
        assert found == pytest.approx(expected, rel=1e-9)


def test_fork_is_symmetric_and_hides_its_joint():
    """A body that forks into two has no more drag along than with one branch plus two ends."""
    branches = [
        joined(str(side), CAPSULE, "trunk", (-0.05, 0, 0), (0.05, 0, 0), 20.0 * side)
        for side in (1, -1)
    ]
    fork = Creature("fork", (Body("trunk", CAPSULE, Material(1000.0)), *branches))
    trunk, left, right = outer_surfaces(fork, 3)
    assert left.areas.sum() == pytest.approx(right.areas.sum(), rel=1e-9)
    assert trunk.areas[trunk.normals[:, 0] < -0.01].sum() == pytest.approx(0.0, abs=1e-9)
    assert drag(fork, ALONG) < 2 * drag(chain([CAPSULE] * 2, -2 * R), ALONG)


CHANGES = {
    "gap": (lambda x: chain([CAPSULE] * 2, x), (-0.14, 0.3)),
    "angle of capsules": (
        lambda x: pair(CAPSULE, CAPSULE, (-0.05, 0, 0), (0.05, 0, 0), x),
        (0.0, 90.0),
    ),
    "angle of ellipsoids": (
        lambda x: pair(
            Ellipsoid((0.1, R, R)), Ellipsoid((0.1, R, R)), (-0.07, 0, 0), (0.07, 0, 0), x
        ),
        (0.0, 90.0),
    ),
    "width": (lambda x: pair(CAPSULE, Capsule(x, L), (-0.05, 0, 0), (0.05, 0, 0)), (0.01, 0.15)),
    "offset": (lambda x: pair(CAPSULE, CAPSULE, (-0.05, x, 0), (0.05, 0, 0)), (0.0, 0.15)),
    "limb that sinks in": (
        lambda x: pair(Capsule(R, 0.6), Capsule(0.018, 0.09), (0.03, x, 0), (-0.055, 0, 0), 90.0),
        (0.0, 0.1),
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize(("build", "between"), CHANGES.values(), ids=CHANGES)
def test_drag_is_continuous_in_the_geometry(build, between):
    """Steps of a quarter of the size change the drag by at most 0.4 times as much."""

    def largest_change(count: int) -> float:
        found = np.array(
            [drag(build(x), ASKEW) for x in np.linspace(between[0], between[1], count)]
        )
        return np.abs(np.diff(found)).max() / found.mean()

    coarse, fine = largest_change(30), largest_change(120)
    assert fine < max(0.4 * coarse, 1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("direction", TOWED.values(), ids=TOWED)
@pytest.mark.parametrize(
    "creature",
    [
        alone(Sphere(R)),
        alone(CAPSULE),
        alone(Capsule(R, 8 * R)),
        alone(Ellipsoid((2 * R, R, R))),
        alone(Ellipsoid((3 * R, R, R))),
        alone(Ellipsoid((0.11, 0.075, 0.05))),
        alone(Ellipsoid((0.1, 0.03, 0.055))),
        chain([CAPSULE] * 5, 0.2 * R),
        chain([Sphere(R)] * 5, 0.0),
        chain([Ellipsoid((2 * R, R, R))] * 5, -4 / 3 * R),
        chain([Ellipsoid((0.11, 0.065, 0.055)), Capsule(R, L), Sphere(0.04)], -0.03),
    ],
)
def test_default_resolution_is_converged(creature, direction):
    for measure, (_, resolution) in ((form_of, FORM), (skin_of, SKIN)):
        dense = measure(*normals_and_areas(creature, 24), direction)
        found = measure(*normals_and_areas(creature, resolution), direction)
        assert found == pytest.approx(dense, rel=0.03)
