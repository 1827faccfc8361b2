"""Measures of animals in a tow, in a flume, and with a cut spinal cord.

**Tow.** A holder moves the root at a constant velocity U along its heading, and does not let it
turn. In deep water this is the same as a root at rest in a current -U (Galilean invariance). The
mean force of the holder along the heading is F. D is the drag of the straight, stiff body at the
same speed.

    thrust = D - F,    efficiency = thrust U / P

P is the mean net power of the motors, the sum of torque x rate. The animal swims on its own at the
speed at which F is 0.

**Cut.** Do the joints behind a cut follow those in front? The joint behind is the joint at which
the cord is cut. The joint in front is the next one towards the root that has the same axis. A cycle
begins when an angle crosses its mid-range upwards. Let t_k be the beginnings behind the cut, and
T_j <= t_k < T_(j+1) those in front. The phase is

    p_k = (t_k - T_j) / (T_(j+1) - T_j).

The lag is the circular mean of p_k, and the scatter its circular standard deviation. Two sides with
rhythms of their own have a large scatter.
"""

import dataclasses
import functools
import math
import operator
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.analysis.cycles import cycle_starts, frequency_of, last_cycles, mean_phase
from evo_cpg.analysis.gait_numbers import GaitNumbers
from evo_cpg.analysis.gait_quantities import Quantity
from evo_cpg.analysis.laboratory.bodies import joints_of
from evo_cpg.analysis.laboratory.settings import NOTHING, LabError, Setting, worded
from evo_cpg.control.couplings import axis_directions, axis_parents
from evo_cpg.creature.tree import Tree
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
    force = holding[:, 3:] @ ahead
    side, yaw = (
        float(np.sqrt(np.square(each).mean())) for each in (holding[:, 3:] @ aside, holding[:, 2])
    )
    rate = frames["joint_rate"][..., 0]
    power = (frames["torque"][:-1, :, 0] * 0.5 * (rate[1:] + rate[:-1])).sum(1)[last]
    thrust = drag - float(force.mean())
    worked = float(power.mean())
    works = worked > _IDLE * abs(drag * speed)
    efficiency = thrust * speed / worked if works and speed > 0 else math.nan
    return [
        Quantity("holding_force", "holding force", float(force.mean()), "N",
                 "mean force on the held root along its heading, positive if it is pushed"),
        Quantity("holding_sway", "sideways holding force", side, "N",
                 "root mean square of the holding force across the heading"),
        Quantity("holding_yaw", "holding moment", yaw, "N m",
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


class Sides(NamedTuple):
    """Rhythms of the joints in front of a cut and behind it.

    Attributes:
        front: frequency in front, Hz, or NaN without a rhythm.
        behind: frequency behind, Hz.
        lag: phase by which the joint behind follows the one in front, degrees, -180 to 180.
        scatter: circular standard deviation of this phase, cycles.
    """

    front: float
    behind: float
    lag: float
    scatter: float


def cut_of(settings: Sequence[Setting]) -> str:
    """Return the only cut of some settings, where the intact are measured, too, or `NOTHING`."""
    cuts = {setting.get("cut", NOTHING) for setting in settings} - {NOTHING}
    return cuts.pop() if len(cuts) == 1 else NOTHING


def cut_numbers(tree: Tree, recording: Recording, cut: str, first: int) -> list[Quantity]:
    """Return the measures of the two sides of a cut, at its first body if there are several.

    Args:
        tree: the creature.
        recording: the motion.
        cut: body in front of whose joint the cord is cut, or `NOTHING`.
        first: first measured sample.
    """
    found = Sides(math.nan, math.nan, math.nan, math.nan)
    if cut != NOTHING:
        behind = tree.dof_bodies.index(min(joints_of(tree, "cut", cut)))
        front = axis_parents(tree)[behind]
        if front is not None:
            angles = recording.joint_angle[first:] * np.array(axis_directions(tree))
            step = float(recording.time[1] - recording.time[0])
            found = sides(angles[:, front], angles[:, behind], step)
    return [
        Quantity("front_frequency", "frequency in front of the cut", found.front, "Hz",
                 "of the next joint in front of the cut"),
        Quantity("behind_frequency", "frequency behind the cut", found.behind, "Hz",
                 "of the joint at the cut"),
        Quantity("cut_lag", "lag at the cut", found.lag, "degrees",
                 "phase by which the joint behind the cut follows the one in front"),
        Quantity("cut_scatter", "scatter of this lag", found.scatter, "cycles",
                 "circular standard deviation"),
    ]  # fmt: skip


def sides(front: Float[np.ndarray, " t"], behind: Float[np.ndarray, " t"], step: float) -> Sides:
    """Return the rhythms of two joint angles, and how the second follows the first."""
    begins, follows = cycle_starts(front, step), cycle_starts(behind, step)
    own = frequency_of(begins), frequency_of(follows)
    if not np.isfinite(own).all():
        return Sides(*own, math.nan, math.nan)
    within = follows[(follows >= begins[0]) & (follows < begins[-1])]
    if not len(within):
        return Sides(*own, math.nan, math.nan)
    phase = np.interp(within, begins, np.arange(len(begins)))
    mean, scatter = mean_phase(phase)
    return Sides(*own, 360 * mean, scatter)
