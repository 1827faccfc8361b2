"""Preparation of URDF files for MuJoCo: XML, folders of meshes, limits of joints.

A URDF names meshes as ``package://PACKAGE/FOLDER/FILE``. MuJoCo knows no packages. Each mesh is
looked for in the folders above the file. Drawings beside collision shapes are left out, and joints
that copy the angle of another one (``mimic``) are refused. Bodies that are fixed to each other stay
separate, so that the first one can be released.

A limit that is not given is 0, as URDF defines. MuJoCo would drop both limits of such a joint, and
those of a joint whose limits are equal. trimesh converts meshes that MuJoCo cannot read. It reads
Collada files (``.dae``) with pycollada.

Masses and inertias of a URDF, some of which MuJoCo's compiler would replace.

The compiler weighs links by their shapes, raises small numbers, and replaces moments that break the
triangle rule by their mean. It therefore gets placeholders, and the compiled model gets the file's
values. A body is a link and the links that are fixed to it. Its values change if no body can have
them:

| in the file | becomes |
|---|---|
| a link without ``inertial`` | 0 kg |
| a body of 0 kg | 1e-6 kg |
| a principal moment of 0 | 1e-9 kg m^2, but at most that of a thin rod |
| a moment that exceeds the sum of the others | the nearest moments that do not |

Each change is recorded with the old and the new value.
"""

import codecs
import contextlib
import re
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement, TreeBuilder
from xml.parsers import expat

import numpy as np
from jaxtyping import Float

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

# Mass (kg) and moment of inertia (kg m^2) of bodies without them.
_LEAST_MASS, _LEAST_MOMENT = 1e-6, 1e-9

# Smallest moment in place of 0, relative to the largest one. The radius of a rod with such moments
# is 1.3 % of its length.
_THIN = 1e-3

# Largest moment that counts as 0, relative to the largest one, because eigenvalues are rounded.
_ROUNDING = 1e-12

# Largest excess of a moment over the sum of the others, as a fraction of the sum, that is kept,
# because numbers in files are rounded. A configuration allows as much.
_EXCESS = 1e-6

# Placeholders of the centre of mass and the inertia. They have no symmetry, so that MuJoCo's
# compiler cannot simplify them, because both change after compiling.
_PLACE, _INERTIA = (0.1, 0.2, 0.3), (2.0, 2.5, 3.0, 0.1, 0.2, 0.3)


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
    # With these handlers, prefixes are part of names, bound or not.
    builder, parser = TreeBuilder(), expat.ParserCreate()
    parser.StartElementHandler, parser.EndElementHandler = builder.start, builder.end
    parser.CharacterDataHandler = builder.data
    try:
        parser.Parse(_STRAY_AMPERSAND.sub("&amp;", text), True)
    except expat.ExpatError as error:
        # MuJoCo reads the first element only.
        if error.code != expat.errors.codes[expat.errors.XML_ERROR_JUNK_AFTER_DOC_ELEMENT]:
            raise ValueError(f"it is not XML: {error}") from None
    robot = builder.close()
    _refuse_macros(robot, refusals)
    meshes: dict[str, bytes] = {}
    has_collada = find_spec("collada") is not None
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
                mesh = solid.find("geometry/mesh")
                name = "" if mesh is None else mesh.get("filename", "")
                found = _found(path, name)
                problem = "it is missing" if found is None else "it cannot be read"
                if found is not None and found.suffix.lower() == ".dae" and not has_collada:
                    problem = "it is a Collada file, and the package pycollada is not installed"
                allowed = "a .stl, .obj or .msh file in a folder beside or above the URDF"
                refusals.add(Refusal(f"mesh {name!r}", f"{problem}. Allowed: {allowed}"))
                link.remove(solid)
    for joint in robot.findall("joint"):
        _prepare_joint(joint, refusals)
    # MuJoCo's URDF reader would choose these options of the compiler differently.
    extension = robot.find("mujoco")
    extension = SubElement(robot, "mujoco") if extension is None else extension
    compiler = extension.find("compiler")
    compiler = SubElement(extension, "compiler") if compiler is None else compiler
    for key in ("meshdir", "assetdir"):
        compiler.attrib.pop(key, None)
    for key in _MASS_OPTIONS:
        if compiler.attrib.pop(key, None):
            refusals.leave_out(f"compiler {key}")
    compiler.attrib |= {"strippath": "false", "fusestatic": "false", "discardvisual": "false"}
    return Urdf(ElementTree.tostring(robot, encoding="unicode"), meshes)


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


def _prepare_joint(joint: Element, refusals: Refusals) -> None:
    """Refuse a joint that copies another one, write its limits, and report which ones are lost."""
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
    if kind in ("revolute", "prismatic"):
        given = limit.attrib.keys() & {"lower", "upper"}
        if lower == upper == 0:
            old, force = "" if given else "none, so ", limit.get("effort", "none")
            refusals.change(name, f"limits {old}0 to 0 -> fixed; effort {force} -> no motor")
            joint.set("type", "fixed")
            return
        if lower < upper:
            limit.attrib |= {"lower": repr(lower), "upper": repr(upper)}
        else:
            problem = f"its limits are {lower:g} to {upper:g}"
            refusals.add(Refusal(name, f"{problem}. Allowed: lower below upper, or 0 to 0"))
            for key in given:
                del limit.attrib[key]
    if velocity:
        refusals.leave_out("velocity limit", name)
    if joint.find("safety_controller") is not None:
        refusals.leave_out("safety controller", name)
    if not 0 < effort < LARGEST:
        new = f"{-effort:g}" if -LARGEST < effort < 0 else "no motor"
        refusals.change(name, f"effort {limit.get('effort', 'none')} -> {new}")


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
    is_text = False
    if found.suffix.lower() == ".stl":
        with found.open("rb") as file:
            head = file.read(_STL_HEAD)
        size = _STL_HEAD + _STL_FACE * int.from_bytes(head[_STL_HEAD - 4 :], "little")
        is_text = head.startswith(b"solid") and found.stat().st_size != size
    if found.suffix.lower() not in _FORMATS or is_text:
        import trimesh
        from trimesh.exchange.stl import export_stl

        name = f"mesh{len(meshes) + 1}.stl"
        try:
            converted = trimesh.load_mesh(found, process=False, skip_materials=True)
            content = export_stl(converted) if len(converted.faces) else None
        except Exception:
            # Any error of the reader concerns the file.
            content = None
        if content is None:
            return False
        meshes[name] = content
    mesh.set("filename", name)
    return True


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


class LinkInertial(NamedTuple):
    """Mass properties of a link.

    Attributes:
        mass: mass, kg.
        place: centre of mass in the link's frame, m.
        turn: quaternion of the axes of the inertia in the link's frame.
        inertia: inertia about the centre of mass, kg m^2.
    """

    mass: float
    place: Float[np.ndarray, " 3"]
    turn: Float[np.ndarray, " 4"]
    inertia: Float[np.ndarray, "3 3"]


def set_inertials_aside(spec: Any, refusals: Refusals) -> dict[str, LinkInertial]:
    """Return the mass properties of links by name, and put placeholders in their place."""
    found = {}
    for body in spec.bodies[1:]:
        name = f"body {body.name!r}"
        mass, numbers = 0.0, np.zeros(6)
        if body.explicitinertial:
            mass, numbers = float(body.mass), np.array(body.fullinertia)
            # MuJoCo marks six zeros by NaN.
            numbers = numbers if numbers[1:].any() else np.nan_to_num(numbers)
        else:
            body.ipos = 0.0, 0.0, 0.0
            refusals.change(name, "mass none -> 0 kg, because it has no inertial")
        if not 0 <= mass < np.inf:
            problem = f"its mass is {mass:g} kg. Allowed: 0 or more"
            refusals.add(Refusal(name, problem, vital=True))
            mass = 0.0
        rounding = _EXCESS * max(_LEAST_MOMENT, np.abs(numbers).max())
        if not (np.isfinite(numbers).all() and numbers[:3].min() >= -rounding):
            words = ", ".join(f"{moment:g}" for moment in numbers[:3])
            problem = f"its moments of inertia are {words} kg m^2. Allowed: 0 or more"
            refusals.add(Refusal(name, problem, vital=True))
            numbers = np.zeros(6)
        xx, yy, zz, xy, xz, yz = numbers
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        found[body.name] = LinkInertial(mass, np.array(body.ipos), np.array(body.iquat), inertia)
        body.mass, body.ipos, body.iquat = 1.0, _PLACE, (1.0, 0.0, 0.0, 0.0)
        body.fullinertia, body.explicitinertial = _INERTIA, True
    return found


def restore_inertials(
    mujoco: Any, model: Any, inertials: Mapping[str, LinkInertial], refusals: Refusals
) -> None:
    """Set the mass properties of links in a compiled model, and make those of bodies possible."""
    for name, inertial in inertials.items():
        body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name)
        model.body_mass[body], model.body_ipos[body] = inertial.mass, inertial.place
        _set_inertia(mujoco, model, body, inertial.turn, inertial.inertia)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    for lead in np.unique(model.body_weldid):
        members = [b for b in range(1, model.nbody) if model.body_weldid[b] == lead]
        if not members:
            continue
        # Change the first link of the body so that the body has possible mass properties.
        first = members[0]
        name = f"body {mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY, first)!r}"
        if not np.any(model.body_mass[members]):
            model.body_mass[first] = _LEAST_MASS
            refusals.change(name, f"mass 0 -> {_LEAST_MASS:g} kg, because a body needs a mass")
        _, _, inertia = mass_properties(model, data, members)
        old, axes = np.linalg.eigh(inertia)
        largest = old[-1]
        least = min(_LEAST_MOMENT, _THIN * largest) if largest > 0 else _LEAST_MOMENT
        new = np.where(old > _ROUNDING * largest, old, least)
        excess = new[2] - new[0] - new[1]
        if excess > _EXCESS * (new[0] + new[1]):
            # The shortest way to the plane on which the largest moment is the sum of the others.
            new += excess / 3 * np.array([1.0, 1.0, -1.0])
        if np.array_equal(old, new):
            continue
        before, after = (", ".join(f"{moment:.9g}" for moment in each) for each in (old, new))
        refusals.change(name, f"principal moments of inertia {before} -> {after} kg m^2")
        frame = np.array(data.ximat[first]).reshape(3, 3).T @ axes
        own = np.diag(model.body_inertia[first]) + frame @ np.diag(new - old) @ frame.T
        _set_inertia(mujoco, model, first, np.array(model.body_iquat[first]), own)
        mujoco.mj_kinematics(model, data)


def mass_properties(
    model: Any, data: Any, members: Sequence[int]
) -> tuple[float, Float[np.ndarray, " 3"], Float[np.ndarray, "3 3"]]:
    """Return mass (kg), centre of mass (m) and inertia about it (kg m^2) of several bodies.

    Args:
        model: the compiled model.
        data: places of its bodies.
        members: MuJoCo's numbers of the bodies.
    """
    members = list(members)
    masses = np.array(model.body_mass[members], float)
    mass = float(masses.sum())
    if not mass:
        return 0.0, np.zeros(3), np.zeros((3, 3))
    places = np.array(data.xipos[members]).reshape(-1, 3)
    centre = masses @ places / mass
    inertia = np.zeros((3, 3))
    for member, own_mass, place in zip(members, masses, places, strict=True):
        axes = np.array(data.ximat[member]).reshape(3, 3)
        arm = place - centre
        inertia += axes @ np.diag(model.body_inertia[member]) @ axes.T
        inertia += own_mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return mass, centre, inertia


def _set_inertia(
    mujoco: Any,
    model: Any,
    body: int,
    turn: Float[np.ndarray, " 4"],
    inertia: Float[np.ndarray, "3 3"],
) -> None:
    """Set the inertia of a link, in axes that a quaternion turns."""
    model.body_inertia[body], axes = np.linalg.eigh(inertia)
    axes[:, 0] *= np.linalg.det(axes)
    principal = np.zeros(4)
    mujoco.mju_mat2Quat(principal, axes.ravel())
    mujoco.mju_mulQuat(model.body_iquat[body], turn, principal)
