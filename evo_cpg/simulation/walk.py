"""Go far: as in Fukui 2003, or with a posture that makes the animal walk instead of run.

The thesis scores only the distance moved after 20 s (section 3.4), so its agents run. To get a
walk, section 4.3 proposes to score the posture as well, without details. `Distance` scores the
distance,

    f = D,

and `Walk` subtracts terms that are typical of running, each from the whole trial:

    f = a D/l - b T - c H/l - d A,
    T = mean(1 - cos(angle between the torso's z axis and the vertical)).

Feet that slide, and motors that work hard, can have a price as well:

    f = ... - e S/l - g C/l,     S = v_s t,     C = E/(m g').

S is the slip speed of `evo_cpg.simulation.foot_slip` times the duration t of the trial. C is the
height to which the energy of the motors could lift the animal. With the slip ratio s = S/D and the
cost of transport k = C/D, the price of a unit of distance is

    a D/l - e S/l - g C/l = (a - e s - g k) D/l.

So a stride pays if e s + g k < a, no ratio is computed near D = 0, and standing still scores 0.

The thesis does not define "distance". Here D is a straight line over ground, without height. It
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

from collections.abc import Mapping
from typing import Literal, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from evo_cpg.creature.algebra.numerics import Number
from evo_cpg.simulation.foot_slip import Slip, no_slip, slip_of_step
from evo_cpg.simulation.measures import Displacement, no_displacement
from evo_cpg.simulation.task import Task, Transition

# ``any``: displacement in any direction. ``forward``: displacement along the world's +x, which an
# animal faces at the start unless it is turned. Backwards is negative.
Heading = Literal["any", "forward"]


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
    """

    light: None = eqx.field(default=None, init=False)
    heading: Heading = eqx.field(static=True, default="any")

    def begin(self, batch: tuple[int, ...], dtype: jnp.dtype, steps: int) -> Displacement:
        """See `Task.begin`."""
        del steps
        return no_displacement(batch, dtype)

    def update(self, tally: Displacement, transition: Transition, steps: int) -> Displacement:
        """See `Task.update`."""
        del steps
        place = transition.before.state.position
        return tally.moved(transition.step, place, place)

    def terms(self, tally: Displacement, steps: int) -> dict[str, Float[Array, " *n"]]:
        """Return ``distance`` and its ``forward`` part (m)."""
        del steps
        return _measured(tally)

    def fitness(
        self, terms: Mapping[str, Float[Array, " *n"]], scales: Mapping[str, Float[Array, ""]]
    ) -> Float[Array, " *n"]:
        """Return D, m."""
        del scales
        return _headed(terms, self.heading)


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
            slip=None if self.slip_weight is None else no_slip(batch, dtype),
            cost=None if self.cost_weight is None else none,
        )

    def update(self, tally: Gait, transition: Transition, steps: int) -> Gait:
        """See `Task.update`."""
        del steps
        place = transition.before.state.position
        displacement = tally.displacement.moved(transition.step, place, place)
        _, x, y, _ = transition.before.state.orientation
        rise = displacement.end[2] - displacement.start[2]
        return Gait(
            displacement,
            # The vertical component of the torso's z axis is 1 - 2 (x^2 + y^2).
            tally.tilt + 2.0 * (x * x + y * y),
            tally.rise + rise,
            tally.squared_rise + rise * rise,
            tally.airborne + transition.airborne,
            slip=None if tally.slip is None else tally.slip.plus(_slip(transition)),
            cost=None if tally.cost is None else tally.cost + _cost(transition),
        )

    def terms(self, tally: Gait, steps: int) -> dict[str, Float[Array, " *n"]]:
        """Return the terms of the module's table, without slip and cost if they are free."""
        mean = tally.rise / steps
        terms = _measured(tally.displacement) | {
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
        fitness = (
            self.distance_weight * _headed(terms, self.heading) / self.torso_length
            - self.tilt_weight * terms["tilt"]
            - self.bounce_weight * terms["bounce"] / self.torso_length
            - self.airborne_weight * terms["airborne"]
        )
        if self.slip_weight is not None:
            fitness = fitness - self.slip_weight * terms["slip"] / self.torso_length
        if self.cost_weight is not None:
            fitness = fitness - self.cost_weight * terms["cost"] / self.torso_length
        return fitness


def _slip(transition: Transition) -> Slip:
    """Return the slip of a control step, with a path (N m) instead of a speed."""
    slide, load = slip_of_step(transition)
    return Slip(transition.before.control_step * slide, load)


def _cost(transition: Transition) -> Float[Array, " *n"]:
    """Return the energy of a control step over the weight, m."""
    return transition.energy / transition.before.world.weight


def _measured(displacement: Displacement) -> dict[str, Float[Array, " *n"]]:
    ahead, aside, _ = displacement.end - displacement.start
    return {"distance": jnp.sqrt(ahead * ahead + aside * aside), "forward": ahead}


def _headed(terms: Mapping[str, Float[Array, " *n"]], heading: Heading) -> Float[Array, " *n"]:
    return terms["distance" if heading == "any" else "forward"]
