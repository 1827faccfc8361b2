"""Weights, delays and spread that all senses of the spinal cord share.

A weight is a setting, or it evolves. A gene g sets a weight that evolves between two numbers:

    w = low + (high - low) / (1 + exp(-g)).

The senses are sampled at the start of a control step of length h, and held during the step. A delay
D between two samples takes a linear mean of both. So it acts like a continuous delay of D + h/2.
Samples before the start of the trial count as 0.
"""

import math
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from evo_cpg.creature.algebra.decisions import chosen
from evo_cpg.creature.algebra.linear import expand_dims_like, of_each
from evo_cpg.creature.algebra.numerics import Number, Numbers

# Longest delay, s. A delay costs one stored sample of each oscillator per control step.
_LONGEST = 1.0

# A number, or the lowest and highest value of a number that evolves.
Weight = float | tuple[float, float]


def check_weights(settings: Any, *names: str) -> None:
    """Check the weights among some settings.

    Raises:
        ValueError: the range of a weight that evolves is empty.
    """
    for name in names:
        weight = getattr(settings, name)
        if isinstance(weight, tuple) and not weight[0] < weight[1]:
            raise ValueError(
                f"{name} must be a number, or [low, high] with low < high, got {list(weight)}"
            )


def check_delay(delay: float) -> None:
    """Check a delay, s.

    Raises:
        ValueError: the delay is outside its range.
    """
    if not 0 <= delay <= _LONGEST:
        raise ValueError(f"delay must be from 0 to {_LONGEST:g} s, got {delay}")


class Gain(eqx.Module):
    """A weight that is a setting, or that evolves within a range.

    Attributes:
        low: the weight, or its smallest value.
        high: its largest value, or None for a setting.
        gene: index of its gene among the genes of the feedback, or None for a setting.
    """

    low: Number
    high: Number | None = None
    gene: int | None = eqx.field(static=True, default=None)

    def times(
        self, values: Float[Array, "k *n"], genes: Float[Array, "g *n"] | None
    ) -> Float[Array, "k *n"]:
        """Return values times the weight of each individual."""
        if self.high is None:
            return self.low * values
        assert genes is not None and self.gene is not None
        share = jax.nn.sigmoid(genes[self.gene])
        return of_each(self.low + (self.high - self.low) * share, values) * values


# Builds the gain of a weight, with the next free gene.
MakeGain = Callable[[Weight], Gain]


class Delay(eqx.Module):
    """A delay between two samples.

    Attributes:
        samples: number of former samples that the delay needs.
        newer: share of the newer one of the two samples, 0 to 1.
    """

    samples: int = eqx.field(static=True)
    newer: Number

    def memory(
        self, count: int, batch: tuple[int, ...], dtype: jnp.dtype | type
    ) -> Float[Array, "k o *n"] | None:
        """Return former samples of 0, the newest first, or None if the delay needs none."""
        return jnp.zeros((self.samples, count, *batch), dtype) if self.samples else None

    def after(
        self, now: Float[Array, "o *n"], past: Float[Array, "k o *n"] | None
    ) -> tuple[Float[Array, "o *n"], Float[Array, "k o *n"] | None]:
        """Return the delayed values, and the next memory."""
        if past is None:
            return now, past
        samples = jnp.concatenate([now[None], past])
        return self.newer * samples[-2] + (1 - self.newer) * samples[-1], samples[:-1]


def make_delay(delay: Number, control_step: float) -> Delay:
    """Return a delay (s) for samples that are a control step (s) apart."""
    steps = delay / control_step
    # A delay that is a whole number of steps, but for rounding, takes no extra sample.
    samples = chosen(lambda: math.ceil(float(steps) - 1e-9))
    return Delay(samples, samples - steps)


def spread(
    offsets: tuple[int, ...], rows: Float[Numbers, "k o"], values: Float[Array, "o *n"]
) -> Float[Array, "o *n"]:
    """Return the product of a matrix, given by its diagonals, with one value per oscillator."""
    count, margin = values.shape[0], max(map(abs, offsets), default=0)
    zeros = jnp.zeros((margin, *values.shape[1:]), values.dtype)
    padded = jnp.concatenate([zeros, values, zeros])
    total = jnp.zeros_like(values)
    for offset, row in zip(offsets, rows, strict=True):
        shifted = padded[margin + offset : margin + offset + count]
        total += expand_dims_like(row, values) * shifted
    return total
