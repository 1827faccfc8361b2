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
"""

from collections.abc import Iterable, Mapping
from typing import Any
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from evo_cpg.creature.algebra.rotation import matrix_to_euler
from evo_cpg.creature.creature import NO_LIMIT, Body, Joint, Muscle
from evo_cpg.io.models.compiled import Compiled, tidy, tidy_vector
from evo_cpg.io.models.mjcf_ground import number_text, place_text, set_effects
from evo_cpg.io.models.mjcf_shapes import Placed
from evo_cpg.io.models.refusals import ExchangeError

# Limits (rad or m) from which on a joint counts as unlimited.
_UNLIMITED = 1e4

# Largest distance of an axis from the joint's place, m, at which it counts as through it.
_AT_PLACE = 1e-12


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

    Args:
        compiled: the model.
        own: the body.
        parent: the body that carries it, or None for the world.
        motors: keys of the motors, by MuJoCo's number of the joint.
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
        limit, rest = _limits(compiled, joint), _rest(compiled, joint)
        if int(model.jnt_type[joint]) == kinds.mjJNT_BALL:
            keys["axes"] = "ball"
            limits.append(limit and tidy_vector(np.rad2deg(limit)))
            rests.append(0.0)
            continue
        direction = _axis(own.direction(np.array(data.xaxis[joint])))
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
    """Refuse springs, dampers, rotors and dry friction of a free joint, which a root cannot have.

    Args:
        compiled: the model.
        body: MuJoCo's number of the root.
    """
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


def _rest(compiled: Compiled, joint: int) -> float:
    """Return where the spring of a joint is relaxed, counted from the neutral pose."""
    model = compiled.model
    place = int(model.jnt_qposadr[joint])
    sprung = model.jnt_stiffness[joint] and not compiled.disabled("spring", "passive")
    return float(model.qpos_spring[place] - model.qpos0[place]) if sprung else 0.0


def one_or_each(values: Iterable[Any]) -> Any:
    """Return the value that all axes have in common, or a list."""
    every = list(values)
    return every[0] if all(value == every[0] for value in every) else every


def _axis(vector: list[float]) -> str | list[float]:
    for name, unit in zip("xyz", np.eye(3), strict=True):
        for sign, word in ((1.0, name), (-1.0, f"-{name}")):
            if np.array_equal(vector, sign * unit):
                return word
    return vector
