"""Rules about bodies and joints: lengths in wrong units, positions, limits, motors."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from evo_cpg.creature.algebra.numerics import Triple
from evo_cpg.creature.axis_kinds import SPANNING, Turn
from evo_cpg.creature.creature import Body, Joint, Muscle, TorqueMotor
from evo_cpg.creature.cylinder import Cylinder
from evo_cpg.creature.shapes import Capsule
from evo_cpg.io.errors import Key
from evo_cpg.io.lint.rule import Case, Jointed, LintWarning, rule
from evo_cpg.io.schema.joint import MuscleConfig, TorqueMotorConfig
from evo_cpg.io.schema.typical import ROUNDING, SOLID, TURN, Direction

# Range of the longest edge of a body, from the limb of a small insect to a whale, m.
_BODIES = (0.001, 30.0)

# Largest ratio of a body's size to the median of all bodies, either way, and the smallest number of
# bodies for a meaningful median.
_UNLIKE, _SEVERAL = 50.0, 3

# Largest ratio of the mass of a limb to the body that carries it, and of the mass of a creature to
# its lightest body. In float32 the motion was right at ratios of 8000 and 1e12, but became infinite
# at 37,000 and 1e15.
_CARRIES, _LIGHTER = 5000.0, 1e12

# Smallest rotation of its own body that a motor must achieve in a trial, degrees.
_LEAST_TURN = 1.0

# Largest distance of a position outside its body, as a fraction of the body's largest half extent.
# Joints have gaps between bodies, and eyes stand on stalks.
_OUT = 0.3

# Smallest density of bodies on dry land, such as inflated bodies and hollow robots, kg/m^3. In
# water such bodies would float like corks, so a wrong unit is more likely.
_AIRY = 3.0

# Largest ratio of an animal's mass to the mass of the water it displaces, either way, for which
# water without a bottom or a surface is plausible. Fish without a swim bladder have 1.08.
_FLOATS = 1.2

# A joint is at an end of its body if its distance from the body's centre is at least `_END` of the
# half extent in that direction. It is at the parent's surface if it is less deep than `_INSIDE` of
# the parent's smallest half extent. The body's centre is inside the parent if it is deeper than
# `_INSIDE` of its distance from the joint.
_END, _INSIDE = 0.75, 0.1

# Smallest angle between successive bodies of a row, degrees, for a warning. The row curls up into a
# ring.
_CURLS = 45.0


@rule
def body_size(case: Case) -> Iterator[LintWarning]:
    """Warn of bodies that are very large, very small, or unlike the median of all bodies."""
    shaped = [each for each in case.bodies() if each[1].shape is not None]
    edges = [2 * float(body.shape.half_extents.max()) for *_, body in shaped]
    middle = float(np.median(edges)) if edges else 0.0
    low, high = _BODIES
    for (key, entry, _), edge in zip(shaped, edges, strict=True):
        if not low <= edge <= high:
            likely = f"In mm it would be {edge / 1000:g} m, in cm {edge / 100:g} m"
            if edge < low:
                likely = "Is it in km, or divided by 1000 twice?"
            problem = f"a body of {edge:g} m. Plausible: {low:g} to {high:g} m. {likely}"
        elif len(edges) >= _SEVERAL and not 1 / _UNLIKE <= edge / middle <= _UNLIKE:
            problem = (
                f"a body of {edge:g} m, but the median is {middle:g} m. Plausible: up to "
                f"{_UNLIKE:g} times larger or smaller. Is it in another unit than m?"
            )
        else:
            continue
        # A mesh has no key for its size.
        size = entry.shape.size_key if entry.shape else None
        place = (*key, "shape", size) if size else (*key, "shape")
        yield case.warning(place, problem, None if size else "mesh")


@rule
def masses(case: Case) -> Iterator[LintWarning]:
    """Warn of bodies that carry a far heavier limb, or are too light for the creature."""
    bodies = case.creature.bodies
    mass = {body.name: 0.0 for body in bodies}
    for body in bodies:
        mass[body.whole or body.name] += float(body.mass)
    parents = {body.name: body.joint.parent for body in bodies if body.joint is not None}
    carried = dict(mass)
    for name in mass:
        above = parents.get(name)
        while above is not None:
            carried[above] += mass[name]
            above = parents.get(above)
    total = sum(mass.values())
    for key, _, body in case.bodies():
        own, above = mass[body.name], parents.get(body.name)
        if above is not None and mass[above] > 0 and carried[body.name] > _CARRIES * mass[above]:
            yield case.warning(
                (*key, "joint", "parent"),
                f"a body of {mass[above]:.2g} kg carries a limb of {carried[body.name]:.2g} kg. "
                f"float32 resolves up to {_CARRIES:g} times the body's mass. Make the heavier "
                "body the parent",
            )
        # A body without a mass of its own is welded to another one, or fixed.
        if total > _LIGHTER * own > 0:
            yield case.warning(
                (*key, "material"),
                f"a body of {own:.2g} kg on a creature of {total:.2g} kg. float32 resolves down to "
                f"{1 / _LIGHTER:g} of the creature's mass. Is a size in another unit than m?",
            )


@rule
def densities(case: Case) -> Iterator[LintWarning]:
    """Warn of densities that are probably in another unit, if they give a body its mass."""
    low = SOLID.low if case.config.world.water else _AIRY
    weighed = [body for body in case.config.creature.bodies if body.mass is None]
    used = {part.material for body in weighed for part in (body, *body.parts)}
    for name, material in case.config.creature.materials.items():
        problem = SOLID.problem(material.density)
        if problem and name in used and not low <= material.density <= SOLID.high:
            yield case.warning(("creature", "materials", name, "density"), problem)


@rule
def weight_in_water(case: Case) -> Iterator[LintWarning]:
    """Warn of an animal that only sinks, because there is no ground, or rises without a surface."""
    world, water = case.config.world, case.config.world.water
    if not (water and world.gravity) or world.forces or case.creature.root_joint is not None:
        return
    volume = sum(float(body.shape.volume) for body in case.creature.bodies)
    if not volume:
        return
    ratio = float(case.creature.mass) / (water.density * volume)
    if ratio > _FLOATS and world.ground is None:
        happens, cure = "sinks from start to end", "Give the world a ground (ground: {})"
    elif ratio < 1 / _FLOATS and water.surface is None:
        happens, cure = "rises from start to end", "Give the water a surface (surface: 0)"
    else:
        return
    key, heaviest, _ = max(case.bodies(), key=lambda found: float(found[2].mass))
    place = (*key, "mass")
    if heaviest.mass is None:
        place = "creature", "materials", heaviest.material, "density"
    yield case.warning(
        place,
        f"the animal has {ratio:.2g} times the mass of the water that it displaces, so it "
        f"{happens}. {cure}, or the animal the density of the water ({water.density:g} kg/m^3)",
    )


@rule
def joint_limits(case: Case) -> Iterator[LintWarning]:
    """Warn of limits in radians, beyond a full turn, or that exclude the neutral pose."""
    joints = [(joint, list(filter(None, joint.given.limits))) for joint in case.joints()]
    all_small = all(np.abs(limits).max() <= np.pi + ROUNDING for _, limits in joints if limits)
    for joint, limits in joints:
        for lower, upper in limits:
            widest = max(abs(lower), abs(upper))
            if widest <= np.pi + ROUNDING and _in_radians((lower, upper), all_small):
                problem = (
                    f"the joint turns by at most {widest:g} degrees. Plausible: 5 to 180. If it "
                    f"is in radians, write {np.rad2deg(widest):.3g}"
                )
            elif widest > TURN + ROUNDING:
                problem = (
                    f"the joint turns by {widest:g} degrees. Plausible: up to {TURN:g}. If it was "
                    f"converted twice, write {np.deg2rad(widest):.3g}"
                )
            elif lower > 0 or upper < 0:
                problem = "the neutral pose, 0 degrees, is beyond the limits, which jerk the joint"
            else:
                continue
            yield case.warning((*joint.key, "limits_deg"), problem)
            break


def _in_radians(limits: tuple[float, float], all_small: bool) -> bool:
    """Return whether limits within 3.14 degrees are probably in radians.

    Common angles in radians, such as 1.57, probably are. Other limits are so only if no joint of
    the animal turns farther, and if they are short fractions, such as 0.5, as written by hand. A
    stiff joint may have limits of 2 degrees, and degrees computed from radians have more digits.
    """
    if Direction().problem(limits):
        return True
    by_hand = all(each == round(each, 2) for each in limits)
    return all_small and by_hand and any(each != round(each) for each in limits)


@rule
def folded(case: Case) -> Iterator[LintWarning]:
    """Warn of bodies that lie inside their parent, because a position has the wrong sign."""
    for joint in case.joints():
        parent, built = joint.parent, joint.built
        if parent is None or not joint.body.shape.exists:
            continue
        own = np.array(built.child_anchor)
        arm = np.array(built.orientation) @ own
        # Vertebrae and shoulders may lie inside their parent, but then their joints do, too.
        at_end = own @ own >= _END * np.abs(own) @ _reach(case, joint.body)
        depth = _gap(case, parent, built.parent_anchor)
        at_end = at_end and depth > -_INSIDE * _reach(case, parent).min()
        inside, flipped = (_gap(case, parent, built.parent_anchor + x) for x in (-arm, arm))
        if at_end and inside < -_INSIDE * np.linalg.norm(own) and flipped > 0:
            yield case.warning(
                (*joint.key, "child_at"),
                f"the centre of {joint.body.name!r} lies {-inside:.2g} m inside {parent.name!r}, "
                "its parent, so the animal is folded into itself. child_at is the joint's position "
                "in the body's own frame. Change the sign of one of its numbers, or of one of at",
            )


@rule
def axes_in_a_plane(case: Case) -> Iterator[LintWarning]:
    """Warn of three axes at one place that reach a common plane, without a rotor among them."""
    for joint in case.joints():
        built = joint.built
        pure = all(dof.kind == Turn() and not any(dof.place) for dof in built.dofs)
        if len(built.axes) != SPANNING or not pure or built.kind == "turns":
            continue
        if not any(dof.armature for dof in built.dofs):
            yield case.warning(
                (*joint.key, "axes"),
                "the middle axis can turn until the three axes lie within 5 degrees of one plane. "
                "Near it the joint spins up under any torque. Give it an armature, narrower limits "
                "for the middle axis, or axes: ball",
            )


@rule
def postures(case: Case) -> Iterator[LintWarning]:
    """Warn of posture angles that may be in radians. These keys lack ``_deg`` but are degrees."""
    # Pyright cannot follow a class that is created at import.
    given: Any = case.config.controller
    if given.type != "postures":
        return
    # The limit avoids an overflow. Too many bits are rejected later.
    reach = given.angle_step * (2.0 ** min(given.bits_per_joint, 60) - 1)
    if reach <= 2 * np.pi:
        yield case.warning(
            ("controller", "angle_step"),
            f"all angles of a joint lie within {reach:.3g} degrees. Plausible: 10 to 180. If the "
            f"step is in radians, write {np.rad2deg(given.angle_step):.3g}",
        )
    for name in ("lowest_angle", "neutral_angle"):
        angle = getattr(given, name)
        if 0 < abs(angle) <= 2 * np.pi and angle != round(angle):
            yield case.warning(
                ("controller", name),
                "angles of postures are in degrees, and 180 is straight by default. If it is in "
                f"radians, write {np.rad2deg(angle):.3g}",
            )


@rule
def no_motor(case: Case) -> Iterator[LintWarning]:
    """Warn if no joint and no tendon has a motor."""
    joints = list(case.joints())
    if any(tendon.actuator for tendon in case.config.creature.tendons):
        return
    if joints and all(motor is None for joint in joints for motor in joint.given.motors):
        first = next((joint for joint in joints if joint.parent is not None), joints[0])
        yield case.warning(
            (*first.key, "actuator"),
            "no joint has a motor, so the controller moves nothing. Give joints a motor, such as "
            "actuator: {gain: 1}",
        )


@rule
def no_rate(case: Case) -> Iterator[LintWarning]:
    """Warn of a `rate_gain` of 0, with which the controller moves no joint."""
    # Pyright cannot follow a class that is created at import.
    given: Any = case.config.controller
    rateless = MuscleConfig, TorqueMotorConfig
    driven = any(isinstance(x, rateless) for joint in case.joints() for x in joint.given.motors)
    if given.type == "brain_cpg" and given.rate_gain == 0 and not driven:
        yield case.warning(
            ("controller", "rate_gain"),
            "the rhythm sets a rate of 0 for every joint, so the animal stays in its neutral pose. "
            "Plausible: 1 to 20 rad/s",
        )


@rule
def weak_motors(case: Case) -> Iterator[LintWarning]:
    """Warn if no motor could turn even its own body by a degree in the whole trial."""
    simulation = case.config.simulation
    time = simulation.seconds
    found = []
    motors = [
        (joint, motor, axis, dof.kind.unit == "m")
        for joint in case.joints()
        for axis, (motor, dof) in enumerate(zip(joint.given.motors, joint.built.dofs, strict=True))
        if motor is not None
    ]
    for joint, motor, axis, slides in motors:
        built = motor.build()
        if isinstance(built, Muscle):
            limit, word = built.strength, "area"
        elif isinstance(built, TorqueMotor):
            limit, word = min(abs(built.gear), built.torque_limit), "gear"
        else:
            limit, word = built.torque_limit, "torque_limit"
        inertia = _least_inertia(joint, slides)
        if inertia == 0:
            continue
        turn = float(np.rad2deg(limit / inertia * time**2 / 2))
        listed = isinstance(joint.given.actuator, list)
        place = (axis,) if listed else ()
        found.append((turn, (*joint.key, "actuator", *place, word)))
    if not found or max(found)[0] >= _LEAST_TURN:
        return
    turn, key = max(found)
    problem = (
        f"the motors are too weak to move anything: the strongest turns its own body by {turn:.2g} "
        f"degrees in the {time:.3g} s of a trial. Torques are in N m"
    )
    yield case.warning(key, problem)


@rule
def repeated_place(case: Case) -> Iterator[LintWarning]:
    """Warn of a row whose joint position fits the first body's parent, but not the row's bodies."""
    for joint in case.joints():
        at, parent, body = joint.built.parent_anchor, joint.parent, joint.body
        if parent is None:
            continue
        fits, gap = _gap(case, parent, at), _gap(case, body, at)
        if joint.repeat == 1 or abs(fits) > _OUT * _reach(case, parent).max():
            continue
        if abs(gap) > _OUT * _reach(case, body).max():
            side = "outside" if gap > 0 else "inside"
            yield case.warning(
                (*joint.key, "at"),
                f"repeat uses this position for all bodies of the row. It fits {parent.name!r}, "
                f"which carries the first, but lies {abs(gap):.3g} m {side} {body.name!r}, which "
                "carries the next. Give the first body its own entry",
            )


@rule
def repeated_turn(case: Case) -> Iterator[LintWarning]:
    """Warn of a row that curls up, because each body is turned relative to its predecessor."""
    for joint in case.joints():
        most = max(map(abs, joint.given.rotation_deg))
        if joint.repeat > 1 and most >= _CURLS:
            yield case.warning(
                (*joint.key, "rotation_deg"),
                f"repeat turns every body of the row by {most:g} degrees relative to its "
                f"predecessor. Plausible: less than {_CURLS:g}. To turn the row as a whole, give "
                "the first body its own entry",
            )


@rule
def far_places(case: Case) -> Iterator[LintWarning]:
    """Warn of joints, eyes and gauges that lie far from their body."""
    places: list[tuple[Key, str, Body, Triple]] = []
    for joint in case.joints():
        parent, body, built = joint.parent, joint.body, joint.built
        if parent is not None:
            on = f"{parent.name!r}, the parent of {body.name!r}"
            places.append(((*joint.key, "at"), on, parent, built.parent_anchor))
        places.append(((*joint.key, "child_at"), f"{body.name!r} itself", body, built.child_anchor))
    for kind in ("light_sensors", "depth_sensors"):
        for i, _, sensor in case.sensors(kind):
            body = case.creature.bodies[case.creature.body_index(sensor.body)]
            key = "creature", kind, i, "position"
            places.append((key, repr(sensor.body), body, sensor.position))
    for key, whose, body, place in places:
        (x, y, z), gap = _reach(case, body), _gap(case, body, place)
        most = max(x, y, z)
        likely = "Positions count from the body's centre, so half its size reaches its surface"
        if isinstance(body.shape, Capsule | Cylinder):
            kind = type(body.shape).__name__.lower()
            likely += f". A {kind} lies along its own x. To turn a leg sideways, use rotation_deg"
        if gap > 100 * most:
            likely = "Positions are in m. Is this in mm?"
        if gap > _OUT * most:
            yield case.warning(
                key,
                f"lies {gap:.3g} m outside body {whose}. The body reaches to {x:.3g}, {y:.3g}, "
                f"{z:.3g} m. {likely}",
            )


def _least_inertia(joint: Jointed, slides: bool) -> float:
    """Return a body's inertia about its joint, kg m^2, which other bodies and water only increase.

    A body of uniform density counts as a rod that turns about its end. If the body slides, return
    its mass times half its length, kg m, as if half its length were a radian.
    """
    body = joint.body
    mass, half = float(body.mass), float(body.shape.half_extents.max())
    if slides:
        return mass * half
    if body.inertial is None:
        return mass * (2 * half) ** 2 / 3
    arm = np.subtract(body.inertial.centre, joint.built.child_anchor)
    return float(np.max(np.diag(body.inertial.inertia)) + mass * (arm @ arm))


def _gap(case: Case, body: Body, place: ArrayLike) -> float:
    """Return the distance from a body's shapes to a place in its frame, m, negative inside.

    The distance is 0 for a body without a shape.
    """
    gaps = [body.shape.distance(np.array([place], float))] if body.shape.exists else []
    for part, joint in _parts(case, body):
        off = np.subtract(place, joint.parent_anchor) @ np.array(joint.orientation)
        gaps.append(part.shape.distance(off[None] + joint.child_anchor))
    return float(min(gaps)[0]) if gaps else 0.0


def _reach(case: Case, body: Body) -> np.ndarray:
    """Return how far a body's shapes extend from its centre along each of its axes, m."""
    reach = [np.asarray(body.shape.half_extents, float)]
    for part, joint in _parts(case, body):
        turn = np.array(joint.orientation)
        centre = joint.parent_anchor - turn @ joint.child_anchor
        reach.append(np.abs(centre) + np.abs(turn) @ part.shape.half_extents)
    return np.max(reach, axis=0)


def _parts(case: Case, body: Body) -> Iterator[tuple[Body, Joint]]:
    """Yield the further parts of a body, with the joints that hold them."""
    for part in case.creature.bodies:
        if part.whole == body.name and part.joint is not None:
            yield part, part.joint
