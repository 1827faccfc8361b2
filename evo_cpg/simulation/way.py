"""Displacement of the animal, whatever it is judged by."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from evo_cpg.physics.world import World
from evo_cpg.simulation.measures import Measure, Measures, Trial, Way, no_way
from evo_cpg.simulation.simulation import Simulation
from evo_cpg.simulation.snapshot import Snapshot
from evo_cpg.simulation.task import Transition

# Name of the term; no term of a task of one's own is called so.
WAY = "(way of the root)"


class Displacement(Measure):
    """Displacement of the root, m.

    With a light: how much nearer to it the root is at the end. Without one: the straight line over
    the ground from the root's place at the start.
    """

    lit: bool = eqx.field(static=True)

    def begin(self, world: World, batch: tuple[int, ...], dtype: jnp.dtype) -> Way:
        """See `Measure.begin`."""
        del world
        return no_way(batch, dtype, 2)

    def update(self, tally: Way, transition: Transition) -> Way:
        """See `Measure.update`."""
        first, last = (_seen_from(x) for x in (transition.before, transition.after))
        return Way(jnp.where(transition.step == 0, first, tally.start), last)

    def finish(self, tally: Way, trial: Trial) -> Float[Array, " *n"]:
        """See `Measure.finish`."""
        del trial
        if self.lit:
            return tally.start[0] - tally.end[0]
        return jnp.sqrt(jnp.sum((tally.end - tally.start) ** 2, 0))


def with_way(simulation: Simulation) -> Simulation:
    """The same trial with its displacement among the terms, as `WAY`."""
    way = Measures((WAY,), (Displacement(lit=simulation.task.light is not None),))
    return dataclasses.replace(simulation, measures=simulation.measures | way)


def _seen_from(snapshot: Snapshot) -> Float[Array, "2 *n"]:
    """Distance from the light, and nothing; or the place over the ground."""
    place = snapshot.state.position
    if snapshot.light_position is None:
        return place[:2]
    away = place - snapshot.light_position
    distance = jnp.sqrt(jnp.sum(away * away, 0))
    return jnp.stack([distance, jnp.zeros_like(distance)])
