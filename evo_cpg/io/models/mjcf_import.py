"""Import of a MuJoCo model (MJCF or URDF) as an experiment.

MuJoCo compiles the file, which resolves defaults, classes, includes, units and orientations. The
import reads the compiled model. Parts that do not affect the animal's motion are left out, by
name. Everything else that a creature cannot have is refused, by name, unless the user accepts the
loss.

| in MJCF | becomes | table |
|---|---|---|
| bodies that are welded together | a body | `rigid` |
| ``geom``s | shape and parts of a body | `mjcf_shapes` |
| mass and inertia | density, or numbers | this module |
| ``joint``s | the joint | `mjcf_joints` |
| ``actuator``s | motors | `mjcf_motors` |
| fixed ``tendon``s | tendons | `mjcf_joints` |
| rules of contacts, planes | ground, self-collision | `mjcf_contact` |
| gravity, medium | world | `mjcf_world` |
| any other field | refused or left out | `mjcf_fields` |
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pydantic import TypeAdapter, ValidationError

from evo_cpg.creature.creature import Creature, CreatureError, lowest_height
from evo_cpg.creature.shapes import Shape
from evo_cpg.creature.tree import build_tree
from evo_cpg.io.errors import ConfigError, KeyProblem
from evo_cpg.io.load import check_config
from evo_cpg.io.models.compiled import WORLD, Compiled, compile_model, printed, tidy, tidy_vector
from evo_cpg.io.models.mjcf_contact import (
    read_color,
    read_ground,
    read_material,
    read_self_collision,
)
from evo_cpg.io.models.mjcf_fields import leave_out_elements, refuse_elements
from evo_cpg.io.models.mjcf_joints import read_joint, read_tendons, refuse_effects_on_free_root
from evo_cpg.io.models.mjcf_motors import read_motors
from evo_cpg.io.models.mjcf_shapes import Placed, body_keys, place_body
from evo_cpg.io.models.mjcf_world import experiment, facing_note, read_world
from evo_cpg.io.models.refusals import ExchangeError, Refusal
from evo_cpg.io.models.rigid import Rigid, rigid_bodies, scenery
from evo_cpg.io.models.urdf import mass_properties
from evo_cpg.io.schema.creature import CreatureConfig
from evo_cpg.io.schema.joint import JointConfig
from evo_cpg.io.schema.shape import ShapeConfig
from evo_cpg.io.wording import checked

# Density of bodies whose mass is given in numbers, kg/m^3. It has no effect.
_ANY_DENSITY = 1000.0

# Relative difference of mass and moments from those of a uniform shape, within which the density
# describes both. Files have this many digits after rounding in the compiler.
_UNIFORM = 1e-11

_SHAPE = TypeAdapter(ShapeConfig)

# Keys and values of a material.
Material = tuple[tuple[str, float], ...]


class Imported(NamedTuple):
    """Result of reading a file.

    Attributes:
        experiment: keys of the experiment.
        left_out: names of parts of the file that are left out without harm.
        dropped: sentences about refused parts whose loss the user accepted.
        changed: sentences about values that differ from the file's, with both values.
        joints: MuJoCo's numbers of the joints of each body, by its name, in the order of its axes.
        warnings: sentences about what a user may have to change before training.
        place: centre of the root in the file's neutral pose, m.
    """

    experiment: dict[str, Any]
    left_out: tuple[str, ...]
    dropped: tuple[str, ...]
    changed: tuple[str, ...]
    joints: dict[str, tuple[int, ...]]
    warnings: tuple[str, ...]
    place: tuple[float, float, float]


def read_model(
    path: Path | str, motor_gain: float | None = None, drop: bool = False, free: bool = False
) -> Imported:
    """Read an experiment from a file that MuJoCo can load.

    Args:
        path: the file.
        motor_gain: gain of the velocity servos that replace torque motors, N m s/rad, or None to
            keep torque motors.
        drop: whether the user accepts the loss of refused parts.
        free: whether the first body is released from the world.

    Raises:
        ExchangeError: MuJoCo is missing or cannot load the file, or a part of the file cannot be
            part of a creature.
    """
    compiled = compile_model(Path(path), drop, free)
    refusals = compiled.refusals
    refuse_elements(compiled)
    motors, tendon_motors = read_motors(compiled, motor_gain)
    rigids: list[Rigid] = []
    with refusals.collecting():
        rigids = rigid_bodies(compiled)
    if not rigids:
        refusals.check()
    names = _body_names(compiled, rigids)
    placed = [place_body(compiled, rigid, names[rigid.lead]) for rigid in rigids]
    fixed = scenery(compiled, [body.rigid for body in placed])
    ground, others, frictions = read_ground(compiled, placed, fixed)
    creature, volumes = _creature_keys(compiled, placed, motors, frictions)
    if not ground:
        creature["pressure_sensors"] = []
    creature["self_collision"] = read_self_collision(compiled, placed)
    world = read_world(compiled, placed, volumes, ground)
    members = {member for body in placed for member in body.rigid.members}
    shown = {solid.geom for body in placed for solid in body.solids}
    for geom, owner in enumerate(compiled.model.geom_bodyid.tolist()):
        if geom in others:
            refusals.leave_out("scenery", str(compiled.item("geom", geom)))
        elif owner in members and geom not in shown:
            refusals.leave_out("drawing", str(compiled.item("geom", geom)))
    leave_out_elements(compiled)
    joints = {body.name: body.rigid.joints for body in placed if body.rigid.joints}
    own = [joint for numbers in joints.values() for joint in numbers]
    tendons = read_tendons(compiled, own, motors, tendon_motors)
    refusals.check()
    if tendons:
        dofs = _dof_names(_checked_creature(compiled, creature), joints)
        creature["tendons"] = [
            {"name": name, "joints": {dofs[joint]: x for joint, x in coefficients.items()}} | law
            for name, coefficients, law in tendons
        ]
    built = _checked_creature(compiled, creature)
    pulling = [tendon.law["actuator"] for tendon in tendons if "actuator" in tendon.law]
    root, every_motor = placed[0], [*motors.values(), *pulling]
    centre = root.centre
    if root.own_shape:
        # The centre of a mesh is not the origin of its frame.
        own_shape = _SHAPE.validate_python(root.solids[0].shape)
        centre = centre + root.turn @ own_shape.build()[0][1]
    clearance, floor = 0.0, (ground or {}).get("floor", {})
    if ground and "slope_deg" not in floor:
        # The animal starts at the height above level ground that it has in the neutral pose.
        lowest = float(lowest_height(built.build()))
        clearance = float(centre[2]) + lowest - floor.get("height", 0.0)
    data = experiment(
        # The name of the run has to be one that a folder can have.
        re.sub(r"[/\\]", "_", creature["name"]).lstrip(".") or "imported",
        creature,
        world,
        clearance,
        bool(root.rigid.joints) or root.rigid.free,
        any("stiffness" in motor for motor in every_motor),
    )
    return Imported(
        data,
        tuple(refusals.left_out),
        tuple(refusals.dropped),
        tuple(refusals.changed),
        joints,
        tuple(_warnings(compiled, root, bool(every_motor), built.build())),
        tuple(centre.tolist()),
    )


def _creature_keys(
    compiled: Compiled,
    placed: Sequence[Placed],
    motors: Mapping[int, dict[str, Any]],
    frictions: Mapping[int, float],
) -> tuple[dict[str, Any], list[float]]:
    """Return the keys of the creature's bodies and materials, and the volume of each body, m^3.

    Motors are by MuJoCo's number of the joint, and frictions of materials by number of the geom.
    """
    carrier = {body.rigid.lead: body for body in placed}
    materials: dict[Material, str] = {}
    bodies, volumes = [], []
    for own in placed:
        shapes = []
        for solid in own.solids:
            try:
                shapes.append(_SHAPE.validate_python(solid.shape).build()[0][0])
            except ValidationError as error:
                problem = error.errors()[0]
                key = ".".join(map(str, problem["loc"][1:]))
                said = problem["msg"].removeprefix("Value error, ")
                compiled.item("geom", solid.geom).refuse(
                    f"{key}: {problem['input']}: {said}"[:200], "sizes of a body"
                )
        volumes.append(sum(float(shape.volume) for shape in shapes))
        entry = {"name": own.name} | _substance(compiled, own, shapes, materials, frictions)
        bodies.append(entry)
        if own.rigid.free:
            refuse_effects_on_free_root(compiled, own.rigid.lead)
        else:
            parent = None if own.rigid.parent is None else carrier[own.rigid.parent]
            entry["joint"] = read_joint(compiled, own, parent, motors)
            try:
                checked(JointConfig, entry["joint"])
            except KeyProblem as error:
                # The joint breaks a rule of joints, such as two parallel axes.
                item = compiled.item("joint", own.rigid.joints[0])
                problem = str(error).removeprefix(": ")
                compiled.refusals.add(Refusal(str(item), problem, item.line, vital=True))
    named = {name: dict(keys) for keys, name in materials.items()}
    name = bytes(compiled.model.names).split(b"\0", 1)[0].decode()
    name = printed(compiled.source.stem if name in ("", "MuJoCo Model") else name)
    return {"name": name, "materials": named, "bodies": bodies}, volumes


def _warnings(compiled: Compiled, root: Placed, driven: bool, creature: Creature) -> Iterator[str]:
    """Yield sentences about what a user may have to change before training."""
    yield from (f"MuJoCo warns: {words}" for words in compiled.refusals.warnings)
    if compiled.tilt:
        angle = np.rad2deg(compiled.tilt)
        yield f"the world is turned by {angle:.3g} degrees, so that gravity points down"
    if not driven:
        yield "no joint has a motor. Give joints an actuator before training"
    note = facing_note(creature)
    if note and (root.rigid.joints or root.rigid.free):
        yield note
    if not (root.rigid.joints or root.rigid.free):
        hint = ". The option --free releases the first body" if compiled.urdf else ""
        yield f"the root {root.name!r} does not move, so use a task of your own{hint}"


def _body_names(compiled: Compiled, rigids: Sequence[Rigid]) -> dict[int, str]:
    """Return a unique name for each rigid body. A body without a name has that of its joint."""
    mujoco, model = compiled.mujoco, compiled.model
    names: dict[int, str] = {}
    for rigid in rigids:
        given = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY, rigid.lead)
        if rigid.lead == WORLD:
            given = "base"
        elif not given and rigid.joints:
            given = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, rigid.joints[0])
        # Braces stand for numbers in our names, and these two words for all bodies and no body.
        name = re.sub(r"[{}*]", "_", printed(given or f"body{rigid.lead}"))
        name = f"{name}_" if name in ("all", "world") else name
        while name in names.values():
            name += "_"
        names[rigid.lead] = name
    return names


def _substance(
    compiled: Compiled,
    own: Placed,
    shapes: Sequence[Shape],
    materials: dict[Material, str],
    frictions: Mapping[int, float],
) -> dict[str, Any]:
    """Return the keys of a body's shapes, materials, mass and inertia.

    ``materials`` are the names of the materials so far, which grow.
    """
    mass, centre, inertia = mass_properties(compiled.model, compiled.data, own.rigid.members)
    centre, inertia = own.turn.T @ (centre - own.centre), own.turn.T @ inertia @ own.turn
    density = None
    alone = len(shapes) == 1 and own.own_shape and own.solids[0].shape["type"] != "mesh"
    if alone and mass and shapes[0].volume:
        # Does a uniform density of the shape give these mass properties?
        (shape,) = shapes
        middle = _SHAPE.validate_python(own.solids[0].shape).build()[0][1]
        centred = np.abs(centre - middle).max() <= _UNIFORM * np.linalg.norm(shape.half_extents)
        # Compare in the principal frame, where the moments of a thin rod do not hide one another.
        moments, frame = np.linalg.eigh(np.asarray(shape.inertia_tensor(mass), float))
        off = np.abs(frame.T @ inertia @ frame - np.diag(moments))
        within = _UNIFORM * np.sqrt(np.outer(moments, moments)) + 1e-15 * moments.max()
        if centred and (off <= within).all():
            density = mass / float(shape.volume)
    named = []
    for solid in own.solids:
        made = read_material(frictions[solid.geom], _ANY_DENSITY if density is None else density)
        key = tuple(made.items())
        named.append(materials.setdefault(key, f"material{len(materials) + 1}"))
    if not named:
        key = (("density", _ANY_DENSITY),)
        named.append(materials.setdefault(key, f"material{len(materials) + 1}"))
    colors = [read_color(compiled, solid.geom) for solid in own.solids]
    keys = body_keys(own, named, colors)
    if not mass:
        # Only a fixed root has no mass in MuJoCo. Any mass does.
        any_mass = {"mass": 1.0, "inertia": [1.0, 1.0, 1.0, 0.0, 0.0, 0.0]}
        return keys if shapes else keys | any_mass
    if density is None:
        keys["mass"] = tidy(mass)
        keys["centre_of_mass"] = tidy_vector(centre)
        i, k = np.array([0, 1, 2, 0, 0, 1]), np.array([0, 1, 2, 1, 2, 2])
        values = (inertia + inertia.T)[i, k] / 2
        # Remainders of numbers that cancel count as 0.
        least = 1e-15 * float(np.trace(inertia))
        keys["inertia"] = [0.0 if abs(value) < least else tidy(value) for value in values]
    return keys


def _checked_creature(compiled: Compiled, keys: Mapping[str, Any]) -> CreatureConfig:
    """Return the creature.

    Raises:
        ExchangeError: its keys break a rule of creatures.
    """
    data = {"name": "imported", "creature": keys}
    try:
        config = check_config(data, compiled.source).creature
        config.build()
    except ConfigError as error:
        where = [str(part) for part in error.key[1:]]
        owner = keys["name"]
        if len(where) > 1 and where[0] == "bodies" and where[1].isdigit():
            owner, where = keys["bodies"][int(where[1])]["name"], where[2:]
        key = f"{'.'.join(where)}: " if where else ""
        raise ExchangeError(f"{compiled.source}: {owner!r}: {key}{error.problem}") from None
    except CreatureError as error:
        raise ExchangeError(f"{compiled.source}: {error}") from None
    return config


def _dof_names(config: CreatureConfig, joints: Mapping[str, tuple[int, ...]]) -> dict[int, str]:
    """Return the name of the degree of freedom of each of MuJoCo's joints that has only one."""
    tree = build_tree(config.build())
    found: dict[str, list[str]] = {}
    for body, dof in zip(tree.dof_bodies, tree.dof_names, strict=True):
        found.setdefault(tree.names[body], []).append(dof)
    return {
        joint: dof
        for name, numbers in joints.items()
        if len(numbers) == len(found.get(name, ()))
        for joint, dof in zip(numbers, found[name], strict=True)
    }
