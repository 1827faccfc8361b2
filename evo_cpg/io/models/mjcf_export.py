"""A creature and its world as a MuJoCo model (MJCF), without MuJoCo.

| here | in MJCF | table |
|---|---|---|
| body, in its working frame at the joint | ``body``; the root's stands at its centre | |
| shape and density | one ``geom``, centred at ``-child_anchor`` | `mjcf_shapes` |
| further part of a body, and welded body | a ``body`` without a joint | |
| mass and inertia in numbers | ``inertial`` | |
| joint | ``hinge``s, ``slide``s or a ``ball`` | `mjcf_joints` |
| root | a ``freejoint``; a root that hangs on the world has its own joints, or none | |
| motor | ``position`` or ``velocity`` | `mjcf_motors` |
| tendon | ``fixed`` tendon | `mjcf_joints` |
| ground | ``geom``s of the world | `mjcf_shapes` |
| buoyancy | ``gravcomp``: density of the water over that of the body | |
| friction of a body on the ground | a ``pair`` of the two geoms | |
| pair of bodies that push each other apart | a ``pair`` without friction (``condim`` 1) | |
| a start in another pose than the neutral one | a ``key`` named ``start`` | |

Masses, inertias, springs, dampers, rotors, motors, gravity and buoyancy are equal on both sides.
MJCF cannot hold drag, added mass and other force laws, the surface of the water, restitution,
sensors, or static friction that differs from dynamic friction. Joint limits and contacts have the
softness of MuJoCo's defaults.
"""

import itertools
from collections.abc import Sequence
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from evo_cpg.creature.algebra.rotation import euler_to_matrix
from evo_cpg.creature.creature import Body, Creature, topological_order
from evo_cpg.io.models.mjcf_joints import add_joints, add_tendons, joint_names
from evo_cpg.io.models.mjcf_motors import add_motor
from evo_cpg.io.models.mjcf_shapes import (
    add_ground,
    add_meshes,
    number_text,
    place_text,
    shape_attributes,
)
from evo_cpg.io.models.mujoco_state import ball_quaternion
from evo_cpg.io.models.refusals import ExchangeError
from evo_cpg.physics.contact.contact_model import Ground, combine
from evo_cpg.physics.water.water import Water

# Name of the keyframe that holds the initial pose.
_START = "start"

# Largest distance of a buoyancy from the centre of mass, as a fraction of the body's size.
_CENTRED = 1e-9


def mjcf_model(
    creature: Creature,
    gravity: float,
    ground: Ground | None = None,
    water: Water | None = None,
    start: tuple[float, float, float] = (0.0, 0.0, 0.0),
    heading: float = 0.0,
    time_step: float | None = None,
    pairs: Sequence[tuple[str, str]] = (),
    orientation: Sequence[float] | None = None,
    angles: Sequence[float] | None = None,
) -> Element:
    """Return the ``mujoco`` element of a creature in its world.

    Args:
        creature: the animal.
        gravity: gravity along -z, m/s^2.
        ground: ground that every body may touch.
        water: water whose buoyancy carries the bodies, unless it has a surface.
        start: initial place of the root's centre, m, or of the frame on which the root hangs.
        heading: initial turn of the root or that frame about z, rad.
        time_step: time step, s, or None for MuJoCo's own.
        pairs: names of bodies that push each other apart, without friction.
        orientation: initial orientation of a free root, unit quaternion (w, x, y, z), if the
            initial pose is not the neutral one.
        angles: angles of the joints in that pose, rad, in the order of the creature's `Tree`.

    Raises:
        CreatureError: the bodies do not form one tree.
        ExchangeError: MJCF cannot hold a shape or a part of the ground.
    """
    topological_order(creature)
    names = [body.name for body in creature.bodies]
    root = Element("mujoco", model=creature.name)
    SubElement(root, "compiler", angle="radian")
    # The servos are too stiff for MuJoCo's other integrators at our steps.
    option = SubElement(root, "option", gravity=number_text(0.0, 0.0, -gravity))
    option.set("integrator", "implicitfast")
    if time_step is not None:
        option.set("timestep", number_text(time_step))
    # A geom that a user adds collides with all of these geoms, which touch each other only as
    # pairs.
    default = SubElement(root, "default")
    SubElement(default, "geom", contype="0", conaffinity="1", condim="3")
    add_meshes(root, creature)
    place = SubElement(root, "worldbody")
    parts = add_ground(root, place, ground, names) if ground else []
    _add_bodies(place, creature, water, start, heading)
    contact = SubElement(root, "contact") if ground or pairs else None
    if ground and contact is not None:
        solid = [body for body in creature.bodies if body.shape.exists]
        for part, body in itertools.product(parts, solid):
            friction = combine(
                ground.friction_rule, body.material.dynamic_friction, ground.dynamic_friction
            )
            pair = SubElement(contact, "pair", geom1=part, geom2=body.name)
            pair.set("friction", number_text(friction, friction))
    for first, second in pairs:
        assert contact is not None
        SubElement(contact, "pair", geom1=first, geom2=second, condim="1")
    actuator = SubElement(root, "actuator")
    for body in creature.bodies:
        joint = creature.joint_of(body)
        if joint is None:
            continue
        names = joint_names(body, joint)
        for name, dof in zip(names, joint.dofs, strict=True):
            if dof.actuator:
                axis = dof.axis if dof.kind.at_once else None
                add_motor(actuator, name, dof.actuator, axis=axis)
    add_tendons(root, actuator, creature)
    if angles is not None:
        pose: dict[str, list[float]] = {}
        values = iter(angles)
        for body in (creature.bodies[i] for i in topological_order(creature)):
            joint = creature.joint_of(body)
            if joint is None:
                continue
            names, own = joint_names(body, joint), [next(values) for _ in joint.dofs]
            if joint.kind == "ball":
                turn = ball_quaternion(np.array(joint.axes, float).T, np.array(own))
                pose[names[0]] = turn.tolist()
            else:
                pose |= {name: [x] for name, x in zip(names, own, strict=True)}
        # MuJoCo orders joints as in the file, limb by limb. The tree orders them by depth.
        bends = [x for joint in place.iter("joint") for x in pose[joint.get("name", "")]]
        free = () if orientation is None else (*start, *orientation)
        keyframe = SubElement(root, "keyframe")
        SubElement(keyframe, "key", name=_START, qpos=number_text(*free, *bends))
    return root


def mjcf_text(model: Element) -> str:
    """Return the model as indented XML."""
    ElementTree.indent(model)
    return ElementTree.tostring(model, encoding="unicode") + "\n"


def _add_bodies(
    place: Element,
    creature: Creature,
    water: Water | None,
    start: tuple[float, float, float],
    heading: float,
) -> None:
    children: dict[str, list[Body]] = {}
    for body in creature.bodies:
        children.setdefault(body.joint.parent if body.joint else "", []).append(body)
    # Each body with the element around it, whose origin is ``parent_anchor`` in our frame of the
    # parent. Children join this list while it is read.
    bodies = [(place, children[""][0], (0.0, 0.0, 0.0))]
    for outer, body, parent_anchor in bodies:
        joint = creature.joint_of(body)
        own_anchor = joint.child_anchor if joint else (0.0, 0.0, 0.0)
        element = SubElement(outer, "body", name=body.name)
        if joint is None:
            element.set("pos", number_text(*start))
            if heading:
                element.set("euler", number_text(0.0, 0.0, heading))
        else:
            at, turn = np.subtract(joint.parent_anchor, parent_anchor), np.array(joint.orientation)
            if body.joint is None:
                ahead = euler_to_matrix(0.0, 0.0, heading)
                at, turn = start + ahead @ at, ahead @ turn
            element.set("pos", place_text(at))
            if not np.array_equal(turn, np.eye(3)):
                element.set("xyaxes", place_text(turn[:, :2].T.ravel()))
        if water is not None and water.surface is None:
            lift = _buoyancy(creature, body, water.density)
            if lift:
                element.set("gravcomp", number_text(lift))
        if joint is None:
            SubElement(element, "freejoint")
        else:
            add_joints(element, body, joint)
        if body.inertial is not None and body.inertial.mass:
            centre = place_text(np.subtract(body.inertial.centre, own_anchor))
            inertial = SubElement(element, "inertial", pos=centre)
            inertial.set("mass", number_text(body.inertial.mass))
            a, b, c = body.inertial.inertia
            inertial.set("fullinertia", number_text(a[0], b[1], c[2], a[1], a[2], b[2]))
        if body.shape.exists:
            geom = SubElement(element, "geom", {"name": body.name, **shape_attributes(body)})
            if any(own_anchor):
                geom.set("pos", place_text(np.negative(own_anchor)))
            if body.inertial is None:
                geom.set("density", number_text(body.material.density))
            else:
                geom.set("mass", "0")
            geom.set("friction", number_text(body.material.dynamic_friction))
            if body.color:
                red, green, blue = (int(body.color[i : i + 2], 16) / 255 for i in (1, 3, 5))
                geom.set("rgba", number_text(red, green, blue, 1.0))
        bodies += [(element, child, own_anchor) for child in children.get(body.name, [])]


def _buoyancy(creature: Creature, body: Body, density: float) -> float:
    """Return the buoyancy of a body over its weight, in deep water.

    Raises:
        ExchangeError: the body's buoyancy does not act at its centre of mass.
    """
    if body.inertial is None:
        return density / body.material.density
    if not body.inertial.mass:
        return 0.0
    volume, moment = body.shape.volume, np.zeros(3)
    for part in creature.bodies:
        if part.whole == body.name and part.joint is not None:
            turn = np.array(part.joint.orientation)
            place = part.joint.parent_anchor - turn @ np.array(part.joint.child_anchor)
            volume, moment = volume + part.shape.volume, moment + part.shape.volume * place
    off = moment / volume - body.inertial.centre if volume else np.zeros(3)
    if np.linalg.norm(off) > _CENTRED * np.linalg.norm(body.shape.half_extents):
        raise ExchangeError(
            f"body {body.name!r}: its buoyancy acts {np.linalg.norm(off):.3g} m from its centre of "
            "mass, but MuJoCo's gravcomp acts at the centre of mass"
        )
    return density * volume / body.inertial.mass
