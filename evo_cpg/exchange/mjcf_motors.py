"""Motors of joints as actuators of MJCF, and back.

| here | in MJCF |
|---|---|
| motor with a spring | ``position``: ``kp`` is its stiffness, ``kv`` its gain |
| motor without a spring | ``velocity``: ``kv`` is its gain |
| torque limit | ``forcerange`` |
| torque motor | ``motor``: ``gear`` is its gear |
| velocity servo with the caller's gain | ``motor`` with limits, in the import on request |
| muscles | ``motor``: ``gear`` is their strength, the command is ML - MR |

The passive stiffness and damping of muscles are those of the hinge. MJCF leaves out the stiffness
of active muscles and Hill's law.
"""

from collections.abc import Container
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from evo_cpg.config.schema.joint import ActuatorConfig, TorqueMotorConfig
from evo_cpg.config.schema.section import LARGEST
from evo_cpg.creature.creature import Actuator, Muscle, TorqueMotor
from evo_cpg.exchange.compiled import TOLERANCE, Compiled, tidy
from evo_cpg.exchange.mjcf_ground import number_text

# Motors that an import makes.
Driver = ActuatorConfig | TorqueMotorConfig

# Number of actuator groups that MuJoCo can disable.
_GROUPS = 31


def add_motor(
    actuator: Element, name: str, motor: Actuator | TorqueMotor | Muscle, of: str = "joint"
) -> None:
    """Add the motor or the muscles of a hinge, or the motor of a tendon.

    Args:
        actuator: the section of actuators.
        name: name of the hinge or the tendon.
        motor: motor or muscles.
        of: kind of the driven part, ``joint`` or ``tendon``.
    """
    driven = {"name": name, of: name}
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
    if np.isfinite(limit):
        element.set("forcerange", number_text(-limit, limit))


def read_motors(compiled: Compiled, motor_gain: float | None) -> dict[int, Driver | None]:
    """Return the motor of every driven joint, or None for a refused motor, which is recorded."""
    motors: dict[int, Driver | None] = {}
    for number in range(len(compiled.model.actuator_trnid)):
        with compiled.refusals.collecting():
            joint = _driven_joint(compiled, number, motors)
            motors[joint] = None
            motors[joint] = _read_motor(compiled, number, joint, motor_gain)
    return motors


def _driven_joint(compiled: Compiled, number: int, driven: Container[int]) -> int:
    """Return the hinge that an actuator drives."""
    model, item = compiled.model, compiled.item("actuator", number)
    joint, group = int(model.actuator_trnid[number, 0]), int(model.actuator_group[number])
    if 0 <= group < _GROUPS and model.opt.disableactuator >> group & 1:
        problem = f"actuatorgroupdisable disables its group, {group}"
        raise item.refusal(problem, "an enabled group")
    on_joint = int(model.actuator_trntype[number]) == compiled.mujoco.mjtTrn.mjTRN_JOINT
    if not on_joint or int(model.jnt_type[joint]) != compiled.mujoco.mjtJoint.mjJNT_HINGE:
        raise item.refusal("it drives no hinge", "joint=, a hinge")
    if joint in driven:
        driven_one = compiled.item("joint", joint)
        raise item.refusal(f"it is the second actuator of {driven_one}", "one")
    return joint


def _read_motor(compiled: Compiled, number: int, joint: int, motor_gain: float | None) -> Driver:
    """Read one motor. The gear scales the angle and multiplies the force."""
    mujoco, model, item = compiled.mujoco, compiled.model, compiled.item("actuator", number)
    gear = float(model.actuator_gear[_place(compiled, "out", number), 0])
    strength = float(model.actuator_gainprm[number, 0])
    offset, stiffness, damping = (-model.actuator_biasprm[number, :3]).tolist()
    affine = int(model.actuator_biastype[number]) == mujoco.mjtBias.mjBIAS_AFFINE
    simple = (
        gear != 0
        and (affine or int(model.actuator_biastype[number]) == mujoco.mjtBias.mjBIAS_NONE)
        and int(model.actuator_dyntype[number]) == mujoco.mjtDyn.mjDYN_NONE
        and int(model.actuator_gaintype[number]) == mujoco.mjtGain.mjGAIN_FIXED
    )
    follows = offset == 0 and stiffness >= 0 and strength == (stiffness or damping)
    if not simple or (affine and not follows):
        raise item.refusal(
            "its law is not a servo's",
            "position, velocity, motor, without actuator dynamics",
        )
    limits = [
        (gear * model.actuator_forcerange[number], model.actuator_forcelimited[number]),
        (model.jnt_actfrcrange[joint], model.jnt_actfrclimited[joint]),
    ]
    if not affine:
        command = gear * strength * model.actuator_ctrlrange[_place(compiled, "ctrl", number)]
        limits.append((command, _limits_commands(compiled, number)))
    elif not damping > 0:
        raise item.refusal("it has no damping", "a kv of more than 0")
    else:
        # The square of the gear could overflow.
        gain, stiffness = (gear * (gear * value) for value in (damping, stiffness))
    torques = [torque for torque, given in limits if given and not _boundless(torque)]
    if not affine and motor_gain is not None and not torques:
        # The servo's limit is the largest torque of the motor.
        raise item.refusal("it has no limits", "ctrlrange or forcerange")
    for lower, upper in torques:
        if not np.isclose(-lower, upper, rtol=TOLERANCE):
            raise item.refusal(
                f"its limits {lower:g} and {upper:g} differ in size", "limits of equal size"
            )
    limit = tidy(min(abs(float(upper)) for _, upper in torques)) if torques else None
    if not affine:
        if motor_gain is None:
            values = {"type": "torque", "gear": tidy(gear * strength), "torque_limit": limit}
            return item.section(TorqueMotorConfig, values)
        gain, stiffness = motor_gain, 0.0
    values = {"gain": tidy(gain), "stiffness": tidy(stiffness), "torque_limit": limit}
    return item.section(ActuatorConfig, values)


def command_ranges(compiled: Compiled) -> list[int]:
    """Return the numbers of servos whose commands have limits. Our servos lack such limits."""
    model = compiled.model
    affine = model.actuator_biastype == compiled.mujoco.mjtBias.mjBIAS_AFFINE
    return [i for i in range(len(affine)) if affine[i] and _limits_commands(compiled, i)]


def _limits_commands(compiled: Compiled, number: int) -> bool:
    limited = bool(compiled.model.actuator_ctrllimited[_place(compiled, "ctrl", number)])
    return limited and not compiled.disabled("clampctrl")


def _place(compiled: Compiled, what: str, number: int) -> int:
    """Return the place of an actuator's first command or output (one of each in older models)."""
    places = getattr(compiled.model, f"actuator_{what}adr", None)
    return number if places is None else int(places[number])


def _boundless(torque: np.ndarray) -> bool:
    """Return whether both limits exceed the largest torque limit that a creature can have."""
    return bool(torque.min() < -LARGEST and torque.max() > LARGEST)
