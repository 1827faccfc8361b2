"""Motors of joints as actuators of MJCF, and back.

| here | in MJCF |
|---|---|
| motor with a spring | ``position``: ``kp`` is its stiffness, ``kv`` its gain |
| motor without a spring | ``velocity``: ``kv`` is its gain |
| torque limit | ``forcerange`` |
| torque motor | ``motor``: ``gear`` is its gear |
| velocity servo with the caller's gain | ``motor`` with limits, in the import on request |
| motor of a tendon | the same, with ``tendon`` |
| muscles | ``motor``: ``gear`` is their strength, the command is ML - MR |

A command has another meaning here: the target of a ``general`` with an affine bias is an angle or a
rate, whatever its gain. Time constants of actuators and limits of servos' commands are left out.

The passive stiffness and damping of muscles are those of the hinge. MJCF leaves out the stiffness
of active muscles and Hill's law.
"""

from typing import Any
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from evo_cpg.creature.algebra.numerics import Triple
from evo_cpg.creature.creature import Actuator, Muscle, TorqueMotor
from evo_cpg.io.models.compiled import TOLERANCE, Compiled, tidy
from evo_cpg.io.models.mjcf_shapes import number_text
from evo_cpg.io.schema.section import LARGEST

# Number of actuator groups that MuJoCo can disable.
_GROUPS = 31


def add_motor(
    actuator: Element,
    name: str,
    motor: Actuator | TorqueMotor | Muscle,
    of: str = "joint",
    axis: Triple | None = None,
) -> None:
    """Add the motor or the muscles of an axis, or the motor of a tendon.

    Args:
        actuator: the section of actuators.
        name: name of the MJCF joint or the tendon.
        motor: motor or muscles.
        of: kind of the driven part, ``joint`` or ``tendon``.
        axis: axis of a ball that the motor turns, or None for a part with one coordinate.
    """
    own = name if axis is None else f"{name}.{'xyz'[int(np.abs(axis).argmax())]}"
    driven = {"name": own, of: name}
    if isinstance(motor, Muscle):
        element = SubElement(actuator, "motor", driven)
        element.set("gear", number_text(motor.strength))
        element.set("ctrlrange", number_text(-1.0, 1.0))
        return
    limit = motor.torque_limit
    if isinstance(motor, TorqueMotor):
        # MuJoCo limits the force before the gear.
        limit = limit / abs(motor.gear)
        element = SubElement(actuator, "motor", driven)
        element.set("gear", number_text(motor.gear))
    else:
        kind = "position" if motor.stiffness else "velocity"
        element = SubElement(actuator, kind, driven)
        if motor.stiffness:
            element.set("kp", number_text(motor.stiffness))
        element.set("kv", number_text(motor.gain))
    if axis is not None:
        gear = motor.gear if isinstance(motor, TorqueMotor) else 1.0
        element.set("gear", number_text(*(gear * x for x in axis)))
    if np.isfinite(limit):
        element.set("forcerange", number_text(-limit, limit))


def read_motors(
    compiled: Compiled, motor_gain: float | None
) -> tuple[dict[int, dict[str, Any]], dict[int, dict[str, Any]]]:
    """Return the keys of the motors, by joint and by tendon. Refused motors are recorded."""
    of_joints: dict[int, dict[str, Any]] = {}
    of_tendons: dict[int, dict[str, Any]] = {}
    model, kinds = compiled.model, compiled.mujoco.mjtTrn
    of_one_coordinate = compiled.mujoco.mjtJoint.mjJNT_HINGE, compiled.mujoco.mjtJoint.mjJNT_SLIDE
    if compiled.disabled("actuation"):
        if count := len(model.actuator_trnid):
            compiled.refusals.leave_out(f"{count} actuator{'s' if count > 1 else ''}")
        return of_joints, of_tendons
    for number in range(len(model.actuator_trnid)):
        with compiled.refusals.collecting():
            item, group = compiled.item("actuator", number), int(model.actuator_group[number])
            if 0 <= group < _GROUPS and model.opt.disableactuator >> group & 1:
                problem = f"actuatorgroupdisable disables its group, {group}"
                raise item.refusal(problem, "an enabled group")
            transmission = int(model.actuator_trntype[number])
            target = int(model.actuator_trnid[number, 0])
            on_joint = transmission in (kinds.mjTRN_JOINT, kinds.mjTRN_JOINTINPARENT)
            if transmission == kinds.mjTRN_TENDON:
                kind = "tendon"
            elif on_joint and int(model.jnt_type[target]) in of_one_coordinate:
                kind = "joint"
            else:
                raise item.refusal("it drives no hinge, slide or tendon", "joint= or tendon=")
            motors = of_joints if kind == "joint" else of_tendons
            if target in motors:
                driven = compiled.item(kind, target)
                item.refuse(f"it is the second actuator of {driven}", "one")
                continue
            motors[target] = _read_motor(compiled, number, kind, target, motor_gain)
    # The joints of a URDF that have an effort get torque motors.
    for joint in range(model.njnt) if compiled.urdf else ():
        effort = float(model.jnt_actfrcrange[joint, 1])
        limited = model.jnt_actfrclimited[joint] and 0 < effort < LARGEST
        if limited and int(model.jnt_type[joint]) in of_one_coordinate:
            motor = {"type": "torque", "gear": tidy(effort), "torque_limit": tidy(effort)}
            of_joints[joint] = motor
    _refuse_shared_limits(compiled, of_joints, of_tendons)
    return of_joints, of_tendons


def _read_motor(
    compiled: Compiled, number: int, kind: str, target: int, motor_gain: float | None
) -> dict[str, Any]:
    """Read one motor. The gear scales the angle and multiplies the force."""
    mujoco, model, item = compiled.mujoco, compiled.model, compiled.item("actuator", number)
    gear = float(model.actuator_gear[_place(compiled, "out", number), 0])
    strength = float(model.actuator_gainprm[number, 0])
    offset, stiffness, damping = (-model.actuator_biasprm[number, :3]).tolist()
    affine = int(model.actuator_biastype[number]) == mujoco.mjtBias.mjBIAS_AFFINE
    if not affine:
        offset = stiffness = damping = 0.0
    dynamics, kinds = int(model.actuator_dyntype[number]), mujoco.mjtDyn
    filters = kinds.mjDYN_FILTER, kinds.mjDYN_FILTEREXACT
    simple = (
        (affine or int(model.actuator_biastype[number]) == mujoco.mjtBias.mjBIAS_NONE)
        and dynamics in (kinds.mjDYN_NONE, kinds.mjDYN_INTEGRATOR, *filters)
        and int(model.actuator_gaintype[number]) == mujoco.mjtGain.mjGAIN_FIXED
    )
    if not simple:
        raise item.refusal(
            "its law is not linear",
            "motor, position, velocity, intvelocity, or general with fixed gain and affine bias",
        )
    if gear == 0 or strength == 0:
        raise item.refusal("its gear or gain is 0", "a gear and a gain other than 0")
    if stiffness < 0 or damping < 0:
        raise item.refusal("it pushes away from its target", "a bias that is not positive")
    servo = stiffness > 0 or damping > 0
    if offset and not servo:
        raise item.refusal("it has a constant force", "a bias of 0, or a stiffness")
    limit = _torque_limit(compiled, number, kind, target, not servo)
    if dynamics == kinds.mjDYN_INTEGRATOR:
        compiled.refusals.leave_out("integration of the command", str(item))
    elif dynamics != kinds.mjDYN_NONE:
        compiled.refusals.leave_out("time constant", str(item))
    if servo:
        for word, _ in _command_limits(compiled, number):
            compiled.refusals.leave_out(word, str(item))
        # The square of the gear could overflow.
        gain, spring = (gear * (gear * value) for value in (damping, stiffness))
        keys: dict[str, Any] = {"gain": tidy(gain), "torque_limit": limit}
        return keys | ({"stiffness": tidy(spring)} if spring else {})
    if motor_gain is None:
        return {"type": "torque", "gear": tidy(gear * strength), "torque_limit": limit}
    if limit is None:
        # The servo's limit is the largest torque of the motor.
        raise item.refusal("it has no limits", "ctrlrange or forcerange")
    return {"gain": motor_gain, "torque_limit": limit}


def _torque_limit(
    compiled: Compiled, number: int, kind: str, target: int, commanded: bool
) -> float | None:
    """Return the largest force of a motor, or None. Report limits of unequal size as changed.

    MuJoCo limits the force of an actuator and of a tendon before the gear multiplies it, but the
    force on a joint after that.

    The part ``target`` of a kind (``joint`` or ``tendon``) is driven. If ``commanded``, the command
    is the force, so that its limits count.
    """
    model, item = compiled.model, compiled.item("actuator", number)
    gear = float(model.actuator_gear[_place(compiled, "out", number), 0])
    ranges = []
    if model.actuator_forcelimited[number]:
        ranges.append(gear * model.actuator_forcerange[number])
    prefix, lever = ("jnt", 1.0) if kind == "joint" else ("tendon", gear)
    if (
        hasattr(model, f"{prefix}_actfrcrange")
        and getattr(model, f"{prefix}_actfrclimited")[target]
    ):
        ranges.append(lever * getattr(model, f"{prefix}_actfrcrange")[target])
    if commanded:
        strength = gear * float(model.actuator_gainprm[number, 0])
        ranges += [strength * limits for _, limits in _command_limits(compiled, number)]
    if not ranges:
        return None
    lower = max(float(min(torque)) for torque in ranges)
    upper = min(float(max(torque)) for torque in ranges)
    largest = max(abs(lower), abs(upper))
    if not largest > 0:
        raise item.refusal("its limits are 0", "a limit above 0")
    limit = None if largest > LARGEST else tidy(largest)
    if min(-lower, upper) <= LARGEST and not np.isclose(-lower, upper, rtol=TOLERANCE):
        new = "no limits" if limit is None else f"{-limit:g} and {limit:g}"
        words = f"its force limits, {lower:g} and {upper:g} (N m or N), become {new}"
        compiled.refusals.change(str(item), words)
    return limit


def _refuse_shared_limits(
    compiled: Compiled, of_joints: dict[int, dict[str, Any]], of_tendons: dict[int, dict[str, Any]]
) -> None:
    """Refuse joints whose limit would cut the force of the motors of tendons."""
    model = compiled.model
    if not hasattr(model, "jnt_actfrcrange"):
        return
    largest: dict[int, float] = {}
    for tendon, motor in of_tendons.items():
        # Without a limit the force may be infinite.
        force = motor["torque_limit"] or np.inf
        first = int(model.tendon_adr[tendon])
        for wrap in range(first, first + int(model.tendon_num[tendon])):
            if int(model.wrap_type[wrap]) == compiled.mujoco.mjtWrap.mjWRAP_JOINT:
                joint = int(model.wrap_objid[wrap])
                own = (of_joints[joint]["torque_limit"] or np.inf) if joint in of_joints else 0.0
                lever = abs(float(model.wrap_prm[wrap]))
                largest[joint] = largest.get(joint, own) + lever * force
    for joint, force in largest.items():
        lower, upper = map(float, model.jnt_actfrcrange[joint])
        limited = model.jnt_actfrclimited[joint] and min(-lower, upper) < LARGEST
        if limited and force > min(-lower, upper) * (1 + TOLERANCE):
            compiled.item("joint", joint).refuse(
                "its actuatorfrcrange limits the force of a tendon's motor",
                "a forcerange of the actuator",
            )


def _command_limits(compiled: Compiled, number: int) -> list[tuple[str, np.ndarray]]:
    """Return the attributes that limit the command of an actuator, and the limits."""
    model, dynamics = compiled.model, compiled.mujoco.mjtDyn
    found = []
    place, kind = _place(compiled, "ctrl", number), int(model.actuator_dyntype[number])
    limited = model.actuator_ctrllimited[place] and not compiled.disabled("clampctrl")
    # The command of an integrator is a rate, so its limits do not limit the force.
    if limited and kind != dynamics.mjDYN_INTEGRATOR:
        found.append(("ctrlrange", model.actuator_ctrlrange[place]))
    if kind != dynamics.mjDYN_NONE and model.actuator_actlimited[number]:
        found.append(("actrange", model.actuator_actrange[number]))
    return found


def _place(compiled: Compiled, what: str, number: int) -> int:
    """Return the place of an actuator's first command or output (one of each in older models)."""
    places = getattr(compiled.model, f"actuator_{what}adr", None)
    return number if places is None else int(places[number])
