"""What the animals are evolved for: a task follows a trial and turns it into a fitness.

A task is structure and settings, like a controller. During a trial its ``tally``, any pytree of
arrays, is updated with every control step; at the end it becomes named terms, and the terms become
one fitness, which is maximised. Terms may be measured against scales taken from the first
generation (such as the most energy that an animal can spend), which then stay fixed.
"""

import abc
from collections.abc import Mapping
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PyTree

from evo_cpg.control.controller import Command, Observation
from evo_cpg.simulation.snapshot import Forces, Snapshot


class Transition(NamedTuple):
    """One control step as a task sees it: the animal before and after it, and what it did.

    Every number of it is computed only where a task uses it.

    Attributes:
        step: number of the control step, from 0.
        before: the animal at its beginning.
        after: the animal at its end.
        observation: what the controller sensed.
        command: what it asked of the motors.
        forces: of motors and ground, means over the step.
        energy: spent by all motors, J.
        airborne: share of the step in which nothing of the animal touches the ground; 1 where
            there is no ground.
    """

    step: Array
    before: Snapshot
    after: Snapshot
    observation: Observation
    command: Command
    forces: Forces
    energy: Float[Array, " *n"]
    airborne: Float[Array, " *n"]


class Task(eqx.Module):
    """What a trial is judged by. Subclass it to write a task of your own.

    The methods must be pure JAX functions of arrays whose trailing axes are individuals. A task
    is built with the keyword arguments in the config's ``task.options``.

    Attributes:
        light: place of the point light, m, where a situation does not have its own; None for a
            task in the dark. `Snapshot.light_position` is where it is.
        heading: ``forward`` where only the way along the world's x counts, else ``any``.

    Example:
        A race along x::

            class GoForward(Task):
                light: None = None

                def begin(self, batch, dtype, steps):
                    return jnp.zeros(batch, dtype)

                def update(self, tally, transition, steps):
                    return transition.after.state.position[0]

                def terms(self, tally, steps):
                    return {"distance": tally}

                def fitness(self, terms, scales):
                    return terms["distance"]
    """

    light: eqx.AbstractVar[tuple[float, float, float] | None]

    heading = "any"

    @abc.abstractmethod
    def begin(self, batch: tuple[int, ...], dtype: jnp.dtype, steps: int) -> PyTree:
        """The tally before a trial of so many control steps."""

    @abc.abstractmethod
    def update(self, tally: PyTree, transition: Transition, steps: int) -> PyTree:
        """The tally after one more control step: same structure, shapes and types."""

    @abc.abstractmethod
    def terms(self, tally: PyTree, steps: int) -> dict[str, Float[Array, " *n"]]:
        """What the finished trial amounted to, by name."""

    def scales(self, terms: Mapping[str, Float[Array, " n"]]) -> dict[str, Float[Array, ""]]:
        """Yardsticks measured on the first generation, all finite; none unless overridden.

        Terms of individuals that diverged are NaN.
        """
        del terms
        return {}

    def descriptors(self, terms: Mapping[str, Float[Array, " n"]]) -> dict[str, Array]:
        """Of the terms, those that say how an animal behaves rather than how well, by name.

        They are for searches that look for variety; none unless overridden.
        """
        del terms
        return {}

    def final_control_steps(self, control_rate: float) -> int:
        """Return the control steps at the end over which a distance to a light is averaged.

        Those of the last second unless overridden.

        Args:
            control_rate: control steps per second, 1/s.
        """
        return max(1, round(control_rate))

    def beyond_scales(
        self, terms: Mapping[str, float], scales: Mapping[str, float]
    ) -> dict[str, float]:
        """Return terms that are larger than their scale, of which the excess is not judged.

        Args:
            terms: of one individual.
            scales: as `scales` measured them.

        Returns:
            The excess relative to the scale, at least 0; for all terms that have such a limit.
        """
        del terms, scales
        return {}

    @abc.abstractmethod
    def fitness(
        self, terms: Mapping[str, Float[Array, " *n"]], scales: Mapping[str, Float[Array, ""]]
    ) -> Float[Array, " *n"]:
        """The score, which is maximised."""


def term_names(task: Task) -> tuple[str, ...]:
    """Names of a task's terms."""
    steps = 1
    terms = jax.eval_shape(lambda: task.terms(task.begin((1,), jnp.dtype("float32"), steps), steps))
    return tuple(terms)
