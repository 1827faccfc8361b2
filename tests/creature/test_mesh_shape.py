"""Meshes as shapes: moments, distances and surfaces against closed forms, and errors."""

import numpy as np
import pytest
import scipy.spatial
import trimesh

from evo_cpg.creature.mesh import (
    MOST_CORNERS,
    MOST_TRIANGLES,
    ConvexMesh,
    MeshError,
    convex_mesh,
    hull,
)
from evo_cpg.creature.shapes import Box
from polyhedra import (
    LEGS,
    TETRAHEDRON,
    TETRAHEDRON_FACES,
    ball_mesh,
    box_mesh,
    shape,
    tetrahedron,
    two_boxes,
    wedge,
    whisker,
)

SIZE = (0.3, 0.2, 0.1)
MESHES = {
    "box": box_mesh(SIZE),
    "tetrahedron": tetrahedron(),
    "wedge": wedge(),
    "cylinder": shape(trimesh.creation.cylinder(0.05, 0.3, sections=24)),
    "ball": ball_mesh(0.1, 2),
}
each_mesh = pytest.mark.parametrize("mesh", MESHES.values(), ids=MESHES.keys())


def test_a_box_mesh_equals_a_box():
    """Volume, inertia, size, distances and supports agree to 1e-12, surface points to 2e-9."""
    mesh, box = MESHES["box"], Box(SIZE)
    assert mesh.volume == pytest.approx(box.volume, rel=1e-12)
    np.testing.assert_allclose(mesh.half_extents, box.half_extents, rtol=1e-12)
    np.testing.assert_allclose(np.diag(mesh.inertia(2.0)), np.diag(box.inertia(2.0)), rtol=1e-12)
    np.testing.assert_allclose(mesh.inertia(2.0), box.inertia(2.0), atol=1e-15)
    points = np.random.default_rng(0).uniform(-0.3, 0.3, (500, 3))
    np.testing.assert_allclose(mesh.distance(points), box.distance(points), atol=1e-12)
    for direction in (*np.eye(3), *np.random.default_rng(1).normal(size=(20, 3))):
        np.testing.assert_allclose(mesh.support(direction), box.support(direction), atol=1e-12)
    for resolution in (1, 2):
        ours, theirs = mesh.surface(resolution), box.surface(resolution)

        def rows(surface):
            return sorted(map(tuple, np.round(np.column_stack(surface), 9) + 0.0))

        np.testing.assert_allclose(rows(ours), rows(theirs), atol=2e-9)


def test_inertia_of_a_tetrahedron():
    """Corners at 0 and at a, b, c on the axes: V = abc/6, and about the centre
    I_xx = 3 m (b^2 + c^2) / 80 and I_xy = m ab / 80."""
    a, b, c = LEGS
    mesh, centre = convex_mesh(TETRAHEDRON, TETRAHEDRON_FACES)
    np.testing.assert_allclose(centre, np.array(LEGS) / 4, rtol=1e-12)
    assert mesh.volume == pytest.approx(a * b * c / 6, rel=1e-12)
    squares = np.square(LEGS)
    expected = np.diag(3 / 80 * (squares.sum() - squares))
    expected += (np.outer(LEGS, LEGS) - np.diag(squares)) / 80
    np.testing.assert_allclose(mesh.inertia(1.0), expected, rtol=1e-12)
    half, turn = mesh.stretch
    like_a_box = turn @ Box(tuple(2 * half)).inertia(1.0) @ turn.T
    np.testing.assert_allclose(like_a_box, expected, atol=1e-15)


@each_mesh
def test_the_place_of_the_drawing_does_not_matter(mesh):
    """A mesh drawn a kilometre away has an equal shape and another centre."""
    moved, centre = convex_mesh(mesh.points + np.array([1000.0, 0, 3.0]), np.array(mesh.faces))
    np.testing.assert_allclose(centre, [1000.0, 0, 3.0], atol=1e-12)
    np.testing.assert_allclose(moved.points, mesh.points, atol=1e-12)
    np.testing.assert_allclose(np.diag(moved.inertia(1.0)), np.diag(mesh.inertia(1.0)), rtol=1e-9)


@each_mesh
@pytest.mark.parametrize("resolution", [1, 2, 3, 4, 8])
def test_surface_points(mesh, resolution):
    """Check the area, int n dA = 0 and int x n^T dA = V 1, to rounding without shared points.

    The number of points is limited, and the points lie on the surface.
    """
    points, normals, areas = mesh.surface(resolution)
    total = mesh.planes[1].sum()
    assert len(areas) <= max(8 * resolution**2, 24)
    assert areas.sum() == pytest.approx(total, rel=1e-12)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, rtol=1e-12)
    moment = np.einsum("p,pi,pj->ij", areas, points, normals)
    facets = np.unique((mesh.planes[0] @ mesh.planes[0].T > 1 - 1e-9).argmax(1))
    if len(facets) <= max(8 * resolution**2, 12):
        np.testing.assert_allclose(areas @ normals, 0, atol=1e-12 * total)
        np.testing.assert_allclose(moment, mesh.volume * np.eye(3), atol=1e-12 * mesh.volume)
        np.testing.assert_allclose(mesh.distance(points), 0, atol=1e-12)
        assert (mesh.distance(points + 1e-4 * normals) > 0).all()
    else:
        np.testing.assert_allclose(areas @ normals, 0, atol=0.02 * total)
        np.testing.assert_allclose(moment, mesh.volume * np.eye(3), atol=0.1 * mesh.volume)
        assert (mesh.distance(points) < 1e-12).all()


def test_shared_points_represent_a_ball():
    """1280 triangles share 32 points: int n n^T dA equals a sphere's within 2 %."""
    _, normals, areas = ball_mesh(0.1, 3).surface(2)
    assert len(areas) == 32
    np.testing.assert_allclose(
        3 * np.einsum("p,pi,pj->ij", areas, normals, normals), areas.sum() * np.eye(3), atol=0.002
    )


def test_points_of_a_facet_have_its_second_moments():
    """Compare with (1/12) sum (v - c)(v - c)^T of a triangle, with 4 and 16 points."""
    mesh = tetrahedron()
    for resolution in (2, 4):
        points, normals, areas = mesh.surface(resolution)
        for corners, normal in zip(mesh.broad, mesh.planes[0], strict=True):
            own = normals @ normal > 1 - 1e-9
            middle = corners.mean(0)
            expected = (corners - middle).T @ (corners - middle) / 12
            found = (points[own] - middle).T * areas[own] @ (points[own] - middle)
            tolerance = 1e-12 if resolution == 2 else 1e-9
            np.testing.assert_allclose(
                found / areas[own].sum(), expected, atol=tolerance * expected.max()
            )


@each_mesh
def test_distance(mesh):
    """Compare with the nearest of many points on the surface, and signs with Delaunay."""
    rng = np.random.default_rng(3)
    points = rng.normal(size=(200, 3)) * mesh.half_extents * 1.5
    found = mesh.distance(points)
    weights = rng.dirichlet(np.ones(3), (20, 40_000 // len(mesh.faces) // 4 + 1))
    surface = np.einsum("ijk,fkc->fijc", weights, mesh.triangles).reshape(-1, 3)
    near, _ = scipy.spatial.cKDTree(surface).query(points)
    assert (np.abs(found) <= near + 1e-12).all()
    np.testing.assert_allclose(np.abs(found), near, atol=0.01)
    inside = scipy.spatial.Delaunay(mesh.points).find_simplex(points) >= 0
    np.testing.assert_array_equal(found < 0, inside)


@each_mesh
def test_support_is_the_farthest_vertex(mesh):
    for direction in np.random.default_rng(2).normal(size=(20, 3)):
        point = mesh.support(direction)
        assert point @ direction == pytest.approx((mesh.points @ direction).max(), rel=1e-12)
        assert mesh.distance(point[None])[0] == pytest.approx(0, abs=1e-12)


def test_corners_leave_out_points_on_edges_and_faces():
    """A box of 768 triangles has eight corners."""
    fine = trimesh.creation.box(SIZE).subdivide().subdivide().subdivide()
    assert len(fine.faces) == 768
    corners = shape(fine).corners
    assert len(corners) == 8
    np.testing.assert_allclose(np.abs(corners), np.tile(np.array(SIZE) / 2, (8, 1)))


def test_corners_are_few_and_far_apart():
    """64 of 642 vertices of a ball are apart by half the side of a square of their mean area."""
    ball = ball_mesh(0.1, 3)
    corners = ball.corners
    assert len(corners) == MOST_CORNERS == len(np.unique(corners, axis=0))
    fair = np.sqrt(4 * np.pi / MOST_CORNERS) * 0.1
    apart = np.linalg.norm(corners[:, None] - corners, axis=-1) + np.eye(len(corners))
    assert apart.min() > 0.5 * fair
    # Each vertex of the ball is within that side of a corner.
    assert np.linalg.norm(ball.points[:, None] - corners, axis=-1).min(1).max() < fair


@each_mesh
def test_hull_is_closed_and_looks_outwards(mesh):
    """n corners have 2 n - 4 triangles, and each edge occurs once in either direction."""
    corners, faces = hull(mesh.corners, "its corners")
    triangles = corners[faces]
    reference = scipy.spatial.ConvexHull(corners)
    assert len(triangles) == 2 * len(corners) - 4
    edges = {(int(face[k]), int(face[k - 1])) for face in faces for k in range(3)}
    assert len(edges) == 3 * len(faces) and edges == {(b, a) for a, b in edges}
    found = trimesh.Trimesh(triangles.reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3))
    assert found.volume == pytest.approx(reference.volume, rel=1e-9)
    assert found.area == pytest.approx(reference.area, rel=1e-9)


@each_mesh
def test_the_cell_has_the_moments_of_the_mesh(mesh):
    """Volume and first moments are exact. Second moments are exact with all corners."""
    (cell,) = mesh.cells()
    count = 3 * len(cell.triangles)
    body = trimesh.Trimesh(cell.triangles.reshape(-1, 3), np.arange(count).reshape(-1, 3))
    assert cell.centre == (0.0, 0.0, 0.0)
    assert body.volume == pytest.approx(mesh.volume, rel=1e-9)
    np.testing.assert_allclose(body.center_mass, 0, atol=1e-9)
    rtol = 1e-6 if len(mesh.corners) < MOST_CORNERS else 0.02
    np.testing.assert_allclose(
        body.moment_inertia / body.volume,
        mesh.inertia(1.0),
        rtol=rtol,
        atol=rtol * np.diag(mesh.inertia(1.0)).max(),
    )


def l_shape() -> trimesh.Trimesh:
    corner = [(0, 0), (0.2, 0), (0.2, 0.1), (0.1, 0.1), (0.1, 0.2), (0, 0.2)]
    bottom = [(x, y, 0.0) for x, y in corner]
    top = [(x, y, 0.1) for x, y in corner]
    cap = [(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 5)]
    sides = [(i, (i + 1) % 6, (i + 1) % 6 + 6) for i in range(6)]
    sides += [(i, (i + 1) % 6 + 6, i + 6) for i in range(6)]
    faces = [face[::-1] for face in cap] + [tuple(i + 6 for i in face) for face in cap] + sides
    return trimesh.Trimesh(bottom + top, faces, process=False)


def flipped(mesh: trimesh.Trimesh, faces: slice) -> tuple[np.ndarray, np.ndarray]:
    turned = np.array(mesh.faces)
    turned[faces] = turned[faces, ::-1]
    return np.array(mesh.vertices), turned


def of(mesh: trimesh.Trimesh) -> tuple[np.ndarray, np.ndarray]:
    return np.array(mesh.vertices), np.array(mesh.faces)


BOX = trimesh.creation.box(SIZE)
REFUSED = {
    "empty": (np.zeros((0, 3)), np.zeros((0, 3), int), "it has no faces"),
    "huge": (*of(trimesh.creation.icosphere(4)), rf"5120 triangles.*{MOST_TRIANGLES}"),
    "not a number": (np.array(BOX.vertices) * [1, np.nan, 1], np.array(BOX.faces), "finite"),
    "no such vertex": (TETRAHEDRON, TETRAHEDRON_FACES + 1, "vertex 4. Allowed: 0 to 3"),
    "millimetres": (*of(trimesh.creation.box((300, 200, 100))), "300 m.*scale: 0.001"),
    "tiny": (*of(trimesh.creation.box((1e-4, 2e-4, 3e-4))), r"0.0003 m\. .*scale too small?"),
    "open": (np.array(BOX.vertices), np.array(BOX.faces)[1:], "open: 3 of 18 edges"),
    "two": (*of(two_boxes(SIZE)), "2 separate pieces"),
    "tangled": (*flipped(BOX, slice(1)), "opposite orientations"),
    "inside out": (*flipped(BOX, slice(None)), "inside out"),
    "flat": (TETRAHEDRON * [1, 1, 0], TETRAHEDRON_FACES, "flat: 0.3 m"),
    "overflow": (TETRAHEDRON * [-1e308, 1e308, 1e308], TETRAHEDRON_FACES[:, ::-1], "3e.307 m"),
    "whisker": (*of(whisker()), "128 of its 128 triangles"),
    "lines": (TETRAHEDRON, np.array([[0, 1, 1], [2, 2, 3]]), "it has no faces"),
    "dent": (*of(l_shape()), r"vertex \d+ lies 0.1 m beyond the plane of face \d+.*0.0002 m"),
}


@pytest.mark.parametrize(("vertices", "faces", "words"), REFUSED.values(), ids=REFUSED.keys())
def test_invalid_meshes_raise(vertices, faces, words):
    with pytest.raises(MeshError, match=words):
        convex_mesh(vertices, faces)


def test_a_shallow_dent_is_accepted():
    """A dent of 0.05 mm in a box of 0.3 m keeps the corners, and the volume to 0.1 %."""
    mesh = trimesh.creation.box(SIZE).subdivide()
    vertices = np.array(mesh.vertices)
    middle = np.abs(vertices - [0, 0, 0.05]).sum(1).argmin()
    vertices[middle, 2] -= 5e-5
    dented, _ = convex_mesh(vertices, np.array(mesh.faces))
    assert isinstance(dented, ConvexMesh)
    assert dented.volume == pytest.approx(Box(SIZE).volume, rel=1e-3)
    np.testing.assert_allclose(np.sort(np.abs(dented.corners), 0)[0], [0.15, 0.1, 0.05], atol=1e-4)


def test_triangles_that_are_lines_are_left_out():
    faces = np.concatenate([TETRAHEDRON_FACES, [[0, 1, 1], [2, 3, 2]]])
    assert convex_mesh(TETRAHEDRON, faces)[0] == tetrahedron()


def test_reach_is_the_farthest_vertex():
    """The tetrahedron reaches (3a/4, b/4, c/4), beyond a corner of the centred bounding box."""
    mesh = tetrahedron()
    assert mesh.reach == pytest.approx(np.linalg.norm([0.225, 0.05, 0.025]), rel=1e-12)
    assert mesh.reach > 1.2 * np.linalg.norm(mesh.half_extents)
    assert MESHES["box"].reach == pytest.approx(Box(SIZE).reach, rel=1e-12)


def test_triangles_without_area_are_accepted():
    """A vertex on an edge of a box needs a triangle without area to close the surface."""
    box = trimesh.creation.box(SIZE)
    vertices = [*box.vertices.tolist()]
    faces = box.faces.tolist()
    first, second, third = faces.pop(0)
    middle = len(vertices)
    vertices.append(((box.vertices[first] + box.vertices[second]) / 2).tolist())
    faces += [[first, middle, third], [middle, second, third], [first, second, middle]]
    mesh, _ = convex_mesh(np.array(vertices), np.array(faces))
    assert len(mesh.corners) == 8 and len(mesh.surface(2).areas) == 24
    points = np.random.default_rng(0).uniform(-0.3, 0.3, (200, 3))
    np.testing.assert_allclose(mesh.distance(points), Box(SIZE).distance(points), atol=1e-12)
