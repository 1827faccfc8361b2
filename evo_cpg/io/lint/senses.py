"""Rules about sensors that never respond, and animals that cannot sense their task."""

from collections.abc import Iterator

import numpy as np

from evo_cpg.creature.creature import neutral_pose
from evo_cpg.io.lint.rule import Case, LintWarning, rule
from evo_cpg.io.schema.choice import CustomConfig

# Largest angle by which an animal on the ground is expected to tilt an eye, degrees.
_TILT = 45.0


@rule
def light_without(case: Case) -> Iterator[LintWarning]:
    """Warn of eyes if the task has no light."""
    task = case.config.task
    if task.goal is not None or isinstance(task, CustomConfig):
        return
    for i in range(len(case.config.creature.light_sensors)):
        yield case.warning(
            ("creature", "light_sensors", i, "body"),
            f"a task of type {task.type!r} has no light, so this eye senses only its own "
            "tilt. Leave the eye out, or choose a task with a light: reach_light",
        )


@rule
def light_unseen(case: Case) -> Iterator[LintWarning]:
    """Warn of a task with a light if the animal has no eye, or its controller uses no eye."""
    config = case.config
    if config.task.goal is None:
        return
    instead = "a task without a light, such as task: {type: distance}"
    if not config.controller.uses_senses:
        yield case.warning(
            ("task", "type"),
            f"a controller of type {config.controller.type!r} senses nothing, so the animal cannot "
            f"steer towards the light. Choose a controller with senses (brain_cpg), or {instead}",
        )
    elif not config.creature.light_sensors and not any(
        isinstance(sensor, CustomConfig) for sensor in config.creature.sensors
    ):
        yield case.warning(
            ("creature", "light_sensors"),
            "the task rewards approaching a light (reach_light, the default), but the animal has "
            f"no eye. Add light_sensors: [{{body: {case.root}}}], or choose {instead}",
        )


@rule
def light_never_in_view(case: Case) -> Iterator[LintWarning]:
    """Warn of eyes of a walker that see no light at any heading."""
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
            yield case.warning(
                ("creature", "light_sensors", i, "axis"),
                f"the eye looks {high:.0f} degrees above the horizon and sees "
                f"{given.field_of_view_deg / 2:g} to each side. Lights stay {nearest:.0f} degrees "
                "or more away at any heading. Turn the axis (straight ahead: [1, 0, 0]), or widen "
                "field_of_view_deg",
            )


def _elevations(case: Case) -> list[float] | None:
    """Return the elevations of the lights above the horizon, degrees, or None if unknown."""
    goal, trials = case.config.task.goal, case.config.simulation.situations
    if goal is None:
        return None
    lights = [entry.light.over(goal) if entry.light else goal for entry in trials] or [goal]
    found = [light.elevation_deg for light in lights]
    return None if None in found else [angle for angle in found if angle is not None]


@rule
def touch_without_ground(case: Case) -> Iterator[LintWarning]:
    """Warn of pressure sensors, requested by name, if there is no ground to touch."""
    named = case.config.creature.pressure_sensors
    # Do not warn of the default ``all``, because such sensors cost nothing.
    if named == "all" or case.config.world.ground is not None:
        return
    for i in range(len(named)):
        yield case.warning(
            ("creature", "pressure_sensors", i),
            "there is no ground to press against it, so it always reads 0. Give the world a "
            "ground (world.ground: {}), or leave the sensor out (pressure_sensors: [])",
        )


@rule
def depth_without_surface(case: Case) -> Iterator[LintWarning]:
    """Warn of depth gauges if there is no water surface."""
    water = case.config.world.water
    if water is not None and water.surface is not None:
        return
    lacks = "there is no water" if water is None else "the water has no surface"
    likely = "world.water" if water is None else "world.water.surface: 0"
    for i in range(len(case.config.creature.depth_sensors)):
        yield case.warning(
            ("creature", "depth_sensors", i, "body"),
            f"{lacks}, so this gauge always reads 0. Set {likely}, or leave the gauge out",
        )


@rule
def controller_without_senses(case: Case) -> Iterator[LintWarning]:
    """Warn of sensors if the controller uses no senses."""
    creature, controller = case.config.creature, case.config.controller
    if controller.uses_senses:
        return
    pressure = creature.pressure_sensors
    listed = {
        "light_sensors": [eye.body for eye in creature.light_sensors],
        "depth_sensors": [gauge.body for gauge in creature.depth_sensors],
        "pressure_sensors": [] if pressure == "all" else pressure,
        "sensors": [sensor.type for sensor in creature.sensors],
    }
    for kind, names in listed.items():
        if names:
            yield case.warning(
                ("creature", kind),
                f"a controller of type {controller.type!r} senses nothing. Leave the sensors "
                "out, or choose a controller with senses: brain_cpg",
                names,
            )
