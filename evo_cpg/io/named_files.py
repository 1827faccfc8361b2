"""Files that replace numbers in a configuration: meshes of bodies, heights of ground."""

import io
import json
import re
import struct
from pathlib import Path
from typing import Any

import numpy as np

from evo_cpg.creature.mesh import MeshError, convex_mesh, few_corners_hull
from evo_cpg.io.errors import KeyProblem, under
from evo_cpg.io.schema.ground import MOST_HEIGHTS, ReliefFileConfig
from evo_cpg.io.schema.shape import MeshFileConfig
from evo_cpg.io.trust import named_file
from evo_cpg.io.wording import checked
from evo_cpg.system import lend_matplotlib_a_folder

MESH_SUFFIXES = (".glb", ".obj", ".off", ".ply", ".stl")
# Values that mark missing heights in maps, m.
_MISSING = (-9999.0, -32767.0, -32768.0, float(np.finfo(np.float32).min))
# A number with a comma next to another delimiter, so that the comma must be a decimal comma.
_DECIMAL_COMMA = re.compile(r'\d,\d+[";\t]|[";\t] *-?\d+,\d|\d,\d+ +-?\d')
_ARRAYS, _TABLES, _IMAGES = (".npy",), (".csv", ".txt"), (".png", ".jpg", ".jpeg", ".tif", ".tiff")

# Largest numbers of nodes, of triangles of all nodes, and of entries of all arrays.
_MOST_NODES, _MOST_TRIANGLES, _MOST_ENTRIES = 1000, 1_000_000, 4_000_000
# Axes of glTF (x left, y up, z ahead) in ours (x ahead, y left, z up).
_TO_OURS = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
# Modes of primitives that are triangles: lists, strips and fans.
_TRIANGLES = (4, 5, 6)


def read_mesh(source: Path, given: dict[str, Any]) -> dict[str, Any]:
    """Return a shape with the vertices (m) and faces of its file.

    Args:
        source: configuration file, whose folder the file's path is relative to.
        given: keys and values of the shape.

    Raises:
        KeyProblem: a key is wrong, the file does not exist or contains no mesh, or the mesh
            cannot be a body.
    """
    shape = checked(MeshFileConfig, given)
    with under("file"):
        path = named_file(source, shape.file, MESH_SUFFIXES)
        try:
            import trimesh

            if path.suffix.lower() == ".glb":
                mesh = _read_glb(path)
            else:
                mesh = trimesh.load_mesh(path, process=False, skip_materials=True)
            if not np.isfinite(mesh.vertices).all():
                raise ValueError("a coordinate of a vertex is not a finite number")
            # Merging rounds positions to integers. Positions that overflow are refused later.
            with np.errstate(all="ignore"):
                mesh.merge_vertices(merge_tex=True, merge_norm=True)
            if not len(mesh.faces):
                raise ValueError("it has no faces")
            vertices = np.array(mesh.vertices, float).reshape(-1, 3)
            faces = np.array(mesh.faces, int).reshape(-1, 3)
        except Exception as error:
            # Any error of the reader concerns the file.
            problem = " ".join(str(error).split()) or type(error).__name__
            problem = f"{shape.file}: cannot be read as a mesh ({problem})"
            raise KeyProblem((), problem) from None
        with np.errstate(over="ignore"):
            vertices = vertices * np.array(shape.scale)
        try:
            if shape.hull:
                vertices, faces = few_corners_hull(vertices)
            convex_mesh(vertices, faces)
        except MeshError as error:
            raise KeyProblem((), f"{shape.file}: {error}") from None
    return {"type": "mesh", "vertices": vertices.tolist(), "faces": faces.tolist()}


def _read_glb(path: Path) -> Any:
    """Return the mesh of a file as a `trimesh.Trimesh`. Check the header's counts first.

    Raises:
        ValueError: the file is no binary glTF, refers to other files, or is too large.
    """
    import trimesh

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
    own = []
    for mesh in header.get("meshes", []):
        lists = [each for each in mesh["primitives"] if each.get("mode", 4) in _TRIANGLES]
        corners = [each.get("indices", each["attributes"]["POSITION"]) for each in lists]
        own.append(sum(int(arrays[i]["count"]) for i in corners) // 3)
    count = sum(own[node["mesh"]] for node in nodes if "mesh" in node)
    if count > _MOST_TRIANGLES:
        raise ValueError(f"its nodes have {count} triangles. Allowed: at most {_MOST_TRIANGLES}")
    with path.open("rb") as file:
        # Without a resolver nothing outside of the file is read.
        scene = trimesh.load_scene(file, file_type="glb", process=False, skip_materials=True)
    mesh = scene.to_mesh()
    mesh.vertices = np.asarray(mesh.vertices) @ _TO_OURS.T
    return mesh


def read_heights(source: Path, given: dict[str, Any]) -> list[list[float]]:
    """Return heights from an array (.npy), a table (.csv, .txt) or an image, m.

    Args:
        source: configuration file, whose folder the file's path is relative to.
        given: keys of `ReliefFileConfig`. The first axis of an array, and a line of a table, is x.
            An image is seen from above, with its right edge straight ahead.

    Raises:
        KeyProblem: a key is wrong, or the file does not exist or contains no grid of numbers.
    """
    relief = checked(ReliefFileConfig, given)
    with under("file"):
        path = named_file(source, relief.file, (*_ARRAYS, *_TABLES, *_IMAGES))
        suffix = path.suffix.lower()
        try:
            if suffix in _ARRAYS:
                # Memory mapping detects a header that promises more than the file contains.
                heights, scaled = np.load(path, mmap_mode="r", allow_pickle=False), False
                if heights.dtype.kind not in "iuf":
                    raise ValueError(f"its values are {heights.dtype}, and not real numbers")
            elif suffix in _TABLES:
                # Skip the byte order mark with which spreadsheets begin a file.
                text = re.sub("#.*", "", path.read_text(encoding="utf-8-sig"))
                if _DECIMAL_COMMA.search(text):
                    raise ValueError("it has decimal commas. Write decimal points")
                # Delimiters are commas, semicolons or spaces.
                delimiter = ";" if ";" in text else "," if "," in text else None
                heights = np.loadtxt(io.StringIO(text), delimiter=delimiter, quotechar='"')
                scaled = False
            else:
                heights, scaled = _image(path, relief.lowest, relief.highest)
            if heights.ndim == 2 and max(heights.shape) <= MOST_HEIGHTS:
                heights = np.asarray(heights, float)
        except Exception as error:
            # Any error of the readers concerns the file.
            raise KeyProblem((), f"{relief.file}: cannot be read ({error})") from None
        problem = None
        if heights.ndim != 2 or not np.isfinite(heights[:MOST_HEIGHTS, :MOST_HEIGHTS]).all():
            problem = f"must contain a 2D grid of finite numbers, got shape {heights.shape}"
        elif not all(2 <= count <= MOST_HEIGHTS for count in heights.shape):
            size = " x ".join(map(str, heights.shape))
            problem = f"{size} heights. Allowed: 2 to {MOST_HEIGHTS} along each axis"
        elif np.isin(heights, _MISSING).any():
            missing = heights[np.isin(heights, _MISSING)][0]
            problem = f"{missing:g} marks missing heights in maps. Fill them in"
        elif not scaled and {"lowest", "highest"} & given.keys():
            problem = "its heights are in metres already. Leave out lowest and highest"
        if problem is not None:
            raise KeyProblem((), f"{relief.file}: {problem}")
    return heights.tolist()


def _image(path: Path, lowest: float, highest: float) -> tuple[np.ndarray, bool]:
    """Return the heights of an image, and whether they were scaled."""
    lend_matplotlib_a_folder()
    from matplotlib.image import imread
    from PIL import Image

    with Image.open(path) as image:
        if max(image.size) > MOST_HEIGHTS:
            raise ValueError(f"{image.width} x {image.height} pixels, more than {MOST_HEIGHTS}")
        if image.mode in ("F", "I") and image.format != "PNG":
            # Pixels of 32 bits are heights and not shades of grey. Matplotlib would clip them at
            # 255.
            return np.asarray(image, float)[::-1].T, False
        if not image.mode.startswith("I"):
            colours = np.asarray(image.convert("RGBA"))
            if (colours[..., 3] < 255).any():
                raise ValueError("it has transparent pixels, whose height is unknown. Fill them in")
            if np.ptp(colours[..., :3], axis=-1).any():
                raise ValueError("it is coloured, but only shades of grey mean a height")
    pixels = np.asarray(imread(path))
    full = np.iinfo(pixels.dtype).max if pixels.dtype.kind in "iu" else 1
    grey = pixels if pixels.ndim == 2 else pixels[..., :3].mean(-1)
    # Rows run downwards in the image, which is towards -y on the ground. The second axis of the
    # heights runs towards +y.
    return lowest + (highest - lowest) / full * grey[::-1].T, True
