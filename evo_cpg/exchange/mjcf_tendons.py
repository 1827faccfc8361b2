"""Fixed tendons of a creature as tendons of MJCF.

| here | in MJCF |
|---|---|
| joints and coefficients | ``joint`` elements of a ``fixed`` tendon |
| stiffness, damping, armature, friction loss | the same attribute |
| lengths at which the spring is relaxed | ``springlength`` |
| limits | ``range``, or none |
| motor | an actuator with ``tendon``, as in `mjcf_motors` |
"""

from xml.etree.ElementTree import Element, SubElement

import numpy as np

from evo_cpg.creature.creature import NO_LIMIT, Creature, topological_order
from evo_cpg.creature.tree import build_tree
from evo_cpg.exchange.mjcf_ground import number_text
from evo_cpg.exchange.mjcf_joints import joint_names
from evo_cpg.exchange.mjcf_motors import add_motor

# MuJoCo replaces the spring length -1 by the length in the neutral pose.
_NEUTRAL = -1.0


def add_tendons(root: Element, actuator: Element, creature: Creature) -> None:
    """Add the tendons and their motors."""
    if not creature.tendons:
        return
    hinges = [name for i in topological_order(creature) for name in joint_names(creature.bodies[i])]
    hinge_of = dict(zip(build_tree(creature).dof_names, hinges, strict=True))
    section = SubElement(root, "tendon")
    for tendon in creature.tendons:
        element = SubElement(section, "fixed", name=tendon.name)
        limited = tendon.upper < NO_LIMIT
        element.set("limited", "true" if limited else "false")
        if limited:
            element.set("range", number_text(tendon.lower, tendon.upper))
        values = {
            "stiffness": tendon.stiffness,
            "damping": tendon.damping,
            "armature": tendon.armature,
            "frictionloss": tendon.friction_loss,
        }
        for key, value in values.items():
            if value:
                element.set(key, number_text(value))
        if tendon.stiffness:
            rest = [np.nextafter(x, 0.0) if x == _NEUTRAL else x for x in tendon.rest]
            element.set("springlength", number_text(*rest))
        for name, coefficient in tendon.joints:
            joint = SubElement(element, "joint", joint=hinge_of[name])
            joint.set("coef", number_text(coefficient))
        if tendon.actuator:
            add_motor(actuator, tendon.name, tendon.actuator, "tendon")
