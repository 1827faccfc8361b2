"""Initial situations of the trials, from the configuration's start and light."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from evo_cpg.creature.algebra.decisions import Condition, chosen, searched
from evo_cpg.creature.algebra.numerics import Number, Triple, as_vector, is_traced, xp
from evo_cpg.creature.algebra.rotation import euler_to_matrix
from evo_cpg.creature.creature import Creature, length_of, lowest_height, neutral_pose
from evo_cpg.io.errors import Key, KeyProblem
from evo_cpg.io.schema.experiment import ExperimentConfig, SituationConfig
from evo_cpg.io.schema.task import DEFAULT_LIGHT
from evo_cpg.native.jax_internals import quick_jit
from evo_cpg.physics.contact.contact_points import clearance
from evo_cpg.physics.contact.terrain import Plane, nearest
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.kinematics import kinematics
from evo_cpg.physics.tree.state import resting_state
from evo_cpg.simulation.plans import Programs
from evo_cpg.simulation.settle import NoRestError, Settling, settled
from evo_cpg.simulation.situation import Situation

# Largest number of steps to find the height at which an animal stands, and its accuracy: in m, and
# as a fraction of the distance from the origin, because float32 resolves 1.2e-7 of it.
_START_STEPS, _START_ACCURACY, _START_ROUNDING = 200, 1e-5, 5e-7

# Largest allowed spacing of float32 at the start along x, y and z, relative to the creature's
# length times the physics step in s. Each step rounds a position by up to half the spacing. At
# 0.006 the turtle's displacement is right to 2.4 %, although it moves only 0.01 lengths in a
# second. At 0.024 the displacement is wrong by a third. Heights may be coarser, because the ground
# holds the animal, so that they do not drift. Up to 0.24 the hexapod walks as far as at height 0,
# and at 2 it diverges.
_COARSEST = (0.006, 0.006, 0.1)

# Largest distance of a light, in lengths of the creature. No creature moves that far in a trial.
_FARTHEST_LIGHT = 1000.0


def build_situations(
    config: ExperimentConfig, creature: Creature, world: World
) -> tuple[Situation, ...]:
    """Build the situations of the trials, or the one situation of all trials.

    Raises:
        KeyProblem: the creature cannot stand or come to rest, or a light cannot be reached.
    """
    settings = config.simulation
    common = getattr(config.task, "light", None)
    h = 1.0 / (settings.control_rate_hz * settings.substeps)
    settling = functools.cache(lambda: Settling(world, h))
    situations: list[Situation] = []
    begins: list[Situation] = []
    listed = settings.trials if isinstance(settings.trials, list) else [SituationConfig()]
    for i, entry in enumerate(listed):
        key = ("simulation", "trials", i)
        x, y = settings.start if entry.start is None else entry.start
        turn = entry.start_heading_deg
        heading = xp.deg2rad(settings.start_heading_deg if turn is None else turn)
        given = (x, y, heading)
        known = [(*begin.start_position[:2], begin.start_heading) for begin in begins]
        same = chosen(
            lambda given=given, known=known: known.index(given) if given in known else None
        )
        if same is not None:
            begin = begins[same]
        else:
            here: Key = ("simulation", "start") if entry.start is None else (*key, "start")
            height = _start_height(creature, world, x, y, heading, settings.start_clearance)
            if height is None:
                problem = f"no place to stand at ({x:g}, {y:g}). Is it inside an obstacle?"
                raise KeyProblem(here, problem)
            begin = Situation((x, y, height), heading)
            _require_resolved(creature, begin.start_position, h, here)
            if settings.start_pose == "settled":
                try:
                    begin = settled(settling, world, h, begin)
                except NoRestError as error:
                    problem = f"'settled': no rest from the start at ({x:g}, {y:g}), {error}"
                    raise KeyProblem(("simulation", "start_pose"), problem) from None
        begins.append(begin)
        start, light = begin.start_position, common
        if creature.root_joint is not None:
            # The root's own joint holds it at an offset from the start.
            own = neutral_pose(creature)[0][creature.root_index]
            offset = euler_to_matrix(0.0, 0.0, begin.start_heading) @ own
            start = as_vector(xp.array(start) + offset)
        if entry.light is not None:
            light = entry.light.over(common or DEFAULT_LIGHT)
        goal = light and light.position(start, heading)
        # A task that places its lights itself has no key for one.
        placed = entry.light is not None or "light" in type(config.task).model_fields
        problem = (placed and goal) and chosen(
            functools.partial(out_of_reach, creature, world, start, goal),
            functools.partial(_is_still_within_reach, creature, world, start, goal),
        )
        if problem:
            own = entry.light is not None
            raise KeyProblem((*key, "light") if own else ("task", "light"), problem)
        situations.append(begin._replace(light=goal))
    return tuple(situations)


def _require_resolved(creature: Creature, place: Triple, h: Number, start: Key) -> None:
    """Check that float32 resolves the motion at the start.

    The position is in m, and the physics step ``h`` in s. Traced numbers are not checked.

    Raises:
        KeyProblem: the start is too far from the origin.
    """
    length = length_of(creature)
    if is_traced(place, h, length):
        return
    for axis, here, coarsest in zip("xyz", place, _COARSEST, strict=True):
        # Below this power of two, neighbouring numbers differ by at most ``coarsest * length * h``.
        most = 2.0 ** (24 + np.floor(np.log2(coarsest * length * h)))
        if abs(here) >= most:
            raise KeyProblem(
                ("world", "ground", "floor") if axis == "z" else start,
                f"the animal of {length:.3g} m would start at {axis} = {here:g} m, where float32 "
                f"resolves only {np.spacing(np.float32(abs(here))):.2g} m. It would stand still or "
                f"move wrongly in steps of {h:.2g} s. Allowed: less than {most:g} m from the "
                f"origin. Subtract about {here:.6g} m from the world's {axis} coordinates",
            )


def _is_still_within_reach(
    creature: Creature, world: World, start: Triple, light: Triple, problem: str | None
) -> Condition:
    """Return whether `out_of_reach` finds no problem. The numbers and the result may be traced."""
    holds = not problem
    if world.ground is not None:
        solid = (world.ground.floor, *world.ground.obstacles)
        holds = holds & (nearest(solid, jnp.array(light))[0] >= 0)
    distance = xp.linalg.norm(xp.array(light) - xp.array(start))
    return holds & (distance > 0) & (distance <= _FARTHEST_LIGHT * _length(creature))


def _length(creature: Creature) -> Number:
    """Return an upper bound of the creature's length in its neutral pose, m."""
    centres, _ = neutral_pose(creature)
    reach = xp.max(xp.array([body.shape.reach for body in creature.bodies]))
    return xp.ptp(centres, axis=0).max() + 2 * reach


def out_of_reach(creature: Creature, world: World, start: Triple, light: Triple) -> str | None:
    """Return why a light cannot be reached, or None if it may be reached."""
    where = "({:g}, {:g}, {:g})".format(*light)
    if world.ground is not None:
        solid = (world.ground.floor, *world.ground.obstacles)
        depth = -float(nearest(solid, jnp.array(light))[0])
        if depth > 0:
            return f"the light at {where} would be {depth:.3g} m deep in the ground"
    length = _length(creature)
    distance = float(np.linalg.norm(np.subtract(light, start)))
    if not distance:
        return f"the light at {where} would be where the animal starts"
    if distance > _FARTHEST_LIGHT * length:
        return (
            f"the light at {where} would be {distance:.3g} m from the start. Allowed: up to "
            f"{_FARTHEST_LIGHT:g} times the creature's length, {_FARTHEST_LIGHT * length:.3g} m"
        )
    return None


def _start_height(
    creature: Creature, world: World, x: Number, y: Number, heading: Number, start_clearance: Number
) -> Number | None:
    """Return the height of the root's centre at which the animal stands on the ground, m.

    If the root hangs on the world, it is the height of the frame on which it hangs.

    Return 0 without ground, and None if there is no height to stand at.
    """
    contact_model = world.contact_model
    if contact_model is None:
        return 0.0
    height = start_clearance - lowest_height(creature)
    if contact_model.ground.level is not None:
        return contact_model.ground.level + height
    floor = contact_model.ground.floor
    if isinstance(floor, Plane) and not contact_model.ground.obstacles:
        normal = xp.array(floor.normal)
        normal = normal / xp.linalg.norm(normal)
        seen = euler_to_matrix(0.0, 0.0, heading).T @ normal
        rise = start_clearance - lowest_height(creature, up=seen) + floor.height
        return (rise - normal[0] * x - normal[1] * y) / normal[2]

    def accuracy(here: Number) -> Number:
        return xp.maximum(_START_ACCURACY, _START_ROUNDING * xp.max(abs(xp.array([x, y, here]))))

    def search() -> float | None:
        gap, numbers = _gaps.of(world)
        here = height
        # In float64, like `followed`, so that both agree where drawn numbers do not matter.
        with jax.enable_x64(True):
            # Except on level ground, raising the creature by the missing clearance is too little.
            for _ in range(_START_STEPS):
                reached, rise = gap(numbers, x, y, heading, here)
                missing = start_clearance - float(reached)
                if abs(missing) < accuracy(here):
                    return here + missing / float(rise)
                here += missing
        return None

    @functools.cache
    def followed(found: float) -> tuple[Number, Condition]:
        """Return the height as a function of traced numbers, and whether it is found."""
        if not is_traced(world, x, y, heading, height):
            return found, True

        stopped: list[Any] = jax.tree.map(
            lambda leaf: jax.lax.stop_gradient(leaf) if is_traced(leaf) else leaf,
            [world, x, y, heading],
        )
        clearance = jax.lax.stop_gradient(jnp.asarray(start_clearance, float))

        def misses(missing: Array) -> Array:
            return abs(missing) >= accuracy(found)

        def step(carry: tuple[Array, ...]) -> tuple[Array, ...]:
            count, here, missing, rise = carry
            here = here + missing / rise
            reached, rise = _gap(*stopped, height=here)
            return count + 1, here, clearance - reached, rise

        # Tracing a gap takes seconds, so the first step stays in place, and only it has a gap.
        begin = jnp.asarray(found, float)
        _, here, missing, _ = jax.lax.while_loop(
            lambda carry: (carry[0] == 0) | (misses(carry[2]) & (carry[0] < _START_STEPS)),
            step,
            (jnp.asarray(0), begin, jnp.zeros_like(begin), jnp.ones_like(begin)),
        )
        # This Newton step makes the height depend on the traced numbers.
        reached, rise = _gap(world, x, y, heading, here)
        return here + (start_clearance - reached) / jax.lax.stop_gradient(rise), ~misses(missing)

    def stands(found: float | None) -> Condition:
        if found is None:
            return not is_traced(world, x, y, heading, height)
        return followed(found)[1]

    found = searched(search, stands)
    return None if found is None else followed(found)[0]


def _gap(
    world: World, x: Number, y: Number, heading: Number, height: Number
) -> tuple[Array, Array]:
    """Return the clearance of the neutral pose above the ground, m, and its height derivative."""
    contact_model = world.contact_model
    assert contact_model is not None

    def gap(height: Array) -> Array:
        turn = Situation((x, y, 0.0), heading).orientation
        state = resting_state(world.tree, (), height.dtype, (x, y, height), turn)
        return clearance(contact_model, kinematics(world.tree, state)).min()

    height = jnp.asarray(height, float)
    return jax.jvp(gap, (height,), (jnp.ones_like(height),))


_gaps = Programs(lambda plan: quick_jit(lambda numbers, *where: _gap(plan.world(numbers), *where)))
