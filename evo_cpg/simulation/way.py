"""How far an animal gets, whatever it is judged by."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from evo_cpg.simulation.snapshot import Snapshot
from evo_cpg.simulation.task import Task, Transition

# Name of the term; no term of a task of one's own is called so.
WAY = "(way of the root)"


class _Way(NamedTuple):
    """The task's own tally, where the animal began and where it is."""

    own: Any
    start: Array
    place: Array


class WithWay(Task):
    """A task that also tells the way, in the term `WAY`.

    Towards the light, where there is one: how much nearer to it the root is at the end, m. Else
    the straight line over the ground from the root's place at the start, m.

    Attributes:
        light: the task's.
        task: what the animal is judged by.
    """

    light: tuple[float, float, float] | None
    task: Task

    def begin(self, batch: tuple[int, ...], dtype: jnp.dtype, steps: int) -> _Way:
        """See `Task.begin`."""
        nowhere = jnp.zeros((2, *batch), dtype)
        return _Way(self.task.begin(batch, dtype, steps), nowhere, nowhere)

    def update(self, tally: _Way, transition: Transition, steps: int) -> _Way:
        """See `Task.update`."""
        first, last = (_seen_from(x) for x in (transition.before, transition.after))
        start = jnp.where(transition.step == 0, first, tally.start)
        return _Way(self.task.update(tally.own, transition, steps), start, last)

    def terms(self, tally: _Way, steps: int) -> dict[str, Float[Array, " *n"]]:
        """Those of the task, and the way (m)."""
        length = jnp.sqrt(jnp.sum((tally.place - tally.start) ** 2, 0))
        if self.light is not None:
            length = tally.start[0] - tally.place[0]
        return self.task.terms(tally.own, steps) | {WAY: length}

    def scales(self, terms: Mapping[str, Float[Array, " n"]]) -> dict[str, Float[Array, ""]]:
        """See `Task.scales`."""
        return self.task.scales(terms)

    def fitness(
        self, terms: Mapping[str, Float[Array, " *n"]], scales: Mapping[str, Float[Array, ""]]
    ) -> Float[Array, " *n"]:
        """The task's."""
        return self.task.fitness(terms, scales)


def _seen_from(snapshot: Snapshot) -> Float[Array, "2 *n"]:
    """Distance from the light, and nothing; or the place over the ground."""
    place = snapshot.state.position
    if snapshot.light_position is None:
        return place[:2]
    away = place - snapshot.light_position
    distance = jnp.sqrt(jnp.sum(away * away, 0))
    return jnp.stack([distance, jnp.zeros_like(distance)])
