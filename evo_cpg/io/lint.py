"""Warnings about values of a configuration that are allowed but probably unintended.

The plausible range of a single field is metadata of the field (`evo_cpg.io.schema.section`). A rule
compares several fields. It is a function that takes a `Case` and yields a key and a problem for
each unintended value. Its line in `RULES`, at the end of this file, makes it work.
"""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from pydantic import BaseModel

from evo_cpg.creature.axis_kinds import SPANNING, Turn
from evo_cpg.creature.creature import Body, Creature, Joint
from evo_cpg.io.build import build_creature
from evo_cpg.io.errors import Key
from evo_cpg.io.keys import value_at
from evo_cpg.io.schema.copies import copies_named
from evo_cpg.io.schema.creature import BodyConfig
from evo_cpg.io.schema.experiment import ExperimentConfig
from evo_cpg.io.schema.joint import JointConfig
from evo_cpg.io.schema.section import ROUNDING, SOLID, TURN, CustomConfig, Direction, TypicalRange
from evo_cpg.io.schema.sensor import kind_of
from evo_cpg.simulation.judge import WILDEST_SPEED

# Range of the longest edge of a body, from the limb of a small insect to a whale, m.
_BODIES = (0.001, 30.0)

# Largest ratio of a body's size to the median of all bodies, either way, and the smallest number of
# bodies for a meaningful median.
_UNLIKE, _SEVERAL = 50.0, 3

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

# Largest movement by gravity in a physics step, as a fraction of a body's half thickness. At 0.6
# the body sinks into the ground by 0.05 of that. At 2 a floating body never rests.
_SINK = 0.5


class LintWarning(NamedTuple):
    """A value that is allowed but probably unintended.

    Attributes:
        key: key of the value.
        value: value in the configuration.
        problem: description of the problem, plausible values, and the probable intention.
    """

    key: Key
    value: Any
    problem: str

    def __str__(self) -> str:
        """Return the key, the value and the problem. A section counts as no value."""

        def written(value: Any) -> str:
            if isinstance(value, (list, tuple)):
                return f"[{', '.join(map(written, value))}]"
            return f"{value:g}" if isinstance(value, float) else str(value)

        words = [".".join(map(str, self.key))]
        if not isinstance(self.value, (BaseModel, dict)):
            words.append("null" if self.value is None else written(self.value))
        return ": ".join([*words, self.problem])


class Jointed(NamedTuple):
    """A body with a joint.

    Attributes:
        key: key of the joint in the configuration.
        given: joint in the configuration.
        built: joint of the creature.
        body: body that hangs on the joint.
        parent: body that carries the joint, or None for a root that hangs on the world.
    """

    key: Key
    given: JointConfig
    built: Joint
    body: Body
    parent: Body | None


class Case(NamedTuple):
    """Argument of the rules: a configuration and its creature."""

    config: ExperimentConfig
    creature: Creature

    def bodies(self) -> Iterator[tuple[Key, BodyConfig, Body]]:
        """Yield every body without its further parts, with the key of its entry, and the entry."""
        entries = self.config.creature.bodies
        whole = [body for body in self.creature.bodies if body.whole is None]
        for copy, body in zip(self.config.creature.copies(), whole, strict=True):
            yield ("creature", "bodies", copy.entry), entries[copy.entry], body

    def joints(self) -> Iterator[Jointed]:
        """Yield every body that has a joint, also a root that hangs on the world."""
        named = {body.name: body for body in self.creature.bodies}
        for key, entry, body in self.bodies():
            built = self.creature.joint_of(body)
            if entry.joint and built:
                parent = body.joint and named[body.joint.parent]
                yield Jointed((*key, "joint"), entry.joint, built, body, parent)

    def pieces(self, body: Body) -> Iterator[tuple[Body, np.ndarray, np.ndarray]]:
        """Yield a body and its parts that have a shape, with their rotation and place in it, m."""
        if body.shape.exists:
            yield body, np.eye(3), np.zeros(3)
        for part in self.creature.bodies:
            if part.whole == body.name and part.joint is not None:
                turn = np.array(part.joint.orientation)
                yield part, turn, part.joint.parent_anchor - turn @ part.joint.child_anchor

    def gap(self, body: Body, place: ArrayLike) -> float:
        """Return the distance from a body's shapes to a place in its frame, m, negative inside.

        The distance is 0 for a body without a shape.
        """
        gaps = [
            float(piece.shape.distance(((np.array(place) - centre) @ turn)[None])[0])
            for piece, turn, centre in self.pieces(body)
        ]
        return min(gaps, default=0.0)

    def reach(self, body: Body) -> np.ndarray:
        """Return how far a body's shapes extend from its centre along each of its axes, m."""
        reach = [
            np.abs(centre) + np.abs(turn) @ piece.shape.half_extents
            for piece, turn, centre in self.pieces(body)
        ]
        return np.max([np.zeros(3), *reach], axis=0)


# A key, and the problem with its value.
Found = Iterator[tuple[Key, str]]


def lint(config: ExperimentConfig, source: Path | str) -> list[LintWarning]:
    """Return warnings about probably unintended values, at most one for each key.

    Raises:
        ConfigError: its bodies do not form one tree.
    """
    case = Case(config, build_creature(config, source))
    found: dict[Key, LintWarning] = {}
    for rule in RULES:
        for key, problem in rule(case):
            warning = LintWarning(tuple(key), value_at(config, key), problem)
            found.setdefault(warning.key, warning)
    return list(found.values())


def single_fields(case: Case) -> Found:
    """Warn of single fields outside their plausible ranges."""

    def inside(key: Key, value: Any) -> Found:
        if isinstance(value, dict):
            for name, each in value.items():
                yield from inside((*key, name), each)
        elif isinstance(value, (list, tuple)) and value and isinstance(value[0], BaseModel):
            for i, each in enumerate(value):
                yield from inside((*key, i), each)
        elif isinstance(value, BaseModel):
            for name, field in type(value).model_fields.items():
                given: Any = getattr(value, name)
                marks = [x for x in field.metadata if isinstance(x, (TypicalRange, Direction))]
                for problem in (mark.problem(given) for mark in marks if given is not None):
                    if problem:
                        yield (*key, name), problem
                yield from inside((*key, name), given)

    yield from inside((), case.config)


def body_size(case: Case) -> Found:
    """Warn of bodies that are very large, very small, or unlike the median of all bodies."""
    shaped = [each for each in case.bodies() if each[1].shape is not None]
    edges = [2 * float(body.shape.half_extents.max()) for *_, body in shaped]
    middle = float(np.median(edges)) if edges else 0.0
    low, high = _BODIES
    for (key, entry, _), edge in zip(shaped, edges, strict=True):
        if not low <= edge <= high:
            problem = f"a body of {edge:g} m. Plausible: {low:g} to {high:g} m. Lengths are in m"
        elif len(edges) >= _SEVERAL and not 1 / _UNLIKE <= edge / middle <= _UNLIKE:
            problem = (
                f"a body of {edge:g} m, but the median is {middle:g} m. Plausible: up to "
                f"{_UNLIKE:g} times larger or smaller. Lengths are in m"
            )
        else:
            continue
        size = entry.shape.size_key if entry.shape else None
        yield (*key, "shape", *([size] if size else [])), problem


def densities(case: Case) -> Found:
    """Warn of densities that are probably in another unit, if they give a body its mass."""
    low = SOLID.low if case.config.world.water else _AIRY
    weighed = [body for body in case.config.creature.bodies if body.mass is None]
    used = {part.material for body in weighed for part in (body, *body.parts)}
    for name, material in case.config.creature.materials.items():
        problem = SOLID.problem(material.density)
        if problem and name in used and not low <= material.density <= SOLID.high:
            yield ("creature", "materials", name, "density"), problem


def weight_in_water(case: Case) -> Found:
    """Warn of an animal that only sinks, because there is no ground, or rises without a surface."""
    world, water = case.config.world, case.config.world.water
    volume = sum(float(body.shape.volume) for body in case.creature.bodies)
    held = world.forces or case.creature.root_joint is not None
    if not (water and world.gravity and volume) or held:
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
    yield (
        place,
        f"the animal has {ratio:.2g} times the mass of the water that it displaces, so it "
        f"{happens}. {cure}, or the animal the density of the water ({water.density:g} kg/m^3)",
    )


def joint_limits(case: Case) -> Found:
    """Warn of limits in radians, beyond a full turn, or that exclude the neutral pose.

    Limits within 3.14 degrees are probably in radians if they are common angles there, such as
    1.57. Others are so only if no joint of the animal turns farther, and if they are short
    fractions, such as 0.5, as written by hand. A stiff joint may have limits of 2 degrees, and
    degrees computed from radians have more digits.
    """
    joints = [(joint, list(filter(None, joint.given.limits))) for joint in case.joints()]
    all_small = all(np.abs(limits).max() <= np.pi + ROUNDING for _, limits in joints if limits)
    for joint, limits in joints:
        for lower, upper in limits:
            both, widest = (lower, upper), max(abs(lower), abs(upper))
            by_hand = all(each == round(each, 2) for each in both)
            by_hand = by_hand and any(each != round(each) for each in both)
            radians = Direction().problem(both) or (all_small and by_hand)
            if widest <= np.pi + ROUNDING and radians:
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
            yield (*joint.key, "limits_deg"), problem
            break


def folded(case: Case) -> Found:
    """Warn of bodies that lie inside their parent, because a position has the wrong sign."""
    for joint in case.joints():
        parent, built = joint.parent, joint.built
        if parent is None or not joint.body.shape.exists:
            continue
        own = np.array(built.child_anchor)
        arm = np.array(built.orientation) @ own
        # Vertebrae and shoulders may lie inside their parent, but then their joints do, too.
        at_end = own @ own >= _END * np.abs(own) @ case.reach(joint.body)
        depth = case.gap(parent, built.parent_anchor)
        at_end = at_end and depth > -_INSIDE * case.reach(parent).min()
        inside, flipped = (case.gap(parent, built.parent_anchor + x) for x in (-arm, arm))
        if at_end and inside < -_INSIDE * np.linalg.norm(own) and flipped > 0:
            yield (
                (*joint.key, "child_at"),
                f"the centre of {joint.body.name!r} lies {-inside:.2g} m inside {parent.name!r}, "
                "its parent, so the animal is folded into itself. child_at is the joint's position "
                "in the body's own frame. Change the sign of one of its numbers, or of one of at",
            )


def axes_in_a_plane(case: Case) -> Found:
    """Warn of three axes at one place that reach a common plane, without a rotor among them."""
    for joint in case.joints():
        built = joint.built
        pure = all(dof.kind == Turn() and not any(dof.place) for dof in built.dofs)
        if len(built.axes) != SPANNING or not pure or built.kind == "turns":
            continue
        if not any(dof.armature for dof in built.dofs):
            yield (
                (*joint.key, "axes"),
                "the middle axis can turn until the three axes lie within 5 degrees of one plane. "
                "Near it the joint spins up under any torque. Give it an armature, narrower limits "
                "for the middle axis, or axes: ball",
            )


def no_motor(case: Case) -> Found:
    """Warn if no joint and no tendon has a motor."""
    joints = list(case.joints())
    pulled = any(tendon.actuator for tendon in case.config.creature.tendons)
    if joints and not pulled and not any(any(joint.given.each("actuator")) for joint in joints):
        first = next((joint for joint in joints if joint.parent is not None), joints[0])
        yield (
            (*first.key, "actuator"),
            "no joint has a motor, so the controller moves nothing. Give joints a motor, such as "
            "actuator: {gain: 1}",
        )


def far_places(case: Case) -> Found:
    """Warn of joints, eyes and gauges that lie far from their body."""
    places: list[tuple[Key, Body, ArrayLike]] = []
    for joint in case.joints():
        if joint.parent is not None:
            places.append(((*joint.key, "at"), joint.parent, joint.built.parent_anchor))
        places.append(((*joint.key, "child_at"), joint.body, joint.built.child_anchor))
    copies = case.config.creature.copies()
    for kind in ("light_sensors", "depth_sensors"):
        built = iter(getattr(case.creature, kind))
        for i, entry in enumerate(getattr(case.config.creature, kind)):
            for copy in copies_named(entry.body, copies):
                body = case.creature.bodies[case.creature.body_index(copy.name)]
                places.append((("creature", kind, i, "position"), body, next(built).position))
    for key, body, place in places:
        (x, y, z), gap = case.reach(body), case.gap(body, place)
        if gap > _OUT * max(x, y, z):
            yield (
                key,
                f"lies {gap:.3g} m outside body {body.name!r}, which reaches to {x:.3g}, {y:.3g}, "
                f"{z:.3g} m from its centre. Positions are in m, and count from the centre",
            )


def light_unseen(case: Case) -> Found:
    """Warn of a task with a light if the animal has no eye, or its controller uses no eye."""
    config = case.config
    if getattr(config.task, "light", None) is None:
        return
    instead = "a task without a light, such as task: {type: distance}"
    if not config.controller.uses_senses:
        yield (
            ("task", "type"),
            f"a controller of type {config.controller.type!r} senses nothing, so the animal cannot "
            f"steer towards the light. Choose a controller with senses (brain_cpg), or {instead}",
        )
    elif not (config.creature.light_sensors or config.controller.type == "body_brain") and not any(
        isinstance(sensor, CustomConfig) for sensor in config.creature.sensors
    ):
        root = next(body.name for body in case.creature.bodies if body.joint is None)
        yield (
            ("creature", "light_sensors"),
            "the task rewards approaching a light (reach_light, the default), but the animal has "
            f"no eye. Add light_sensors: [{{body: {root}}}], or choose {instead}",
        )


def step_length(case: Case) -> Found:
    """Warn of a step that is too long for resting or floating bodies to come to rest."""
    world, simulation = case.config.world, case.config.simulation
    if world.ground is None and (world.water is None or world.water.surface is None):
        return
    half, name = min(
        (float(b.shape.half_extents.min()), b.name) for b in case.creature.bodies if b.shape.exists
    )
    h = 1.0 / (simulation.control_rate_hz * simulation.substeps)
    if world.gravity * h * h > _SINK * half:
        enough = np.sqrt(world.gravity / (_SINK * half)) / simulation.control_rate_hz
        yield (
            ("simulation", "substeps"),
            f"body {name!r} is {2 * half:.2g} m thick and falls {world.gravity * h * h:.2g} m in a "
            f"physics step of {h:.2g} s. It would sink into the ground or bob forever. Plausible: "
            f"{int(np.ceil(enough))} or more",
        )


def water_by_default(case: Case) -> Found:
    """Warn of ground that lies under water because the key ``water`` is left out."""
    world = case.config.world
    if world.ground is not None and "water" not in world.model_fields_set:
        yield (
            ("world", "water"),
            "left out, so there is water everywhere, and the ground lies under it. Write "
            "water: null for dry land, water: {surface: 0} for water up to a height, or water: {} "
            "for water everywhere",
        )


def nothing_to_hold_it(case: Case) -> Found:
    """Warn of gravity without water, ground or a force law, because the animal falls forever.

    A root that hangs on the world does not fall.
    """
    world, hangs = case.config.world, any(body.hangs for body in case.config.creature.bodies)
    empty = world.water is None and world.ground is None and not world.forces
    if world.gravity and empty and not hangs:
        simulation = case.config.simulation
        speed = world.gravity * simulation.steps / simulation.control_rate_hz
        yield (
            ("world", "ground"),
            "there is neither water nor ground, so the animal falls from start to end, to "
            f"{speed:.3g} m/s. Above {WILDEST_SPEED:g} m/s it counts as diverged. Give the world a "
            "ground (ground: {}) or water (water: {}), or set gravity to 0",
        )


def walk_without_ground(case: Case) -> Found:
    """Warn of a task that needs ground if there is no ground."""
    if case.config.task.needs_ground and case.config.world.ground is None:
        yield (
            ("task", "type"),
            "there is no ground to walk on, so the animal always counts as airborne. Give "
            "the world a ground (world.ground: {}), or choose task: {type: distance}",
        )


def trials_alike(case: Case) -> Found:
    """Warn of several equal trials."""
    trials = case.config.simulation.trials
    alike = isinstance(trials, int) or trials.count(trials[0]) == len(trials)
    count = trials if isinstance(trials, int) else len(trials)
    if case.config.silent and alike and count > 1:
        yield (
            ("simulation", "trials"),
            f"without noise all {count} trials are alike, so one is enough. Give noise, or a list "
            "of situations that differ",
        )


# What each kind of sense needs in the world.
_NEEDS = {"flow": "water", "depth": "surface", "rays": "ground", "load": "ground"}
_GIVE = {
    "water": "there is no water. Give world.water",
    "surface": "the water has no surface. Give world.water.surface",
    "ground": "there is no ground. Give world.ground",
}


def senseless(case: Case) -> Found:
    """Warn of senses that never fire in this world."""
    world, creature = case.config.world, case.config.creature
    missing = {"ground"} if world.ground is None else set()
    if world.water is None:
        missing |= {"water", "surface"}
    elif world.water.surface is None:
        missing.add("surface")
    senses: list[tuple[str, Key]] = [
        ("depth", ("depth_sensors", i)) for i in range(len(creature.depth_sensors))
    ]
    if creature.pressure_sensors != "all" and creature.pressure_sensors:
        senses.append(("load", ("pressure_sensors",)))
    senses += [(kind_of(sensor), ("sensors", i)) for i, sensor in enumerate(creature.sensors)]
    for kind, key in senses:
        need = _NEEDS.get(kind, "")
        if need in missing:
            yield ("creature", *key), f"never fires, because {_GIVE[need]}, or leave it out"


RULES: tuple[Callable[[Case], Found], ...] = (
    single_fields,
    body_size,
    densities,
    weight_in_water,
    joint_limits,
    folded,
    axes_in_a_plane,
    no_motor,
    far_places,
    light_unseen,
    step_length,
    water_by_default,
    nothing_to_hold_it,
    walk_without_ground,
    trials_alike,
    senseless,
)
