"""Measures of gait: numbers that describe the motion in a whole trial, for any task.

They are reported with the task's terms, and can be axes of maps of behaviour
(`evo_cpg.evolution.map_elites`). Each is a class with the same three functions, like a task. The
table `MEASURES` lists them by name. The distance is the straight line from the initial to the final
place of the root's centre. If there is ground, only the horizontal distance counts.

| name | meaning | unit |
|---|---|---|
| ``speed`` | distance / duration of the trial | m/s |
| ``cost_of_transport`` | energy of the motors / (weight x distance) (Tucker 1975) | - |
| ``power`` | energy of the motors / duration | W |
| ``duty_factor`` | fraction of time on the ground, mean of the bodies that ever touch it | - |
| ``limb_duty_factor`` | the same of whole limbs, without trunk and tail | - |
| ``airborne`` | fraction of time in which nothing touches the ground | - |
| ``relative_slip`` | slip speed on the ground / speed (`evo_cpg.simulation.foot_slip`) | - |
| ``stride_length`` | distance / number of strides, from ``frequency`` | m |
| ``frequency`` | sign changes of a joint's velocity / (2 x duration), mean of turning axes | Hz |
| ``amplitude`` | standard deviation of the joints' angles, mean of turning axes | rad |
| ``turning`` | mean angular velocity of the root about the vertical, to the left | rad/s |
| ``tilt`` | mean of 1 - cos(angle between the root's z axis and the vertical) | - |
"""

import abc
from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, PyTree

from evo_cpg.physics.step.world import World
from evo_cpg.simulation.foot_slip import Slip, no_slip, slip_of_step
from evo_cpg.simulation.task import Transition

# Smallest distance (m) to divide by, so that an animal that stays in place has a finite cost.
_NOWHERE = 1e-6


class Trial(NamedTuple):
    """Facts about the whole trial that a measure may use at the end.

    Attributes:
        world: the animal and its environment.
        duration: duration of the trial, s.
    """

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
    """Initial place of the root in the trial, and its latest place, m."""

    start: Float[Array, "c *n"]
    end: Float[Array, "c *n"]

    def moved(
        self, step: Array, before: Float[Array, "c *n"], after: Float[Array, "c *n"]
    ) -> "Displacement":
        """Return the displacement after a control step. Step 0 sets the start."""
        return Displacement(jnp.where(step == 0, before, self.start), after)


def no_displacement(batch: tuple[int, ...], dtype: jnp.dtype, components: int = 3) -> Displacement:
    """Return the displacement before a trial."""
    nowhere = jnp.zeros((components, *batch), dtype)
    return Displacement(nowhere, nowhere)


class Speed(Measure):
    """Distance divided by the duration of the trial, m/s."""

    def begin(self, world: World, batch: tuple[int, ...], dtype: jnp.dtype) -> Displacement:
        """See `Measure.begin`."""
        return no_displacement(batch, dtype)

    def update(self, tally: Displacement, transition: Transition) -> Displacement:
        """See `Measure.update`."""
        places = (each.state.position for each in (transition.before, transition.after))
        return tally.moved(transition.step, *places)

    def finish(self, tally: Displacement, trial: Trial) -> Float[Array, " *n"]:
        """See `Measure.finish`."""
        return distance(tally, trial.world) / trial.duration


class Spent(NamedTuple):
    """Energy of the motors so far, J, and displacement of the root."""

    energy: Float[Array, " *n"]
    displacement: Displacement


class CostOfTransport(Measure):
    """Energy of the motors divided by the animal's weight and by the distance."""

    def begin(self, world: World, batch: tuple[int, ...], dtype: jnp.dtype) -> Spent:
        """See `Measure.begin`."""
        return Spent(jnp.zeros(batch, dtype), no_displacement(batch, dtype))

    def update(self, tally: Spent, transition: Transition) -> Spent:
        """See `Measure.update`."""
        displacement = Speed().update(tally.displacement, transition)
        return Spent(tally.energy + transition.energy, displacement)

    def finish(self, tally: Spent, trial: Trial) -> Float[Array, " *n"]:
        """See `Measure.finish`."""
        moved = distance(tally.displacement, trial.world)
        return tally.energy / (trial.world.weight * jnp.maximum(moved, _NOWHERE))


class _Total(Measure):
    """Sum over the trial, divided by its duration."""

    def begin(self, world: World, batch: tuple[int, ...], dtype: jnp.dtype) -> Array:
        """See `Measure.begin`."""
        return jnp.zeros(batch, dtype)

    def update(self, tally: Array, transition: Transition) -> Array:
        """See `Measure.update`."""
        return tally + self.of_step(transition)

    def finish(self, tally: Array, trial: Trial) -> Float[Array, " *n"]:
        """See `Measure.finish`."""
        return tally / trial.duration

    @abc.abstractmethod
    def of_step(self, transition: Transition) -> Float[Array, " *n"]:
        """Return the addend of a control step."""


class Power(_Total):
    """Energy of the motors divided by the duration of the trial, W."""

    def of_step(self, transition: Transition) -> Float[Array, " *n"]:
        """Return the energy of the motors in the step, J."""
        return transition.energy


class Airborne(_Total):
    """Fraction of time in which nothing touches the ground."""

    def of_step(self, transition: Transition) -> Float[Array, " *n"]:
        """Return the time in the air, s."""
        return transition.airborne * transition.before.control_step


class Turning(_Total):
    """Mean angular velocity of the root about the vertical, positive to the left, rad/s."""

    def of_step(self, transition: Transition) -> Float[Array, " *n"]:
        """Return the turn to the left, rad."""
        return transition.after.state.angular_velocity[2] * transition.before.control_step


class Tilt(_Total):
    """Mean of 1 - cos(angle between the root's z axis and the vertical)."""

    def of_step(self, transition: Transition) -> Float[Array, " *n"]:
        """Return 1 - cos(angle) at the start of the step, times the length of the step in s."""
        _, x, y, _ = transition.before.state.orientation
        return 2.0 * (x * x + y * y) * transition.before.control_step


class Strides(NamedTuple):
    """For each joint axis: last sign of its velocity (0 at first), and number of sign changes."""

    sign: Float[Array, "d *n"]
    changes: Float[Array, "d *n"]


class Frequency(Measure):
    """Mean frequency of the turning axes, from sign changes of their velocities, Hz."""

    def begin(self, world: World, batch: tuple[int, ...], dtype: jnp.dtype) -> Strides:
        """See `Measure.begin`."""
        none = jnp.zeros((world.tree.dof_count, *batch), dtype)
        return Strides(none, none)

    def update(self, tally: Strides, transition: Transition) -> Strides:
        """See `Measure.update`."""
        rate = transition.after.state.qd
        sign = jnp.where(rate > 0, 1.0, jnp.where(rate < 0, -1.0, tally.sign)).astype(rate.dtype)
        changed = jnp.where(sign * tally.sign < 0, 1.0, 0.0).astype(rate.dtype)
        return Strides(sign, tally.changes + changed)

    def finish(self, tally: Strides, trial: Trial) -> Float[Array, " *n"]:
        """See `Measure.finish`."""
        changes = _of_angles(tally.changes, trial.world)
        return changes.sum(0) / (2.0 * changes.shape[0] * trial.duration)


class Stepped(NamedTuple):
    """Strides so far, and displacement of the root."""

    strides: Strides
    displacement: Displacement


class StrideLength(Measure):
    """Distance divided by the number of strides, m. Less than one stride counts as one."""

    def begin(self, world: World, batch: tuple[int, ...], dtype: jnp.dtype) -> Stepped:
        """See `Measure.begin`."""
        return Stepped(Frequency().begin(world, batch, dtype), no_displacement(batch, dtype))

    def update(self, tally: Stepped, transition: Transition) -> Stepped:
        """See `Measure.update`."""
        displacement = Speed().update(tally.displacement, transition)
        return Stepped(Frequency().update(tally.strides, transition), displacement)

    def finish(self, tally: Stepped, trial: Trial) -> Float[Array, " *n"]:
        """See `Measure.finish`."""
        strides = Frequency().finish(tally.strides, trial) * trial.duration
        return distance(tally.displacement, trial.world) / jnp.maximum(strides, 1.0)


class Swing(NamedTuple):
    """Time integrals of the joints' angles and of their squares."""

    angle: Float[Array, "d *n"]
    square: Float[Array, "d *n"]


class Amplitude(Measure):
    """Standard deviation of the joints' angles, mean of all turning axes, rad."""

    def begin(self, world: World, batch: tuple[int, ...], dtype: jnp.dtype) -> Swing:
        """See `Measure.begin`."""
        none = jnp.zeros((world.tree.dof_count, *batch), dtype)
        return Swing(none, none)

    def update(self, tally: Swing, transition: Transition) -> Swing:
        """See `Measure.update`."""
        angle, step = transition.after.state.q, transition.before.control_step
        return Swing(tally.angle + step * angle, tally.square + step * angle * angle)

    def finish(self, tally: Swing, trial: Trial) -> Float[Array, " *n"]:
        """See `Measure.finish`."""
        angle, square = (_of_angles(x, trial.world) for x in tally)
        mean = angle / trial.duration
        variance = jnp.maximum(square / trial.duration - mean * mean, 0.0)
        return jnp.sqrt(variance).sum(0) / variance.shape[0]


def _of_angles(each: Float[Array, "d *n"], world: World) -> Float[Array, "k *n"]:
    """Return the part of turning axes, or everything if nothing turns.

    Slides have another unit, and those of a root drift.
    """
    slides = world.tree.slides
    return each if slides.all() or not slides.any() else each[np.flatnonzero(~slides)]


class Slid(NamedTuple):
    """Sums of the slip so far, and displacement of the root."""

    slip: Slip
    displacement: Displacement


class RelativeSlip(Measure):
    """Slip speed of everything that touches the ground, divided by the speed."""

    def begin(self, world: World, batch: tuple[int, ...], dtype: jnp.dtype) -> Slid:
        """See `Measure.begin`."""
        return Slid(no_slip(batch, dtype), no_displacement(batch, dtype))

    def update(self, tally: Slid, transition: Transition) -> Slid:
        """See `Measure.update`."""
        displacement = Speed().update(tally.displacement, transition)
        return Slid(tally.slip.plus(slip_of_step(transition)), displacement)

    def finish(self, tally: Slid, trial: Trial) -> Float[Array, " *n"]:
        """See `Measure.finish`."""
        moved = jnp.maximum(distance(tally.displacement, trial.world), _NOWHERE)
        return tally.slip.speed() * trial.duration / moved


class DutyFactor(Measure):
    """Fraction of control steps on the ground, mean of all bodies but the root that ever touch it.

    A control step with any contact of a body counts as a whole, however short the contact is.
    """

    def begin(self, world: World, batch: tuple[int, ...], dtype: jnp.dtype) -> Array:
        """Return zero as the time on the ground (s) of every body that can touch it."""
        return jnp.zeros((len(_limbs(world)), *batch), dtype)

    def update(self, tally: Array, transition: Transition) -> Array:
        """See `Measure.update`."""
        bodies = [(body,) for body in _limbs(transition.before.world)]
        touched = _touched_groups(transition, bodies)
        return tally + transition.before.control_step * touched.astype(tally.dtype)

    def finish(self, tally: Array, trial: Trial) -> Float[Array, " *n"]:
        """See `Measure.finish`."""
        return _mean_of_touching(tally, trial)


class LimbDutyFactor(Measure):
    """Fraction of control steps on the ground, mean of all limbs that ever touch it.

    A limb touches the ground if any of its bodies does. Trunk and tail are not limbs
    (`evo_cpg.creature.limbs`).

    Attributes:
        limbs: indices in the tree of the bodies of each limb.
    """

    limbs: tuple[tuple[int, ...], ...] = eqx.field(static=True, default=())

    def begin(self, world: World, batch: tuple[int, ...], dtype: jnp.dtype) -> Array:
        """Return zero as the time on the ground (s) of every limb."""
        return jnp.zeros((len(self.limbs), *batch), dtype)

    def update(self, tally: Array, transition: Transition) -> Array:
        """See `Measure.update`."""
        touched = _touched_groups(transition, self.limbs)
        return tally + transition.before.control_step * touched.astype(tally.dtype)

    def finish(self, tally: Array, trial: Trial) -> Float[Array, " *n"]:
        """See `Measure.finish`."""
        return _mean_of_touching(tally, trial)


MEASURES: dict[str, type[Measure]] = {
    "airborne": Airborne,
    "amplitude": Amplitude,
    "cost_of_transport": CostOfTransport,
    "duty_factor": DutyFactor,
    "frequency": Frequency,
    "limb_duty_factor": LimbDutyFactor,
    "power": Power,
    "relative_slip": RelativeSlip,
    "speed": Speed,
    "stride_length": StrideLength,
    "tilt": Tilt,
    "turning": Turning,
}

# Measures that mean nothing without ground.
GROUND_MEASURES = ("airborne", "duty_factor", "limb_duty_factor", "relative_slip")


class Measures(eqx.Module):
    """Several measures, by name.

    Attributes:
        names: name of each measure.
        each: the measures.
    """

    names: tuple[str, ...] = eqx.field(static=True, default=())
    each: tuple[Measure, ...] = ()

    def __or__(self, other: "Measures") -> "Measures":
        return Measures(self.names + other.names, self.each + other.each)

    def begin(self, world: World, batch: tuple[int, ...], dtype: jnp.dtype) -> dict[str, PyTree]:
        """Return the tallies before a trial."""
        return {name: one.begin(world, batch, dtype) for name, one in self._named()}

    def update(self, tallies: dict[str, PyTree], transition: Transition) -> dict[str, PyTree]:
        """Return the tallies after one more control step."""
        return {name: one.update(tallies[name], transition) for name, one in self._named()}

    def finish(self, tallies: dict[str, PyTree], trial: Trial) -> dict[str, Float[Array, " *n"]]:
        """Return the numbers by name."""
        return {name: one.finish(tallies[name], trial) for name, one in self._named()}

    def _named(self) -> zip:
        return zip(self.names, self.each, strict=True)


def measures(*names: str, limbs: tuple[tuple[int, ...], ...] = ()) -> Measures:
    """Return measures by their keys in `MEASURES`.

    Args:
        names: keys of the measures.
        limbs: indices in the tree of the bodies of each limb, for ``limb_duty_factor``.
    """
    return Measures(
        names,
        tuple(
            LimbDutyFactor(limbs) if MEASURES[name] is LimbDutyFactor else MEASURES[name]()
            for name in names
        ),
    )


def distance(displacement: Displacement, world: World) -> Float[Array, " *n"]:
    """Return the length of the displacement, m. If there is ground, z does not count."""
    x, y, z = displacement.end - displacement.start
    level = x * x + y * y
    return jnp.sqrt(level if world.contact_model is not None else level + z * z)


def _touched_groups(
    transition: Transition, groups: Sequence[tuple[int, ...]]
) -> Bool[Array, "g *n"]:
    """Return whether any body of each group touches the ground in a control step."""
    force = transition.forces.contact_force
    # Every contact force has a normal component. So the force vector is not zero in any axes.
    touched = (force * force).sum(0) > 0
    owners = transition.before.contact_bodies
    rows = [touched[np.flatnonzero(np.isin(owners, group))].any(0) for group in groups]
    return jnp.stack(rows)


def _mean_of_touching(time: Float[Array, "g *n"], trial: Trial) -> Float[Array, " *n"]:
    """Return the mean fraction of time of the groups that ever touch, from their times, s."""
    ever = (time > 0).astype(time.dtype).sum(0)
    return time.sum(0) / (jnp.maximum(ever, 1.0) * trial.duration)


def _limbs(world: World) -> list[int]:
    """Return the bodies with contact points, without the root, which is body 0."""
    contact_model = world.contact_model
    owners = np.array(() if contact_model is None else contact_model.bodies, int)
    return [int(body) for body in np.unique(owners) if body > 0]
