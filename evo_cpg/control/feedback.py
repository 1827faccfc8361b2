"""Feedback of the senses into the spinal cord: all kinds together.

| kind | module |
|---|---|
| stretch of joints | `evo_cpg.control.stretch` |
| load of limbs | `evo_cpg.control.limb_load` |

The inputs f of all senses are added, and their sum is limited:

    s = u_max clip(f, -limit, limit).
"""

import dataclasses
import itertools
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from evo_cpg.control.afferent import Gain, Weight
from evo_cpg.control.limb_load import Load, LoadFeedback, build_load
from evo_cpg.control.stretch import StretchFeedback, StretchSense, build_stretch
from evo_cpg.creature.algebra.numerics import Number
from evo_cpg.creature.tree import Tree


@dataclasses.dataclass(frozen=True)
class FeedbackSettings:
    """Feedback of the senses into the spinal cord.

    Attributes:
        stretch: stretch of joints.
        load: load of limbs.
        limit: largest size of the input of one neuron from all its senses, in units of
            ``max_tonic_input``, more than 0.

    Raises:
        ValueError: a value is outside its range.
    """

    stretch: tuple[StretchFeedback, ...] = ()
    load: tuple[LoadFeedback, ...] = ()
    limit: float = 1.0

    def __post_init__(self):
        if not self.limit > 0:
            raise ValueError(f"limit must be positive, got {self.limit}")


class Feedback(eqx.Module):
    """Feedback into the oscillators of one creature.

    Attributes:
        gene_count: number of weights that evolve.
        stretch: senses of stretch.
        load: senses of load.
        limit: largest size of the input of one neuron, in the unit of the tonic input.
        unit: u_max, the unit of the weights.
    """

    gene_count: int = eqx.field(static=True)
    stretch: tuple[StretchSense, ...]
    load: tuple[Load, ...]
    limit: Number
    unit: Number

    @property
    def uses_load(self) -> bool:
        """Return whether any sense is the load of a limb."""
        return bool(self.load)


class Memory(NamedTuple):
    """Former samples of the senses.

    Attributes:
        stretch: samples of each sense of stretch, the newest first, or None without a delay.
        load: samples of each sense of load, in the same way.
    """

    stretch: tuple[Float[Array, "k o *n"] | None, ...]
    load: tuple[Float[Array, "k o *n"] | None, ...]


def build_feedback(
    tree: Tree, settings: FeedbackSettings, max_tonic_input: Number, control_step: float
) -> Feedback:
    """Build the feedback into the oscillators of a creature's tree.

    Args:
        tree: the creature.
        settings: settings.
        max_tonic_input: u_max.
        control_step: time between two samples, s.

    Raises:
        CouplingError: the creature lacks a limb or joint that the settings name.
    """
    genes = itertools.count()

    def gain(weight: Weight) -> Gain:
        return Gain(*weight, next(genes)) if isinstance(weight, tuple) else Gain(weight)

    stretch = tuple(
        build_stretch(tree, one, i, gain, control_step) for i, one in enumerate(settings.stretch)
    )
    load = tuple(
        build_load(tree, one, i, gain, control_step) for i, one in enumerate(settings.load)
    )
    limit = settings.limit * max_tonic_input
    return Feedback(next(genes), stretch, load, limit, max_tonic_input)


def first_memory(
    feedback: Feedback, count: int, batch: tuple[int, ...], dtype: jnp.dtype | type
) -> Memory:
    """Return the memory at the start of a trial: all senses were 0.

    Args:
        feedback: the senses.
        count: number of oscillators.
        batch: trailing axes, such as ``(population,)``.
        dtype: floating-point type.
    """
    return Memory(
        tuple(sense.delay.memory(count, batch, dtype) for sense in feedback.stretch),
        tuple(sense.delay.memory(count, batch, dtype) for sense in feedback.load),
    )


def feel(
    feedback: Feedback,
    genes: Float[Array, "g *n"] | None,
    memory: Memory,
    joint_angle: Float[Array, "d *n"],
    joint_rate: Float[Array, "d *n"],
    load: Float[Array, "b *n"] | None,
) -> tuple[Float[Array, "2 d *n"], Memory]:
    """Return the input to each neuron in one control step, and the next memory.

    The inputs of the extensors come first, in the unit of the tonic input.

    Args:
        feedback: the senses.
        genes: genes of the feedback, or None if no weight evolves.
        memory: former samples.
        joint_angle: joint angles, rad.
        joint_rate: joint rates, rad/s.
        load: load of each body, or None if no sense is a load.
    """
    # Input of the extensors. Flexors receive the negative.
    total = jnp.zeros_like(joint_angle)
    stretched, loaded = [], []
    for sense, past in zip(feedback.stretch, memory.stretch, strict=True):
        delayed, past = sense.delay.after(sense.now(genes, joint_angle, joint_rate), past)
        total -= delayed
        stretched.append(past)
    if not feedback.uses_load:
        load = None
    elif load is None:
        raise ValueError("the spinal cord feels the load of limbs, but got no Observation.load")
    if load is not None:
        for sense, past in zip(feedback.load, memory.load, strict=True):
            delayed, past = sense.delay.after(sense.now(genes, load), past)
            total += delayed
            loaded.append(past)
    bounded = jnp.clip(feedback.unit * total, -feedback.limit, feedback.limit)
    return jnp.stack([bounded, -bounded]), Memory(tuple(stretched), tuple(loaded))
