"""Imperfect senses: noise, delay, a rate below that of the control steps, or silence.

A sense is sampled every ``period`` control steps, with normal noise, and held in between. A delay
between two control steps takes a linear mean of both samples (`evo_cpg.control.feedback.Delay`).
Readings are not clipped after noise, because clipping would move their mean.

Every sense has one `Imperfection`, which holds for all its readings. A perfect sense has none and
costs nothing.
"""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, UInt32

from evo_cpg.control.controller import Observation
from evo_cpg.control.feedback import Delay
from evo_cpg.creature.algebra.numerics import Number
from evo_cpg.simulation.noise import SENSES, is_none, normals


class Imperfection(eqx.Module):
    """How some readings of an observation differ from the truth.

    Attributes:
        part: field of `Observation` with the readings.
        first: index of the first of the readings in this field.
        count: number of readings.
        noise: standard deviation of the noise of each sample.
        delay: delay of the samples.
        period: number of control steps between two samples.
        silent: whether all readings are 0.
    """

    part: str = eqx.field(static=True)
    first: int = eqx.field(static=True)
    count: int = eqx.field(static=True)
    noise: Number = 0.0
    delay: Delay = Delay(0, 1.0)
    period: int = eqx.field(static=True, default=1)
    silent: bool = eqx.field(static=True, default=False)


class SenseMemory(NamedTuple):
    """Former readings of an imperfect sense.

    Attributes:
        held: last sample, or None if every control step has a sample.
        past: samples of former control steps, the newest first, or None without a delay.
    """

    held: Float[Array, "k *n"] | None
    past: Float[Array, "d k *n"] | None


def first_memories(
    imperfections: tuple[Imperfection, ...], batch: tuple[int, ...], dtype: jnp.dtype
) -> tuple[SenseMemory, ...]:
    """Return the memory at the start of a trial. Delayed readings are 0 until the delay is over."""
    found = []
    for one in imperfections:
        samples = one.delay.samples
        held = jnp.zeros((one.count, *batch), dtype) if one.period > 1 else None
        past = jnp.zeros((samples, one.count, *batch), dtype) if samples else None
        found.append(SenseMemory(held, past))
    return tuple(found)


def imperfect(
    imperfections: tuple[Imperfection, ...],
    index: Array | int,
    seen: Observation,
    memories: tuple[SenseMemory, ...],
    keys: UInt32[Array, "w *n"] | None,
) -> tuple[Observation, tuple[SenseMemory, ...]]:
    """Return what the animal senses, and its memory for the next control step.

    Args:
        imperfections: imperfections of the senses.
        index: number of the control step.
        seen: true readings.
        memories: memory of each imperfect sense.
        keys: raw random keys of the trials, or None without noise.
    """
    later = []
    for number, (one, memory) in enumerate(zip(imperfections, memories, strict=True)):
        part = getattr(seen, one.part)
        rows = slice(one.first, one.first + one.count)
        sample = jnp.zeros_like(part[rows]) if one.silent else part[rows]
        if keys is not None and not is_none(one.noise):
            sample = sample + one.noise * normals(keys, SENSES + number, one.count, index)
        held = None
        if memory.held is not None:
            sample = held = jnp.where(index % one.period == 0, sample, memory.held)
        felt, past = one.delay.after(sample, memory.past)
        seen = seen._replace(**{one.part: part.at[rows].set(felt)})
        later.append(SenseMemory(held, past))
    return seen, tuple(later)
