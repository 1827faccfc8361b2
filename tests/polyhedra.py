"""Meshes of bodies with a known closed form."""

import numpy as np
import trimesh

from evo_cpg.creature.mesh import ConvexMesh, convex_mesh

# One corner is at the origin, and the others are on the axes.
LEGS = (0.3, 0.2, 0.1)
TETRAHEDRON = np.array([[0, 0, 0], [0.3, 0, 0], [0, 0.2, 0], [0, 0, 0.1]])
TETRAHEDRON_FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


def shape(mesh: trimesh.Trimesh) -> ConvexMesh:
    return convex_mesh(mesh.vertices, mesh.faces)[0]


def box_mesh(size: tuple[float, float, float]) -> ConvexMesh:
    return shape(trimesh.creation.box(size))


def ball_mesh(radius: float, subdivisions: int) -> ConvexMesh:
    return shape(trimesh.creation.icosphere(subdivisions, radius=radius))


def tetrahedron() -> ConvexMesh:
    return convex_mesh(TETRAHEDRON, TETRAHEDRON_FACES)[0]


def two_boxes(size: tuple[float, float, float]) -> trimesh.Trimesh:
    """Return two boxes side by side, 1 m apart."""
    box = trimesh.creation.box(size)
    return trimesh.util.concatenate([box, box.copy().apply_translation((1, 0, 0))])


def whisker() -> trimesh.Trimesh:
    """Return a cylinder so slender that all its triangles are thin."""
    return trimesh.creation.cylinder(0.0005, 1.0)


def wedge() -> ConvexMesh:
    """Return a body without any symmetry: the convex hull of nine random points."""
    points = np.random.default_rng(4).normal(size=(9, 3)) * [0.2, 0.12, 0.08]
    return shape(trimesh.PointCloud(points).convex_hull)
