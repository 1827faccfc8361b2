"""Fixed tendons of a creature as tendons of MJCF, and back: laws on a sum of joint angles.

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

from evo_cpg.creature.creature import NO_LIMIT, Creature, topological_order
from evo_cpg.creature.tree import build_tree
from evo_cpg.io.models.compiled import Compiled, printed, tidy
from evo_cpg.io.models.mjcf_ground import number_text, set_effects
from evo_cpg.io.models.mjcf_joints import joint_names
from evo_cpg.io.models.mjcf_motors import add_motor

# MuJoCo replaces the spring length -1 by the length in the neutral pose.
_NEUTRAL = -1.0


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

    def keys(self, names: Mapping[int, str]) -> dict[str, Any]:
        """Return its keys in the configuration.

        Args:
            names: name of the degree of freedom of each of MuJoCo's joints.
        """
        joints = {names[joint]: value for joint, value in self.coefficients.items()}
        return {"name": self.name, "joints": joints, **self.law}


def read_tendons(
    compiled: Compiled,
    joints: Container[int],
    driven: Iterable[int],
    motors: Mapping[int, dict[str, Any]],
) -> list[ReadTendon]:
    """Return the tendons with an effect. Refused tendons are recorded.

    Args:
        compiled: the model.
        joints: MuJoCo's numbers of the joints that the animal has.
        driven: MuJoCo's numbers of the joints with a motor.
        motors: keys of the motors, by MuJoCo's number of the tendon.
    """
    tendons, taken = [], set(driven)
    for number in range(compiled.model.ntendon):
        law, item = _law(compiled, number), compiled.item("tendon", number)
        if not law and number not in motors:
            compiled.refusals.leave_out("tendon without effect", str(item))
            continue
        with compiled.refusals.collecting():
            coefficients = _coefficients(compiled, number, joints)
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
                tendons.append(ReadTendon(_name(compiled, number), coefficients, law))
    return tendons


def _coefficients(compiled: Compiled, number: int, joints: Container[int]) -> dict[int, float]:
    """Return the coefficient of each joint of a tendon."""
    model, item = compiled.model, compiled.item("tendon", number)
    first, count = int(model.tendon_adr[number]), int(model.tendon_num[number])
    coefficients: dict[int, float] = {}
    for wrap in range(first, first + count):
        joint = int(model.wrap_objid[wrap])
        if int(model.wrap_type[wrap]) != compiled.mujoco.mjtWrap.mjWRAP_JOINT:
            raise item.refusal("it runs through sites", "fixed tendons, over joints")
        if joint not in joints:
            raise item.refusal("it acts on a joint that is not part of the animal", "its joints")
        old = coefficients.get(joint, 0.0)
        coefficients[joint] = tidy(old + float(model.wrap_prm[wrap]))
    coefficients = {joint: value for joint, value in coefficients.items() if value}
    if not coefficients:
        raise item.refusal("all its coefficients are 0", "one that is not 0")
    return coefficients


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


def _name(compiled: Compiled, number: int) -> str:
    mujoco, model = compiled.mujoco, compiled.model
    given = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_TENDON, number)
    return printed(given or f"tendon{number + 1}")
