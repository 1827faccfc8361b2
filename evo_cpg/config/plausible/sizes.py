"""Lengths that look like those of another unit, and what float32 does not resolve."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from evo_cpg.config.errors import Key
from evo_cpg.config.plausible.doubt import Case, Doubt
from evo_cpg.config.schema.ground import BoulderConfig, HillsConfig, ReliefConfig
from evo_cpg.config.schema.shape import SolidConfig

# The longest edge of a body: from the limb of a small insect to a whale, m.
_BODIES = (0.001, 30.0)

# How much larger or smaller than the median of all bodies a body may be, and how many have to be
# there for a median to mean anything.
_UNLIKE, _SEVERAL = 50.0, 3

# In float32 a body carries a limb of up to so many times its mass: with 8000 times the motion was
# right, with 37,000 times it became infinite. A creature may have up to so many times the mass of
# its lightest body: with 1e12 times the motion was right, with 1e15 times it became infinite.
_CARRIES, _LIGHTER = 5000.0, 1e12

# Of half the thickness of a body, the most that gravity may move it in a physics step. At 0.6 the
# body sinks into the ground by a twentieth of that half. At 2 a floating body never comes to rest.
_FALL = 0.5

# An obstacle may be so many times the creature's length.
_OBSTACLE = 100.0

# Of a body's length: so much may the floor rise between its ends.
_BUMP = 0.1


def body_size(case: Case) -> Iterator[Doubt]:
    """No body is as large as a house, as small as dust, or unlike all the others."""
    edges = [2 * float(body.shape.half_extents.max()) for body in case.creature.bodies]
    middle = float(np.median(edges))
    low, high = _BODIES
    for (key, entry, _), edge in zip(case.bodies(), edges, strict=True):
        place, value = _size(entry.shape)
        if not low <= edge <= high:
            likely = f"in mm it would be {edge / 1000:g} m, in cm {edge / 100:g} m"
            if edge < low:
                likely = "is it in km, or divided by 1000 twice?"
            problem = f"a body of {edge:g} m; plausible are {low:g} to {high:g} m; {likely}"
        elif len(edges) >= _SEVERAL and not 1 / _UNLIKE <= edge / middle <= _UNLIKE:
            problem = (
                f"a body of {edge:g} m among others of {middle:g} m; plausible is up to "
                f"{_UNLIKE:g} times as much or as little; is it in another unit than m?"
            )
        else:
            continue
        yield Doubt((*key, "shape", *place), value, problem)


def masses(case: Case) -> Iterator[Doubt]:
    """No body carries a limb that is far heavier, or is a speck on the creature."""
    bodies = case.creature.bodies
    mass = {body.name: float(body.material.density * body.shape.volume) for body in bodies}
    parents = {body.name: body.joint.parent for body in bodies if body.joint is not None}
    carried = dict(mass)
    for name in mass:
        above = parents.get(name)
        while above is not None:
            carried[above] += mass[name]
            above = parents.get(above)
    total = sum(mass.values())
    for key, entry, body in case.bodies():
        own, above = mass[body.name], parents.get(body.name)
        if above is not None and carried[body.name] > _CARRIES * mass[above]:
            yield Doubt(
                (*key, "joint", "parent"),
                above,
                f"a body of {mass[above]:.2g} kg that carries a limb of {carried[body.name]:.2g} "
                f"kg; float32 resolves up to {_CARRIES:g} times its mass; make the heavier body "
                "the parent",
            )
        if total > _LIGHTER * own:
            yield Doubt(
                (*key, "material"),
                entry.material,
                f"a body of {own:.2g} kg on a creature of {total:.2g} kg; float32 resolves down to "
                f"{1 / _LIGHTER:g} of its mass; is it in another unit than m?",
            )


def step_length(case: Case) -> Iterator[Doubt]:
    """A step is short enough for what rests on the ground, or floats, to come to rest."""
    world, simulation = case.config.world, case.config.simulation
    if world.ground is None and (world.water is None or world.water.surface is None):
        return
    half, name = min((float(b.shape.half_extents.min()), b.name) for b in case.creature.bodies)
    h = 1.0 / (simulation.control_rate_hz * simulation.substeps)
    if world.gravity * h * h > _FALL * half:
        enough = np.sqrt(world.gravity / (_FALL * half)) / simulation.control_rate_hz
        yield Doubt(
            ("simulation", "substeps"),
            simulation.substeps,
            f"body {name!r} is {2 * half:.2g} m thick and falls {world.gravity * h * h:.2g} m in a "
            f"physics step of {h:.2g} s; it would sink into the ground or bob for ever; plausible "
            f"are {int(np.ceil(enough))} and more",
        )


def _size(shape: SolidConfig) -> tuple[tuple[str, ...], object]:
    """The key, within a shape, of what says how large it is, and the value."""
    for name in ("size", "radii", "length", "radius"):
        if hasattr(shape, name):
            return (name,), getattr(shape, name)
    return (), "mesh"


def obstacle_size(case: Case) -> Iterator[Doubt]:
    """No obstacle is a hundred times as large as the creature across."""
    ground = case.config.world.ground
    most = _OBSTACLE * case.length
    for i, obstacle in enumerate(ground.obstacles if ground else ()):
        round_one = isinstance(obstacle, BoulderConfig)
        name, value = ("radius", obstacle.radius) if round_one else ("size", obstacle.size)
        edge = obstacle.radius if round_one else min(obstacle.size)
        if edge > most:
            yield Doubt(
                ("world", "ground", "obstacles", i, name),
                value,
                f"{edge:g} m beside a creature of {case.length:.2g} m; plausible is up to "
                f"{most:.2g} m; lengths are in m: is this in mm?",
            )


def floor_bumps(case: Case) -> Iterator[Doubt]:
    """A box feels the floor by the corners of its lowest face, and no bump between them."""
    boxes = [
        (2 * float(body.shape.half_extents.max()), body.name)
        for body in case.creature.bodies
        if any(part.kind == "box" for part in body.shape.floor_parts())
    ]
    ground = case.config.world.ground
    if not boxes or ground is None:
        return
    (edge, name), floor = max(boxes), ground.floor
    problem = f"body {name!r} is {edge:.3g} m long and feels the floor by its corners alone"
    if isinstance(floor, HillsConfig) and floor.height > 0 and floor.length < edge:
        key = "world", "ground", "floor", "length"
        yield Doubt(key, floor.length, f"{problem}; plausible are hills of {edge:.3g} m and more")
    if isinstance(floor, ReliefConfig):
        height = _bump(np.array(floor.heights), round(edge / (2 * floor.spacing)))
        if height > _BUMP * edge:
            key = "world", "ground", "floor", "spacing"
            yield Doubt(
                key,
                floor.spacing,
                f"{problem}, and a bump of {height:.2g} m has room between them: bodies pass "
                "through it; shorter bodies would feel it",
            )


def _bump(heights: np.ndarray, reach: int) -> float:
    """The highest that a grid rises above the middle between places so many steps to both sides."""
    highest = 0.0
    for rows in (heights, heights.T):
        if 0 < reach < len(rows) / 2:
            ends = (rows[: -2 * reach] + rows[2 * reach :]) / 2
            highest = max(highest, float((rows[reach:-reach] - ends).max()))
    return highest


def friction(case: Case) -> Iterator[Doubt]:
    """Nothing that slides is held more than what rests."""
    of_bodies = case.config.creature.materials.items()
    places: list[tuple[Key, Any]] = [(("creature", "materials", name), m) for name, m in of_bodies]
    if case.config.world.ground is not None:
        places.append((("world", "ground"), case.config.world.ground))
    for key, given in places:
        if given.dynamic_friction > given.static_friction:
            yield Doubt(
                (*key, "dynamic_friction"),
                given.dynamic_friction,
                f"more than static_friction ({given.static_friction:g}); what slides is held less "
                "than what rests; were the two swapped?",
            )


RULES = (body_size, masses, step_length, obstacle_size, floor_bumps, friction)
