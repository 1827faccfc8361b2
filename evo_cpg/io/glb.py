"""Meshes of binary glTF files (.glb), in this program's axes.

glTF has y up and z ahead. Here z is up and x is ahead. All nodes of the file become one mesh.

A small file may promise billions of numbers or instances. The sizes are therefore read from the
header before trimesh reads the file. A file that names other files is refused.
"""

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np

# Largest numbers of nodes, of triangles of all nodes, and of entries of all arrays.
_MOST_NODES, _MOST_TRIANGLES, _MOST_ENTRIES = 1000, 1_000_000, 4_000_000
# Axes of glTF (x left, y up, z ahead) in ours (x ahead, y left, z up).
_TO_OURS = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
# Modes of primitives that are triangles: lists, strips and fans.
_TRIANGLES = (4, 5, 6)


def read_glb(path: Path) -> Any:
    """Return the mesh of a file as a `trimesh.Trimesh`.

    Raises:
        ValueError: the file is no binary glTF, refers to other files, or is too large.
    """
    import trimesh

    _require_sensible(path)
    with path.open("rb") as file:
        # Without a resolver nothing outside of the file is read.
        scene = trimesh.load_scene(file, file_type="glb", process=False, skip_materials=True)
    mesh = scene.to_mesh()
    mesh.vertices = np.asarray(mesh.vertices) @ _TO_OURS.T
    return mesh


def _require_sensible(path: Path) -> None:
    """Check the header's counts.

    Raises:
        ValueError: a count is too large, or the header is none.
    """
    with path.open("rb") as file:
        head = file.read(20)
        if len(head) < 20 or head[:4] != b"glTF":
            raise ValueError("it is no binary glTF")
        _, version, _, length, kind = struct.unpack("<4sIIII", head)
        if version != 2 or kind != 0x4E4F534A:
            raise ValueError("it is no glTF of version 2")
        try:
            header = json.loads(file.read(length))
        except RecursionError:
            raise ValueError("its header is nested too deeply") from None
    nodes, arrays = header.get("nodes", []), header.get("accessors", [])
    if any("uri" in each for each in header.get("buffers", [])):
        raise ValueError("it refers to other files or texts. Export one binary file")
    if header.get("extensionsRequired"):
        names = ", ".join(map(str, header["extensionsRequired"]))[:80]
        raise ValueError(f"it needs the extensions {names}. Export it without compression")
    if len(nodes) > _MOST_NODES:
        raise ValueError(f"it has {len(nodes)} nodes. Allowed: at most {_MOST_NODES}")
    entries = sum(int(each["count"]) for each in arrays)
    if entries > _MOST_ENTRIES:
        raise ValueError(f"its arrays have {entries} entries. Allowed: at most {_MOST_ENTRIES}")

    def triangles(mesh: dict[str, Any]) -> int:
        lists = [each for each in mesh["primitives"] if each.get("mode", 4) in _TRIANGLES]
        corners = [each.get("indices", each["attributes"]["POSITION"]) for each in lists]
        return sum(int(arrays[i]["count"]) for i in corners) // 3

    own = [triangles(mesh) for mesh in header.get("meshes", [])]
    count = sum(own[node["mesh"]] for node in nodes if "mesh" in node)
    if count > _MOST_TRIANGLES:
        raise ValueError(f"its nodes have {count} triangles. Allowed: at most {_MOST_TRIANGLES}")
