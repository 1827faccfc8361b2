"""Measures of gait: numbers that describe the motion in a whole trial, for any task.

They are reported with the task's terms, and can be axes of maps of behaviour
(`evo_cpg.evolution.map_elites`). The table `MEASURES` lists them by name. The distance is the
straight line from the initial to the final place of the root's centre. If there is ground, only the
horizontal distance counts.

| name | meaning | unit |
|---|---|---|
| ``speed`` | distance / duration of the trial | m/s |
| ``cost_of_transport`` | energy of the motors / (weight x distance) (Tucker 1975) | - |
| ``power`` | energy of the motors / duration | W |
| ``duty_factor`` | fraction of time on the ground, mean of the bodies that ever touch it | - |
| ``limb_duty_factor`` | the same of whole limbs, without trunk and tail | - |
| ``airborne`` | fraction of time in which nothing touches the ground | - |
| ``relative_slip`` | slip speed on the ground (equation 1) / speed | - |
| ``stride_length`` | distance / number of strides, from ``frequency`` | m |
| ``frequency`` | sign changes of a joint's velocity / (2 x duration), mean of turning axes | Hz |
| ``amplitude`` | standard deviation of the joints' angles, mean of turning axes | rad |
| ``turning`` | mean angular velocity of the root about the vertical, to the left | rad/s |
| ``tilt`` | mean of 1 - cos(angle between the root's z axis and the vertical) | - |

*Slip* is the speed over the ground of everything that touches it, weighted by load. With the load
N_p of a contact point p (the vertical force of the ground, N) and the horizontal velocity v_p of
the material at the point (m/s), the slip speed of a trial is

    v_s = int sum_p N_p |v_p| dt / int sum_p N_p dt.                                     (1)

A rolling or pivoting foot does not slip, because the material at its lowest point is at rest. A
point without load counts nothing. A body needs no name to be a foot: all contact points of the
creature count, and those of the belly and the tail too. On level ground with one coefficient of
sliding friction mu, the numerator times mu is the energy that friction dissipates.

Differs from a mean over the time of contact: a foot that lands or leaves counts by its load, so
there is no touch-down to detect, and equation (1) has derivatives.
"""

import abc
from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree

from evo_cpg.physics.step.world import World
from evo_cpg.simulation.task import Transition

# Name of the term of `RootDisplacement`. Its parentheses keep it different from the names of terms
# in users' tasks.
DISPLACEMENT = "(displacement of the root)"

# Duration (s) of a stretch of `RootTravel`: longer than a stroke, and mostly shorter than a turn.
_STRETCH = 3.0
# Squared speed (m^2/s^2) added under the root, so that a point at rest has a derivative.
_FLOOR = 1e-20
# Load (N) below which nothing touches.
_NO_LOAD = 1e-9
# Smallest distance (m) to divide by, so that an animal that stays in place has a finite cost.
_NOWHERE = 1e-6


class Trial(NamedTuple):
    """Facts that a measure may use at the end of a trial: its world and its duration (s)."""

    world: World
    duration: float


class Measure(eqx.Module):
    """A number of a whole trial, computed from a tally that follows the control steps."""

    @abc.abstractmethod
    def begin(self, world: World, batch: tuple[int, ...], dtype: jnp.dtype) -> PyTree:
        """Return the tally before the trial."""

    @abc.abstractmethod
    def update(self, tally: PyTree, transition: Transition) -> PyTree:
        """Return the tally after one more control step: same structure, shapes and types."""

    @abc.abstractmethod
    def finish(self, tally: PyTree, trial: Trial) -> Float[Array, " *n"]:
        """Return the measure of the whole trial."""


class Displacement(NamedTuple):
    """Place of the root where its displacement starts, and its latest place, m."""

    start: Float[Array, "c *n"]
    end: Float[Array, "c *n"]

    def moved(
        self, starts: Array, before: Float[Array, "c *n"], after: Float[Array, "c *n"]
    ) -> "Displacement":
        """Return the displacement after a control step, which may be where it starts."""
        return Displacement(jnp.where(starts, before, self.start), after)


def no_displacement(batch: tuple[int, ...], dtype: jnp.dtype, components: int = 3) -> Displacement:
    """Return the displacement before a trial."""
    nowhere = jnp.zeros((components, *batch), dtype)
    return Displacement(nowhere, nowhere)


class Slip(NamedTuple):
    """Sums over control steps, for equation (1).

    Attributes:
        slide: load times speed, all contact points together, N m/s.
        load: load of all contact points, N.
    """

    slide: Float[Array, " *n"]
    load: Float[Array, " *n"]

    def speed(self) -> Float[Array, " *n"]:
        """Return the slip speed, m/s, or 0 if nothing has touched the ground."""
        return self.slide / jnp.maximum(self.load, _NO_LOAD)


def slip_of_points(force: Float[Array, "3 p *n"], velocity: Float[Array, "3 p *n"]) -> Slip:
    """Return the slip of contact points at an instant.

    Args:
        force: force of the ground on every contact point, world axes, N.
        velocity: velocity of the material at every contact point, m/s.
    """
    x, y, _ = velocity
    load = jnp.maximum(force[2], 0.0)
    return Slip((load * jnp.sqrt(x * x + y * y + _FLOOR)).sum(0), load.sum(0))


class RootDisplacement(Measure):
    """Displacement of the root, m.

    If there is a light, this is the decrease of the root's distance to the light. Otherwise it is
    the horizontal distance from the root's initial place to its final place.
    """

    lit: bool = eqx.field(static=True)

    def begin(self, world: World, batch: tuple[int, ...], dtype: jnp.dtype) -> Displacement:
        """See `Measure.begin`."""
        del world
        return no_displacement(batch, dtype, 2)

    def update(self, tally: Displacement, transition: Transition) -> Displacement:
        """See `Measure.update`. The place in the light is the distance from it, and 0."""
        places = []
        for snapshot in (transition.before, transition.after):
            place = snapshot.state.position
            if snapshot.light_position is None:
                places.append(place[:2])
            else:
                away = place - snapshot.light_position
                distance = jnp.sqrt(jnp.sum(away * away, 0))
                places.append(jnp.stack([distance, jnp.zeros_like(distance)]))
        return tally.moved(transition.step == 0, *places)

    def finish(self, tally: Displacement, trial: Trial) -> Float[Array, " *n"]:
        """See `Measure.finish`."""
        del trial
        if self.lit:
            return tally.start[0] - tally.end[0]
        return _length(tally)


class RootTravel(Measure):
    """Horizontal distance that the root travels, m, as a sum of straight stretches of 3 s.

    It is the displacement of animals whose light moves, because they may end where they started.
    """

    def begin(
        self, world: World, batch: tuple[int, ...], dtype: jnp.dtype
    ) -> tuple[Displacement, Array]:
        """See `Measure.begin`."""
        del world
        return no_displacement(batch, dtype, 2), jnp.zeros(batch, dtype)

    def update(
        self, tally: tuple[Displacement, Array], transition: Transition
    ) -> tuple[Displacement, Array]:
        """See `Measure.update`."""
        stretch, total = tally
        before, after = transition.before, transition.after
        starts = transition.step % max(round(_STRETCH / before.control_step), 1) == 0
        total = total + jnp.where(starts, _length(stretch), 0.0)
        return stretch.moved(starts, before.state.position[:2], after.state.position[:2]), total

    def finish(self, tally: tuple[Displacement, Array], trial: Trial) -> Float[Array, " *n"]:
        """See `Measure.finish`."""
        del trial
        stretch, total = tally
        return total + _length(stretch)


def _length(displacement: Displacement) -> Float[Array, " *n"]:
    return jnp.sqrt(jnp.sum((displacement.end - displacement.start) ** 2, 0))


def _distance(tallies: dict[str, Any], world: World) -> Float[Array, " *n"]:
    """Return the length of the displacement, m. If there is ground, z does not count."""
    x, y, z = tallies["displacement"].end - tallies["displacement"].start
    level = x * x + y * y
    return jnp.sqrt(level if world.contact_model is not None else level + z * z)


def _frequency(tallies: dict[str, Any], trial: Trial) -> Float[Array, " *n"]:
    """Return the mean frequency of the turning axes, from sign changes of their velocities, Hz."""
    changes = _of_angles(tallies["strides"][1], trial.world)
    return changes.sum(0) / (2.0 * changes.shape[0] * trial.duration)


def _of_angles(each: Float[Array, "d *n"], world: World) -> Float[Array, "k *n"]:
    """Return the part of turning axes, or everything if nothing turns.

    Slides have another unit, and those of a root drift.
    """
    slides = world.tree.slides
    return each if slides.all() or not slides.any() else each[np.flatnonzero(~slides)]


# Tallies from which each measure of gait is computed.
MEASURES: dict[str, tuple[str, ...]] = {
    "airborne": ("airborne",),
    "amplitude": ("angle", "square"),
    "cost_of_transport": ("energy", "displacement"),
    "duty_factor": ("contact",),
    "frequency": ("strides",),
    "limb_duty_factor": ("contact",),
    "power": ("energy",),
    "relative_slip": ("slip", "displacement"),
    "speed": ("displacement",),
    "stride_length": ("strides", "displacement"),
    "tilt": ("tilt",),
    "turning": ("turn",),
}

# Measures that mean nothing without ground.
GROUND_MEASURES = ("airborne", "duty_factor", "limb_duty_factor", "relative_slip")


class GaitMeasure(Measure):
    """A measure of the table `MEASURES`.

    Attributes:
        name: key in the table.
        limbs: indices in the tree of the bodies of each limb, for ``limb_duty_factor``. A limb
            touches the ground if any of its bodies does. Trunk and tail are not limbs
            (`evo_cpg.creature.limbs`).
    """

    name: str = eqx.field(static=True)
    limbs: tuple[tuple[int, ...], ...] = eqx.field(static=True, default=())

    def begin(self, world: World, batch: tuple[int, ...], dtype: jnp.dtype) -> dict[str, Any]:
        """See `Measure.begin`."""
        none = jnp.zeros(batch, dtype)
        joints = jnp.zeros((world.tree.dof_count, *batch), dtype)
        contact = jnp.zeros((len(self._groups(world)), *batch), dtype)
        special = {
            "displacement": no_displacement(batch, dtype),
            "slip": Slip(none, none),
            "angle": joints,
            "square": joints,
            "strides": (joints, joints),
            "contact": contact,
        }
        return {name: special.get(name, none) for name in MEASURES[self.name]}

    def update(self, tally: dict[str, Any], transition: Transition) -> dict[str, Any]:
        """See `Measure.update`."""
        before, state = transition.before, transition.after.state
        duration, new = before.control_step, {}
        for name, old in tally.items():
            match name:
                case "displacement":
                    now = old.moved(transition.step == 0, before.state.position, state.position)
                case "slip":
                    # Mean load, and velocities at the end of the step.
                    force = transition.forces.contact_force
                    slide, load = slip_of_points(force, transition.after.contact_velocity)
                    now = Slip(old.slide + slide, old.load + load)
                case "energy":  # of the motors, J
                    now = old + transition.energy
                case "airborne":  # time in the air, s
                    now = old + transition.airborne * duration
                case "turn":  # to the left, rad
                    now = old + state.angular_velocity[2] * duration
                case "tilt":
                    # 1 - cos(angle between the root's z axis and the vertical).
                    _, x, y, _ = before.state.orientation
                    now = old + 2.0 * (x * x + y * y) * duration
                case "angle":
                    now = old + duration * state.q
                case "square":
                    now = old + duration * state.q * state.q
                case "strides":
                    # For each joint axis: last sign of its velocity, 0 at first, and number of sign
                    # changes.
                    sign, changes = old
                    last = jnp.where(state.qd > 0, 1.0, jnp.where(state.qd < 0, -1.0, sign))
                    last = last.astype(state.qd.dtype)
                    change = jnp.where(last * sign < 0, 1.0, 0.0).astype(state.qd.dtype)
                    now = last, changes + change
                case _:
                    # Time on the ground of each group of bodies, s. A control step with any contact
                    # counts as a whole. Every contact force has a normal component, so the force
                    # vector is not zero in any axes.
                    force = transition.forces.contact_force
                    touched, owners = (force * force).sum(0) > 0, before.contact_bodies
                    rows = [
                        touched[np.flatnonzero(np.isin(owners, group))].any(0)
                        for group in self._groups(before.world)
                    ]
                    now = old + duration * jnp.stack(rows).astype(old.dtype)
            new[name] = now
        return new

    def finish(self, tally: dict[str, Any], trial: Trial) -> Float[Array, " *n"]:
        """See `Measure.finish`."""
        world, duration = trial
        match self.name:
            case "amplitude":
                angle, square = (_of_angles(tally[name], world) for name in ("angle", "square"))
                mean = angle / duration
                variance = jnp.maximum(square / duration - mean * mean, 0.0)
                return jnp.sqrt(variance).sum(0) / variance.shape[0]
            case "cost_of_transport":
                return tally["energy"] / (
                    world.weight * jnp.maximum(_distance(tally, world), _NOWHERE)
                )
            case "duty_factor" | "limb_duty_factor":
                time = tally["contact"]
                ever = (time > 0).astype(time.dtype).sum(0)
                return time.sum(0) / (jnp.maximum(ever, 1.0) * duration)
            case "frequency":
                return _frequency(tally, trial)
            case "relative_slip":
                farthest = jnp.maximum(_distance(tally, world), _NOWHERE)
                return tally["slip"].speed() * duration / farthest
            case "speed":
                return _distance(tally, world) / duration
            case "stride_length":
                # Less than one stride counts as one.
                strides = jnp.maximum(_frequency(tally, trial) * duration, 1.0)
                return _distance(tally, world) / strides
        (total,) = tally.values()
        return total / duration

    def _groups(self, world: World) -> Sequence[tuple[int, ...]]:
        """Return the limbs, or all bodies with contact points but the root, which is body 0."""
        if self.name == "limb_duty_factor":
            return self.limbs
        owners = () if world.contact_model is None else world.contact_model.bodies
        return [(int(body),) for body in np.unique(np.array(owners, int)) if body > 0]


class Measures(eqx.Module):
    """Several measures, by name."""

    names: tuple[str, ...] = eqx.field(static=True, default=())
    each: tuple[Measure, ...] = ()

    def __or__(self, other: "Measures") -> "Measures":
        return Measures(self.names + other.names, self.each + other.each)


def measures(*names: str, limbs: tuple[tuple[int, ...], ...] = ()) -> Measures:
    """Return measures by their keys in `MEASURES`, with the bodies of each limb."""
    return Measures(names, tuple(GaitMeasure(name, limbs) for name in names))
