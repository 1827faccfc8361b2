"""What each trial begins with, from what the configuration says of start and light."""

import dataclasses
import functools
from collections.abc import Callable
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from evo_cpg.config.errors import ConfigError
from evo_cpg.config.schema.experiment import ExperimentConfig
from evo_cpg.config.schema.section import Vector
from evo_cpg.config.schema.task import DEFAULT_LIGHT, ReachLightConfig
from evo_cpg.config.schema.trial import SituationConfig
from evo_cpg.creature.creature import Creature, lowest_along, lowest_height, neutral_pose
from evo_cpg.physics.footing import clearance
from evo_cpg.physics.kinematics import kinematics
from evo_cpg.physics.state import resting_state
from evo_cpg.physics.terrain import Plane, nearest
from evo_cpg.physics.world import World
from evo_cpg.simulation.settle import NoRestError, Settling
from evo_cpg.simulation.situation import Situation
from evo_cpg.simulation.task import Task
from evo_cpg.spatial.rotation import euler_to_matrix

# Tries to find the height at which an animal stands, and how exact it is to be, m.
_START_STEPS, _START_ACCURACY = 200, 1e-5

# Nothing swims or walks so many times its own length in a trial.
_FARTHEST_LIGHT = 1000.0


def build_situations(
    config: ExperimentConfig, creature: Creature, world: World, source: Path | str
) -> tuple[Situation, ...]:
    """The situations of the trials, or the one that all trials have.

    Raises:
        ConfigError: there is no place to stand or no rest, or a light that cannot be reached.
    """
    settings = config.simulation
    task = config.task
    common = task.light if isinstance(task, ReachLightConfig) else None
    place = functools.cache(functools.partial(_start_height, creature, world))
    settling = functools.cache(
        lambda: Settling(world, 1.0 / (settings.control_rate_hz * settings.substeps))
    )
    situations = []
    entries = settings.trials if isinstance(settings.trials, list) else [SituationConfig()]
    for i, entry in enumerate(entries):
        key = ("simulation", "trials", i)
        x, y = settings.start if entry.start is None else entry.start
        turn = entry.start_heading_deg
        heading = float(np.deg2rad(settings.start_heading_deg if turn is None else turn))
        height = place(x, y, heading, settings.start_clearance)
        if height is None:
            raise ConfigError(
                source,
                ("simulation", "start") if entry.start is None else (*key, "start"),
                f"no place to stand at ({x:g}, {y:g}); is it in an obstacle?",
            )
        begin = Situation((x, y, height), heading)
        if settings.start_pose == "settled":
            begin = _settled(settling, begin, source)
        start, light = begin.start_position, common
        if entry.light is not None:
            light = entry.light.over(common or DEFAULT_LIGHT)
        goal = light and light.position(start, heading)
        problem = goal and out_of_reach(creature, world, start, goal)
        if problem:
            own = entry.light is not None
            raise ConfigError(source, (*key, "light") if own else ("task", "light"), problem)
        situations.append(begin._replace(light=goal))
    return tuple(situations)


def _settled(
    settling: Callable[[], Settling],
    situation: Situation,
    source: Path | str,
) -> Situation:
    """The situation with the creature at rest.

    Raises:
        ConfigError: it does not come to rest.
    """
    try:
        return settling().settle(situation)
    except NoRestError as error:
        x, y, _ = situation.start_position
        raise ConfigError(
            source,
            ("simulation", "start_pose"),
            f"'settled': no rest from the start at ({x:g}, {y:g}), {error}; "
            "'neutral' starts in the neutral pose",
        ) from None


def require_light(config: ExperimentConfig, task: Task, source: Path | str) -> None:
    """Check that no trial moves a light that the task does not have.

    Raises:
        ConfigError: one does.
    """
    trials = config.simulation.trials
    for i, entry in enumerate(trials if isinstance(trials, list) else []):
        if entry.light is not None and task.light is None:
            raise ConfigError(
                source,
                ("simulation", "trials", i, "light"),
                f"a task of type {config.task.type!r} has no light",
            )


def out_of_reach(creature: Creature, world: World, start: Vector, light: Vector) -> str | None:
    """Why a light cannot be reached; None where it may be.

    Args:
        creature: the animal.
        world: its surroundings.
        start: place of its root at the start, m.
        light: place of the light, m.
    """
    where = "({:g}, {:g}, {:g})".format(*light)
    if world.ground is not None:
        solid = (world.ground.floor, *world.ground.obstacles)
        depth = -float(nearest(solid, jnp.array(light))[0])
        if depth > 0:
            return f"the light at {where} would be {depth:.3g} m deep in the ground"
    centres, _ = neutral_pose(creature)
    reach = max(body.shape.reach for body in creature.bodies)
    length = float(np.ptp(centres, axis=0).max()) + 2 * reach
    distance = float(np.linalg.norm(np.subtract(light, start)))
    if not distance:
        return f"the light at {where} would be where the animal starts"
    if distance > _FARTHEST_LIGHT * length:
        return (
            f"the light at {where} would be {distance:.3g} m from the start; allowed: up to "
            f"{_FARTHEST_LIGHT:g} times the creature's length, {_FARTHEST_LIGHT * length:.3g} m"
        )
    return None


def _start_height(
    creature: Creature, world: World, x: float, y: float, heading: float, start_clearance: float
) -> float | None:
    """Of the root's centre, m: where the animal stands on the ground, or height 0.

    None where there is no place to stand.
    """
    footing = world.footing
    if footing is None:
        return 0.0
    height = start_clearance - lowest_height(creature)
    if footing.ground.level is not None:
        return footing.ground.level + height
    floor = footing.ground.floor
    if isinstance(floor, Plane) and not footing.ground.obstacles:
        normal = np.array(floor.normal) / np.linalg.norm(floor.normal)
        seen = euler_to_matrix(0.0, 0.0, heading).T @ normal
        rise = start_clearance - lowest_along(creature, seen) + float(floor.height)
        return float((rise - normal[:2] @ (x, y)) / normal[2])
    level = Situation((x, y, 0.0), heading)

    @jax.jit
    def gap(height):
        state = resting_state(
            world.tree, (), position=level.start_position, orientation=level.orientation
        )
        raised = dataclasses.replace(state, position=state.position.at[2].set(height))
        return clearance(footing, kinematics(world.tree, raised)).min()

    # Raising it by its missing clearance raises it less than enough, but for level ground.
    for _ in range(_START_STEPS):
        missing = start_clearance - float(gap(height))
        if abs(missing) < _START_ACCURACY:
            return height
        height += missing
    return None
