"""Preparation of URDF files for MuJoCo: XML, folders of meshes, limits of joints.

A URDF names meshes as ``package://PACKAGE/FOLDER/FILE``. MuJoCo knows no packages. Each mesh is
looked for in the folders above the file. Drawings beside collision shapes are left out, and joints
that copy the angle of another one (``mimic``) are refused. Bodies that are fixed to each other stay
separate, so that the first one can be released.

A limit that is not given is 0, as URDF defines. MuJoCo would drop both limits of such a joint, and
those of a joint whose limits are equal. trimesh converts meshes that MuJoCo cannot read. It reads
Collada files (``.dae``) with pycollada.
"""

import codecs
import contextlib
import re
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement, TreeBuilder
from xml.parsers import expat

from evo_cpg.io.models.refusals import Refusal, Refusals
from evo_cpg.io.schema.section import LARGEST

# Formats of meshes that MuJoCo reads.
_FORMATS = (".stl", ".obj", ".msh")

# Parts of an XML file that MuJoCo skips, some of which a strict reader refuses: text before the
# first element, declarations, comments (also with ``--`` inside) and control characters.
_SKIPPED = re.compile(r"\A[^<]*|<\?.*?\?>|<!--.*?-->|[\0-\x08\x0b\x0c\x0e-\x1f]", re.DOTALL)

# An ampersand that begins none of the entities that every reader knows.
_STRAY_AMPERSAND = re.compile("&(?!(?:amp|lt|gt|quot|apos|#[0-9]+|#x[0-9a-fA-F]+);)")

# Options of MuJoCo's compiler that would replace masses of the file.
_MASS_OPTIONS = (
    *("boundmass", "boundinertia", "balanceinertia"),
    *("inertiafromgeom", "inertiagrouprange", "settotalmass"),
)

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


def read_xml(content: bytes) -> str:
    """Return the text of an XML file without the parts that MuJoCo skips. Lines stay in place.

    Bytes that are not text, in UTF-8 or in the encoding that the file declares, become surrogates.
    """
    wide = content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    declared = re.match(rb"\s*<\?xml[^>]*?encoding\s*=\s*[\"']([\w.-]+)", content)
    text = content.decode("utf-8-sig", "surrogateescape")
    for encoding in (
        "utf-16" if wide else "utf-8-sig",
        *([declared[1].decode()] if declared else []),
    ):
        with contextlib.suppress(LookupError, UnicodeDecodeError):
            text = content.decode(encoding)
            break
    return _SKIPPED.sub(lambda part: "\n" * part[0].count("\n"), text)


def is_urdf(text: str) -> bool:
    """Return whether the first element of an XML text is that of a URDF. MuJoCo ignores case."""
    first = re.search(r"<([^\W\d][^\s/>]*)", text)
    return first is not None and first[1].lower() == "robot"


def read_urdf(text: str, path: Path, refusals: Refusals) -> Urdf:
    """Return a URDF that MuJoCo compiles with the right meshes and limits.

    Args:
        text: result of `read_xml`.
        path: the file, in whose folders meshes are looked for.
        refusals: faults and changes, which grow.

    Raises:
        UnicodeDecodeError: not all bytes of the file are text.
        ValueError: the text is not XML.
    """
    text = text.encode(errors="surrogateescape").decode()
    try:
        robot = _parsed(_STRAY_AMPERSAND.sub("&amp;", text))
    except expat.ExpatError as error:
        raise ValueError(f"it is not XML: {error}") from None
    _refuse_macros(robot, refusals)
    meshes: dict[str, bytes] = {}
    for link in robot.findall("link"):
        if link.get("name") == "world" and link.find("inertial") is not None:
            # MuJoCo takes this link for the fixed world, so its mass has no effect.
            refusals.leave_out("mass", "body 'world'")
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
    for joint in robot.findall("joint"):
        _prepare_joint(joint, refusals)
    _set_compiler(robot, refusals)
    return Urdf(ElementTree.tostring(robot, encoding="unicode"), meshes)


def _parsed(text: str) -> Element:
    """Return the first element of an XML text. Prefixes are part of names, bound or not."""
    builder, parser = TreeBuilder(), expat.ParserCreate()
    parser.StartElementHandler, parser.EndElementHandler = builder.start, builder.end
    parser.CharacterDataHandler = builder.data
    try:
        parser.Parse(text, True)
    except expat.ExpatError as error:
        # MuJoCo reads the first element only.
        if error.code != expat.errors.codes[expat.errors.XML_ERROR_JUNK_AFTER_DOC_ELEMENT]:
            raise
    return builder.close()


def _refuse_macros(robot: Element, refusals: Refusals) -> None:
    """Refuse macros of xacro, from which the program xacro makes the elements of a URDF.

    Raises:
        ExchangeError: there are macros, so MuJoCo could not load the file.
    """
    expand = "Allowed: the URDF that `xacro FILE` prints"
    for tag in sorted({each.tag for each in robot.iter() if each.tag.startswith("xacro:")}):
        refusals.add(Refusal(f"element <{tag}>", f"it is a macro of xacro. {expand}", vital=True))
    for element in (*robot.findall("link"), *robot.findall("joint")):
        values = [value for part in element.iter() for value in part.attrib.values()]
        if macro := next((value for value in values if re.search(r"\$[({]", value)), None):
            name = f"{element.tag} {element.get('name', '')!r}"
            problem = f"{macro!r} is an expression of xacro. {expand}"
            refusals.add(Refusal(name, problem, vital=True))
    refusals.check()


def _refuse(path: Path, shape: Element, refusals: Refusals) -> None:
    mesh = shape.find("geometry/mesh")
    name = "" if mesh is None else mesh.get("filename", "")
    found = _found(path, name)
    problem = "it is missing" if found is None else "it cannot be read"
    if found is not None and found.suffix.lower() == ".dae" and find_spec("collada") is None:
        problem = "it is a Collada file, and the package pycollada is not installed"
    allowed = "a .stl, .obj or .msh file in a folder beside or above the URDF"
    refusals.add(Refusal(f"mesh {name!r}", f"{problem}. Allowed: {allowed}"))


def _prepare_joint(joint: Element, refusals: Refusals) -> None:
    """Refuse a joint that copies another one, and report which of its limits are lost."""
    name, kind = f"joint {joint.get('name', '')!r}", joint.get("type")
    for mimic in joint.findall("mimic"):
        # Refuse it here, because some versions of MuJoCo ignore it.
        problem = f"it mimics joint {mimic.get('joint', '')!r}. Allowed: no mimic"
        refusals.add(Refusal(name, problem))
        joint.remove(mimic)
    limit = joint.find("limit")
    if limit is None or kind == "fixed":
        return
    keys = ("lower", "upper", "effort", "velocity")
    try:
        lower, upper, effort, velocity = (float(limit.get(key, 0.0)) for key in keys)
    except ValueError:
        # MuJoCo reports the fault.
        return
    if kind in ("planar", "floating"):
        joint.remove(limit)
        refusals.change(name, f"limits and effort of a {kind} joint -> none")
        return
    if kind == "continuous" and (lower or upper):
        refusals.leave_out("unused limits", name)
    if kind in ("revolute", "prismatic") and not _limit(joint, limit, (lower, upper), refusals):
        return
    if velocity:
        refusals.leave_out("velocity limit", name)
    if joint.find("safety_controller") is not None:
        refusals.leave_out("safety controller", name)
    if not 0 < effort < LARGEST:
        new = f"{-effort:g}" if -LARGEST < effort < 0 else "no motor"
        refusals.change(name, f"effort {limit.get('effort', 'none')} -> {new}")


def _limit(joint: Element, limit: Element, values: tuple[float, float], refusals: Refusals) -> bool:
    """Write both limits of a joint, and return whether it still moves."""
    lower, upper = values
    name = f"joint {joint.get('name', '')!r}"
    if lower == upper == 0:
        given = "" if limit.attrib.keys() & {"lower", "upper"} else "none, so "
        effort = limit.get("effort", "none")
        refusals.change(name, f"limits {given}0 to 0 -> fixed; effort {effort} -> no motor")
        joint.set("type", "fixed")
        return False
    if lower < upper:
        limit.attrib |= {"lower": repr(lower), "upper": repr(upper)}
    else:
        problem = f"its limits are {lower:g} to {upper:g}. Allowed: lower below upper, or 0 to 0"
        refusals.add(Refusal(name, problem))
        for key in limit.attrib.keys() & {"lower", "upper"}:
            del limit.attrib[key]
    return True


def _set_compiler(robot: Element, refusals: Refusals) -> None:
    """Set the options of MuJoCo's compiler that its URDF reader would choose differently."""
    extension = robot.find("mujoco")
    extension = SubElement(robot, "mujoco") if extension is None else extension
    compiler = extension.find("compiler")
    compiler = SubElement(extension, "compiler") if compiler is None else compiler
    for key in ("meshdir", "assetdir"):
        compiler.attrib.pop(key, None)
    for key in _MASS_OPTIONS:
        if compiler.attrib.pop(key, None):
            refusals.leave_out(f"compiler {key}")
    ours = {"strippath": "false", "fusestatic": "false", "discardvisual": "false"}
    for key, value in ours.items():
        compiler.set(key, value)


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
