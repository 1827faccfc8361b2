"""Sensors that can never feel anything, and animals that sense nothing of their task."""

from collections.abc import Iterator

import numpy as np

from evo_cpg.config.plausible.doubt import Case, Doubt
from evo_cpg.config.plausible.surroundings import lowest_ground
from evo_cpg.config.schema.choice import CustomConfig
from evo_cpg.config.schema.task import ReachLightConfig
from evo_cpg.creature.creature import neutral_pose

# By so much may an animal on the ground tilt an eye, degrees.
_TILT = 45.0

# Less of its range than this is too little for a depth gauge to tell anything.
_LEAST_READING = 0.01


def light_without(case: Case) -> Iterator[Doubt]:
    """Eyes where no trial has a light."""
    task = case.config.task
    if isinstance(task, ReachLightConfig | CustomConfig):
        return
    for i, eye in enumerate(case.config.creature.light_sensors):
        yield Doubt(
            ("creature", "light_sensors", i, "body"),
            eye.body,
            f"a task of type {task.type!r} has no light, so this eye sees none (it still tells how "
            "far it is tilted); leave the eye out, or choose a task with a light: reach_light",
        )


def light_unseen(case: Case) -> Iterator[Doubt]:
    """A task about a light, and an animal that has no eye, or whose controller uses none."""
    config = case.config
    if not isinstance(config.task, ReachLightConfig):
        return
    instead = "or choose a task without a light, such as task: {type: distance}"
    if config.controller.type == "postures":
        yield Doubt(
            ("task", "type"),
            config.task.type,
            "a controller of type 'postures' senses nothing, so the animal cannot steer towards "
            f"the light; take a controller that does, such as brain_cpg, {instead}",
        )
    elif not config.creature.light_sensors and not _own_sensors(case):
        yield Doubt(
            ("creature", "light_sensors"),
            [],
            "the task rewards coming near to a light (reach_light, the default), but the animal "
            f"has no eye; add one, such as light_sensors: [{{body: {case.root}}}], {instead}",
        )


def _own_sensors(case: Case) -> bool:
    """Return whether the creature has sensors of the user's own, which may see the light."""
    return any(isinstance(sensor, CustomConfig) for sensor in case.config.creature.sensors)


def light_never_in_view(case: Case) -> Iterator[Doubt]:
    """Eyes of a walker that look away from every light, however it turns about the vertical."""
    config = case.config
    if config.world.ground is None or config.world.water is not None:
        return
    lights = _elevations(case)
    if lights is None:
        return
    _, turns = neutral_pose(case.creature)
    for i, given, eye in case.sensors("light_sensors"):
        axis = turns[case.creature.body_index(eye.body)] @ np.array(eye.axis)
        high = float(np.rad2deg(np.arcsin(np.clip(axis[2], -1, 1))))
        nearest = min(abs(high - light) for light in lights)
        if nearest > given.field_of_view_deg / 2 + _TILT:
            yield Doubt(
                ("creature", "light_sensors", i, "axis"),
                given.axis,
                f"the eye looks {high:.0f} degrees above the horizon and sees "
                f"{given.field_of_view_deg / 2:g} to each side; no light comes nearer than "
                f"{nearest:.0f}, whichever way the animal faces; turn the axis, such as [1, 0, 0] "
                "straight ahead, or widen field_of_view_deg",
            )


def _elevations(case: Case) -> list[float] | None:
    """Of the lights above the horizon, degrees; None where they cannot be told."""
    task, trials = case.config.task, case.config.simulation.trials
    if not isinstance(task, ReachLightConfig):
        return None
    own = [entry.light for entry in trials if entry.light] if isinstance(trials, list) else []
    lights = [light.over(task.light) for light in own] or [task.light]
    if isinstance(trials, list) and len(own) < len(trials):
        lights.append(task.light)
    found = [light.elevation_deg for light in lights]
    return None if None in found else [angle for angle in found if angle is not None]


def touch_without_ground(case: Case) -> Iterator[Doubt]:
    """Pressure sensors, asked for by name, where there is nothing to touch."""
    named = case.config.creature.pressure_sensors
    # All is the default, and costs nothing.
    if named == "all" or case.config.world.ground is not None:
        return
    for i, name in enumerate(named):
        yield Doubt(
            ("creature", "pressure_sensors", i),
            name,
            "there is no ground to press against it, so it always feels 0; give the world a "
            "ground (world.ground: {}), or leave the sensor out (pressure_sensors: [])",
        )


def touch_inside(case: Case) -> Iterator[Doubt]:
    """Pressure sensors on bodies that lie inside of another one at rest."""
    named = case.config.creature.pressure_sensors
    if named == "all" or case.config.world.ground is None:
        return
    creature = case.creature
    centres, turns = neutral_pose(creature)
    for i, name in ((i, name) for i, given in enumerate(named) for name in case.named(given)):
        inner = creature.body_index(name)
        points = creature.bodies[inner].shape.surface(2).points @ turns[inner].T + centres[inner]
        for outer, body in enumerate(creature.bodies):
            own = (points - centres[outer]) @ turns[outer]
            if outer != inner and (body.shape.distance(own) < 0).all():
                yield Doubt(
                    ("creature", "pressure_sensors", i),
                    name,
                    f"the body lies inside of {body.name!r}, which touches the ground before it; "
                    f"put the sensor on {body.name!r}",
                )


def depth_without_surface(case: Case) -> Iterator[Doubt]:
    """Depth gauges where there is no surface to be deep under."""
    water = case.config.world.water
    if water is not None and water.surface is not None:
        return
    lacks = "there is no water" if water is None else "the water has no surface"
    likely = "world.water" if water is None else "world.water.surface: 0"
    for i, gauge in enumerate(case.config.creature.depth_sensors):
        yield Doubt(
            ("creature", "depth_sensors", i, "body"),
            gauge.body,
            f"{lacks}, so this gauge always reads 0; set {likely}, or leave the gauge out",
        )


def depth_out_of_scale(case: Case) -> Iterator[Doubt]:
    """Depth gauges whose scale is so long that the deepest place is a tick on it."""
    water, lowest = case.config.world.water, lowest_ground(case)
    if water is None or water.surface is None or lowest is None:
        return
    deepest = water.surface - lowest
    if deepest <= 0:
        return
    for i, gauge in enumerate(case.config.creature.depth_sensors):
        if deepest < _LEAST_READING * gauge.full_scale:
            yield Doubt(
                ("creature", "depth_sensors", i, "full_scale"),
                gauge.full_scale,
                f"the water is {deepest:.3g} m deep, so this gauge never reads more than "
                f"{deepest / gauge.full_scale:.2g}; plausible is about the water's depth; lengths "
                "are in m: is this in mm?",
            )


def controller_without_senses(case: Case) -> Iterator[Doubt]:
    """Sensors of an animal that takes its postures in turn and senses nothing."""
    creature = case.config.creature
    if case.config.controller.type != "postures":
        return
    named = [] if creature.pressure_sensors == "all" else creature.pressure_sensors
    listed = [("light_sensors", eye.body) for eye in creature.light_sensors]
    listed += [("depth_sensors", gauge.body) for gauge in creature.depth_sensors]
    listed += [("pressure_sensors", name) for name in named]
    listed += [("sensors", sensor.type) for sensor in creature.sensors]
    for kind in dict.fromkeys(kind for kind, _ in listed):
        names = [name for other, name in listed if other == kind]
        yield Doubt(
            ("creature", kind),
            names,
            "a controller of type 'postures' senses nothing; leave them out, or take one that "
            "does: brain_cpg",
        )


RULES = (
    light_without,
    light_unseen,
    light_never_in_view,
    touch_without_ground,
    touch_inside,
    depth_without_surface,
    depth_out_of_scale,
    controller_without_senses,
)
