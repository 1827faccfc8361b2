"""Lofts against closed forms: volumes, moments, bends, mirror images and errors."""

import contextlib

import numpy as np
import pytest

from evo_cpg.creature.cylinder import Cylinder
from evo_cpg.creature.loft import LoftPiece, LoftSection, loft
from evo_cpg.creature.mesh import MeshError
from evo_cpg.creature.shapes import Box, Ellipsoid
from evo_cpg.creature.tree import build_tree
from evo_cpg.io.load import complete_config
from evo_cpg.io.schema.shape import LoftConfig


def straight(
    *sizes: tuple[float, float, float], corners: int | None = None
) -> tuple[LoftPiece, ...]:
    """Return a loft along x, of (x, width, height)."""
    return loft(tuple(LoftSection((x, 0.0, 0.0), w, h) for x, w, h in sizes), corners)


def total(pieces: tuple[LoftPiece, ...]) -> tuple[float, np.ndarray, np.ndarray]:
    """Return volume, centre, and inertia about the centre at a density of 1."""
    volumes = np.array([piece.shape.volume for piece in pieces])
    centre = volumes @ np.array([piece.centre for piece in pieces]) / volumes.sum()
    inertia = np.zeros((3, 3))
    for piece, volume in zip(pieces, volumes, strict=True):
        arm = piece.centre - centre
        inertia += piece.shape.inertia(volume)
        inertia += volume * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return float(volumes.sum()), centre, inertia


def ellipsoid(count: int) -> tuple[LoftPiece, ...]:
    """Return a loft inscribed in an ellipsoid with semi-axes 0.2, 0.1 and 0.05 m."""
    angles = np.linspace(0, np.pi, count + 1)
    sizes = np.sin(angles)
    sizes[[0, -1]] = 0
    rows = np.column_stack([0.2 * np.cos(angles), 0.2 * sizes, 0.1 * sizes])
    return straight(*map(tuple, rows.tolist()))


def test_two_equal_circles_are_a_cylinder():
    """The volume is exact, and moments agree to 5e-5."""
    (piece,) = straight((0.1, 0.08, 0.08), (-0.2, 0.08, 0.08))
    cylinder = Cylinder(0.04, 0.3)
    assert piece.shape.volume == pytest.approx(cylinder.volume, rel=1e-12)
    np.testing.assert_allclose(
        np.diag(piece.shape.inertia(1.0)), np.diag(cylinder.inertia(1.0)), rtol=5e-5
    )
    np.testing.assert_allclose(piece.centre, [-0.05, 0, 0], atol=1e-12)


def test_a_taper_is_a_cone_frustum():
    """Volume, centre and axial moment of a frustum with radii R and r and height h."""
    (piece,) = straight((0.0, 0.2, 0.2), (0.3, 0.1, 0.1))
    R, r, h = 0.1, 0.05, 0.3
    squares = R * R + R * r + r * r
    assert piece.shape.volume == pytest.approx(np.pi * h / 3 * squares, rel=1e-12)
    middle = h / 4 * (R * R + 2 * R * r + 3 * r * r) / squares
    np.testing.assert_allclose(piece.centre, [middle, 0, 0], atol=1e-12)
    axial = 0.3 * (R**5 - r**5) / (R**3 - r**3)
    assert piece.shape.inertia(1.0)[0, 0] == pytest.approx(axial, rel=5e-5)


def test_four_corners_are_a_box_and_an_edge_is_a_wedge():
    (beam,) = straight((0.1, 0.2, 0.1), (-0.1, 0.2, 0.1), corners=4)
    box = Box((0.2, 0.2, 0.1))
    assert beam.shape.volume == pytest.approx(box.volume, rel=1e-12)
    np.testing.assert_allclose(
        np.diag(beam.shape.inertia(1.0)), np.diag(box.inertia(1.0)), rtol=1e-12
    )
    (wedge,) = straight((0.1, 0.2, 0.1), (-0.1, 0, 0.1), corners=4)
    assert wedge.shape.volume == pytest.approx(box.volume / 2, rel=1e-12)


def test_an_ellipsoid_converges_with_the_square_of_its_sections():
    shape = Ellipsoid((0.2, 0.1, 0.05))
    volumes, inertias = [], []
    for count in (6, 12, 24):
        pieces = ellipsoid(count)
        assert len(pieces) == 1
        volume, _, inertia = total(pieces)
        volumes.append(abs(volume / shape.volume - 1))
        inertias.append(np.abs(np.diag(inertia) / np.diag(shape.inertia(shape.volume)) - 1).max())
    for errors in (volumes, inertias):
        assert np.log2(errors[0] / errors[1]) == pytest.approx(2, abs=0.15)
        assert np.log2(errors[1] / errors[2]) == pytest.approx(2, abs=0.15)


def test_a_bend_converges_to_a_torus():
    """A quarter of a ring: Pappus's volume, and the centre at 2 (R^2 + r^2/4) / (pi/2 R) on 45 deg.

    The sections of a polyline are R cos(step / 2) from the centre at their middle, so errors are of
    second order.
    """
    ring, tube = 0.2, 0.03
    centre = np.sqrt(2) * (ring**2 + tube**2 / 4) / (np.pi / 2 * ring)
    errors = []
    for count in (6, 12, 24):
        places = [(ring * np.cos(a), ring * np.sin(a)) for a in np.linspace(0, np.pi / 2, count)]
        pieces = loft(tuple(LoftSection((x, y, 0.0), 2 * tube, 2 * tube) for x, y in places))
        assert len(pieces) == count - 1
        volume, found, _ = total(pieces)
        exact = np.pi * tube**2 * ring * np.pi / 2
        errors.append((abs(volume / exact - 1), np.linalg.norm(found[:2]) / centre - 1))
    steps = np.log2(np.abs(errors[:-1]) / np.abs(errors[1:])) / np.log2([[11 / 5], [23 / 11]])
    np.testing.assert_allclose(steps, 2, atol=0.35)
    assert np.abs(errors[-1]).max() < 2e-3


def test_pieces_of_a_waist_meet_without_overlap():
    """A waist is not convex: two pieces. No point lies deep in both."""
    pieces = straight((0.1, 0.1, 0.1), (0, 0.04, 0.04), (-0.1, 0.1, 0.1))
    assert len(pieces) == 2
    frustum = np.pi * 0.1 / 3 * (0.05**2 + 0.05 * 0.02 + 0.02**2)
    assert total(pieces)[0] == pytest.approx(2 * frustum, rel=1e-12)
    points = np.random.default_rng(0).uniform(-0.1, 0.1, (2000, 3))
    depths = [piece.shape.distance(points - piece.centre) for piece in pieces]
    assert (np.max(depths, axis=0) > -1e-9).all()
    assert (depths[0] < 0).sum() > 100 and (depths[1] < 0).sum() > 100


def animal(shape: dict, **more) -> dict:
    body = {"name": "a", "shape": shape, "material": "m"} | more
    return {"name": "x", "creature": {"name": "x", "materials": {"m": {"density": 500.0}},
            "bodies": [body]}}  # fmt: skip


SECTIONS = [
    {"at": [0.1, 0.0, 0.0], "width": 0.1, "height": 0.06},
    {"at": [0.0, 0.05, 0.01], "width": 0.06, "height": 0.08},
    {"at": [-0.1, 0.0, 0.02], "width": 0.02, "height": 0.1},
]


def test_a_bent_body_has_the_mass_and_inertia_of_its_pieces(tmp_path):
    shape = {"type": "loft", "sections": SECTIONS}
    creature = complete_config(animal(shape), tmp_path / "x.yaml").creature.build()
    pieces = loft(tuple(LoftSection(tuple(s["at"]), s["width"], s["height"]) for s in SECTIONS))
    assert [body.name for body in creature.bodies] == ["a", "a/2"]
    volume, centre, inertia = total(pieces)
    tree = build_tree(creature)
    assert tree.mass[0] == pytest.approx(500 * volume, rel=1e-12)
    np.testing.assert_allclose(tree.com[:, 0], centre - pieces[0].centre, atol=1e-12)
    # The tree's inertia is about the centre of the first piece.
    arm = centre - pieces[0].centre
    about = inertia + volume * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    np.testing.assert_allclose(np.asarray(tree.inertia)[:3, :3, 0], 500 * about, rtol=1e-9)
    # A mass in numbers sets one density for all pieces.
    weighed = complete_config(animal(shape, mass=2.0), tmp_path / "x.yaml").creature.build()
    assert build_tree(weighed).mass[0] == pytest.approx(2.0, rel=1e-12)


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_the_mirror_image_of_a_loft_is_mirrored(axis):
    given = LoftConfig.model_validate({"type": "loft", "sections": SECTIONS})
    image = np.where(np.array(list("xyz")) == axis, -1.0, 1.0)
    for ours, theirs in zip(_pieces(given.mirrored(axis)), _pieces(given), strict=True):
        assert ours.shape.volume == pytest.approx(theirs.shape.volume, rel=1e-12)
        np.testing.assert_allclose(ours.centre, image * theirs.centre, atol=1e-12)
        tensor = np.diag(image) @ theirs.shape.inertia(1.0) @ np.diag(image)
        np.testing.assert_allclose(ours.shape.inertia(1.0), tensor, atol=1e-12)


def _pieces(given: LoftConfig) -> list[LoftPiece]:
    return list(given.build())  # pyright: ignore


def test_a_round_side_looks_smooth_and_an_edge_sharp():
    """Normals on the side of a cylinder point away from its axis, and those of a cap along it."""
    (piece,) = straight((0.1, 0.08, 0.08), (-0.1, 0.08, 0.08))
    skin = piece.shape.skin()
    cap = np.abs(skin.normals[:, 0]) > 0.5
    np.testing.assert_allclose(np.abs(skin.normals[cap, 0]), 1, atol=1e-9)
    radial = skin.points[~cap] * [0, 1, 1]
    radial /= np.linalg.norm(radial, axis=1)[:, None]
    # Each corner has two triangles of one side and one of the other, at most 15 degrees apart.
    assert (np.sum(radial * skin.normals[~cap], 1) > np.cos(np.radians(4))).all()
    (beam,) = straight((0.1, 0.2, 0.1), (-0.1, 0.2, 0.1), corners=4)
    assert set(np.abs(beam.shape.skin().normals).max(1)) == {1.0}


def test_sections_that_make_no_body_are_refused():
    with pytest.raises(MeshError, match="section 1 has no area"):
        straight((0, 0.1, 0.1), (0.1, 0, 0.1), (0.2, 0.1, 0.1))
    with pytest.raises(MeshError, match="sections 0 and 1 are at one place"):
        straight((0, 0.1, 0.1), (0, 0.2, 0.1))
    with pytest.raises(MeshError, match=r"bends by 180 degrees at section 1\. Allowed: up to 120"):
        straight((0, 0.1, 0.1), (0.1, 0.1, 0.1), (0.05, 0.1, 0.1))
    with pytest.raises(MeshError, match="sections 0 and 1 enclose no volume"):
        straight((0, 0.1, 0), (0.1, 0.1, 0))
    bent = [(0.0, 0.0, 0.0), (0.1, 0.0, 0.0), (0.1, 0.1, 0.0)]
    with pytest.raises(MeshError, match="sections 0 and 1 cross"):
        loft(tuple(LoftSection(at, 0.5, 0.1) for at in bent))


def around(degrees: float, radius: float = 0.3, rise: float = 0.0) -> tuple[LoftPiece, ...]:
    """Return a loft of 28 slices along an arc or a helix, 0.04 m wide and 0.06 m high."""
    angles = np.radians(np.linspace(0, degrees, 29))
    rows = np.column_stack([radius * np.sin(angles), -radius * np.cos(angles), rise * angles])
    return loft(tuple(LoftSection(tuple(row), 0.04, 0.06) for row in rows.tolist()))


def hairpin(apart: float) -> tuple[LoftPiece, ...]:
    """Return two parallel beams of 0.04 m that are joined at one end."""
    x, y = [0.0, 0.1, 0.2, 0.2 + apart / 2, 0.2, 0.1, 0.0], [0, 0, 0, 0.5, 1, 1, 1]
    rows = zip(x, np.multiply(y, apart).tolist(), strict=True)
    return loft(tuple(LoftSection((*row, 0.0), 0.04, 0.04) for row in rows), 4)


@pytest.mark.parametrize(
    ("make", "where"),
    [
        (lambda: around(350), None),
        (lambda: around(400), "0 and 1 overlaps the part between sections 25 and 26"),
        (lambda: around(500, rise=0.02), None),
        (lambda: around(500, rise=0.005), "0 and 1 overlaps the part between sections 20 and 21"),
        (lambda: hairpin(0.04), None),
        (lambda: hairpin(0.0399), "0 and 1 overlaps the part between sections 5 and 6"),
    ],
)
def test_a_loft_that_meets_itself_is_refused(make, where):
    with contextlib.nullcontext() if where is None else pytest.raises(MeshError, match=where):
        make()
