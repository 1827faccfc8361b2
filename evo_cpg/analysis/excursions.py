"""Extremes of a trial that an audit limits: peaks, depths, fractions of time."""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from evo_cpg.analysis.energy import along_time
from evo_cpg.creature.algebra.linear import expand_dims_like, matvec
from evo_cpg.creature.creature import Creature
from evo_cpg.creature.per_body import take
from evo_cpg.creature.shapes import Shape
from evo_cpg.physics.contact.contact_points import contact_points
from evo_cpg.physics.contact.pairs import Pairs, gaps_of_pairs, make_pairs
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.kinematics import kinematics
from evo_cpg.physics.tree.tendon import torque_of
from evo_cpg.simulation.observers import PhysicsSteps
from evo_cpg.simulation.simulation import Simulation

# Residuals above which a step's equations count as unsolved, and its friction as off its cone
# (`evo_cpg.physics.step.equations.Residual`).
SOLVED, SLIPPING = 1e-3, 1e-1

# Number of instants at which the overlap of two bodies is computed in one call.
_INSTANTS = 64

# Points on the line from an eye to the light, and depth (m) in the ground from which a point blocks
# the light.
_POINTS, _WITHIN = 128, 1e-3


class Excursions(NamedTuple):
    """Extremes of one trial.

    Attributes:
        displacement: displacement of the root, towards the light or over the ground, m.
        airborne_way: fraction of the displacement while nothing touched the ground and no body's
            centre was under water, or 0 without ground.
        penetration: largest penetration of the ground, m.
        overlap: deepest overlap of two bodies in `World.watched`, m.
        overlapping: names of these two bodies, empty without overlap.
        unsolved: fraction of steps whose equations are not solved to `SOLVED`.
        slipping: fraction of steps whose friction misses its cone by more than `SLIPPING`.
        peak_torque: largest torque of any motor about a turning axis, N m.
        overload: largest torque of a motor beyond its limit, as a fraction of the limit, or 0
            without limits.
        peak_power: largest absolute power of all motors, W.
        mean_power: mean absolute power of all motors, W.
        peak_rate: largest rate of any turning axis, rad/s.
        peak_speed: largest speed of the root, m/s.
        seen_through_ground: fraction of the light that eyes see with ground in the way.
    """

    displacement: float
    airborne_way: float
    penetration: float
    overlap: float
    overlapping: tuple[str, ...]
    unsolved: float
    slipping: float
    peak_torque: float
    overload: float
    peak_power: float
    mean_power: float
    peak_rate: float
    peak_speed: float
    seen_through_ground: float


def excursions(
    simulation: Simulation, creature: Creature, steps: PhysicsSteps, situation: int = 0
) -> Excursions:
    """Measure the extremes of a trial in one of the simulation's situations."""
    # The steps do not hold the place of a light that moves.
    world, light = simulation.world, simulation.goals[situation]
    every = make_pairs(creature, world.tree, world.watched)

    def depths(steps: PhysicsSteps) -> tuple[Array, Array, Array]:
        kin = kinematics(world.tree, steps.after)
        clearance = apart = kin.origin[0, :0]
        if world.contact_model is not None:
            clearance = contact_points(world.contact_model, kin).gap
        if every is not None:
            apart = gaps_of_pairs(every, kin)
        return clearance, apart, swims(world, steps)

    clearance, apart, swimming = along_time(depths, steps)
    overlap, overlapping = _deepest_overlap(every, world, creature, steps, apart)
    rate = (steps.before.qd + steps.after.qd) / 2
    turns = ~world.tree.slides
    power = steps.torque * rate
    # The largest force of a motor beyond its limit, as a fraction of the limit.
    tree, overload = world.tree, 0.0
    forces = [(steps.torque, tree.torque_limit)]
    if tree.tendons is not None and steps.tension is not None:
        pull = np.asarray(torque_of(tree.tendons, jnp.asarray(steps.tension), len(steps.torque)))
        forces = [
            (steps.torque - pull, tree.torque_limit),
            (steps.tension, tree.tendons.torque_limit),
        ]
    for force, limits in forces:
        limit = np.asarray(limits, float)
        limited = np.isfinite(limit) & (limit > 0)
        peaks = np.abs(force).max(-1)[limited]
        overload = max(overload, float((peaks / limit[limited] - 1.0).max(initial=0.0)))
    root = np.asarray(steps.after.position, float)
    h = simulation.step_length
    travelled = displacement(np.concatenate([steps.before.position[:, :1], root], 1), light)
    return Excursions(
        displacement=travelled,
        airborne_way=(
            0.0
            if world.contact_model is None
            else _airborne_displacement(steps, swimming, light, h)
        ),
        penetration=float(max(0.0, -clearance.min(initial=np.inf))),
        overlap=overlap,
        overlapping=overlapping,
        unsolved=float((steps.solved_residual > SOLVED).mean()),
        slipping=float((steps.coulomb_residual > SLIPPING).mean()),
        peak_torque=float(np.abs(steps.torque[turns]).max(initial=0.0)),
        overload=overload,
        peak_power=float(np.abs(power).sum(0).max()),
        mean_power=float(np.abs(power).sum(0).mean()),
        peak_rate=float(np.abs(steps.after.qd[turns]).max(initial=0.0)),
        peak_speed=float(np.linalg.norm(steps.after.linear_velocity, axis=0).max()),
        seen_through_ground=_seen_through_ground(simulation, steps, light),
    )


def displacement(
    path: Float[np.ndarray, "3 t"], light: tuple[float, float, float] | np.ndarray | None
) -> float:
    """Return the decrease in distance to the light, or the horizontal displacement, m.

    Args:
        path: positions, the initial one first, m.
        light: position of the light, m, or None without a light.
    """
    first, last = np.asarray(path[:, 0], float), np.asarray(path[:, -1], float)
    if light is None:
        return float(np.linalg.norm((last - first)[:2]))
    return float(np.linalg.norm(light - first) - np.linalg.norm(light - last))


def swims(world: World, steps: PhysicsSteps) -> Bool[Array, " t"]:
    """Return whether the centre of any body is under water, after every step."""
    centre, _ = _poses(world, steps)
    return (centre[2] < world.water_level).any(0)


def _deepest_overlap(
    pairs: Pairs | None,
    world: World,
    creature: Creature,
    steps: PhysicsSteps,
    apart: Float[np.ndarray, "k t"],
) -> tuple[float, tuple[str, ...]]:
    """Return the deepest overlap of two bodies, m, and their names.

    Args:
        pairs: pairs of bodies to check.
        world: world of the trial.
        creature: the animal.
        steps: physics steps of the trial.
        apart: gap between the rounded boxes of each pair, m.
    """
    deepest, names = 0.0, ()
    if pairs is None or not apart.size:
        return deepest, names
    # Use the order of the tree, as `kinematics` does.
    shapes = [body.shape for body in creature.bodies_of(world.tree.names)]
    poses = functools.cache(lambda: along_time(functools.partial(_poses, world), steps))
    for *own, gap in zip(pairs.first, pairs.second, apart, strict=True):
        if all(shapes[i].fills_rounded_box for i in own):
            found = -float(gap.min())
        else:
            # Bodies overlap no more than their rounded boxes, so the instants with the deepest
            # boxes are first.
            (i, j), found, order = own, deepest, np.argsort(gap)
            for start in range(0, len(order), _INSTANTS):
                instants = order[start : start + _INSTANTS]
                if -gap[instants[0]] <= found:
                    break
                centre, rotation = poses()
                places = centre[:, i, instants].T, centre[:, j, instants].T
                turned = rotation[:, :, i, instants], rotation[:, :, j, instants]
                turns = np.moveaxis(turned[0], -1, 0), np.moveaxis(turned[1], -1, 0)
                found = max(found, -float(gaps((shapes[i], shapes[j]), places, turns).min()))
        if found > deepest:
            deepest, names = found, tuple(world.tree.names[i] for i in own)
    return deepest, names


def _poses(world: World, steps: PhysicsSteps) -> tuple[Array, Array]:
    """Return centres and rotations of all bodies after every step, in the world."""
    kin = kinematics(world.tree, steps.after)
    return kin.origin + matvec(kin.rotation, expand_dims_like(world.tree.centre, kin.origin)), (
        kin.rotation
    )


def _airborne_displacement(
    steps: PhysicsSteps,
    swims: Bool[np.ndarray, " t"],
    light: tuple[float, float, float] | None,
    h: float,
) -> float:
    """Return the fraction of the displacement without contact with ground or water."""
    touching = (np.abs(steps.contact_force).sum((0, 1)) > 0) | swims
    start = np.asarray(steps.before.position[:, 0], float)
    end = np.asarray(steps.after.position[:, -1], float)
    towards = (end if light is None else np.array(light)) - start
    towards[2] = 0.0
    length = np.linalg.norm(towards)
    if length == 0:
        return 0.0
    forward = h * (towards / length) @ np.asarray(steps.after.linear_velocity, float)
    total = forward.sum()
    return float(np.clip(forward[~touching].sum() / total, 0.0, 1.0)) if total > 0 else 0.0


def _seen_through_ground(
    simulation: Simulation, steps: PhysicsSteps, light: tuple[float, float, float] | None
) -> float:
    """Return the fraction of the light seen by all eyes, in all control steps, through ground."""
    world, sensors = simulation.world, simulation.sensors
    bodies = np.array(sensors.eye_bodies, int)
    if world.contact_model is None or light is None or not len(bodies) or sensors.blind:
        return 0.0
    floor = world.contact_model.ground.floor
    # Leave out the eye and the light themselves.
    fractions = np.linspace(0.0, 1.0, _POINTS + 2)[1:-1]

    def lowest(steps: PhysicsSteps) -> Float[Array, "e t"]:
        kin = kinematics(world.tree, steps.before)
        rotation = take(kin.rotation, bodies, 2)
        eye = take(kin.origin, bodies) + matvec(
            rotation, expand_dims_like(sensors.eye_positions, kin.origin)
        )
        to_light = jnp.asarray(light)[:, None, None] - eye
        line = eye[:, None] + fractions[None, :, None, None] * to_light[:, None]
        return floor.distance(line)[0].min(0)

    sampled = jax.tree.map(lambda x: x[..., :: simulation.substeps], steps)
    hidden = along_time(lowest, sampled) < -_WITHIN
    seen = np.asarray(sampled.light, float)
    total = seen.sum()
    return float((seen * hidden).sum() / total) if total > 0 else 0.0


# Number of initial directions, and number of rounds that try directions near the best one.
_DIRECTIONS, _ROUNDS = 400, 48
# Initial angle between the best direction and the directions near it, rad, and their number.
_FIRST, _AROUND = 0.2, 8


def gaps(
    shapes: tuple[Shape, Shape],
    places: tuple[Float[np.ndarray, "t 3"], Float[np.ndarray, "t 3"]],
    turns: tuple[Float[np.ndarray, "t 3 3"], Float[np.ndarray, "t 3 3"]],
) -> Float[np.ndarray, " t"]:
    """Return the distance of two shapes, m. An overlap is the negative depth.

    The depth is the shortest displacement that separates the shapes. The distance is the largest
    distance of two parallel planes between the shapes that touch them. The search finds at most
    this distance, so it never underestimates an overlap.

    Args:
        shapes: the two shapes.
        places: positions of their centres, m.
        turns: rotations from their frames to the world.
    """
    offset = places[1] - places[0]

    def apart(normals: Float[np.ndarray, "t n 3"]) -> Float[np.ndarray, "t n"]:
        reach = (normals @ offset[..., None])[..., 0]
        for shape, turn, sign in zip(shapes, turns, (1.0, -1.0), strict=True):
            reach = reach - shape.height(sign * normals @ turn)
        return reach

    # Unit vectors spread evenly along a spiral.
    height = 1.0 - (2.0 * np.arange(_DIRECTIONS) + 1.0) / _DIRECTIONS
    turn, radius = np.pi * (1.0 + np.sqrt(5.0)) * np.arange(_DIRECTIONS), np.sqrt(1.0 - height**2)
    sphere = np.column_stack([radius * np.cos(turn), radius * np.sin(turn), height])
    count = len(offset)
    spread = np.broadcast_to(sphere, (count, _DIRECTIONS, 3))
    best, most = _best(spread, apart(spread))
    angle = np.full(count, _FIRST)
    around = 2 * np.pi * np.arange(_AROUND) / _AROUND
    for _ in range(_ROUNDS):
        # Two unit vectors perpendicular to each best normal and to each other.
        first = np.cross(best, np.eye(3)[np.abs(best).argmin(1)])
        first /= np.linalg.norm(first, axis=1, keepdims=True)
        second = np.cross(best, first)
        circle = np.cos(around)[:, None, None] * first + np.sin(around)[:, None, None] * second
        tried = np.cos(angle)[:, None] * best + np.sin(angle)[:, None] * circle
        tried = np.moveaxis(tried, 0, 1)
        other, more = _best(tried, apart(tried))
        better = more > most
        best, most = np.where(better[:, None], other, best), np.maximum(more, most)
        angle = np.where(better, angle, angle / 2)
    return most


def _best(
    normals: Float[np.ndarray, "t n 3"], values: Float[np.ndarray, "t n"]
) -> tuple[Float[np.ndarray, "t 3"], Float[np.ndarray, " t"]]:
    place = values.argmax(1)[:, None]
    return (
        np.take_along_axis(normals, place[..., None], 1)[:, 0],
        np.take_along_axis(values, place, 1)[:, 0],
    )
