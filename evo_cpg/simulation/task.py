"""Tasks that animals are evolved for: a task follows a trial and returns a fitness.

A task is structure and settings, like a controller. Every control step updates its ``tally``, any
pytree of arrays. At the end of the trial the tally becomes named terms, and the terms become one
fitness, which is maximised. Fitness may divide terms by scales that are measured on the first
generation, such as a large energy. The scales stay fixed in later generations.
"""

import abc
from collections.abc import Mapping
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PyTree, UInt32

from evo_cpg.control.controller import Command, Observation
from evo_cpg.creature.algebra.numerics import Number
from evo_cpg.simulation.noise import uniforms
from evo_cpg.simulation.snapshot import Forces, Snapshot

# Tag that keeps a task's draws apart from those of numbers (`evo_cpg.io.courses`).
_TAG = 0


class CourseStart(NamedTuple):
    """Start of a trial, from which a course is drawn.

    Attributes:
        position: place of the root's centre, m.
        light: place of the light, m.
        keys: raw random keys of the course, or None if it is not drawn.
    """

    position: Float[Array, "3 *n"]
    light: Float[Array, "3 *n"]
    keys: UInt32[Array, "w *n"] | None

    def uniform(self, count: int) -> Float[Array, "count *n"]:
        """Return random numbers from 0 to 1, equal for all individuals of a generation."""
        if self.keys is None:
            raise ValueError("courses are random only if the task has draws_course = True")
        return uniforms(self.keys, count, _TAG)


class Transition(NamedTuple):
    """One control step for a task: the animal before and after it, and its actions.

    The compiled program computes only the numbers that a task uses.

    Attributes:
        step: number of the control step, from 0.
        before: the animal at the start of the step.
        after: the animal at the end of the step.
        observation: readings of the senses.
        command: command of the controller to the motors.
        forces: forces of motors and ground, means over the step.
        energy: energy spent by all motors, J.
        airborne: fraction of the step in which nothing touches the ground, 1 without ground.
        course: course of the light at the end of the step (`Task.begin_course`).
    """

    step: Array
    before: Snapshot
    after: Snapshot
    observation: Observation
    command: Command
    forces: Forces
    energy: Float[Array, " *n"]
    airborne: Float[Array, " *n"]
    course: PyTree = ()


class Task(eqx.Module):
    """Score of a trial. Subclass it to write your own task.

    The methods must be pure JAX functions of arrays whose trailing axes are individuals. A task
    is built with the keyword arguments in the config's ``task.options``.

    Attributes:
        light: place of the point light, m, for situations without their own, or None for a task
            without a light. `Snapshot.light_position` is the place in the trial.
        heading: ``forward`` if only displacement along the world's x counts, else ``any``. The
            class decides what its fitness counts. `evo-cpg sensitivity` reads this attribute.
        moves_light: whether the light moves in a trial (False unless overridden). Then override
            `begin_course`, `place_light` and `advance_course`.
        draws_course: whether courses are random (False unless overridden).

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
    moves_light = False
    draws_course = False

    def begin_course(self, start: CourseStart) -> PyTree:
        """Return what the light of a trial depends on, any pytree of arrays."""
        del start
        return ()

    def place_light(self, course: PyTree) -> Float[Array, "3 *n"]:
        """Return the place of the light that the animals sense, m."""
        raise NotImplementedError(f"{type(self).__name__} moves its light, so it must place it")

    def advance_course(self, course: PyTree, after: Snapshot, step: Array) -> PyTree:
        """Return the course after a control step: same structure, shapes and types.

        Args:
            course: the course before the step.
            after: the animal at the end of the step.
            step: number of the control step, from 0.
        """
        del after, step
        return course

    @abc.abstractmethod
    def begin(self, batch: tuple[int, ...], dtype: jnp.dtype, steps: int) -> PyTree:
        """Return the tally before a trial of this many control steps."""

    @abc.abstractmethod
    def update(self, tally: PyTree, transition: Transition, steps: int) -> PyTree:
        """Return the tally after one more control step: same structure, shapes and types."""

    @abc.abstractmethod
    def terms(self, tally: PyTree, steps: int) -> dict[str, Float[Array, " *n"]]:
        """Return the terms of the finished trial, by name."""

    def scales(self, terms: Mapping[str, Float[Array, " n"]]) -> dict[str, Float[Array, ""]]:
        """Return scales measured on the first generation, all finite. Empty unless overridden.

        Terms of individuals that diverged are NaN in ``terms``.
        """
        del terms
        return {}

    def descriptors(self, terms: Mapping[str, Float[Array, " n"]]) -> dict[str, Array]:
        """Return the terms that describe behaviour rather than success, by name.

        They serve as axes of maps of behaviour (MAP-Elites). There are none unless overridden.
        """
        del terms
        return {}

    def final_control_steps(self, control_rate: float) -> int:
        """Return the number of final control steps over which a distance to a light is averaged.

        By default, these are the steps of the last second, at ``control_rate`` steps per second.
        """
        return max(1, round(control_rate))

    def beyond_scales(
        self, terms: Mapping[str, float], scales: Mapping[str, float]
    ) -> dict[str, float]:
        """Return the excess of terms over their scale. Fitness ignores this excess.

        Returns:
            Excess divided by the scale, at least 0, for every term that the fitness limits to its
            scale.
        """
        del terms, scales
        return {}

    def of_length(self, length: Number) -> "Task":
        """Return the task of an animal whose longest extent at rest is a length, m.

        By default it is the same task. Plans have different lengths.
        """
        del length
        return self

    @abc.abstractmethod
    def fitness(
        self, terms: Mapping[str, Float[Array, " *n"]], scales: Mapping[str, Float[Array, ""]]
    ) -> Float[Array, " *n"]:
        """Return the fitness, which is maximised."""


def term_names(task: Task) -> tuple[str, ...]:
    """Return the names of a task's terms."""
    steps = 1
    terms = jax.eval_shape(lambda: task.terms(task.begin((1,), jnp.dtype("float32"), steps), steps))
    return tuple(terms)
