"""Mesh files that a user gives to the page: checked, and written beside the document."""

import re
from pathlib import Path

from evo_cpg.config.errors import KeyProblem
from evo_cpg.config.files import LARGEST
from evo_cpg.config.named_files import read_mesh
from evo_cpg.drawing.document import DrawingError
from evo_cpg.files import write_whole

_SUFFIXES = (".stl", ".obj")
# Longest name before the suffix, characters.
_LONGEST = 100


def add_mesh_file(document: Path, name: str, content: bytes) -> str:
    """Write a mesh file beside a document, and return its name.

    Args:
        document: file of the document.
        name: name of the file on the user's side, of which only the last part is kept.
        content: content of the file.

    Raises:
        DrawingError: it is no mesh that a body can have, or another file has its name.
    """
    bare = re.sub(r"[^A-Za-z0-9_.-]+", "_", re.split(r"[/\\]", name)[-1]).lstrip("._")
    stem, dot, suffix = bare.rpartition(".")
    bare = f"{stem[:_LONGEST]}{dot}{suffix[:_LONGEST]}"
    place = document.parent / bare
    if place.suffix.lower() not in _SUFFIXES:
        raise DrawingError(f"{name[:80]}: a mesh is a file {' or '.join(_SUFFIXES)}")
    if len(content) > LARGEST:
        raise DrawingError(f"{bare}: more than the limit of {LARGEST // 2**20} MiB")
    if place.exists():
        if place.is_file() and place.read_bytes() == content:
            return bare
        raise DrawingError(f"{place} exists with other content. Rename your file")
    write_whole(place, lambda file: file.write(content))
    try:
        read_mesh(document, {"type": "mesh", "file": bare})
    except KeyProblem as error:
        place.unlink(missing_ok=True)
        raise DrawingError(f"{bare}: {error.problem}") from None
    return bare
