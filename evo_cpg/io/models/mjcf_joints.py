"""Joints of a creature as joints of an MJCF body, and back.

| here | in MJCF |
|---|---|
| each turning axis of a joint | a ``hinge`` at its place, named `body.1`, `body.2`, ... |
| each sliding axis | a ``slide``, named alike |
| a ball | a ``ball``, `body.1` |
| a joint without axes | no joint |
| limits of an axis | ``range``, or none |
| stiffness, damping, armature, friction loss of an axis | the same attribute of its joint |
| angle of the relaxed spring | ``springref`` |
| passive stiffness and damping of muscles | added to those of every hinge |

In the import an axis may have a place of its own, and may be a slide. Angles and lengths count from
the neutral pose, where MuJoCo counts from ``ref``.

Fixed tendons of a creature as tendons of MJCF, and back: laws on a sum of joint angles.

| here | in MJCF |
|---|---|
| tendon over degrees of freedom | ``fixed`` tendon over ``joint``s with ``coef`` |
| stiffness, damping, armature, friction loss | the same attribute |
| lengths at which the spring is relaxed | ``springlength`` |
| limits of the length | ``range`` |
| motor | an actuator with ``tendon`` |

Our length is 0 in the neutral pose. A tendon without a spring, a damper, a rotor, dry friction,
limits and a motor has no effect and is left out.
"""

from collections.abc import Container, Iterable, Mapping
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from evo_cpg.creature.algebra.rotation import matrix_to_euler
from evo_cpg.creature.creature import NO_LIMIT, Body, Creature, Joint, Muscle, topological_order
from evo_cpg.creature.tree import build_tree
from evo_cpg.io.models.compiled import Compiled, printed, tidy, tidy_vector
from evo_cpg.io.models.mjcf_motors import add_motor
from evo_cpg.io.models.mjcf_shapes import Placed, number_text, place_text, set_effects
from evo_cpg.io.models.refusals import ExchangeError

# Limits (rad or m) from which on a joint counts as unlimited.
_UNLIMITED = 1e4

# Largest distance of an axis from the joint's place, m, at which it counts as through it.
_AT_PLACE = 1e-12

# Directions that have a word in a configuration.
_AXES = {
    word: sign * axis
    for name, axis in zip("xyz", np.eye(3), strict=True)
    for sign, word in ((1.0, name), (-1.0, f"-{name}"))
}

# MuJoCo replaces the spring length -1 by the length in the neutral pose.
_NEUTRAL = -1.0


def joint_names(body: Body, joint: Joint | None) -> list[str]:
    """Return the name of the MJCF joint of each axis of a body's joint, in their order.

    All axes of a ball have the same name.
    """
    dofs = joint.dofs if joint else ()
    return [f"{body.name}.{1 if dof.kind.at_once else i + 1}" for i, dof in enumerate(dofs)]


def add_joints(element: Element, body: Body, joint: Joint) -> None:
    """Add the joint of a body to its element."""
    # The axes of a ball have the same name and the same values.
    for name, dof in dict(zip(joint_names(body, joint), joint.dofs, strict=True)).items():
        if dof.kind.mujoco is None:
            raise ExchangeError(f"joint of {body.name!r}: no joint of MuJoCo {dof.kind.motion}")
        hinge = SubElement(element, "joint", name=name, type=dof.kind.mujoco)
        if not dof.kind.at_once:
            hinge.set("axis", place_text(np.array(dof.axis)))
        if any(dof.place):
            hinge.set("pos", place_text(np.array(dof.place)))
        limited = dof.upper < NO_LIMIT
        hinge.set("limited", "true" if limited else "false")
        if limited:
            lower = 0.0 if dof.kind.at_once else dof.lower
            hinge.set("range", number_text(lower, dof.upper))
        muscle = dof.actuator if isinstance(dof.actuator, Muscle) else None
        effects = {
            "stiffness": dof.stiffness + (muscle.rest_stiffness if muscle else 0.0),
            "damping": dof.damping + (muscle.damping if muscle else 0.0),
            "armature": dof.armature,
            "springref": dof.rest,
            "frictionloss": dof.friction_loss,
        }
        set_effects(hinge, effects)


def read_joint(
    compiled: Compiled, own: Placed, parent: Placed | None, motors: Mapping[int, dict[str, Any]]
) -> dict[str, Any]:
    """Return the keys of the joint of a body.

    ``parent`` is None for the world. Motors are by MuJoCo's number of the joint.
    """
    model, data, kinds = compiled.model, compiled.data, compiled.mujoco.mjtJoint
    joints = own.rigid.joints
    turning = [j for j in joints if int(model.jnt_type[j]) != kinds.mjJNT_SLIDE]
    place = own.centre
    if joints:
        place = np.array(data.xanchor[(turning or joints)[0]])
    at = [0.0, 0.0, 0.0] if parent is None else parent.place(place)
    keys: dict[str, Any] = {"parent": "world" if parent is None else parent.name, "at": at}
    axes: list[Any] = []
    keys |= {"child_at": own.place(place), "axes": axes}
    if parent is not None:
        turn = np.rad2deg(matrix_to_euler(parent.turn.T @ own.turn))
        if np.any(turn := tidy_vector(turn)):
            keys["rotation_deg"] = turn
    if not joints:
        return keys
    limits, rests = [], []
    for joint in joints:
        limit, address = _limits(compiled, joint), int(model.jnt_qposadr[joint])
        sprung = model.jnt_stiffness[joint] and not compiled.disabled("spring", "passive")
        # Here the spring's rest counts from the neutral pose.
        rest = float(model.qpos_spring[address] - model.qpos0[address]) if sprung else 0.0
        if int(model.jnt_type[joint]) == kinds.mjJNT_BALL:
            keys["axes"] = "ball"
            limits.append(limit and tidy_vector(np.rad2deg(limit)))
            rests.append(0.0)
            continue
        vector = tidy_vector(own.turn.T @ np.array(data.xaxis[joint]))
        named = (word for word, axis in _AXES.items() if np.array_equal(vector, axis))
        direction = next(named, vector)
        if int(model.jnt_type[joint]) == kinds.mjJNT_SLIDE:
            slide = {"slide": direction, "limits_m": limit and tidy_vector(np.array(limit))}
            axes.append(slide | ({"rest_m": tidy(rest)} if rest else {}))
            limits.append(None)
            rests.append(0.0)
            continue
        anchor = np.array(data.xanchor[joint])
        apart = np.abs(anchor - place).max() > _AT_PLACE
        entry = {"turn": direction, "at": own.place(anchor)} if apart else direction
        axes.append(entry)
        limits.append(limit and tidy_vector(np.rad2deg(limit)))
        rests.append(tidy(np.rad2deg(rest)))
    if keys["axes"] == "ball":
        keys["limits_deg"] = limits[0]
    else:
        keys["limits_deg"] = one_or_each(limits)
    keys |= _passive(compiled, joints, rests)
    driven = [motors.get(joint) for joint in joints]
    if any(driven):
        keys["actuator"] = one_or_each(driven)
    return keys


def refuse_effects_on_free_root(compiled: Compiled, body: int) -> None:
    """Refuse springs, dampers, rotors and dry friction of a free joint: no root has them."""
    joint = int(compiled.model.body_jntadr[body])
    if effects := _passive(compiled, [joint], [0.0]):
        words = ", ".join(f"{name.replace('_', '')} {x:g}" for name, x in effects.items())
        item = compiled.item("joint", joint)
        item.refuse(
            f"it is a free joint with {words}, which change the accelerations of all bodies",
            "<freejoint/>, which takes no defaults",
        )


def _passive(compiled: Compiled, joints: Iterable[int], rests: list[float]) -> dict[str, Any]:
    """Return springs, dampers, rotors and dry friction, except those that are 0."""
    model = compiled.model
    every = list(joints)
    dofs = model.jnt_dofadr[every]
    sprung = not compiled.disabled("spring", "passive")
    damped = not compiled.disabled("damper", "passive")
    rubbed = not compiled.disabled("frictionloss", "constraint")
    values = {
        "stiffness": model.jnt_stiffness[every] * sprung,
        "rest_deg": rests,
        "damping": model.dof_damping[dofs] * damped,
        "armature": model.dof_armature[dofs],
        "friction_loss": model.dof_frictionloss[dofs] * rubbed,
    }
    return {name: one_or_each(map(tidy, value)) for name, value in values.items() if np.any(value)}


def _limits(compiled: Compiled, joint: int) -> list[float] | None:
    """Return the limits of a joint, counted from the neutral pose, or None."""
    model = compiled.model
    off = compiled.disabled("limit", "constraint")
    if off or not model.jnt_limited[joint]:
        return None
    lower, upper = map(float, model.jnt_range[joint])
    if int(model.jnt_type[joint]) == compiled.mujoco.mjtJoint.mjJNT_BALL:
        return None if upper >= np.pi else [0.0, upper]
    kept = [max(lower, -_UNLIMITED), min(upper, _UNLIMITED)]
    unlimited = kept == [-_UNLIMITED, _UNLIMITED]
    if kept != [lower, upper]:
        new = "none" if unlimited else f"{kept[0]:g} to {kept[1]:g}"
        name = str(compiled.item("joint", joint))
        compiled.refusals.change(name, f"limits {lower:g} to {upper:g} -> {new}")
    neutral = float(model.qpos0[model.jnt_qposadr[joint]])
    return None if unlimited else [limit - neutral for limit in kept]


def one_or_each(values: Iterable[Any]) -> Any:
    """Return the value that all axes have in common, or a list."""
    every = list(values)
    return every[0] if all(value == every[0] for value in every) else every


def add_tendons(root: Element, actuator: Element, creature: Creature) -> None:
    """Add the tendons and their motors."""
    if not creature.tendons:
        return
    bodies = [creature.bodies[i] for i in topological_order(creature)]
    hinges = [name for body in bodies for name in joint_names(body, creature.joint_of(body))]
    hinge_of = dict(zip(build_tree(creature).dof_names, hinges, strict=True))
    section = SubElement(root, "tendon")
    for tendon in creature.tendons:
        element = SubElement(section, "fixed", name=tendon.name)
        limited = tendon.upper < NO_LIMIT
        element.set("limited", "true" if limited else "false")
        if limited:
            element.set("range", number_text(tendon.lower, tendon.upper))
        effects = {
            "stiffness": tendon.stiffness,
            "damping": tendon.damping,
            "armature": tendon.armature,
            "frictionloss": tendon.friction_loss,
        }
        set_effects(element, effects)
        if tendon.stiffness:
            rest = [np.nextafter(x, 0.0) if x == _NEUTRAL else x for x in tendon.rest]
            element.set("springlength", number_text(*rest))
        for name, coefficient in tendon.joints:
            joint = SubElement(element, "joint", joint=hinge_of[name])
            joint.set("coef", number_text(coefficient))
        if tendon.actuator:
            add_motor(actuator, tendon.name, tendon.actuator, "tendon")


class ReadTendon(NamedTuple):
    """A tendon of the file.

    Attributes:
        name: its name.
        coefficients: coefficient of each joint, by MuJoCo's number.
        law: keys of its springs, limits and motor.
    """

    name: str
    coefficients: dict[int, float]
    law: dict[str, Any]


def read_tendons(
    compiled: Compiled,
    joints: Container[int],
    driven: Iterable[int],
    motors: Mapping[int, dict[str, Any]],
) -> list[ReadTendon]:
    """Return the tendons with an effect. Refused tendons are recorded.

    ``joints`` are those of the animal, ``driven`` those with a motor, and ``motors`` the motors of
    tendons, all by MuJoCo's numbers.
    """
    model, tendons, taken = compiled.model, [], set(driven)
    for number in range(model.ntendon):
        law, item = _law(compiled, number), compiled.item("tendon", number)
        if not law and number not in motors:
            compiled.refusals.leave_out("tendon without effect", str(item))
            continue
        with compiled.refusals.collecting():
            first, count = int(model.tendon_adr[number]), int(model.tendon_num[number])
            coefficients: dict[int, float] = {}
            for wrap in range(first, first + count):
                joint = int(model.wrap_objid[wrap])
                if int(model.wrap_type[wrap]) != compiled.mujoco.mjtWrap.mjWRAP_JOINT:
                    raise item.refusal("it runs through sites", "fixed tendons, over joints")
                if joint not in joints:
                    problem = "it acts on a joint that is not part of the animal"
                    raise item.refusal(problem, "its joints")
                old = coefficients.get(joint, 0.0)
                coefficients[joint] = tidy(old + float(model.wrap_prm[wrap]))
            coefficients = {joint: value for joint, value in coefficients.items() if value}
            if not coefficients:
                raise item.refusal("all its coefficients are 0", "one that is not 0")
            if number in motors:
                # The motor follows the command of a joint, as in `evo_cpg.creature.laws`.
                free = [joint for joint in coefficients if joint not in taken]
                taken.update(free[:1])
                if free:
                    law["actuator"] = motors[number]
                else:
                    item.refuse(
                        "it has a motor, but each of its joints has a motor or gives its command "
                        "to another tendon",
                        "a joint without a motor",
                    )
            if law:
                code = compiled.mujoco.mjtObj.mjOBJ_TENDON
                given = compiled.mujoco.mj_id2name(model, code, number)
                name = printed(given or f"tendon{number + 1}")
                tendons.append(ReadTendon(name, coefficients, law))
    return tendons


def _law(compiled: Compiled, number: int) -> dict[str, Any]:
    """Return the keys of a tendon with an effect."""
    model = compiled.model
    law: dict[str, Any] = {}
    neutral = float(model.tendon_length0[number])
    stiffness, damping = float(model.tendon_stiffness[number]), float(model.tendon_damping[number])
    if stiffness and not compiled.disabled("spring", "passive"):
        law["stiffness"] = tidy(stiffness)
        rest = [tidy(float(x) - neutral) for x in model.tendon_lengthspring[number]]
        if any(rest):
            law["rest"] = rest[0] if rest[0] == rest[1] else rest
    if damping and not compiled.disabled("damper", "passive"):
        law["damping"] = tidy(damping)
    armature = float(getattr(model, "tendon_armature", np.zeros(model.ntendon))[number])
    if armature:
        law["armature"] = tidy(armature)
    loss = float(model.tendon_frictionloss[number])
    if loss and not compiled.disabled("frictionloss", "constraint"):
        law["friction_loss"] = tidy(loss)
    if model.tendon_limited[number] and not compiled.disabled("limit", "constraint"):
        law["limits"] = [tidy(float(x)) for x in model.tendon_range[number] - neutral]
    return law
