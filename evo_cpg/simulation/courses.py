"""Tasks with a light that moves: reach one after the other, follow, or stay near one.

`Waypoints` counts the lights that an animal reaches in a row. The next light appears when the
present one is reached. `Follow` scores the time near a light that turns or flees. With a light that
rests, it is a task of staying in place, for instance in a current.

All individuals of a generation have equal courses, because these do not depend on the individual
(`evo_cpg.training.experiment.trial_keys`). All lights of a course are at one height.
"""

from collections.abc import Mapping
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from evo_cpg.creature.algebra.numerics import Number, Triple
from evo_cpg.simulation.snapshot import Snapshot
from evo_cpg.simulation.task import CourseStart, Task, Transition

# Largest fraction of a leg that is left. So one animal that flees cannot dominate averages.
_FARTHEST = 1.5


class Reached(NamedTuple):
    """Course of lights in a row.

    Attributes:
        lights: places of all lights, m. The last one stands for the time after it was reached.
        count: number of lights that were reached.
        leg: distance of the present light when it appeared, m.
    """

    lights: Float[Array, "3 lights *n"]
    count: Int[Array, " *n"]
    leg: Float[Array, " *n"]


class Waypoints(Task):
    """Reach lights in a row.

        f = reached + 1 - left,

    with ``left`` the final distance of the root from the present light, as a fraction of its
    distance when it appeared. It is 1 if no light is left.

    Attributes:
        light: first light if no direction is drawn. Its direction from the start is straight ahead.
        lights: number of lights.
        spacing: distance between two lights, and from the start to the first, m.
        turn: largest turn from one leg to the next, either way, rad. Turns are uniform.
        radius: distance at which a light is reached, m.
        enough: number of lights that is a success.
        arena: edge of the square about the start in which all lights are drawn, m, or None.
    """

    light: Triple
    lights: int = eqx.field(static=True)
    spacing: Number
    turn: Number
    radius: Number
    enough: int = eqx.field(static=True)
    arena: Number | None = None

    moves_light = True
    draws_course = True

    def begin_course(self, start: CourseStart) -> Reached:
        """See `Task.begin_course`."""
        away = start.light - start.position
        if self.arena is not None:
            draws = start.uniform(2 * self.lights).reshape(2, self.lights, *away.shape[1:])
            places = self.arena * (draws - 0.5) + start.position[:2, None]
        else:
            turns = self.turn * (2 * start.uniform(self.lights) - 1)
            heading = jnp.arctan2(away[1], away[0])[None] + jnp.cumsum(turns, 0)
            legs = self.spacing * jnp.stack([jnp.cos(heading), jnp.sin(heading)])
            places = start.position[:2, None] + jnp.cumsum(legs, 1)
        heights = jnp.broadcast_to(start.light[2], places.shape[1:])
        lights = jnp.concatenate([places, heights[None]])
        first = _length(lights[:, 0] - start.position)
        return Reached(lights, jnp.zeros(away.shape[1:], jnp.int32), first)

    def place_light(self, course: Reached) -> Float[Array, "3 *n"]:
        """See `Task.place_light`."""
        shown = jnp.minimum(course.count, self.lights - 1)
        number = jnp.arange(self.lights).reshape(-1, *[1] * shown.ndim)
        return jnp.where(number == shown, course.lights, 0.0).sum(1)

    def advance_course(self, course: Reached, after: Snapshot, step: Array) -> Reached:
        """See `Task.advance_course`."""
        del step
        near = _distance(self.place_light(course), after) < self.radius
        later = course._replace(count=jnp.minimum(course.count + near, self.lights))
        leg = _distance(self.place_light(later), after)
        return later._replace(leg=jnp.where(near, leg, course.leg))

    def begin(self, batch: tuple[int, ...], dtype: jnp.dtype, steps: int) -> tuple[Array, Array]:
        """See `Task.begin`."""
        del steps
        return jnp.zeros(batch, dtype), jnp.zeros(batch, dtype)

    def update(
        self, tally: tuple[Array, Array], transition: Transition, steps: int
    ) -> tuple[Array, Array]:
        """See `Task.update`."""
        del steps
        course: Reached = transition.course
        left = _distance(self.place_light(course), transition.after) / course.leg
        return course.count.astype(tally[0].dtype), left

    def terms(self, tally: tuple[Array, Array], steps: int) -> dict[str, Float[Array, " *n"]]:
        """Return ``reached`` lights, fraction ``left`` of the present leg, and ``success``."""
        del steps
        count, left = tally
        return {
            "reached": count,
            "left": jnp.where(count < self.lights, jnp.minimum(left, _FARTHEST), 1.0),
            "success": (count >= self.enough).astype(count.dtype),
        }

    def fitness(
        self, terms: Mapping[str, Float[Array, " *n"]], scales: Mapping[str, Float[Array, ""]]
    ) -> Float[Array, " *n"]:
        """Return the number of lights that were reached, and the part of the way to the next."""
        del scales
        return terms["reached"] + 1.0 - terms["left"]


class Led(NamedTuple):
    """Course of a light that moves.

    Attributes:
        place: place of the light, m.
        headings: direction of its motion in each leg, rad.
    """

    place: Float[Array, "3 *n"]
    headings: Float[Array, "legs *n"]


class Nearness(NamedTuple):
    """Sums over the counted part of the trial so far.

    Attributes:
        distance: sum of the distances from the light, m.
        farthest: largest distance, m.
        near: number of control steps near the light.
        count: number of control steps.
    """

    distance: Float[Array, " *n"]
    farthest: Float[Array, " *n"]
    near: Float[Array, " *n"]
    count: Float[Array, " *n"]


class Follow(Task):
    """Stay near a light that moves, or rests.

        f = near - mean(min(d / radius, 10)) / 10,

    with ``near`` the fraction of the counted time in which the distance d of the root from the
    light is less than ``radius``.

    Attributes:
        light: place of the light at the start, m.
        speed: speed of the light, m/s.
        every: duration of a leg, s.
        turn: least turn from one leg to the next, either way, rad. Turns are uniform up to half a
            turn.
        flees: distance of the animal below which the light flees from it, m, or None for legs.
        radius: distance that counts as near, m.
        settle_seconds: time that does not count yet, s.
        legs: number of legs.
    """

    light: Triple
    speed: Number
    every: Number
    turn: Number
    radius: Number
    settle_seconds: Number
    legs: int = eqx.field(static=True)
    flees: Number | None = None

    moves_light = True

    @property
    def draws_course(self) -> bool:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Whether courses are random."""
        return self.legs > 0

    def begin_course(self, start: CourseStart) -> Led:
        """See `Task.begin_course`."""
        away = start.light - start.position
        heading = jnp.arctan2(away[1], away[0])[None]
        if not self.draws_course:
            return Led(start.light, heading[:0])
        draws = 2 * start.uniform(self.legs) - 1
        turns = jnp.sign(draws) * (self.turn + (np.pi - self.turn) * jnp.abs(draws))
        return Led(start.light, heading + jnp.cumsum(turns, 0))

    def place_light(self, course: Led) -> Float[Array, "3 *n"]:
        """See `Task.place_light`."""
        return course.place

    def advance_course(self, course: Led, after: Snapshot, step: Array) -> Led:
        """See `Task.advance_course`."""
        h = after.control_step
        if self.flees is not None:
            away = (course.place - after.state.position).at[2].set(0.0)
            distance = _length(away)
            pace = jnp.where(distance < self.flees, self.speed * h / distance, 0.0)
            return course._replace(place=course.place + pace[None] * away)
        if not self.legs:
            return course
        leg = jnp.minimum(((step + 1) * h / self.every).astype(jnp.int32), self.legs - 1)
        number = jnp.arange(self.legs).reshape(-1, *[1] * (course.headings.ndim - 1))
        heading = jnp.where(number == leg, course.headings, 0.0).sum(0)
        ahead = jnp.stack([jnp.cos(heading), jnp.sin(heading), jnp.zeros_like(heading)])
        return course._replace(place=course.place + self.speed * h * ahead)

    def begin(self, batch: tuple[int, ...], dtype: jnp.dtype, steps: int) -> Nearness:
        """See `Task.begin`."""
        del steps
        return Nearness(*(jnp.zeros(batch, dtype) for _ in Nearness._fields))

    def update(self, tally: Nearness, transition: Transition, steps: int) -> Nearness:
        """See `Task.update`."""
        del steps
        counts = transition.step * transition.before.control_step >= self.settle_seconds
        distance = _distance(self.place_light(transition.course), transition.after)
        new = Nearness(
            tally.distance + jnp.minimum(distance, 10 * self.radius),
            jnp.maximum(tally.farthest, distance),
            tally.near + (distance < self.radius),
            tally.count + 1.0,
        )
        return Nearness(*(jnp.where(counts, a, b) for a, b in zip(new, tally, strict=True)))

    def terms(self, tally: Nearness, steps: int) -> dict[str, Float[Array, " *n"]]:
        """Return distances (m), fraction of the time ``near``, and ``success`` (near all the time).

        ``distance`` is a mean in which no step counts more than ten radii. ``farthest`` is the
        largest distance.
        """
        del steps
        count = jnp.maximum(tally.count, 1.0)
        return {
            "distance": tally.distance / count,
            "farthest": tally.farthest,
            "near": tally.near / count,
            "success": (tally.farthest < self.radius).astype(count.dtype),
        }

    def fitness(
        self, terms: Mapping[str, Float[Array, " *n"]], scales: Mapping[str, Float[Array, ""]]
    ) -> Float[Array, " *n"]:
        """Return the fraction of the time near the light, minus a tenth of the mean distance."""
        del scales
        return terms["near"] - 0.1 * terms["distance"] / self.radius


def _distance(light: Float[Array, "3 *n"], snapshot: Snapshot) -> Float[Array, " *n"]:
    return _length(light - snapshot.state.position)


def _length(vector: Float[Array, "3 *n"]) -> Float[Array, " *n"]:
    # The root has a derivative everywhere, even at 0.
    return jnp.sqrt((vector**2).sum(0) + 1e-12)
