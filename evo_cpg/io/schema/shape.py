"""Sections of the shapes of bodies: lengths in m, in the frame of the body."""

from collections.abc import Callable
from typing import Annotated, ClassVar, Literal, TypeVar

import numpy as np
from pydantic import Field, model_validator
from typing_extensions import override

from evo_cpg.creature.cylinder import Cylinder
from evo_cpg.creature.loft import LoftSection, loft
from evo_cpg.creature.mesh import convex_mesh
from evo_cpg.creature.shapes import Box, Capsule, Ellipsoid, Shape, Sphere
from evo_cpg.io.schema.copies import MirrorAxis, reflected
from evo_cpg.io.schema.section import NotNegative, Positive, Section, Vector

Size = tuple[Positive, Positive, Positive]
# Index of a vertex. Larger numbers do not fit into arrays.
Index = Annotated[int, Field(ge=0, lt=2**31)]


# Convex shapes, the largest one first, with their centres ``(3,)`` in the body's frame, m.
Pieces = tuple[tuple[Shape, np.ndarray], ...]

_Solid = TypeVar("_Solid", bound="SolidConfig")


class SolidConfig(Section):
    """A kind of shape."""

    kind: ClassVar[Callable[..., Shape]]
    # Key of its size; None if there is none.
    size_key: ClassVar[str | None] = None

    def build(self) -> Pieces:
        """Build the shape: one piece at the origin, except for meshes and lofts."""
        return ((self.into(self.kind), np.zeros(3)),)

    def mirrored(self: _Solid, axis: MirrorAxis) -> _Solid:
        """Return the mirror image in the frame's plane with this normal (often the same shape)."""
        del axis
        return self


class BoxConfig(SolidConfig):
    """Cuboid.

    Attributes:
        type: ``box``.
        size: edges along x, y and z, m.
    """

    type: Literal["box"]
    size: Size

    kind, size_key = Box, "size"


class SphereConfig(SolidConfig):
    """Sphere.

    Attributes:
        type: ``sphere``.
        radius: distance from centre to surface, m.
    """

    type: Literal["sphere"]
    radius: Positive

    kind, size_key = Sphere, "radius"


class EllipsoidConfig(SolidConfig):
    """Ellipsoid.

    Attributes:
        type: ``ellipsoid``.
        radii: semi-axes along x, y and z, m.
    """

    type: Literal["ellipsoid"]
    radii: Size

    kind, size_key = Ellipsoid, "radii"


class CapsuleConfig(SolidConfig):
    """Cylinder along x with half-spherical ends.

    Attributes:
        type: ``capsule``.
        radius: radius of the cylinder and its ends, m.
        length: length of the cylinder, without its ends, m.
    """

    type: Literal["capsule"]
    radius: Positive
    length: Positive

    kind, size_key = Capsule, "length"


class CylinderConfig(SolidConfig):
    """Cylinder along x with flat ends.

    Attributes:
        type: ``cylinder``.
        radius: radius, m.
        length: length, m.
    """

    type: Literal["cylinder"]
    radius: Positive
    length: Positive

    kind, size_key = Cylinder, "length"


class _CheckedSolid(SolidConfig):
    """A kind of shape whose faults show when it is built."""

    @model_validator(mode="after")
    def _check(self: _Solid) -> _Solid:
        self.build()
        return self


class MeshConfig(_CheckedSolid):
    """Convex polyhedron, in any frame.

    Attributes:
        type: ``mesh``.
        vertices: positions of the corners, m; ``file`` can replace vertices and faces.
        faces: triangles of three vertices, counted from 0, counterclockwise seen from outside.
    """

    type: Literal["mesh"]
    vertices: tuple[Vector, ...]
    faces: tuple[tuple[Index, Index, Index], ...]

    @override
    def mirrored(self, axis: MirrorAxis) -> "MeshConfig":
        vertices = tuple(reflected(vertex, axis) for vertex in self.vertices)
        faces = tuple((a, c, b) for a, b, c in self.faces)
        return self.model_copy(update={"vertices": vertices, "faces": faces})

    @override
    def build(self) -> Pieces:
        faces = np.array(self.faces, int).reshape(-1, 3)
        return (convex_mesh(np.array(self.vertices).reshape(-1, 3), faces),)


class LoftSectionConfig(Section):
    """A cross-section of a loft.

    Attributes:
        at: centre of the section, a point of the spine, m.
        width: size across the spine, m; horizontal in the first section. 0 at an end is an edge.
        height: size across the spine and the width, m. A width and height of 0 at an end is a tip.
    """

    at: Vector
    width: NotNegative
    height: NotNegative


class LoftConfig(_CheckedSolid):
    """Body through cross-sections along a spine, in any frame.

    Attributes:
        type: ``loft``.
        sections: cross-sections in order, from one end to the other.
        corners: even number of corners of every section, 4 for beams; left out for ellipses.
    """

    type: Literal["loft"]
    sections: Annotated[tuple[LoftSectionConfig, ...], Field(min_length=2, max_length=40)]
    corners: Annotated[int, Field(ge=4, le=24, multiple_of=2)] | None = None

    @override
    def mirrored(self, axis: MirrorAxis) -> "LoftConfig":
        sections = tuple(
            each.model_copy(update={"at": reflected(each.at, axis)}) for each in self.sections
        )
        return self.model_copy(update={"sections": sections})

    @override
    def build(self) -> Pieces:
        return loft(self.drawn, self.corners)

    @property
    def drawn(self) -> tuple[LoftSection, ...]:
        """The sections as `loft` takes them."""
        return tuple(LoftSection(each.at, each.width, each.height) for each in self.sections)


# No unit of drawings requires a larger scale.
Scale = Annotated[float, Field(gt=0, lt=1e9, strict=True)]


class MeshFileConfig(Section):
    """Keys for a file that contains the vertices and faces of a mesh.

    Attributes:
        type: ``mesh``.
        file: file (.glb, .obj, .off, .ply, .stl) with vertices and faces.
        scale: factor for positions in the file, for all or along x, y and z.
        hull: whether to use the convex hull of the vertices, with at most 2000 triangles.
    """

    type: Literal["mesh"]
    file: str
    scale: Scale | tuple[Scale, Scale, Scale] = 1.0
    hull: bool = False


ShapeConfig = Annotated[
    BoxConfig
    | SphereConfig
    | EllipsoidConfig
    | CapsuleConfig
    | CylinderConfig
    | LoftConfig
    | MeshConfig,
    Field(discriminator="type"),
]
