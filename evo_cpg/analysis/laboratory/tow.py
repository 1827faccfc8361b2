"""Measures of an animal that is towed with its root held.

A holder moves the root at a constant velocity U along its heading, and does not let it turn. In
deep water this is the same as a root at rest in a current -U (Galilean invariance). The mean force
of the holder along the heading is F. D is the drag of the straight, stiff body at the same speed.

    thrust = D - F,    efficiency = thrust U / P

P is the mean net power of the motors, the sum of torque x rate. The animal swims on its own at the
speed at which F is 0.
"""

import dataclasses
import functools
import math
import operator
from collections.abc import Mapping, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.analysis.cycles import last_cycles
from evo_cpg.analysis.gait_numbers import GaitNumbers
from evo_cpg.analysis.gait_quantities import Quantity
from evo_cpg.analysis.laboratory.settings import LabError, Setting, worded
from evo_cpg.native.jax_internals import quick_jit
from evo_cpg.physics.step.step import needs_iteration
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.kinematics import kinematics
from evo_cpg.simulation.recording import Recording
from evo_cpg.simulation.simulation import Simulation
from evo_cpg.simulation.situation import starting_state

# Smallest power of an animal that works, as a fraction of the power that moves its straight body.
_IDLE = 1e-3


def held(world: World) -> World:
    """Return the world with a held root.

    Raises:
        LabError: a step of the world needs iteration, which holds no root.
    """
    if world.tree.hanging is not None:
        raise LabError("tow: needs a free root, but this root hangs on the world")
    if world.contact_model is not None:
        raise LabError("tow: an animal on the ground cannot be towed. Leave out world.ground")
    if world.pairs is not None:
        raise LabError("tow: needs creature.self_collision: false")
    if needs_iteration(world):
        raise LabError(
            "tow: needs motors without a torque_limit, and joints without a friction_loss"
        )
    return dataclasses.replace(world, held=True)


def tow_numbers(
    simulation: Simulation,
    frames: Mapping[str, np.ndarray],
    numbers: GaitNumbers,
    speed: float,
    drag: float,
) -> list[Quantity]:
    """Return the measures of a towed animal, means over whole cycles of the second half.

    Args:
        simulation: the trial.
        frames: full frames of one individual.
        numbers: numbers of the same motion, with the frequency of its cycles.
        speed: U, m/s.
        drag: D, drag of the straight body, N.
    """
    count = len(frames["energy"]) - 1
    last = last_cycles(numbers.first, count, numbers.step, numbers.frequency)
    ahead, aside = directions(simulation)
    holding = frames["holding"][:-1][last, :, 0]
    force, side, yaw = holding[:, 3:] @ ahead, holding[:, 3:] @ aside, holding[:, 2]
    rate = frames["joint_rate"][..., 0]
    power = (frames["torque"][:-1, :, 0] * 0.5 * (rate[1:] + rate[:-1])).sum(1)[last]
    thrust = drag - float(force.mean())
    worked = float(power.mean())
    works = worked > _IDLE * abs(drag * speed)
    efficiency = thrust * speed / worked if works and speed > 0 else math.nan
    return [
        Quantity("holding_force", "holding force", float(force.mean()), "N",
                 "mean force on the held root along its heading, positive if it is pushed"),
        Quantity("holding_sway", "sideways holding force", _rms(side), "N",
                 "root mean square of the holding force across the heading"),
        Quantity("holding_yaw", "holding moment", _rms(yaw), "N m",
                 "root mean square of the holding moment about the vertical"),
        Quantity("straight_drag", "drag of the straight body", drag, "N",
                 "force of the water on the straight body at rest in the same current"),
        Quantity("thrust", "thrust", thrust, "N",
                 "drag of the straight body - mean holding force"),
        Quantity("net_power", "net power", worked, "W", "mean of torque x rate of all motors"),
        Quantity("efficiency", "efficiency", efficiency, "",
                 "thrust x speed / net power", "the animal is not towed forwards or does no work"),
    ]  # fmt: skip


def straight_drag(simulation: Simulation) -> float:
    """Return the drag of the animal in its initial pose, at rest in the current, N."""
    world = simulation.world
    start = starting_state(simulation.situations, None, world.tree, (), jnp.dtype(jnp.float32))

    @quick_jit
    def force() -> Float[Array, "3"]:
        bodies = world.bodies(kinematics(world.tree, start), simulation.step_length)
        none = jnp.zeros_like(bodies.velocity)
        own = functools.reduce(operator.add, (law.wrench(bodies) for law in world.forces), none)
        return jnp.einsum("ijb,jb->i", bodies.kin.rotation, own[3:])

    return float(-np.asarray(force()) @ directions(simulation)[0])


def directions(simulation: Simulation) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Return the unit vectors along the heading and to its left."""
    heading = simulation.situations[0].start_heading
    cosine, sine = math.cos(heading), math.sin(heading)
    return np.array([cosine, sine, 0.0]), np.array([-sine, cosine, 0.0])


def _rms(values: Float[np.ndarray, " t"]) -> float:
    return float(np.sqrt(np.square(values).mean()))


def ground_speed(simulation: Simulation, recording: Recording, numbers: GaitNumbers) -> Quantity:
    """Return the speed over ground along the initial heading, over whole cycles."""
    # A mean velocity over k steps needs k + 1 positions.
    count = len(recording.time) - 1
    last = last_cycles(numbers.first, count, numbers.step, numbers.frequency)
    path = recording.position.mean(1) @ directions(simulation)[0]
    speed = (path[last.stop] - path[last.start]) / (numbers.step * (last.stop - last.start))
    definition = "mean velocity of all bodies along the initial heading, over whole cycles"
    return Quantity("ground_speed", "speed over ground", float(speed), "m/s", definition)


def flume_notes(settings: Sequence[Setting], rows: Sequence[Mapping[str, Any]]) -> tuple[str, ...]:
    """Return the current in which an animal stays in place, for each of the other settings.

    The speed over ground is interpolated linearly between two currents.
    """
    groups: dict[str, list[tuple[float, float]]] = {}
    for setting, row in zip(settings, rows, strict=True):
        if "current" not in setting or "tow" in setting:
            continue
        others = worded({name: x for name, x in setting.items() if name != "current"})
        groups.setdefault(others, []).append((setting["current"], row["ground_speed"]))
    notes = []
    for others, points in groups.items():
        if len(points) < 2:
            continue
        current, speed = np.array(sorted(points)).T
        change = np.flatnonzero((speed[:-1] >= 0) != (speed[1:] >= 0))
        place = "in none of these currents"
        if len(change):
            k = change[0]
            share = speed[k] / (speed[k] - speed[k + 1])
            found = current[k] + share * (current[k + 1] - current[k])
            place = f"against a current of {found:.3g} m/s"
        notes.append(f"{others}{': ' if others else ''}holds its place {place}")
    return tuple(notes)
