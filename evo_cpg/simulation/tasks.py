"""Tasks: reach a light (Iwadate 2010), go far (Fukui 2003), and walk instead of run.

`ReachLight` scores the shortest path, with the light in view and little energy,

    f(D, E, L) = -a D - b E + c L,    a D_max > c L_max > b E_max            (eqs. 9 and 10)

D is the distance to the light at the end (mean of the last second). E is the energy of the motors.
L is the strongest light among all eyes in each step, averaged over the trial. All three are
normalised: D by the initial distance, E by a given value or the 95th percentile of the first
generation. Eq. 10 then reads ``a > c > b``.

Fukui 2003 scores only the distance moved after 20 s (section 3.4), so its agents run. To get a
walk, section 4.3 proposes to score the posture as well, without details. `Distance` scores the
distance,

    f = D,

and `Walk` subtracts terms that are typical of running, each from the whole trial:

    f = a D/l - b T - c H/l - d A,
    T = mean(1 - cos(angle between the torso's z axis and the vertical)).

Feet that slide, and motors that work hard, can have a price as well:

    f = ... - e S/l - g C/l,     S = v_s t,     C = E/(m g').

S is the slip speed (`evo_cpg.simulation.measures`, equation 1) times the duration t. C is the
height to which the energy of the motors could lift the animal. With the slip ratio s = S/D and the
cost of transport k = C/D, the price of a unit of distance is

    a D/l - e S/l - g C/l = (a - e s - g k) D/l.

So a stride pays if e s + g k < a, no ratio is computed near D = 0, and standing still scores 0.

The thesis does not define "distance". Here its D is a straight line over ground, without height. It
leads from the initial place of the torso's centre to its place at the last control step. The torso
is the root of the creature. Lengths are measured in torso lengths l. A weight is the cost of a term
of 1, in torso lengths of displacement.

| symbol | name |
|---|---|
| D | ``distance`` or ``forward`` (m) |
| T | ``tilt``: 0 upright, 1 on the side, 2 on the back |
| H | ``bounce``: standard deviation of the height of the torso's centre (m) |
| A | ``airborne``: fraction of the time in which nothing touches the ground |
| S | ``slip``: path (m) that everything on the ground slides in the trial, weighted by load |
| C | ``cost``: energy of the motors E over the weight m g' (m) |
| l | ``torso_length`` (m) |
| a, b, c, d | ``distance_weight``, ``tilt_weight``, ``bounce_weight``, ``airborne_weight`` |
| e, g | ``slip_weight``, ``cost_weight`` |
"""

import dataclasses
from collections.abc import Mapping
from typing import Literal, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from evo_cpg.creature.algebra.numerics import Number, Triple
from evo_cpg.simulation.measures import Displacement, Slip, no_displacement, slip_of_points
from evo_cpg.simulation.task import Task, Transition

# Upper limit of the distance relative to the initial distance. So one individual that flees from
# the light cannot dominate averages.
_FARTHEST = 1.5

# Scale of the energy: this percentile of the first generation is E_max.
_ENERGY_PERCENTILE = 95.0


# ``any``: displacement in any direction. ``forward``: displacement along the world's +x, which an
# animal faces at the start unless it is turned. Backwards is negative.
Heading = Literal["any", "forward"]
# Point whose displacement counts. A long animal moves its root by curling up once.
Point = Literal["root", "centre_of_mass"]


class LightTally(NamedTuple):
    """Initial distance to the light, and sums over the trial so far of the other quantities."""

    start_distance: Array
    final_distance: Array
    light: Array
    energy: Array


class ReachLight(Task):
    """Swim to a point light.

    Attributes:
        light: place of the light, m, for situations without their own.
        distance_weight: a.
        energy_weight: b.
        light_weight: c.
        final_steps: control steps at the end over which the distance is averaged.
        energy_max: E_max, J, or None to measure it on the first generation.
    """

    light: Triple
    distance_weight: Number = 1.0
    energy_weight: Number = 0.2
    light_weight: Number = 0.5
    final_steps: int = 60
    energy_max: Number | None = None

    def begin(self, batch: tuple[int, ...], dtype: jnp.dtype, steps: int) -> LightTally:
        """See `Task.begin`."""
        del steps
        return LightTally(*(jnp.zeros(batch, dtype) for _ in LightTally._fields))

    def update(self, tally: LightTally, transition: Transition, steps: int) -> LightTally:
        """See `Task.update`."""
        before, step = transition.before, transition.step
        assert before.light_position is not None
        away = before.light_position - before.state.position
        distance = jnp.sqrt(jnp.sum(away**2, 0))
        last = step >= steps - min(self.final_steps, steps)
        return LightTally(
            jnp.where(step == 0, distance, tally.start_distance),
            tally.final_distance + jnp.where(last, distance, 0.0),
            tally.light + transition.observation.light.max(0, initial=0.0),
            tally.energy + transition.energy,
        )

    def terms(self, tally: LightTally, steps: int) -> dict[str, Float[Array, " *n"]]:
        """Return ``distance`` (relative to the start), ``energy`` (J), ``light`` (mean, 0 to 1)."""
        final = tally.final_distance / min(self.final_steps, steps)
        return {
            "distance": final / tally.start_distance,
            "energy": tally.energy,
            "light": tally.light / steps,
        }

    def scales(self, terms: Mapping[str, Float[Array, " n"]]) -> dict[str, Float[Array, ""]]:
        """Return ``energy``: E_max, as given or the 95th percentile of the first generation, J."""
        if self.energy_max is not None:
            return {"energy": jnp.asarray(self.energy_max, terms["energy"].dtype)}
        energy = jnp.where(jnp.isfinite(terms["energy"]), terms["energy"], jnp.nan)
        top = jnp.nanpercentile(energy, _ENERGY_PERCENTILE)
        return {"energy": jnp.where(top > 0, top, 1.0)}

    def final_control_steps(self, control_rate: float) -> int:
        """See `Task.final_control_steps`."""
        del control_rate
        return self.final_steps

    def beyond_scales(
        self, terms: Mapping[str, float], scales: Mapping[str, float]
    ) -> dict[str, float]:
        """See `Task.beyond_scales`."""
        return {"energy": max(0.0, terms["energy"] / scales["energy"] - 1.0)}

    def fitness(
        self, terms: Mapping[str, Float[Array, " *n"]], scales: Mapping[str, Float[Array, ""]]
    ) -> Float[Array, " *n"]:
        """Return eq. 9 with the normalised terms."""
        return (
            -self.distance_weight * jnp.minimum(terms["distance"], _FARTHEST)
            - self.energy_weight * jnp.minimum(terms["energy"] / scales["energy"], 1.0)
            + self.light_weight * terms["light"]
        )


class Gait(NamedTuple):
    """Displacement and sums over the trial so far.

    Attributes:
        displacement: displacement of the torso.
        tilt: sum of 1 - cos(angle between the torso's z axis and the vertical).
        rise: sum of the torso's height above its initial height, m. This difference is small, so
            the variance keeps its digits.
        squared_rise: sum of the squared rise, m^2.
        airborne: sum of the airborne fractions of the control steps.
        slip: sums of the slip, times the length of a control step, or None if slip costs nothing.
        cost: energy of the motors over the weight, m, or None if it costs nothing.
    """

    displacement: Displacement
    tilt: Float[Array, " *n"]
    rise: Float[Array, " *n"]
    squared_rise: Float[Array, " *n"]
    airborne: Float[Array, " *n"]
    slip: Slip | None
    cost: Float[Array, " *n"] | None


class Distance(Task):
    """Move a large distance.

    Attributes:
        light: none.
        heading: ``any`` direction, or ``forward``.
        settle_seconds: time in which the displacement does not count yet, s. Otherwise a tall body
            scores by falling over.
        point: point of the animal that moves.
        length: longest extent of the animal at rest, m, if the displacement counts in lengths.
    """

    light: None = eqx.field(default=None, init=False)
    heading: Heading = eqx.field(static=True, default="any")
    settle_seconds: Number = 0.0
    point: Point = eqx.field(static=True, default="root")
    length: Number | None = None

    def begin(self, batch: tuple[int, ...], dtype: jnp.dtype, steps: int) -> Displacement:
        """See `Task.begin`."""
        del steps
        return no_displacement(batch, dtype)

    def update(self, tally: Displacement, transition: Transition, steps: int) -> Displacement:
        """See `Task.update`."""
        del steps
        before = transition.before
        place = before.state.position if self.point == "root" else before.centre_of_mass
        starts = transition.step * before.control_step <= self.settle_seconds
        return tally.moved(starts, place, place)

    def terms(self, tally: Displacement, steps: int) -> dict[str, Float[Array, " *n"]]:
        """Return ``distance`` and its ``forward`` part (m), and which one counts in ``lengths``."""
        del steps
        ahead, aside, _ = tally.end - tally.start
        found = {"distance": jnp.sqrt(ahead * ahead + aside * aside), "forward": ahead}
        if self.length is not None:
            found["lengths"] = found[self._counted] / self.length
        return found

    def of_length(self, length: Number) -> Task:
        """See `Task.of_length`."""
        return self if self.length is None else dataclasses.replace(self, length=length)

    @property
    def _counted(self) -> str:
        return "distance" if self.heading == "any" else "forward"

    def fitness(
        self, terms: Mapping[str, Float[Array, " *n"]], scales: Mapping[str, Float[Array, ""]]
    ) -> Float[Array, " *n"]:
        """Return D, m or lengths."""
        del scales
        return terms[self._counted if self.length is None else "lengths"]


class Walk(Task):
    """Move a large distance with an upright, steady torso and a foot always on the ground.

    Attributes:
        torso_length: l, m.
        light: none.
        heading: ``any`` direction, or ``forward``.
        distance_weight: a.
        tilt_weight: b.
        bounce_weight: c.
        airborne_weight: d.
        slip_weight: e, or None if slip is not measured.
        cost_weight: g, or None if the cost is not measured.
    """

    torso_length: Number
    light: None = eqx.field(default=None, init=False)
    heading: Heading = eqx.field(static=True, default="any")
    distance_weight: Number = 1.0
    tilt_weight: Number = 20.0
    bounce_weight: Number = 20.0
    airborne_weight: Number = 10.0
    slip_weight: Number | None = None
    cost_weight: Number | None = None

    def begin(self, batch: tuple[int, ...], dtype: jnp.dtype, steps: int) -> Gait:
        """See `Task.begin`."""
        del steps
        none = jnp.zeros(batch, dtype)
        return Gait(
            no_displacement(batch, dtype),
            *(none, none, none, none),
            slip=None if self.slip_weight is None else Slip(none, none),
            cost=None if self.cost_weight is None else none,
        )

    def update(self, tally: Gait, transition: Transition, steps: int) -> Gait:
        """See `Task.update`."""
        del steps
        place = transition.before.state.position
        displacement = tally.displacement.moved(transition.step == 0, place, place)
        _, x, y, _ = transition.before.state.orientation
        rise = displacement.end[2] - displacement.start[2]
        slip, cost = tally.slip, tally.cost
        if slip is not None:
            # The slip of a step is a path (N m) here, instead of a speed.
            force = transition.forces.contact_force
            slide, load = slip_of_points(force, transition.after.contact_velocity)
            slide = transition.before.control_step * slide
            slip = Slip(slip.slide + slide, slip.load + load)
        if cost is not None:
            cost = cost + transition.energy / transition.before.world.weight
        return Gait(
            displacement,
            # The vertical component of the torso's z axis is 1 - 2 (x^2 + y^2).
            tally.tilt + 2.0 * (x * x + y * y),
            tally.rise + rise,
            tally.squared_rise + rise * rise,
            tally.airborne + transition.airborne,
            slip,
            cost,
        )

    def terms(self, tally: Gait, steps: int) -> dict[str, Float[Array, " *n"]]:
        """Return the terms of the module's table, without slip and cost if they are free."""
        mean = tally.rise / steps
        ahead, aside, _ = tally.displacement.end - tally.displacement.start
        terms = {
            "distance": jnp.sqrt(ahead * ahead + aside * aside),
            "forward": ahead,
            "tilt": tally.tilt / steps,
            "bounce": jnp.sqrt(jnp.maximum(tally.squared_rise / steps - mean * mean, 0.0)),
            "airborne": tally.airborne / steps,
        }
        if tally.slip is not None:
            terms["slip"] = steps * tally.slip.speed()
        if tally.cost is not None:
            terms["cost"] = tally.cost
        return terms

    def fitness(
        self, terms: Mapping[str, Float[Array, " *n"]], scales: Mapping[str, Float[Array, ""]]
    ) -> Float[Array, " *n"]:
        """Return the weighted displacement minus the prices of all other terms."""
        del scales
        distance = terms["distance" if self.heading == "any" else "forward"]
        fitness = (
            self.distance_weight * distance / self.torso_length
            - self.tilt_weight * terms["tilt"]
            - self.bounce_weight * terms["bounce"] / self.torso_length
            - self.airborne_weight * terms["airborne"]
        )
        if self.slip_weight is not None:
            fitness = fitness - self.slip_weight * terms["slip"] / self.torso_length
        if self.cost_weight is not None:
            fitness = fitness - self.cost_weight * terms["cost"] / self.torso_length
        return fitness
