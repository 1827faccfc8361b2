"""From a mesh file that a configuration names to the vertices and faces of a body."""

from pathlib import Path
from typing import Any

import numpy as np

from evo_cpg.config.errors import ConfigError, Key
from evo_cpg.config.schema.shape import MeshFileConfig
from evo_cpg.config.trust import named_file
from evo_cpg.config.wording import check_section
from evo_cpg.creature.mesh import MeshError, convex_mesh


def read_mesh(source: Path, where: Key, given: dict[str, Any]) -> dict[str, Any]:
    """A shape with the vertices (m) and faces of a file in the place of its name.

    Args:
        source: the configuration file, beside which the file is looked for.
        where: key of the shape.
        given: keys and values of the shape.

    Raises:
        ConfigError: a key is wrong, there is no such file, it does not hold a mesh, or the mesh
            cannot be a body.
    """
    checked = check_section(MeshFileConfig, given, source, where)
    file, where = checked.file, (*where, "file")
    path = named_file(source, file, where, (".obj", ".stl"))
    try:
        vertices, faces = _read(path)
    except Exception as error:
        # Whatever the reader raises is about the file.
        problem = " ".join(str(error).split()) or type(error).__name__
        raise ConfigError(source, where, f"{file}: cannot be read as a mesh ({problem})") from None
    with np.errstate(over="ignore"):
        vertices = vertices * np.array(checked.scale)
    try:
        convex_mesh(vertices, faces)
    except MeshError as error:
        raise ConfigError(source, where, f"{file}: {error}") from None
    return {"type": "mesh", "vertices": vertices.tolist(), "faces": faces.tolist()}


def _read(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices, each once, and triangles."""
    import trimesh

    mesh = trimesh.load_mesh(path, process=False, skip_materials=True)
    if not np.isfinite(mesh.vertices).all():
        raise ValueError("a coordinate of a vertex is not a finite number")
    # Merging takes places for whole numbers; those that are too large are refused later.
    with np.errstate(all="ignore"):
        mesh.merge_vertices(merge_tex=True, merge_norm=True)
    if not len(mesh.faces):
        raise ValueError("it has no faces")
    return np.array(mesh.vertices, float).reshape(-1, 3), np.array(mesh.faces, int).reshape(-1, 3)
