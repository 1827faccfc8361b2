"""Go far: as in Fukui 2003, or with a posture that makes the animal walk instead of run.

The thesis scores only the distance moved after 20 s (section 3.4), so its agents run. To get a
walk, section 4.3 proposes to score the posture as well, without details. `Distance` scores the
distance,

    f = D,

and `Walk` subtracts terms that are typical of running, each from the whole trial:

    f = a D/l - b T - c H/l - d A,
    T = mean(1 - cos(angle between the torso's z axis and the vertical)).

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
| l | ``torso_length`` (m) |
| a, b, c, d | ``distance_weight``, ``tilt_weight``, ``bounce_weight``, ``airborne_weight`` |
"""

from collections.abc import Mapping
from typing import Literal, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from evo_cpg.simulation.measures import Displacement, no_displacement
from evo_cpg.simulation.task import Task, Transition
from evo_cpg.spatial.numerics import Number

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
    """

    displacement: Displacement
    tilt: Float[Array, " *n"]
    rise: Float[Array, " *n"]
    squared_rise: Float[Array, " *n"]
    airborne: Float[Array, " *n"]


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
    """

    torso_length: Number
    light: None = eqx.field(default=None, init=False)
    heading: Heading = eqx.field(static=True, default="any")
    distance_weight: Number = 1.0
    tilt_weight: Number = 20.0
    bounce_weight: Number = 20.0
    airborne_weight: Number = 10.0

    def begin(self, batch: tuple[int, ...], dtype: jnp.dtype, steps: int) -> Gait:
        """See `Task.begin`."""
        del steps
        sums = (jnp.zeros(batch, dtype) for _ in Gait._fields[1:])
        return Gait(no_displacement(batch, dtype), *sums)

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
        )

    def terms(self, tally: Gait, steps: int) -> dict[str, Float[Array, " *n"]]:
        """Return ``distance``, ``forward`` (m), ``tilt``, ``bounce`` (m) and ``airborne``."""
        mean = tally.rise / steps
        return _measured(tally.displacement) | {
            "tilt": tally.tilt / steps,
            "bounce": jnp.sqrt(jnp.maximum(tally.squared_rise / steps - mean * mean, 0.0)),
            "airborne": tally.airborne / steps,
        }

    def fitness(
        self, terms: Mapping[str, Float[Array, " *n"]], scales: Mapping[str, Float[Array, ""]]
    ) -> Float[Array, " *n"]:
        """Return the weighted displacement minus the costs of tilt, bounce and airborne time."""
        del scales
        return (
            self.distance_weight * _headed(terms, self.heading) / self.torso_length
            - self.tilt_weight * terms["tilt"]
            - self.bounce_weight * terms["bounce"] / self.torso_length
            - self.airborne_weight * terms["airborne"]
        )


def _measured(displacement: Displacement) -> dict[str, Float[Array, " *n"]]:
    ahead, aside, _ = displacement.end - displacement.start
    return {"distance": jnp.sqrt(ahead * ahead + aside * aside), "forward": ahead}


def _headed(terms: Mapping[str, Float[Array, " *n"]], heading: Heading) -> Float[Array, " *n"]:
    return terms["distance" if heading == "any" else "forward"]
