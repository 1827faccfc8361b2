"""Rules about world, trials and search: unintended values, and tasks without meaning."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from evo_cpg.creature.creature import lowest_height
from evo_cpg.creature.tree import build_tree
from evo_cpg.io.errors import Key
from evo_cpg.io.lint.rule import Case, LintWarning, rule
from evo_cpg.io.schema.ground import BoulderConfig, HillsConfig, ReliefConfig
from evo_cpg.physics.water.lift import make_plate_lift
from evo_cpg.simulation.judge import WILDEST_SPEED

# Largest movement by gravity in a physics step, as a fraction of a body's half thickness. At 0.6
# the body sinks into the ground by 0.05 of that. At 2 a floating body never rests.
_SINK = 0.5

# Largest size of an obstacle, in lengths of the creature.
_OBSTACLE = 100.0

# Largest rise of the floor between the ends of a body, as a fraction of its length.
_BUMP = 0.1

# Largest initial height above the ground or water, in lengths of the creature.
_FALL = 10.0


@rule
def step_length(case: Case) -> Iterator[LintWarning]:
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
        yield case.warning(
            ("simulation", "substeps"),
            f"body {name!r} is {2 * half:.2g} m thick and falls {world.gravity * h * h:.2g} m in a "
            f"physics step of {h:.2g} s. It would sink into the ground or bob forever. Plausible: "
            f"{int(np.ceil(enough))} or more",
        )


@rule
def obstacle_size(case: Case) -> Iterator[LintWarning]:
    """Warn of obstacles more than a hundred times as large as the creature."""
    ground = case.config.world.ground
    most = _OBSTACLE * case.length
    for i, obstacle in enumerate(ground.obstacles if ground else ()):
        name = "radius" if isinstance(obstacle, BoulderConfig) else "size"
        edge = float(np.min(getattr(obstacle, name)))
        if edge > most:
            yield case.warning(
                ("world", "ground", "obstacles", i, name),
                f"{edge:g} m next to a creature of {case.length:.2g} m. Plausible: up to "
                f"{most:.2g} m. Lengths are in m. Is this in mm?",
            )


@rule
def floor_bumps(case: Case) -> Iterator[LintWarning]:
    """Warn of bumps between the corners of a box, or the rims of a cylinder."""
    boxes = [
        (2 * float(body.shape.half_extents.max()), body.name)
        for body in case.creature.bodies
        if any(part.kind in ("box", "cylinder") for part in body.shape.floor_parts())
    ]
    ground = case.config.world.ground
    if not boxes or ground is None:
        return
    (edge, name), floor = max(boxes), ground.floor
    problem = (
        f"body {name!r} is {edge:.3g} m long and touches the floor only with its corners or rims"
    )
    if isinstance(floor, HillsConfig) and floor.height > 0 and floor.length < edge:
        key = "world", "ground", "floor", "length"
        yield case.warning(key, f"{problem}. Plausible: {edge:.3g} m or more")
    if isinstance(floor, ReliefConfig):
        height = _bump(np.array(floor.heights), round(edge / (2 * floor.spacing)))
        if height > _BUMP * edge:
            key = "world", "ground", "floor", "spacing"
            yield case.warning(
                key,
                f"{problem}. A bump of {height:.2g} m fits between them, and passes through the "
                "body. Use shorter bodies",
            )


def _bump(heights: np.ndarray, reach: int) -> float:
    """Return the largest rise of a grid above the mean of the points ``reach`` steps either way."""
    highest = 0.0
    for rows in (heights, heights.T):
        if 0 < reach < len(rows) / 2:
            ends = (rows[: -2 * reach] + rows[2 * reach :]) / 2
            highest = max(highest, float((rows[reach:-reach] - ends).max()))
    return highest


@rule
def friction(case: Case) -> Iterator[LintWarning]:
    """Warn of a dynamic friction above the static friction."""
    materials = case.config.creature.materials.items()
    places: dict[Key, Any] = {("creature", "materials", name): each for name, each in materials}
    if case.config.world.ground is not None:
        places["world", "ground"] = case.config.world.ground
    for key, given in places.items():
        if given.dynamic_friction > given.static_friction:
            yield case.warning(
                (*key, "dynamic_friction"),
                f"more than static_friction ({given.static_friction:g}), but sliding bodies have "
                "less friction than resting ones. Were the two swapped?",
            )


@rule
def water_by_default(case: Case) -> Iterator[LintWarning]:
    """Warn of ground that lies under water because the key ``water`` is left out."""
    world = case.config.world
    if world.ground is None or "water" in world.model_fields_set:
        return
    yield case.warning(
        ("world", "water"),
        "without this key there is water everywhere, so the ground lies under water. Write "
        "water: null for dry land, water: {surface: 0} for water up to a height, or water: {} for "
        "water everywhere",
        "left out",
    )


@rule
def lift_of_nothing(case: Case) -> Iterator[LintWarning]:
    """Warn of lift if no body is a plate."""
    water = case.config.world.water
    if water is None or not water.lift:
        return
    if make_plate_lift(case.creature, build_tree(case.creature)) is None:
        yield case.warning(
            ("world", "water", "lift"),
            "no body has lift; it needs a body that is thinner than three quarters of its width "
            "and that is not in a chain of three bodies or more",
        )


@rule
def water_below_ground(case: Case) -> Iterator[LintWarning]:
    """Warn of water that lies below the ground everywhere."""
    water, lowest = case.config.world.water, case.lowest_ground
    if water is None or water.surface is None or lowest is None or water.surface > lowest:
        return
    yield case.warning(
        ("world", "water", "surface"),
        f"the lowest ground is at {lowest:.3g} m, so the water covers no ground. Raise "
        "the surface, lower the ground (world.ground.floor), or leave the water out (water: null)",
    )


@rule
def nothing_to_hold_it(case: Case) -> Iterator[LintWarning]:
    """Warn of gravity without water, ground or a force law, because the animal falls forever.

    A root that hangs on the world does not fall.
    """
    world, hangs = case.config.world, any(body.hangs for body in case.config.creature.bodies)
    empty = world.water is None and world.ground is None and not world.forces
    if world.gravity and empty and not hangs:
        simulation = case.config.simulation
        speed = world.gravity * simulation.steps / simulation.control_rate_hz
        yield case.warning(
            ("world", "ground"),
            "there is neither water nor ground, so the animal falls from start to end, to "
            f"{speed:.3g} m/s. Above {WILDEST_SPEED:g} m/s it counts as diverged. Give the world a "
            "ground (ground: {}) or water (water: {}), or set gravity to 0",
        )


@rule
def ground_without_weight(case: Case) -> Iterator[LintWarning]:
    """Warn of ground without gravity or water, because nothing presses the animal onto it."""
    world = case.config.world
    if not world.gravity and world.water is None and world.ground is not None:
        yield case.warning(
            ("world", "gravity"),
            "without gravity nothing holds the animal on the ground. Earth has 9.81 m/s^2",
        )


@rule
def start_above(case: Case) -> Iterator[LintWarning]:
    """Warn of a start high above the ground or water, or with clearance but no ground."""
    world, clearance = case.config.world, case.config.simulation.start_clearance
    key, most = ("simulation", "start_clearance"), _FALL * case.length
    if world.ground is None and clearance:
        problem = "there is no ground, so this changes nothing. Leave it out, or give the world a "
        yield case.warning(key, f"{problem}ground")
    elif world.ground is not None and world.gravity and clearance > most:
        problem = f"the animal of {case.length:.2g} m falls from that height. Plausible: up to "
        yield case.warning(key, f"{problem}{most:.2g} m. Lengths are in m. Is this in mm?")
    water = world.water
    if world.ground is None and world.gravity and water is not None and water.surface is not None:
        height = float(lowest_height(case.creature)) - water.surface
        if height > most:
            yield case.warning(
                ("world", "water", "surface"),
                f"the animal of {case.length:.2g} m starts {height:.3g} m above the water, at "
                f"height 0, and falls in. Plausible: up to {most:.2g} m",
            )


@rule
def distance_of_a_fixed_root(case: Case) -> Iterator[LintWarning]:
    """Warn of a task that measures the displacement of a root that cannot move."""
    joint, kind = case.creature.root_joint, case.config.task.type
    if joint is not None and not joint.dofs and kind in ("distance", "walk"):
        yield case.warning(
            ("task", "type"),
            f"the task measures the displacement of the root, but {case.root!r} is fixed to the "
            "world, so it is always 0. Give its joint axes, or write a task of your own",
        )


@rule
def walk_without_ground(case: Case) -> Iterator[LintWarning]:
    """Warn of a task that needs ground if there is no ground."""
    task = case.config.task
    if task.needs_ground and case.config.world.ground is None:
        yield case.warning(
            ("task", "type"),
            "there is no ground to walk on, so the animal always counts as airborne. Give "
            "the world a ground (world.ground: {}), or choose task: {type: distance}",
        )


@rule
def trials_alike(case: Case) -> Iterator[LintWarning]:
    """Warn of several equal trials."""
    trials = case.config.simulation.trials
    if isinstance(trials, int):
        alike, count, hint = True, trials, "one is run"
    else:
        alike, count, hint = trials.count(trials[0]) == len(trials), len(trials), "one is enough"
    if case.config.noise.silent and alike and count > 1:
        problem = f"without noise all {count} trials are alike, so {hint}. Give noise, or a list of"
        yield case.warning(("simulation", "trials"), f"{problem} situations that differ", count)
