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
from evo_cpg.exchange.mjcf_fields import (
    PLAIN_PAIR,
    left_out_options,
    refuse_elements,
    refuse_fields,
)
from evo_cpg.exchange.mjcf_motors import command_ranges, read_motors
from evo_cpg.exchange.mjcf_shapes import Placed, only_geom, place_body, uniform_density
from evo_cpg.spatial.rotation import matrix_to_euler

# MuJoCo's own for a geom without one.
_GREY = (0.5, 0.5, 0.5, 1.0)

_WITHOUT_PART_IN_MOTION = {
    "nlight": "light",
    "ncam": "camera",
    "nsite": "site",
    "nsensor": "sensor",
    "nskin": "skin",
    "nkey": "keyframe",
}

# Flags that say which bodies touch.
_OF_COLLISIONS = ("contact", "filterparent")

# Springs, dampers and rotors of the root against the world, as the compiled model has them and as
# they are written.
_OF_ROOT = {"dof_damping": "damping", "dof_armature": "armature", "jnt_stiffness": "stiffness"}


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
    compiled.require_numbers()
    refuse_elements(compiled)
    refuse_fields(compiled)
    root = _find_root(compiled)
    motors = read_motors(compiled, motor_gain)
    names = _body_names(compiled)
    bodies = [i for i in range(root, model.nbody) if model.body_rootid[i] == root]
    placed, made_of = _read_shapes(compiled, bodies)
    for body in bodies[1:]:
        _check_joints(compiled, body, motors)
    fluid = 0.0
    if len(placed) == len(bodies):
        with compiled.refusals.collecting():
            fluid = _buoyancy(compiled, placed)
    compiled.refusals.check()
    materials: dict[MaterialConfig, str] = {}
    entries = []
    for body in bodies:
        material = materials.setdefault(made_of[body], f"material{len(materials) + 1}")
        entry = {"name": names[body], "shape": placed[body].shape, "material": material}
        entry["color"] = _color(model, int(model.body_geomadr[body]))
        with compiled.refusals.collecting():
            if body != root:
                entry["joint"] = _read_joint(compiled, body, placed, names, motors)
            what, at = compiled.named("body", body), ("body", body)
            entries.append(compiled.checked(what, BodyConfig, entry, at))
    compiled.refusals.check()
    name = _model_name(compiled)
    made = {name: made_of for made_of, name in materials.items()}
    whole = {"name": name, "materials": made, "bodies": entries}
    with compiled.refusals.collecting():
        creature = compiled.checked(f"model {name!r}", CreatureConfig, whole)
        return Imported(creature, _left_out(compiled, fluid))
    compiled.refusals.check()
    raise AssertionError("unreachable")


def _read_shapes(
    compiled: Compiled, bodies: list[int]
) -> tuple[dict[int, Placed], dict[int, MaterialConfig]]:
    """Shapes and materials of those bodies that can have them; the others are refused."""
    placed: dict[int, Placed] = {}
    made_of: dict[int, MaterialConfig] = {}
    for body in bodies:
        with compiled.refusals.collecting():
            geom = only_geom(compiled, body)
            placed[body] = own = place_body(compiled, body, geom, body == bodies[0])
            density = uniform_density(compiled, body, geom, own)
            made_of[body] = _material(compiled, geom, density)
    return placed, made_of


def _find_root(compiled: Compiled) -> int:
    """The body that all others hang on."""
    model = compiled.model
    tops = [i for i in range(1, model.nbody) if model.body_parentid[i] == WORLD]
    if not tops:
        raise ExchangeError(f"{compiled.source}: the worldbody holds no body; allowed: one")
    root = tops[0]
    for other in tops[1:]:
        compiled.refuse(
            "body",
            other,
            f"it stands in the worldbody beside {compiled.named('body', root)}",
            "one body there, the root",
        )
    joints = _joints_of(model, root)
    free = compiled.mujoco.mjtJoint.mjJNT_FREE
    if [int(model.jnt_type[joint]) for joint in joints] != [free]:
        compiled.refuse("body", root, "the root does not float freely", "a freejoint")
        return root
    dofs = slice(int(model.jnt_dofadr[joints[0]]), int(model.jnt_dofadr[joints[0]]) + 6)
    for field, word in _OF_ROOT.items():
        places = dofs if field.startswith("dof") else joints[0]
        if np.any(getattr(model, field)[places]):
            compiled.refuse("joint", joints[0], f"it has {word}", f"no {word}")
    return root


def _body_names(compiled: Compiled) -> dict[int, str]:
    mujoco, model = compiled.mujoco, compiled.model
    given = [mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY, i) for i in range(model.nbody)]
    names = {}
    for i, name in enumerate(given):
        if name and "{i}" in name:
            compiled.refuse("body", i, "{i} stands for a number in our names", "a name without it")
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
    placed: dict[int, Placed],
    names: dict[int, str],
    motors: dict[int, ActuatorConfig | None],
) -> JointConfig:
    """The joint of a body whose hinges `_check_joints` has let pass."""
    above = int(compiled.model.body_parentid[body])
    own, parent = placed[body], placed[above]
    model = compiled.model
    joints = _joints_of(model, body)
    first, limits = joints[0], []
    for joint in joints:
        # MuJoCo counts angles from where the model file says, we from the neutral pose.
        neutral = model.qpos0[model.jnt_qposadr[joint]]
        turns = np.rad2deg(model.jnt_range[joint] - neutral)
        limits.append(tuple(tidy_difference(turn) for turn in turns))
    place, dof = np.array(model.jnt_pos[first]), int(model.jnt_dofadr[first])
    turn = rotation(compiled, model.body_quat[body])
    at = np.array(model.body_pos[body]) + turn @ place
    euler = np.rad2deg(matrix_to_euler(parent.turn.T @ turn @ own.turn))
    values = {
        "parent": names[above],
        "at": tidy_vector(parent.turn.T @ (at - parent.centre)),
        "child_at": tidy_vector(own.turn.T @ (place - own.centre)),
        "axes": [_axis(own.turn.T @ model.jnt_axis[joint]) for joint in joints],
        "limits_deg": limits[0] if len(set(limits)) == 1 else limits,
        "rotation_deg": tidy_vector(euler),
        "stiffness": tidy(model.jnt_stiffness[first]),
        "damping": tidy(model.dof_damping[dof]),
        "armature": tidy(model.dof_armature[dof]),
        "actuator": motors.get(first),
    }
    what = f"joint of {compiled.named('body', body)}"
    return compiled.checked(what, JointConfig, values, ("body", body))


def _material(compiled: Compiled, geom: int, density: float) -> MaterialConfig:
    friction = tidy(compiled.model.geom_friction[geom, 0])
    values = {
        "density": tidy(density),
        "static_friction": friction,
        "dynamic_friction": friction,
    }
    return compiled.checked(compiled.named("geom", geom), MaterialConfig, values, ("geom", geom))


def _check_joints(compiled: Compiled, body: int, motors: dict[int, ActuatorConfig | None]) -> None:
    """Refuse what keeps a body's joints from being one joint of ours."""
    model = compiled.model
    joints = _joints_of(model, body)
    if not 1 <= len(joints) <= 3:
        problem = f"it has {len(joints)} joints" if joints else "it is welded to its parent"
        compiled.refuse("body", body, problem, "one to three hinges")
    if not all(_is_plain_hinge(compiled, joint) for joint in joints):
        return
    # None where an actuator is refused already.
    unread = [joint for joint in joints if motors.get(joint, ...) is None]
    for joint in joints[1:]:
        if not unread and motors.get(joint) != motors.get(joints[0]):
            compiled.refuse(*_unlike(compiled, joint, joints[0], "actuator"))
        for word, values in _alike(compiled).items():
            if not np.allclose(values[joint], values[joints[0]], rtol=TOLERANCE, atol=0):
                compiled.refuse(*_unlike(compiled, joint, joints[0], word))
        apart = np.abs(model.jnt_pos[joint] - model.jnt_pos[joints[0]]).max()
        if apart > TOLERANCE:
            compiled.refuse(*_unlike(compiled, joint, joints[0], "pos"))


def _alike(compiled: Compiled) -> dict[str, np.ndarray]:
    """What all hinges of a body have to have in common, by joint."""
    model = compiled.model
    first = model.jnt_dofadr
    return {
        "stiffness": model.jnt_stiffness,
        "damping": model.dof_damping[first],
        "armature": model.dof_armature[first],
    }


def _is_plain_hinge(compiled: Compiled, joint: int) -> bool:
    """Whether a joint is a hinge; what else is wrong with it is refused."""
    model, kinds = compiled.model, compiled.mujoco.mjtJoint
    kind = int(model.jnt_type[joint])
    if kind != kinds.mjJNT_HINGE:
        word = str(kinds(kind).name).removeprefix("mjJNT_").lower()
        compiled.refuse(
            "joint",
            joint,
            f"it is a {word} joint",
            "one to three hinges at one place, which turn one after the other",
        )
        return False
    if not model.jnt_limited[joint]:
        compiled.refuse("joint", joint, "it has no limits", "a range")
    address = model.jnt_qposadr[joint]
    if model.jnt_stiffness[joint] and model.qpos_spring[address] != model.qpos0[address]:
        compiled.refuse(
            "joint", joint, "its springref is not its ref", "a spring to the neutral pose"
        )
    return True


def _unlike(compiled: Compiled, joint: int, first: int, word: str) -> tuple[str, int, str, str]:
    return (
        "joint",
        joint,
        f"its {word} is not that of {compiled.named('joint', first)}",
        f"the same {word} for all hinges of a body",
    )


def _left_out(compiled: Compiled, fluid: float) -> tuple[str, ...]:
    """What belongs to the world, or has no part in the motion.

    Args:
        compiled: the model.
        fluid: density of the fluid whose buoyancy carries the bodies, kg/m^3.
    """
    model = compiled.model
    options = left_out_options(compiled)
    found = []
    if _has_weight(compiled):
        gravity = ", ".join(f"{value:g}" for value in model.opt.gravity)
        found.append(f"gravity ({gravity}) m/s^2")
    ground = [i for i in range(model.ngeom) if model.geom_bodyid[i] == WORLD]
    found += [compiled.named("geom", geom) for geom in ground]
    if fluid:
        found.append(f"the buoyancy of a fluid of {fluid:g} kg/m^3")
    medium = [name for name in ("density", "viscosity") if name in options]
    if medium:
        found.append(f"drag of the fluid (option {', '.join(medium)})")
    found += [f"option {name}" for name in options if name not in ("gravity", *medium)]
    found += _collisions(compiled)
    ranges = command_ranges(compiled)
    if len(ranges) == 1:
        found.append(f"the ctrlrange of {compiled.named('actuator', ranges[0])}")
    elif ranges:
        found.append(f"the ctrlrange of {len(ranges)} actuators")
    for count, kind in _WITHOUT_PART_IN_MOTION.items():
        found += _counted(int(getattr(model, count, 0)), kind)
    return tuple(found)


def _collisions(compiled: Compiled) -> list[str]:
    """What says which bodies touch: in a creature, `self_collision` and the world do."""
    model = compiled.model
    own = model.geom_bodyid != WORLD
    bits = np.stack([model.geom_contype, model.geom_conaffinity], 1)
    # MuJoCo's default, and that of our own export.
    usual = (bits == [1, 1]).all(1) | (bits == [0, 1]).all(1)
    unusual = int((own & ~usual).sum())
    # A pair with the ground goes with the ground. One without friction is what `self_collision`
    # makes of two bodies.
    among = own[model.pair_geom1] & own[model.pair_geom2]
    plain = model.pair_dim == 1
    for field, value in PLAIN_PAIR.items():
        close = np.isclose(getattr(model, field, value), value)
        plain &= close.all(axis=tuple(range(1, close.ndim)))
    pairs = (among & ~plain).sum()
    found = [f"contype and conaffinity of {unusual} geom{'s' * (unusual > 1)}"] if unusual else []
    found += _counted(int(pairs), "contact pair") + _counted(int(model.nexclude), "contact exclude")
    return found + [f"flag {flag}" for flag in _OF_COLLISIONS if compiled.disabled(flag)]


def _counted(number: int, kind: str) -> list[str]:
    return [f"{number} {kind}{'s' if number > 1 else ''}"] if number else []


def _has_weight(compiled: Compiled) -> bool:
    return bool(np.any(compiled.model.opt.gravity)) and not compiled.disabled("gravity")


def _buoyancy(compiled: Compiled, placed: dict[int, Placed]) -> float:
    """Density of the fluid that carries all bodies, kg/m^3; 0 for none."""
    if not _has_weight(compiled):
        return 0.0
    model = compiled.model
    bodies = list(placed)
    volumes = [placed[body].shape.build().volume for body in bodies]
    fluid = model.body_gravcomp[bodies] * model.body_mass[bodies] / volumes
    alike = np.isclose(fluid, fluid[0], rtol=TOLERANCE, atol=0)
    wrong = np.flatnonzero(~alike | (fluid < 0))
    if wrong.size:
        raise compiled.refusal(
            "body",
            bodies[int(wrong[0])],
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
