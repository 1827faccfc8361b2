"""How the shapes of bodies are written: lengths in m, in the frame of the body."""

from collections.abc import Callable
from typing import Annotated, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, model_validator
from typing_extensions import override

from evo_cpg.config.schema.copies import MirrorAxis
from evo_cpg.config.schema.frames import reflected
from evo_cpg.config.schema.section import Positive, Section, Vector
from evo_cpg.creature.mesh import ConvexMesh, convex_mesh
from evo_cpg.creature.shapes import Box, Capsule, Ellipsoid, Shape, Sphere

Size = tuple[Positive, Positive, Positive]
# Of a vertex; larger ones do not fit into arrays.
Index = Annotated[int, Field(ge=0, lt=2**31)]


class SolidConfig(Section):
    """A kind of shape."""

    kind: ClassVar[Callable[..., Shape]]
    # The key that says how large it is; None if there is none.
    size_key: ClassVar[str | None] = None

    def build(self) -> Shape:
        """The shape, centred on its own frame."""
        return self.into(self.kind)

    @property
    def centre(self) -> np.ndarray:
        """Centre of mass ``(3,)`` in the body's frame, m; a mesh's alone is not at 0."""
        return np.zeros(3)

    def mirrored(self, axis: MirrorAxis) -> Self:
        """Return the image in the plane of the frame with this normal; most are their own."""
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
        radius: from centre to surface, m.
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
        radius: of the cylinder and its ends, m.
        length: of the cylinder, without its ends, m.
    """

    type: Literal["capsule"]
    radius: Positive
    length: Positive

    kind, size_key = Capsule, "length"


class MeshConfig(SolidConfig):
    """Convex polyhedron, in a frame of its own choice.

    Attributes:
        type: ``mesh``.
        vertices: places of the corners, m; with ``file`` they are read from there.
        faces: triangles of three vertices, counted from 0, counterclockwise seen from outside.
    """

    type: Literal["mesh"]
    vertices: tuple[Vector, ...]
    faces: tuple[tuple[Index, Index, Index], ...]

    @model_validator(mode="after")
    def _check(self) -> "MeshConfig":
        self._made()
        return self

    @property
    @override
    def centre(self) -> np.ndarray:
        return self._made()[1]

    @override
    def mirrored(self, axis: MirrorAxis) -> "MeshConfig":
        vertices = tuple(reflected(vertex, axis) for vertex in self.vertices)
        faces = tuple((a, c, b) for a, b, c in self.faces)
        return self.model_copy(update={"vertices": vertices, "faces": faces})

    @override
    def build(self) -> Shape:
        return self._made()[0]

    def _made(self) -> tuple[ConvexMesh, np.ndarray]:
        faces = np.array(self.faces, int).reshape(-1, 3)
        return convex_mesh(np.array(self.vertices).reshape(-1, 3), faces)


# Larger ones belong to no unit that anything is drawn in.
Scale = Annotated[float, Field(gt=0, lt=1e9, strict=True)]


class MeshFileConfig(Section):
    """Keys that name a file in the place of the vertices and faces of a mesh.

    Attributes:
        type: ``mesh``.
        file: file (.stl, .obj) that vertices and faces are read from.
        scale: by which places in the file are multiplied, all alike or along x, y and z.
    """

    type: Literal["mesh"]
    file: str
    scale: Scale | tuple[Scale, Scale, Scale] = 1.0


ShapeConfig = Annotated[
    BoxConfig | SphereConfig | EllipsoidConfig | CapsuleConfig | MeshConfig,
    Field(discriminator="type"),
]
