"""Reach the light by the shortest path, keeping it in view, with little energy (Iwadate 2010).

    f(D, E, L) = -a D - b E + c L,    a D_max > c L_max > b E_max            (eqs. 9 and 10)

D is the distance to the light at the end (mean of the last second). E is the energy of the motors.
L is the strongest light among all eyes in each step, averaged over the trial. All three are
normalised: D by the initial distance, E by a given value or the 95th percentile of the first
generation. Eq. 10 then reads ``a > c > b``.
"""

from collections.abc import Mapping
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from evo_cpg.creature.algebra.numerics import Number, Triple
from evo_cpg.simulation.task import Task, Transition

# Upper limit of the distance relative to the initial distance. So one individual that flees from
# the light cannot dominate averages.
_FARTHEST = 1.5

# Scale of the energy: this percentile of the first generation is E_max.
_ENERGY_PERCENTILE = 95.0


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
        distance = _distance(before.state.position, before.light_position)
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


def _distance(
    position: Float[Array, "3 *n"], light: Float[Array, "3 *#n"] | None
) -> Float[Array, " *n"]:
    """Return the distance from the light, m."""
    assert light is not None
    return jnp.sqrt(jnp.sum((light - position) ** 2, 0))
