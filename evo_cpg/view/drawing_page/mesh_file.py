"""Mesh files that a user gives to the page: checked, and written beside the document."""

import re
import unicodedata
from pathlib import Path

from evo_cpg.files import write_whole
from evo_cpg.io.errors import KeyProblem
from evo_cpg.io.named_files import MESH_SUFFIXES, read_mesh
from evo_cpg.io.trust import LARGEST
from evo_cpg.view.drawing_page.document import DrawingError

# Longest name before the suffix, bytes.
_LONGEST = 100


def add_mesh_file(document: Path, name: str, content: bytes) -> dict[str, str]:
    """Write a mesh file beside a document.

    Args:
        document: file of the document.
        name: name of the file on the user's side, of which only the last part is kept.
        content: content of the file.

    Returns:
        The name of the ``file``, and ``problem`` if only its convex hull can be a body.

    Raises:
        DrawingError: it is no mesh that a body can have, or another file has its name.
    """
    # Some systems write an accent apart from its letter, so one name would have two forms.
    given_name = unicodedata.normalize("NFC", re.split(r"[/\\]", name)[-1])
    stem, dot, suffix = given_name.rpartition(".")
    if f"{dot}{suffix}".lower() not in MESH_SUFFIXES:
        raise DrawingError(f"{name[:80]}: a mesh is a file {', '.join(MESH_SUFFIXES)}")
    stem = re.sub(r"[^\w.-]+", "_", stem).lstrip("._").encode()[:_LONGEST].decode(errors="ignore")
    bare = f"{stem or 'mesh'}.{suffix}"
    place = document.parent / bare
    if len(content) > LARGEST:
        raise DrawingError(f"{bare}: more than the limit of {LARGEST // 2**20} MiB")
    is_new = not place.exists()
    if is_new:
        write_whole(place, lambda file: file.write(content))
    elif not place.is_file() or place.read_bytes() != content:
        raise DrawingError(f"{place} exists with other content. Rename your file")
    given = {"type": "mesh", "file": bare}
    try:
        read_mesh(document, given)
    except KeyProblem as error:
        try:
            read_mesh(document, given | {"hull": True})
        except KeyProblem:
            if is_new:
                place.unlink(missing_ok=True)
            raise DrawingError(f"{bare}: {error.problem}") from None
        return {"file": bare, "problem": error.problem}
    return {"file": bare}
