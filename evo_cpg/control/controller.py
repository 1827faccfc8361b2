"""What every controller takes and gives: senses in, motor commands out, once per control step."""

import abc
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, PyTree

from evo_cpg.control.matsuoka import Oscillators


class Observation(NamedTuple):
    """What an animal senses at one instant (Iwadate 2010, Table 2).

    The trailing axes ``*n`` are the individuals; one alone has none. Degrees of freedom are in
    the order of ``Tree.dof_names``.

    Attributes:
        light: strength at each light sensor, 0 to 1.
        pressure: 1 where a pressure sensor touches something solid, else 0.
        vertical_cosine: cosine of the angle between a sensor's axis and the vertical.
        vertical_sine: its sine.
        joint_angle: rad.
        joint_rate: rad/s.
        depth: of each depth gauge below the water's surface, 0 to 1 at its full scale and below.
        custom: readings of the creature's `sensors`, one after the other; None stands for none.
    """

    light: Float[Array, "l *n"]
    pressure: Float[Array, "p *n"]
    vertical_cosine: Float[Array, "v *n"]
    vertical_sine: Float[Array, "v *n"]
    joint_angle: Float[Array, "d *n"]
    joint_rate: Float[Array, "d *n"]
    depth: Float[Array, "z *n"]
    custom: Float[Array, "c *n"] | None = None


class Command(NamedTuple):
    """What a controller asks of the motors until the next control step.

    Attributes:
        target_rate: rate for each motor's velocity servo to follow, rad/s.
        signal: the rhythm behind it, for plots of the phase lag: the output y_e - y_f of each
            oscillator, or whatever plays its part.
        target_angle: angle for each motor's spring to pull to, rad; None leaves the springs at
            their neutral angle.
    """

    target_rate: Float[Array, "d *n"]
    signal: Float[Array, "d *n"]
    target_angle: Float[Array, "d *n"] | None = None


class Origin:
    """What something was built from, to be looked up: it takes no part in comparisons.

    The numbers that count are fields of what was built, where derivatives can be taken by them.
    """

    def __init__(self, settings: Any):
        self.settings = settings

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Origin)

    def __hash__(self) -> int:
        return hash(Origin)


class Controller(eqx.Module):
    """A nervous system whose genes evolve.

    The controller itself is structure and settings, the same for the whole population; what
    differs between individuals are the ``genes``, and what changes in time is the ``state``, any
    pytree of arrays. To write one, subclass this, declare the number of genes, and give the three
    methods. They must be pure JAX functions: no Python branches on array values, nothing changed
    in place. Arrays have their components first and individuals on the trailing axes, of which
    there may be none, so plain arithmetic serves one individual and a population alike.

    ``act`` is called once per control step (1/60 s unless the config says otherwise), with the
    senses at the start of the step; its command is held until the next one.

    Example:
        Every joint follows one sine wave; amplitude and frequency evolve.

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
        uses_senses: False if commands do not depend on the senses.
        signal_label: what `Command.signal` is, with its unit, for plots.
    """

    gene_count: eqx.AbstractVar[int]

    uses_senses = True
    signal_label = "controller's signal"

    @property
    def binary(self) -> bool:
        """Whether genes are bits, 0 or 1; no, unless overridden."""
        return False

    @property
    def rhythm_generator(self) -> Oscillators | None:
        """The oscillators that make the rhythm; None unless overridden."""
        return None

    @abc.abstractmethod
    def random_genes(
        self, key: Array, batch: tuple[int, ...], dtype: jnp.dtype | type
    ) -> Float[Array, "g *n"]:
        """Genes of the first generation.

        Args:
            key: random key.
            batch: trailing axes, such as ``(population,)``.
            dtype: floating-point type.
        """

    @abc.abstractmethod
    def initial_state(self, batch: tuple[int, ...], dtype: jnp.dtype | type) -> PyTree[Array]:
        """State at the start of a trial.

        Args:
            batch: trailing axes of every array, such as ``(population,)``.
            dtype: floating-point type.
        """

    def decode(self, genes: Float[Array, "g *n"]) -> PyTree[Array]:
        """What `act` gets of the genes, which is the genes themselves unless a subclass says so.

        Called once per trial. What stays the same throughout belongs here: it is then computed
        once, and a gradient adds up its slopes array by array.

        Args:
            genes: of each individual.
        """
        return genes

    @abc.abstractmethod
    def act(
        self, decoded: PyTree[Array], state: PyTree[Array], observation: Observation
    ) -> tuple[PyTree[Array], Command]:
        """One control step.

        Args:
            decoded: the genes of each individual, as `decode` gives them.
            state: as `initial_state` or the last step left it.
            observation: senses at the start of the step.

        Returns:
            The state for the next step (same structure, shapes and types) and the command.
        """
