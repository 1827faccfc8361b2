"""From a mesh file that a configuration names to the vertices and faces of a body."""

from pathlib import Path
from typing import Any

import numpy as np

from evo_cpg.config.errors import ConfigError, Key, nearest
from evo_cpg.config.files import require_small
from evo_cpg.config.trust import beside
from evo_cpg.creature.mesh import MeshError, convex_mesh

_KINDS = (".obj", ".stl")
_KEYS = ("file", "scale", "type")
# Of no unit that anything is drawn in.
_LARGEST_SCALE = 1e9


def read_mesh(source: Path, where: Key, given: dict[str, Any]) -> dict[str, Any]:
    """A shape with the vertices (m) and faces of a file in the place of its name.

    Args:
        source: the configuration file, beside which the file is looked for.
        where: key of the shape.
        given: what stands there; it should be ``file`` and, if need be, ``scale``.

    Raises:
        ConfigError: no file is named, there is no such file, it does not hold a mesh, the mesh
            cannot be a body, or the scale is none.
    """
    for key in given:
        if key not in _KEYS:
            raise ConfigError(source, (*where, key), f"unknown key; {nearest(key, _KEYS)}")
    if "file" not in given:
        raise ConfigError(source, (*where, "file"), "is missing and has no default")
    scale = _scale(source, (*where, "scale"), given.get("scale", 1.0))
    file, where = given["file"], (*where, "file")
    if not isinstance(file, str):
        raise ConfigError(source, where, f"{file!r}: must be the name of a file")
    path = beside(source, file, where)
    suffix = path.suffix.lower()
    if suffix not in _KINDS:
        raise ConfigError(
            source, where, f"{file}: {path.suffix!r} is not known; allowed: {', '.join(_KINDS)}"
        )
    try:
        require_small(path)
    except FileNotFoundError:
        raise ConfigError(source, where, f"{file}: no such file") from None
    except (OSError, ValueError) as error:
        problem = getattr(error, "strerror", None) or error
        raise ConfigError(source, where, f"{file[:60]}: cannot be read ({problem})") from None
    if path.is_dir():
        raise ConfigError(source, where, f"{file}: is a folder")
    try:
        vertices, faces = _read(path)
    except Exception as error:
        # Whatever the reader raises is about the file.
        problem = " ".join(str(error).split()) or type(error).__name__
        raise ConfigError(source, where, f"{file}: cannot be read as a mesh ({problem})") from None
    with np.errstate(over="ignore"):
        vertices = vertices * scale
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


def _scale(source: Path, where: Key, value: Any) -> np.ndarray:
    """One number, or one for each axis."""
    parts: list[Any] = value if isinstance(value, list) and len(value) == 3 else [value]
    for part in parts:
        number = isinstance(part, int | float) and not isinstance(part, bool)
        if not number or not 0 < part < _LARGEST_SCALE:
            raise ConfigError(
                source,
                where,
                f"{value!r}: must be a number greater than 0 and less than {_LARGEST_SCALE:g}, or "
                "three of them",
            )
    return np.array(parts, float)
