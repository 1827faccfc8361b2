"""A MuJoCo model (MJCF) as a creature, as far as our creatures go.

MuJoCo itself compiles the file, so defaults, classes, includes, units and orientations are
resolved, and what is read is the compiled model. What can be part of a creature is taken, what has
no part in its motion is named as left out, and everything else is refused by name:

| in MJCF | becomes |
|---|---|
| the body with a ``freejoint`` | the root, which stands in the world's axes |
| one to three ``hinge``s of a body | the joint; each has a ``range``, else they are alike |
| one ``geom``, which gives the body its mass | the shape; the body's frame is put into its centre |
| ``position``, ``velocity`` | a motor with and without a spring |
| ``motor`` with limits | a velocity servo of a gain that the caller chooses |
| its first friction | static and dynamic friction |
"""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from evo_cpg.config.schema.creature import BodyConfig, CreatureConfig, MaterialConfig
from evo_cpg.config.schema.joint import ActuatorConfig, JointConfig
from evo_cpg.exchange.compiled import (
    TOLERANCE,
    WORLD,
    Compiled,
    compile_model,
    rotation,
    tidy,
    tidy_difference,
    tidy_vector,
)
from evo_cpg.exchange.errors import ExchangeError
from evo_cpg.exchange.mjcf_motors import command_ranges, read_motors
from evo_cpg.exchange.mjcf_shapes import Placed, only_geom, place_body, uniform_density
from evo_cpg.spatial.rotation import matrix_to_euler

# MuJoCo's own for a geom without one.
_GREY = (0.5, 0.5, 0.5, 1.0)

# Counts in the compiled model and what they count. Newer versions of MuJoCo know more of them.
_REFUSED = {
    "neq": "equality",
    "ntendon": "tendon",
    "nflex": "flex",
    "nplugin": "plugin",
}
# Flags of the option element without which joints are not what they say. Older versions of MuJoCo
# have "passive" for springs and dampers.
_NEEDED = ("passive", "spring", "damper", "limit", "actuation")

_WITHOUT_PART_IN_MOTION = {
    "nlight": "light",
    "ncam": "camera",
    "nsite": "site",
    "nsensor": "sensor",
    "nskin": "skin",
    "nkey": "keyframe",
}

# Properties that must be zero, as the compiled model has them and as they are written.
_ZERO_OF_DOF = {"dof_frictionloss": "frictionloss", "dof_dampingpoly": "damping polynomial"}
_ZERO_OF_JOINT = {"jnt_stiffnesspoly": "stiffness polynomial", "jnt_springyield": "spring yield"}


class Imported(NamedTuple):
    """What a file gave.

    Attributes:
        creature: in the user's terms.
        left_out: what belongs to the world, or has no part in the motion.
    """

    creature: CreatureConfig
    left_out: tuple[str, ...]


def read_mjcf(path: Path | str, motor_gain: float | None = None) -> Imported:
    """Read a creature from a file that MuJoCo can load.

    Args:
        path: the file.
        motor_gain: of the velocity servos that torque motors become, N m s/rad; None refuses
            torque motors.

    Raises:
        ExchangeError: MuJoCo is missing or cannot load the file, or something in it cannot be part
            of a creature.
    """
    compiled = compile_model(Path(path))
    model = compiled.model
    for count, kind in _REFUSED.items():
        if getattr(model, count, 0):
            raise compiled.refusal(kind, 0, "no creature has such a thing", f"no {kind}")
    for flag in _NEEDED:
        if compiled.disabled(flag):
            raise ExchangeError(
                f"{compiled.source}: flag {flag!r}: it is disabled; allowed: enable"
            )
    compiled.require_numbers()
    root = _find_root(compiled)
    names = _body_names(compiled)
    motors = read_motors(compiled, motor_gain)
    materials: dict[MaterialConfig, str] = {}
    placed: dict[int, Placed] = {}
    bodies = []
    for body in range(root, model.nbody):
        geom = only_geom(compiled, body)
        placed[body] = own = place_body(compiled, body, geom, body == root)
        made_of = _material(compiled, geom, uniform_density(compiled, body, geom, own))
        material = materials.setdefault(made_of, f"material{len(materials) + 1}")
        joint = None
        if body != root:
            parent = int(model.body_parentid[body])
            joint = _read_joint(compiled, body, own, placed[parent], names[parent], motors)
        entry = {"name": names[body], "shape": own.shape, "material": material, "joint": joint}
        entry["color"] = _color(model, geom)
        bodies.append(compiled.checked(compiled.named("body", body), BodyConfig, entry))
    name = _model_name(compiled)
    made = {name: made_of for made_of, name in materials.items()}
    whole = {"name": name, "materials": made, "bodies": bodies}
    creature = compiled.checked(f"model {name!r}", CreatureConfig, whole)
    return Imported(creature, _left_out(compiled, creature))


def _find_root(compiled: Compiled) -> int:
    model = compiled.model
    tops = [i for i in range(1, model.nbody) if model.body_parentid[i] == WORLD]
    if not tops:
        raise ExchangeError(f"{compiled.source}: the worldbody holds no body; allowed: one")
    if len(tops) > 1:
        raise compiled.refusal(
            "body",
            tops[1],
            f"it stands in the worldbody beside {compiled.named('body', tops[0])}",
            "one body there, the root",
        )
    root = tops[0]
    joints = _joints_of(model, root)
    free = compiled.mujoco.mjtJoint.mjJNT_FREE
    if [int(model.jnt_type[joint]) for joint in joints] != [free]:
        raise compiled.refusal("body", root, "the root does not float freely", "a freejoint")
    _require_free_dofs(compiled, joints[0])
    return root


def _require_free_dofs(compiled: Compiled, joint: int) -> None:
    """Refuse a root with springs, dampers or rotors against the world."""
    model = compiled.model
    first = int(model.jnt_dofadr[joint])
    resisted = {"dof_damping": "damping", "dof_armature": "armature"} | _ZERO_OF_DOF
    for dof in range(first, first + 6):
        compiled.require_zero("joint", joint, resisted, dof)
    compiled.require_zero("joint", joint, {"jnt_stiffness": "stiffness"} | _ZERO_OF_JOINT, joint)


def _body_names(compiled: Compiled) -> dict[int, str]:
    mujoco, model = compiled.mujoco, compiled.model
    given = [mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY, i) for i in range(model.nbody)]
    names = {}
    for i, name in enumerate(given):
        if name and "{i}" in name:
            raise compiled.refusal(
                "body", i, "{i} stands for a number in our names", "a name without it"
            )
        invented = f"body{i}"
        while invented in given:
            invented += "_"
        names[i] = name or invented
    return names


def _joints_of(model: Any, body: int) -> list[int]:
    """Numbers of a body's joints."""
    first = int(model.body_jntadr[body])
    return list(range(first, first + int(model.body_jntnum[body])))


def _read_joint(
    compiled: Compiled,
    body: int,
    own: Placed,
    parent: Placed,
    parent_name: str,
    motors: dict[int, ActuatorConfig],
) -> JointConfig:
    model = compiled.model
    joints = _joints_of(model, body)
    if not 1 <= len(joints) <= 3:
        problem = f"it has {len(joints)} joints" if joints else "it is welded to its parent"
        raise compiled.refusal("body", body, problem, "one to three hinges")
    for joint in joints:
        _require_plain_hinge(compiled, joint)
    first = joints[0]
    place = np.array(model.jnt_pos[first])
    dofs = [int(model.jnt_dofadr[joint]) for joint in joints]
    limits = []
    for joint, dof in zip(joints, dofs, strict=True):
        if np.abs(model.jnt_pos[joint] - place).max() > TOLERANCE:
            raise _unlike(compiled, joint, first, "pos")
        for word, values, at, other in (
            ("stiffness", model.jnt_stiffness, joint, first),
            ("damping", model.dof_damping, dof, dofs[0]),
            ("armature", model.dof_armature, dof, dofs[0]),
        ):
            if not np.isclose(values[at], values[other], rtol=TOLERANCE, atol=0):
                raise _unlike(compiled, joint, first, word)
        if motors.get(joint) != motors.get(first):
            raise _unlike(compiled, joint, first, "actuator")
        # MuJoCo counts angles from where the model file says, we from the neutral pose.
        neutral = model.qpos0[model.jnt_qposadr[joint]]
        turns = np.rad2deg(model.jnt_range[joint] - neutral)
        limits.append(tuple(tidy_difference(turn) for turn in turns))
    turn = rotation(compiled, model.body_quat[body])
    at = np.array(model.body_pos[body]) + turn @ place
    euler = np.rad2deg(matrix_to_euler(parent.turn.T @ turn @ own.turn))
    values = {
        "parent": parent_name,
        "at": tidy_vector(parent.turn.T @ (at - parent.centre)),
        "child_at": tidy_vector(own.turn.T @ (place - own.centre)),
        "axes": [_axis(own.turn.T @ model.jnt_axis[joint]) for joint in joints],
        "limits_deg": limits[0] if len(set(limits)) == 1 else limits,
        "rotation_deg": tidy_vector(euler),
        "stiffness": tidy(model.jnt_stiffness[first]),
        "damping": tidy(model.dof_damping[dofs[0]]),
        "armature": tidy(model.dof_armature[dofs[0]]),
        "actuator": motors.get(first),
    }
    return compiled.checked(f"joint of {compiled.named('body', body)}", JointConfig, values)


def _material(compiled: Compiled, geom: int, density: float) -> MaterialConfig:
    friction = tidy(compiled.model.geom_friction[geom, 0])
    values = {
        "density": tidy(density),
        "static_friction": friction,
        "dynamic_friction": friction,
    }
    return compiled.checked(compiled.named("geom", geom), MaterialConfig, values)


def _require_plain_hinge(compiled: Compiled, joint: int) -> None:
    model, kinds = compiled.model, compiled.mujoco.mjtJoint
    kind = int(model.jnt_type[joint])
    if kind != kinds.mjJNT_HINGE:
        word = str(kinds(kind).name).removeprefix("mjJNT_").lower()
        raise compiled.refusal(
            "joint",
            joint,
            f"it is a {word} joint",
            "one to three hinges at one place, which turn one after the other",
        )
    compiled.require_zero("joint", joint, _ZERO_OF_DOF, int(model.jnt_dofadr[joint]))
    compiled.require_zero("joint", joint, _ZERO_OF_JOINT, joint)
    if getattr(model, "jnt_plasticadr", np.full(joint + 1, -1))[joint] >= 0:
        raise compiled.refusal("joint", joint, "it is plastic", "an elastic spring")
    if not model.jnt_limited[joint]:
        raise compiled.refusal("joint", joint, "it has no limits", "a range")
    address = model.jnt_qposadr[joint]
    if model.jnt_stiffness[joint] and model.qpos_spring[address] != model.qpos0[address]:
        raise compiled.refusal(
            "joint", joint, "its springref is not its ref", "a spring to the neutral pose"
        )


def _unlike(compiled: Compiled, joint: int, first: int, word: str) -> ExchangeError:
    return compiled.refusal(
        "joint",
        joint,
        f"its {word} is not that of {compiled.named('joint', first)}",
        f"the same {word} for all hinges of a body",
    )


def _left_out(compiled: Compiled, creature: CreatureConfig) -> tuple[str, ...]:
    model = compiled.model
    found = []
    gravity = np.array(model.opt.gravity)
    weighs = gravity.any() and not compiled.disabled("gravity")
    if weighs:
        found.append(f"gravity ({', '.join(f'{value:g}' for value in gravity)}) m/s^2")
    ground = [i for i in range(model.ngeom) if model.geom_bodyid[i] == WORLD]
    found += [compiled.named("geom", geom) for geom in ground]
    carried = _buoyancy(compiled, creature) if weighs else 0.0
    if carried:
        found.append(f"the buoyancy of a fluid of {carried:g} kg/m^3")
    if model.opt.density or model.opt.viscosity:
        found.append("drag of the fluid")
    ranges = command_ranges(compiled)
    if len(ranges) == 1:
        found.append(f"the ctrlrange of {compiled.named('actuator', ranges[0])}")
    elif ranges:
        found.append(f"the ctrlrange of {len(ranges)} actuators")
    for count, kind in _WITHOUT_PART_IN_MOTION.items():
        number = int(getattr(model, count, 0))
        if number:
            found.append(f"{number} {kind}{'s' if number > 1 else ''}")
    return tuple(found)


def _buoyancy(compiled: Compiled, creature: CreatureConfig) -> float:
    """Density of the fluid that carries all bodies, kg/m^3; 0 for none."""
    model = compiled.model
    volumes = [entry.shape.build().volume for entry in creature.bodies]
    fluid = model.body_gravcomp[1:] * model.body_mass[1:] / volumes
    alike = np.isclose(fluid, fluid[0], rtol=TOLERANCE, atol=0)
    wrong = np.flatnonzero(~alike | (fluid < 0))
    if wrong.size:
        raise compiled.refusal(
            "body",
            1 + int(wrong[0]),
            "its gravcomp is not the buoyancy of a fluid around all bodies",
            "gravcomp in inverse proportion to the density, or none",
        )
    return tidy(fluid[0])


def _color(model: Any, geom: int) -> str | None:
    rgba = model.geom_rgba[geom]
    if np.allclose(rgba, _GREY):
        return None
    return "#" + "".join(f"{round(255 * float(value)):02x}" for value in np.clip(rgba[:3], 0, 1))


def _model_name(compiled: Compiled) -> str:
    name = bytes(compiled.model.names).split(b"\0", 1)[0].decode()
    return compiled.source.stem if name in ("", "MuJoCo Model") else name


def _axis(direction: np.ndarray) -> str | tuple[float, float, float]:
    vector = tidy_vector(direction)
    for name, unit in zip("xyz", np.eye(3), strict=True):
        if np.array_equal(vector, unit):
            return name
    return vector
