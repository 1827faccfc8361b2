"""Water, ground and gravity that were hardly meant, or with which the task means nothing."""

from collections.abc import Iterator

from evo_cpg.config.plausible.doubt import Case, Doubt
from evo_cpg.config.schema.ground import PlaneConfig, ReliefConfig, ShoreConfig
from evo_cpg.config.schema.task import WalkConfig
from evo_cpg.creature.creature import lowest_height

# An animal that starts so many times its own length above what holds it falls for long.
_FALL = 10.0


def water_by_default(case: Case) -> Iterator[Doubt]:
    """Ground that lies under water since nothing was written about water."""
    world = case.config.world
    if world.ground is None or "water" in world.model_fields_set:
        return
    yield Doubt(
        ("world", "water"),
        "left out",
        "unless it is written, there is water everywhere, so the ground lies under water; write "
        "water: null for dry land, water: {surface: 0} for water up to a height, or water: {} for "
        "water everywhere",
    )


def water_below_ground(case: Case) -> Iterator[Doubt]:
    """Water that lies under the ground everywhere."""
    water, lowest = case.config.world.water, lowest_ground(case)
    if water is None or water.surface is None or lowest is None or water.surface > lowest:
        return
    yield Doubt(
        ("world", "water", "surface"),
        water.surface,
        f"the ground is nowhere lower than {lowest:.3g} m, so there is no water above it; raise "
        "the surface, lower the ground (world.ground.floor), or leave the water out (water: null)",
    )


def lowest_ground(case: Case) -> float | None:
    """Height of the lowest ground, m; None where there is no ground, no end to it, or no telling.

    Slopes go down for ever.
    """
    ground = case.config.world.ground
    if ground is None:
        return None
    floor = ground.floor
    if isinstance(floor, PlaneConfig):
        return None if floor.slope_deg else floor.height
    if isinstance(floor, ShoreConfig):
        return min(floor.start_height, floor.stop_height)
    if isinstance(floor, ReliefConfig):
        return min(map(min, floor.heights))
    return None


def nothing_to_hold_it(case: Case) -> Iterator[Doubt]:
    """Gravity, but neither water, ground nor a force law: the animal falls for ever."""
    world = case.config.world
    if world.gravity and world.water is None and world.ground is None and not world.forces:
        yield Doubt(
            ("world", "gravity"),
            world.gravity,
            "there is neither water nor ground, so the animal falls from start to end; give the "
            "world a ground (ground: {}) or water (water: {}), or set gravity to 0",
        )


def ground_without_weight(case: Case) -> Iterator[Doubt]:
    """Ground on which nothing presses the animal."""
    world = case.config.world
    if not world.gravity and world.water is None and world.ground is not None:
        yield Doubt(
            ("world", "gravity"),
            world.gravity,
            "without gravity nothing holds the animal on the ground; the earth has 9.81 m/s^2",
        )


def start_above(case: Case) -> Iterator[Doubt]:
    """A start high above the ground or the water, or above a ground that is not there."""
    world, clearance = case.config.world, case.config.simulation.start_clearance
    key, most = ("simulation", "start_clearance"), _FALL * case.length
    if world.ground is None and clearance:
        problem = "there is no ground, so this changes nothing; give the world a ground, or leave "
        yield Doubt(key, clearance, f"{problem}it out")
    elif world.ground is not None and world.gravity and clearance > most:
        problem = f"the animal of {case.length:.2g} m falls from that height; plausible is up to "
        yield Doubt(key, clearance, f"{problem}{most:.2g} m; lengths are in m: is this in mm?")
    water = world.water
    if world.ground is None and world.gravity and water is not None and water.surface is not None:
        height = float(lowest_height(case.creature)) - water.surface
        if height > most:
            yield Doubt(
                ("world", "water", "surface"),
                water.surface,
                f"the animal of {case.length:.2g} m starts {height:.3g} m above the water, at "
                f"height 0, and falls in; plausible is up to {most:.2g} m",
            )


def walk_without_ground(case: Case) -> Iterator[Doubt]:
    """The task of walking where there is nothing to walk on."""
    task = case.config.task
    if isinstance(task, WalkConfig) and case.config.world.ground is None:
        yield Doubt(
            ("task", "type"),
            task.type,
            "there is no ground to walk on, so the animal counts as airborne all the time; give "
            "the world a ground (world.ground: {}), or choose task: {type: distance}",
        )


RULES = (
    water_by_default,
    water_below_ground,
    nothing_to_hold_it,
    ground_without_weight,
    start_above,
    walk_without_ground,
)
