"""Displacement of the animal, independent of its task."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from evo_cpg.physics.step.world import World
from evo_cpg.simulation.measures import Displacement, Measure, Measures, Trial, no_displacement
from evo_cpg.simulation.simulation import Simulation
from evo_cpg.simulation.snapshot import Snapshot
from evo_cpg.simulation.task import Transition

# Name of the term. Its parentheses keep it different from the names of terms in users' tasks.
DISPLACEMENT = "(displacement of the root)"


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
        """See `Measure.update`."""
        first, last = (_seen_from(x) for x in (transition.before, transition.after))
        return tally.moved(transition.step, first, last)

    def finish(self, tally: Displacement, trial: Trial) -> Float[Array, " *n"]:
        """See `Measure.finish`."""
        del trial
        if self.lit:
            return tally.start[0] - tally.end[0]
        return jnp.sqrt(jnp.sum((tally.end - tally.start) ** 2, 0))


def with_displacement(simulation: Simulation) -> Simulation:
    """Return the same trial with the displacement among its terms, as `DISPLACEMENT`."""
    measure = RootDisplacement(lit=simulation.task.light is not None)
    added = Measures((DISPLACEMENT,), (measure,))
    return dataclasses.replace(simulation, measures=simulation.measures | added)


def _seen_from(snapshot: Snapshot) -> Float[Array, "2 *n"]:
    """Return the root's distance from the light and 0, or its x and y if there is no light."""
    place = snapshot.state.position
    if snapshot.light_position is None:
        return place[:2]
    away = place - snapshot.light_position
    distance = jnp.sqrt(jnp.sum(away * away, 0))
    return jnp.stack([distance, jnp.zeros_like(distance)])
