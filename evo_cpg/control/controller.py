"""Interface of all controllers: senses in, motor commands out, once per control step."""

import abc
import dataclasses
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, PyTree

from evo_cpg.control.matsuoka import Oscillators


class Observation(NamedTuple):
    """Senses of an animal at one instant (Iwadate 2010, Table 2).

    The trailing axes ``*n`` are the individuals. A single individual has none. Degrees of freedom
    are in the order of ``Tree.dof_names``.

    Attributes:
        light: strength at each light sensor, 0 to 1.
        pressure: for each pressure sensor, 1 if the ground presses its body harder than the water
            does, else 0.
        vertical_cosine: cosine of the angle between each light sensor's axis and the vertical.
        vertical_sine: sine of the angle between each light sensor's axis and the vertical.
        joint_angle: joint angles, rad.
        joint_rate: joint rates, rad/s.
        depth: depth of each gauge below the water's surface, as a fraction of its full scale,
            clipped to 0 and 1.
        custom: readings of the creature's `sensors`, concatenated. None if there are none.
        load: vertical force of the ground on each body in the last control step, as a fraction of
            the animal's weight. None if the controller does not use it.
        bearing: unit vector from the centre of each body to the light, in the body's own axes. None
            if the controller does not use it.
    """

    light: Float[Array, "l *n"]
    pressure: Float[Array, "p *n"]
    vertical_cosine: Float[Array, "v *n"]
    vertical_sine: Float[Array, "v *n"]
    joint_angle: Float[Array, "d *n"]
    joint_rate: Float[Array, "d *n"]
    depth: Float[Array, "z *n"]
    custom: Float[Array, "c *n"] | None = None
    load: Float[Array, "b *n"] | None = None
    bearing: Float[Array, "3 b *n"] | None = None


class Command(NamedTuple):
    """Command to the motors until the next control step.

    Attributes:
        target_rate: rate for each motor's velocity servo to follow, rad/s.
        signal: rhythm behind the rate, for plots of the phase lag: the output y_e - y_f of each
            oscillator, or an equivalent.
        target_angle: angle that each motor's spring pulls its joint to, rad. None is the neutral
            angle of every joint.
        activation: activation of the muscles of each degree of freedom, 0 to 1: of those that pull
            to positive angles, then of the others. None relaxes all muscles. Axes with motors
            ignore it, and axes with muscles ignore the rate and the angle.
        torque: torque of each torque motor, N m, clipped to its limit. None is no torque. Other
            axes ignore it, and axes with torque motors ignore the rate and the angle.
    """

    target_rate: Float[Array, "d *n"]
    signal: Float[Array, "d *n"]
    target_angle: Float[Array, "d *n"] | None = None
    activation: Float[Array, "2 d *n"] | None = None
    torque: Float[Array, "d *n"] | None = None


@dataclasses.dataclass(frozen=True)
class Origin:
    """Settings that an object was built from, for reference only. Comparisons ignore them.

    The effective numbers are fields of the object, so that derivatives can be taken by them.
    """

    settings: Any = dataclasses.field(compare=False)


class Controller(eqx.Module):
    """A nervous system whose genes evolve.

    The controller itself is structure and settings, common to the whole population. Individuals
    differ in the ``genes``. The ``state``, any pytree of arrays, changes in time.

    To write a controller, subclass this, declare the number of genes, and define ``random_genes``,
    ``initial_state`` and ``act``. They must be pure JAX functions: no Python branches on array
    values, no changes in place. Arrays have their components first and individuals on the trailing
    axes. A single individual has no trailing axes, so plain arithmetic serves one individual and a
    population.

    ``act`` is called once per control step (1/60 s by default) with the senses at the start of the
    step. Its command is held until the next call.

    Example:
        Every joint follows one sine wave. Its amplitude and frequency evolve.

        >>> import equinox as eqx
        >>> import jax
        >>> import jax.numpy as jnp
        >>> from evo_cpg.control.controller import Command, Controller
        >>> class SineController(Controller):
        ...     gene_count: int = eqx.field(static=True, default=2)
        ...     control_step: float = eqx.field(static=True, default=1 / 60)
        ...
        ...     def random_genes(self, key, batch, dtype):
        ...         return jax.random.uniform(key, (self.gene_count, *batch), dtype)
        ...
        ...     def initial_state(self, batch, dtype):
        ...         return jnp.zeros(batch, dtype)
        ...
        ...     def act(self, decoded, state, observation):
        ...         amplitude, frequency = decoded
        ...         time = state + self.control_step
        ...         wave = jnp.sin(2 * jnp.pi * frequency * time)
        ...         signal = wave[None] * jnp.ones_like(observation.joint_angle)
        ...         return time, Command(target_rate=amplitude[None] * signal, signal=signal)

    Attributes:
        gene_count: numbers in the genome of one individual.
        binary: whether genes are bits, 0 or 1 (False unless overridden).
        uses_senses: False if commands do not depend on the senses.
        uses_load: whether the controller needs `Observation.load` (False unless overridden).
        uses_bearing: whether it needs `Observation.bearing` (False unless overridden).
        rhythm_generator: the oscillators that make the rhythm (None unless overridden).
        signal_label: meaning of `Command.signal`, with its unit, for plots.
    """

    gene_count: eqx.AbstractVar[int]

    binary = False
    uses_senses = True
    uses_load = False
    uses_bearing = False
    rhythm_generator: ClassVar[Oscillators | None] = None
    signal_label = "controller's signal"

    @abc.abstractmethod
    def random_genes(
        self, key: Array, batch: tuple[int, ...], dtype: jnp.dtype | type
    ) -> Float[Array, "g *n"]:
        """Return genes of the first generation.

        Args:
            key: random key.
            batch: trailing axes, such as ``(population,)``.
            dtype: floating-point type.
        """

    @abc.abstractmethod
    def initial_state(self, batch: tuple[int, ...], dtype: jnp.dtype | type) -> PyTree[Array]:
        """Return the state at the start of a trial.

        Args:
            batch: trailing axes of every array, such as ``(population,)``.
            dtype: floating-point type.
        """

    def decode(self, genes: Float[Array, "g *n"]) -> PyTree[Array]:
        """Return the genes in the form that `act` takes. They are unchanged unless overridden.

        Called once per trial. Compute here everything that does not change in the trial. It is then
        computed once, and a gradient over all steps is summed in the decoded arrays.

        Args:
            genes: genes of each individual.
        """
        return genes

    @abc.abstractmethod
    def act(
        self, decoded: PyTree[Array], state: PyTree[Array], observation: Observation
    ) -> tuple[PyTree[Array], Command]:
        """Run one control step.

        Args:
            decoded: genes of each individual from `decode`.
            state: state from `initial_state`, or from the previous call.
            observation: senses at the start of the step.

        Returns:
            The state for the next step (same structure, shapes and types) and the command.
        """
