"""Preparation of URDF files for MuJoCo: the folders of meshes, and links without mass.

A URDF names meshes as ``package://PACKAGE/FOLDER/FILE``. MuJoCo knows no packages. Each mesh is
looked for in the folders above the file. Drawings beside collision shapes are left out, and joints
that copy the angle of another one (``mimic``) are refused. Bodies that are fixed to each other stay
separate, so that the first one can be released.

Links without mass or inertia get very small ones: other programs take them, and MuJoCo does not.
trimesh converts meshes that MuJoCo cannot read. It reads Collada files (``.dae``) with pycollada.
"""

from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from evo_cpg.exchange.refusals import Refusal, Refusals

# Formats of meshes that MuJoCo reads.
_FORMATS = (".stl", ".obj", ".msh")

# Mass (kg) and moment of inertia (kg m^2) of links without them.
_LEAST_MASS, _LEAST_INERTIA = 1e-6, 1e-9

# Header and size of a triangle of a binary STL file, bytes.
_STL_HEAD, _STL_FACE = 84, 50


class Urdf(NamedTuple):
    """A URDF that MuJoCo compiles.

    Attributes:
        text: contents of the file, with the lines of the original.
        meshes: contents of meshes that MuJoCo cannot read from their files, by name.
    """

    text: str
    meshes: dict[str, bytes]


def read_urdf(path: Path, refusals: Refusals) -> Urdf:
    """Return a URDF that MuJoCo compiles with the right meshes. Refuse unreadable meshes.

    Raises:
        ValueError: the file is not XML.
    """
    parser = ElementTree.XMLParser(target=ElementTree.TreeBuilder(insert_comments=True))
    try:
        robot = ElementTree.parse(path, parser).getroot()
    except (ElementTree.ParseError, LookupError) as error:
        raise ValueError(f"it is not XML: {error}") from None
    meshes: dict[str, bytes] = {}
    for link in robot.iter("link"):
        for drawn in link.findall("visual"):
            if link.find("collision") is not None:
                link.remove(drawn)
            elif not _is_readable(path, drawn, meshes):
                refusals.leave_out("unreadable drawing", f"body {link.get('name', '')!r}")
                link.remove(drawn)
        for solid in link.findall("collision"):
            if not _is_readable(path, solid, meshes):
                _refuse(path, solid, refusals)
                link.remove(solid)
        _give_inertia(link, refusals)
    _refuse_mimics(robot, refusals)
    _set_compiler(robot)
    return Urdf(ElementTree.tostring(robot, encoding="unicode"), meshes)


def _refuse(path: Path, shape: Element, refusals: Refusals) -> None:
    mesh = shape.find("geometry/mesh")
    name = "" if mesh is None else mesh.get("filename", "")
    found = _found(path, name)
    problem = "it is missing" if found is None else "it cannot be read"
    if found is not None and found.suffix.lower() == ".dae" and find_spec("collada") is None:
        problem = "it is a Collada file, and the package pycollada is not installed"
    allowed = "a .stl, .obj or .msh file in a folder beside or above the URDF"
    refusals.add(Refusal(f"mesh {name!r}", f"{problem}. Allowed: {allowed}"))


def _refuse_mimics(robot: Element, refusals: Refusals) -> None:
    """Refuse joints that copy the angle of another one. Some versions of MuJoCo ignore them."""
    for joint in robot.iter("joint"):
        for mimic in joint.findall("mimic"):
            name = f"joint {joint.get('name', '')!r}"
            problem = f"it mimics joint {mimic.get('joint', '')!r}. Allowed: no mimic"
            refusals.add(Refusal(name, problem))
            joint.remove(mimic)


def _give_inertia(link: Element, refusals: Refusals) -> None:
    """Give a link without moments of inertia very small ones."""
    inertial = link.find("inertial")
    inertia = None if inertial is None else inertial.find("inertia")
    if inertial is None or inertia is None:
        return
    try:
        moments = [float(inertia.get(key, 0.0)) for key in ("ixx", "iyy", "izz")]
    except ValueError:
        # MuJoCo reports the fault.
        return
    if any(moment > 0 for moment in moments):
        return
    for key in ("ixx", "iyy", "izz"):
        inertia.set(key, f"{_LEAST_INERTIA:g}")
    refusals.leave_out("missing inertia", f"body {link.get('name', '')!r}")


def _set_compiler(robot: Element) -> None:
    """Set the options of MuJoCo's compiler that its URDF reader would choose differently."""
    extension = robot.find("mujoco")
    extension = SubElement(robot, "mujoco") if extension is None else extension
    compiler = extension.find("compiler")
    compiler = SubElement(extension, "compiler") if compiler is None else compiler
    for key in ("meshdir", "assetdir"):
        compiler.attrib.pop(key, None)
    ours = {"strippath": "false", "fusestatic": "false", "discardvisual": "false"}
    for key, value in ours.items():
        compiler.set(key, value)
    compiler.attrib.setdefault("boundmass", f"{_LEAST_MASS:g}")
    compiler.attrib.setdefault("boundinertia", f"{_LEAST_INERTIA:g}")
    # Rounded inertias of drawing programs break the triangle rule by little.
    compiler.attrib.setdefault("balanceinertia", "true")


def _is_readable(path: Path, shape: Element, meshes: dict[str, bytes]) -> bool:
    """Return whether MuJoCo can read the mesh of a shape, or the shape has none.

    The mesh gets the path of its file, or the name of its contents in ``meshes``.
    """
    mesh = shape.find("geometry/mesh")
    if mesh is None:
        return True
    found = _found(path, mesh.get("filename", ""))
    if found is None:
        return False
    name = str(found.resolve())
    if found.suffix.lower() not in _FORMATS or _is_text(found):
        name = f"mesh{len(meshes) + 1}.stl"
        content = _converted(found)
        if content is None:
            return False
        meshes[name] = content
    mesh.set("filename", name)
    return True


def _is_text(path: Path) -> bool:
    """Return whether a mesh is an STL file in text form."""
    if path.suffix.lower() != ".stl":
        return False
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(_STL_HEAD)
    count = int.from_bytes(head[_STL_HEAD - 4 :], "little")
    return head.startswith(b"solid") and size != _STL_HEAD + _STL_FACE * count


def _converted(path: Path) -> bytes | None:
    """Return a mesh as a binary STL file, or None if it cannot be read."""
    import trimesh
    from trimesh.exchange.stl import export_stl

    try:
        mesh = trimesh.load_mesh(path, process=False, skip_materials=True)
        return export_stl(mesh) if len(mesh.faces) else None
    except Exception:
        # Any error of the reader concerns the file.
        return None


def _found(path: Path, name: str) -> Path | None:
    """Return the file that a URDF names, or None."""
    inner = name.partition("://")[2] if "://" in name else name
    parts = Path(inner).parts
    for folder in (path.resolve().parent, *path.resolve().parent.parents):
        # A package may have another name on disk.
        for skipped in range(min(2, len(parts))):
            candidate = folder.joinpath(*parts[skipped:])
            if candidate.is_file():
                return candidate
    return None
