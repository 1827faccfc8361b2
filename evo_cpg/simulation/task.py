"""What the animals are evolved for: a task watches a trial and turns it into a fitness.

A task is structure and settings, like a controller. During a trial its ``tally``, any pytree of
arrays, is updated once per control step; at the end it becomes named terms, and the terms become
one fitness, which is maximised. Terms may be measured against scales taken from the first
generation (such as the most energy that an animal can spend), which then stay fixed.
"""

import abc
from collections.abc import Mapping
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, PyTree


class Moment(NamedTuple):
    """One control step as a task sees it; trailing axes are individuals.

    Attributes:
        step: number of the control step, from 0.
        position: centre of the root body, m.
        orientation: of the root, quaternion (w, x, y, z).
        light: strength at each light sensor.
        joint_angle: rad.
        energy: spent by all motors in this control step, J.
        airborne: share of this control step in which nothing of the animal touches the ground; 1
            where there is no ground.
        light_position: place of the light in this trial, m; None for a task in the dark.
    """

    step: Array
    position: Float[Array, "3 *n"]
    orientation: Float[Array, "4 *n"]
    light: Float[Array, "eyes *n"]
    joint_angle: Float[Array, "d *n"]
    energy: Float[Array, " *n"]
    airborne: Float[Array, " *n"]
    light_position: Float[Array, "3 *#n"] | None = None


class Task(eqx.Module):
    """What a trial is judged by. Subclass it to write a task of your own.

    The methods must be pure JAX functions of arrays whose trailing axes are individuals. A task
    is built with the keyword arguments in the config's ``task.options``.

    Attributes:
        light: place of the point light, m, where a situation does not have its own; None for a
            task in the dark. `Moment.light_position` is where it is.

    Example:
        A race along x::

            class GoForward(Task):
                light: None = None

                def begin(self, batch, dtype, steps):
                    return jnp.zeros(batch, dtype)

                def watch(self, tally, moment, steps):
                    return moment.position[0]

                def terms(self, tally, steps):
                    return {"distance": tally}

                def fitness(self, terms, scales):
                    return terms["distance"]
    """

    light: eqx.AbstractVar[tuple[float, float, float] | None]

    @abc.abstractmethod
    def begin(self, batch: tuple[int, ...], dtype: jnp.dtype, steps: int) -> PyTree:
        """The tally before a trial of so many control steps."""

    @abc.abstractmethod
    def watch(self, tally: PyTree, moment: Moment, steps: int) -> PyTree:
        """The tally after one more control step."""

    @abc.abstractmethod
    def terms(self, tally: PyTree, steps: int) -> dict[str, Float[Array, " *n"]]:
        """What the finished trial amounted to, by name."""

    def scales(self, terms: Mapping[str, Float[Array, " n"]]) -> dict[str, Float[Array, ""]]:
        """Yardsticks measured on the first generation, all finite; none unless overridden.

        Terms of individuals that diverged are NaN.
        """
        del terms
        return {}

    @abc.abstractmethod
    def fitness(
        self, terms: Mapping[str, Float[Array, " *n"]], scales: Mapping[str, Float[Array, ""]]
    ) -> Float[Array, " *n"]:
        """The score, which is maximised."""
