"""Sensory feedback into the spinal cord: the stretch of the body's two sides.

The extensor of an oscillator pulls its joint to positive angles. At an angle q > 0 the extensor's
side of the joint is short, and the flexor's side is stretched:

    stretch_e = [-q]+,    stretch_f = [q]+,    [x]+ = max(0, x).

The stretched side's own neuron receives + w times the stretch, and the other one - w times it. Both
terms together are linear in the angle:

    s_e = w ([-q]+ - [q]+) = -w q,    s_f = w ([q]+ - [-q]+) = w q.

The feedback of oscillator i adds the angle and the rate of its own joint and of its neighbours,
after a delay D, and is limited:

    f_i(t) = sum_j K_ij (w q_j(t - D) + w_r q'_j(t - D)),
    s_f = -s_e = u_max clip(f_i, -limit, limit).                                         (1)

| symbol | name |
|---|---|
| w, w_r | ``angle_weight`` (1/rad), ``rate_weight`` (s/rad) |
| D | ``delay`` (s) |
| K | ``rows``: 1 for the own joint, 1 - n/(N + 1) for the nth joint along the chain |
| N | ``from_parents``, ``from_children`` |

A positive weight excites the neuron of the stretched side (edge cells of the lamprey). A negative
weight excites the neuron of the bent side. Published models use either sign.

The angle is sampled at the start of a control step of length h and held during the step. So a delay
D acts like a continuous delay of D + h/2. Samples before the start of the trial count as 0.
"""

import dataclasses
import math
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.control.couplings import axis_directions, axis_parents, matching_oscillators
from evo_cpg.creature.tree import Tree
from evo_cpg.spatial.decisions import chosen
from evo_cpg.spatial.linear import expand_dims_like
from evo_cpg.spatial.numerics import Number, Numbers

# Longest delay, s. A delay costs one stored sample of each joint per control step.
_LONGEST_DELAY = 1.0

# A number, or the lowest and highest value of a number that evolves.
Weight = float | tuple[float, float]


@dataclasses.dataclass(frozen=True)
class StretchFeedback:
    """Stretch of joints, which enters their oscillators and those of neighbours.

    Attributes:
        joints: degrees of freedom that are sensed, and whose oscillators receive the feedback. They
            are names or patterns such as ``tail*.z``.
        angle_weight: input per joint angle, 1/rad, in units of ``max_tonic_input``. A positive
            weight excites the neuron of the stretched side and inhibits the other one. Two numbers
            are the range of a weight that evolves.
        rate_weight: input per joint rate, s/rad, in units of ``max_tonic_input``. Its sign and its
            range are those of ``angle_weight``.
        delay: time from the joint to the neuron, s, 0 to 1.
        from_parents: number of joints towards the root whose stretch an oscillator also receives.
            The effect decreases linearly along the chain, to 0 at the next joint.
        from_children: number of joints away from the root, in the same way.

    Raises:
        ValueError: a value is outside its range.
    """

    joints: tuple[str, ...] = ("*",)
    angle_weight: Weight = 0.0
    rate_weight: Weight = 0.0
    delay: float = 0.0
    from_parents: int = 0
    from_children: int = 0

    def __post_init__(self):
        check_weights(self, ("angle_weight", "rate_weight"))
        check_delay(self.delay)
        for name in ("from_parents", "from_children"):
            if not getattr(self, name) >= 0:
                raise ValueError(f"{name} must not be negative, got {getattr(self, name)}")


@dataclasses.dataclass(frozen=True)
class FeedbackSettings:
    """Feedback of the senses into the spinal cord.

    Attributes:
        stretch: stretch of joints.
        limit: largest size of the feedback of one neuron, in units of ``max_tonic_input``, more
            than 0.

    Raises:
        ValueError: a value is outside its range.
    """

    stretch: tuple[StretchFeedback, ...] = ()
    limit: float = 1.0

    def __post_init__(self):
        if not self.limit > 0:
            raise ValueError(f"limit must be positive, got {self.limit}")


def check_weights(settings: StretchFeedback, names: Sequence[str]) -> None:
    """Raise ValueError for an evolved weight whose range is empty."""
    for name in names:
        weight = getattr(settings, name)
        if isinstance(weight, tuple) and not weight[0] < weight[1]:
            raise ValueError(
                f"{name} must be a number or a range [low, high] with low < high, got {weight}"
            )


def check_delay(delay: float) -> None:
    """Raise ValueError for a delay outside its range."""
    if not 0 <= delay <= _LONGEST_DELAY:
        raise ValueError(f"delay must be from 0 to {_LONGEST_DELAY:g} s, got {delay}")


class Gain(eqx.Module):
    """A weight that is set, or that evolves within a range.

    Attributes:
        low: the weight, or its smallest value.
        high: its largest value, or None if the weight is set.
        gene: index of its gene among the genes of the feedback, or None if the weight is set.
    """

    low: Number
    high: Number | None = None
    gene: int | None = eqx.field(static=True, default=None)

    def value(self, genes: Float[Array, "g *n"] | None) -> Array | Number:
        """Return the weight of each individual: low + (high - low) / (1 + exp(-gene))."""
        if self.high is None:
            return self.low
        assert genes is not None and self.gene is not None
        return self.low + (self.high - self.low) * jax.nn.sigmoid(genes[self.gene])


class Stretch(eqx.Module):
    """One `StretchFeedback` on a creature's tree.

    Attributes:
        angle_weight: w.
        rate_weight: w_r.
        offsets: offsets of the nonzero diagonals of K. Offset k means that oscillator i receives
            the stretch of joint i + k.
        rows: these diagonals, ``rows[m, i] = K[i, i + offsets[m]]``, 0 outside.
        samples: number of former samples that the delay needs.
        newest: share of the newer one of the two samples around the delay, 0 to 1.
    """

    angle_weight: Gain
    rate_weight: Gain
    offsets: tuple[int, ...] = eqx.field(static=True)
    rows: Float[Numbers, "k o"]
    samples: int = eqx.field(static=True)
    newest: Number


class Feedback(eqx.Module):
    """Feedback into the oscillators of one creature.

    Attributes:
        gene_count: number of weights that evolve.
        stretch: senses of stretch.
        limit: largest size of the feedback of one neuron, in the unit of the tonic input.
        unit: u_max, the unit of the weights.
    """

    gene_count: int = eqx.field(static=True)
    stretch: tuple[Stretch, ...]
    limit: Number
    unit: Number


# Former samples of each sense, the newest first, or None for a sense without a delay.
Memory = tuple[Float[Array, "k o *n"] | None, ...]


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
        CouplingError: the creature lacks a joint that the settings name.
    """
    genes: list[Weight] = []

    def gain(weight: Weight) -> Gain:
        if not isinstance(weight, tuple):
            return Gain(weight)
        genes.append(weight)
        return Gain(*weight, len(genes) - 1)

    stretch = []
    for i, given in enumerate(settings.stretch):
        offsets, rows = _spread(tree, given, i)
        samples, newest = _delay(given.delay, control_step)
        weights = gain(given.angle_weight), gain(given.rate_weight)
        stretch.append(Stretch(*weights, offsets, rows, samples, newest))
    limit = settings.limit * max_tonic_input
    return Feedback(len(genes), tuple(stretch), limit, max_tonic_input)


def no_memory(
    feedback: Feedback, count: int, batch: tuple[int, ...], dtype: jnp.dtype | type
) -> Memory:
    """Return the memory at the start of a trial, all zero.

    Args:
        feedback: the senses.
        count: number of oscillators.
        batch: trailing axes, such as ``(population,)``.
        dtype: floating-point type.
    """
    return tuple(
        jnp.zeros((sense.samples, count, *batch), dtype) if sense.samples else None
        for sense in feedback.stretch
    )


def feel(
    feedback: Feedback,
    genes: Float[Array, "g *n"] | None,
    memory: Memory,
    joint_angle: Float[Array, "d *n"],
    joint_rate: Float[Array, "d *n"],
) -> tuple[Float[Array, "2 d *n"], Memory]:
    """Return the feedback of eq. 1 to each neuron, extensors first, and the next memory.

    Args:
        feedback: the senses.
        genes: genes of the weights that evolve, or None if none evolves.
        memory: former samples.
        joint_angle: joint angles, rad.
        joint_rate: joint rates, rad/s.
    """
    total, kept = jnp.zeros_like(joint_angle), []
    for sense, past in zip(feedback.stretch, memory, strict=True):
        angle, rate = sense.angle_weight.value(genes), sense.rate_weight.value(genes)
        now = spread(sense.offsets, sense.rows, angle * joint_angle + rate * joint_rate)
        delayed, past = _after_delay(sense, now, past)
        total += delayed
        kept.append(past)
    bounded = jnp.clip(feedback.unit * total, -feedback.limit, feedback.limit)
    return jnp.stack([-bounded, bounded]), tuple(kept)


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


def _after_delay(
    sense: Stretch, now: Float[Array, "o *n"], past: Float[Array, "k o *n"] | None
) -> tuple[Float[Array, "o *n"], Float[Array, "k o *n"] | None]:
    """Return the delayed value, linear between two samples, and the next memory."""
    if past is None:
        return now, past
    samples = jnp.concatenate([now[None], past])
    delayed = sense.newest * samples[-2] + (1 - sense.newest) * samples[-1]
    return delayed, samples[:-1]


def _delay(delay: Number, control_step: float) -> tuple[int, Number]:
    """Return the number of former samples, and the share of the newer one of the last two."""
    steps = delay / control_step
    # A delay that is a whole number of steps but for rounding takes no extra sample.
    samples = chosen(lambda: math.ceil(float(steps) - 1e-9))
    return samples, samples - steps


def _spread(
    tree: Tree, settings: StretchFeedback, number: int
) -> tuple[tuple[int, ...], Float[Numbers, "k o"]]:
    """Return the offsets and diagonals of K.

    Joints whose axes point in opposite directions receive each other's stretch with a minus sign.
    """
    where = ("feedback", "stretch", number, "joints")
    among = {
        oscillator
        for i, pattern in enumerate(settings.joints)
        for oscillator in matching_oscillators(tree, pattern, (*where, i))
    }
    parents = axis_parents(tree)
    direction = axis_directions(tree)
    elements: dict[tuple[int, int], float] = {(i, i): 1.0 for i in among}
    for i in among:
        ancestor, steps = parents[i], 1
        while ancestor is not None and steps <= max(settings.from_parents, settings.from_children):
            if ancestor in among:
                side = direction[i] * direction[ancestor]
                for place, reach in (
                    ((i, ancestor), settings.from_parents),
                    ((ancestor, i), settings.from_children),
                ):
                    if steps <= reach:
                        elements[place] = side * (1 - steps / (reach + 1))
            ancestor, steps = parents[ancestor], steps + 1
    offsets = tuple(sorted({source - target for target, source in elements}))
    rows = np.zeros((len(offsets), tree.dof_count))
    for (target, source), share in elements.items():
        rows[offsets.index(source - target), target] = share
    return offsets, rows
