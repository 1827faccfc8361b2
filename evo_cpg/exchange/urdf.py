"""Preparation of URDF files for MuJoCo: the folders of meshes, and the compiler's settings.

A URDF names meshes as ``package://PACKAGE/FOLDER/FILE``. MuJoCo knows no packages. Each mesh is
looked for in the folders above the file. Meshes for drawing alone are left out, because bodies move
without them. Bodies that are fixed to each other stay separate, so that the first one can be
released.
"""

from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from evo_cpg.exchange.refusals import Refusal, Refusals

# Formats of meshes that MuJoCo reads.
_FORMATS = (".stl", ".obj", ".msh")


def urdf_text(path: Path, refusals: Refusals) -> str:
    """Return the text of a URDF that MuJoCo compiles with the right meshes.

    Lines of elements are those of the file.

    Raises:
        ValueError: the file is not XML.
    """
    parser = ElementTree.XMLParser(target=ElementTree.TreeBuilder(insert_comments=True))
    try:
        robot = ElementTree.parse(path, parser).getroot()
    except (ElementTree.ParseError, LookupError) as error:
        raise ValueError(f"it is not XML: {error}") from None
    for link in robot.iter("link"):
        for drawn in link.findall("visual"):
            if link.find("collision") is not None or not _is_readable(path, drawn):
                link.remove(drawn)
        for solid in link.findall("collision"):
            mesh = solid.find("geometry/mesh")
            if mesh is not None and not _is_readable(path, solid):
                name = mesh.get("filename", "")
                known = _found(path, name) is None
                problem = "it is missing" if known else "MuJoCo cannot read its format"
                allowed = "a .stl, .obj or .msh file in a folder beside or above the URDF"
                refusals.add(Refusal(f"mesh {name!r}", f"{problem}. Allowed: {allowed}"))
                link.remove(solid)
    for mesh in robot.iter("mesh"):
        found = _found(path, mesh.get("filename", ""))
        if found is not None:
            mesh.set("filename", str(found.resolve()))
    _set_compiler(robot)
    return ElementTree.tostring(robot, encoding="unicode")


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
    # Rounded inertias of drawing programs break the triangle rule by little.
    compiler.attrib.setdefault("balanceinertia", "true")


def _is_readable(path: Path, shape: Element) -> bool:
    """Return whether MuJoCo can read the mesh of a shape, or the shape has none."""
    mesh = shape.find("geometry/mesh")
    if mesh is None:
        return True
    found = _found(path, mesh.get("filename", ""))
    return found is not None and found.suffix.lower() in _FORMATS


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
