"""Feedback of the senses into the spinal cord: stretch of joints, and load of limbs.

The inputs f of all senses are added, and their sum is limited:

    s = u_max clip(f, -limit, limit).

**Stretch.** The extensor of an oscillator pulls its joint to positive angles. At an angle q > 0 the
extensor's side of the joint is short, and the flexor's side is stretched:

    stretch_e = [-q]+,    stretch_f = [q]+,    [x]+ = max(0, x).

The neuron of the stretched side receives + w times the stretch, and the other one - w times it.
Both terms together are linear in the angle:

    s_e = w ([-q]+ - [q]+) = -w q,    s_f = w ([q]+ - [-q]+) = w q.

Oscillator i adds the angles and rates of its own joint and of its neighbours, after a delay D:

    s_f = -s_e = sum_j K_ij (w q_j(t - D) + w_r q'_j(t - D)).                              (1)

| symbol | name |
|---|---|
| w, w_r | ``angle_weight`` (1/rad), ``rate_weight`` (s/rad) |
| D | ``delay`` (s) |
| K | ``rows``: 1 for the own joint, 1 - n/(N + 1) for the nth joint along the chain |
| N | ``from_parents``, ``from_children`` |

A positive weight excites the neuron of the stretched side, as edge cells of the lamprey do. A
negative weight excites the neuron of the bent side. Published models use either sign.

**Load.** The load n of a limb is the vertical force of the ground on all its bodies, in units of
the animal's weight. It excites the extensors of the limb, and inhibits its flexors:

    s_e = -s_f = w n_own(t - D) + v sum_others n(t - D).                                    (2)

| symbol | name |
|---|---|
| w, v | ``weight``, ``neighbour_weight`` |

**Weights and delays.** A weight is a setting, or it evolves. A gene g sets a weight that evolves
between two numbers:

    w = low + (high - low) / (1 + exp(-g)).

The senses are sampled at the start of a control step of length h, and held during the step. A delay
D between two samples takes a linear mean of both. So it acts like a continuous delay of D + h/2.
Samples before the start of the trial count as 0.
"""

import dataclasses
import itertools
import math
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.control.couplings import (
    CouplingError,
    axis_directions,
    axis_parents,
    listed_oscillators,
    matching_bodies,
)
from evo_cpg.creature.algebra.decisions import chosen
from evo_cpg.creature.algebra.linear import expand_dims_like, of_each
from evo_cpg.creature.algebra.numerics import Number, Numbers
from evo_cpg.creature.tree import Tree

# Longest delay, s. A delay costs one stored sample of each oscillator per control step.
LONGEST_DELAY = 1.0

# A number, or the lowest and highest value of a number that evolves.
Weight = float | tuple[float, float]


class _Sense:
    """Settings whose weights, delay and reach along the chain of joints are checked."""

    delay: float

    def __post_init__(self):
        for field in dataclasses.fields(self):  # pyright: ignore[reportArgumentType]
            name, value = field.name, getattr(self, field.name)
            if isinstance(value, tuple):
                if name.endswith("weight") and not value[0] < value[1]:
                    allowed = "a number, or [low, high] with low < high"
                    raise ValueError(f"{name} must be {allowed}, got {list(value)}")
            elif name.startswith("from_") and not value >= 0:
                raise ValueError(f"{name} must not be negative, got {value}")
        if not 0 <= self.delay <= LONGEST_DELAY:
            raise ValueError(f"delay must be from 0 to {LONGEST_DELAY:g} s, got {self.delay}")


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


class Delay(eqx.Module):
    """A delay between two samples.

    Attributes:
        samples: number of former samples that the delay needs.
        newer: share of the newer one of the two samples, 0 to 1.
    """

    samples: int = eqx.field(static=True)
    newer: Number

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


@dataclasses.dataclass(frozen=True)
class StretchFeedback(_Sense):
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


class StretchSense(eqx.Module):
    """One `StretchFeedback` on a creature's tree.

    Attributes:
        angle_weight: w.
        rate_weight: w_r.
        offsets: offsets of the nonzero diagonals of K. Offset k means that oscillator i receives
            the stretch of joint i + k.
        rows: these diagonals, ``rows[m, i] = K[i, i + offsets[m]]``, 0 outside.
        delay: D.
    """

    angle_weight: Gain
    rate_weight: Gain
    offsets: tuple[int, ...] = eqx.field(static=True)
    rows: Float[Numbers, "k o"]
    delay: Delay

    def now(
        self,
        genes: Float[Array, "g *n"] | None,
        joint_angle: Float[Array, "d *n"],
        joint_rate: Float[Array, "d *n"],
    ) -> Float[Array, "d *n"]:
        """Return s_f of eq. 1 before the delay, in units of u_max."""
        angle = self.angle_weight.times(joint_angle, genes)
        values = angle + self.rate_weight.times(joint_rate, genes)
        count, margin = values.shape[0], max(map(abs, self.offsets), default=0)
        zeros = jnp.zeros((margin, *values.shape[1:]), values.dtype)
        padded = jnp.concatenate([zeros, values, zeros])
        total = jnp.zeros_like(values)
        for offset, row in zip(self.offsets, self.rows, strict=True):
            shifted = padded[margin + offset : margin + offset + count]
            total += expand_dims_like(row, values) * shifted
        return total


def _spread(
    tree: Tree, settings: StretchFeedback, number: int
) -> tuple[tuple[int, ...], Float[Numbers, "k o"]]:
    """Return the offsets and diagonals of K.

    Joints whose axes point in opposite directions receive each other's stretch with a minus sign.
    """
    where = ("feedback", "stretch", number, "joints")
    among = set(listed_oscillators(tree, settings.joints, where))
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


@dataclasses.dataclass(frozen=True)
class LoadFeedback(_Sense):
    """Load of limbs, which enters the oscillators of these limbs.

    Attributes:
        limbs: bodies, or patterns such as ``*_thigh``. Each one is the first body of a limb. All
            bodies behind it belong to the limb.
        joints: degrees of freedom of the limbs whose oscillators receive the load. They are names
            or patterns such as ``*.y``.
        weight: input per load of the own limb, in units of ``max_tonic_input``. A positive weight
            excites the extensor and inhibits the flexor. The load is 1 if the limb carries the
            whole animal. Two numbers are the range of a weight that evolves.
        neighbour_weight: the same for the sum of the loads of the other limbs in the list.
        delay: time from the ground to the neuron, s, 0 to 1.

    Raises:
        ValueError: a value is outside its range.
    """

    limbs: tuple[str, ...]
    joints: tuple[str, ...] = ("*",)
    weight: Weight = 0.0
    neighbour_weight: Weight = 0.0
    delay: float = 0.0


class Limbs(eqx.Module):
    """Limbs of a creature, and the oscillators that feel them.

    Attributes:
        bodies: bodies of each limb.
        limb: limb whose load each oscillator feels, or the number of limbs for none.
    """

    bodies: tuple[tuple[int, ...], ...] = eqx.field(static=True)
    limb: tuple[int, ...] = eqx.field(static=True)


class Load(eqx.Module):
    """One `LoadFeedback` on a creature's tree.

    Attributes:
        limbs: the limbs.
        weight: w.
        neighbour_weight: v.
        delay: D.
    """

    limbs: Limbs
    weight: Gain
    neighbour_weight: Gain
    delay: Delay

    def now(
        self, genes: Float[Array, "g *n"] | None, load: Float[Array, "b *n"]
    ) -> Float[Array, "o *n"]:
        """Return s_e of eq. 2 before the delay, in units of u_max."""
        own = jnp.stack([load[np.array(bodies)].sum(0) for bodies in self.limbs.bodies])
        others = own.sum(0, keepdims=True) - own
        felt = self.weight.times(own, genes) + self.neighbour_weight.times(others, genes)
        # Oscillators without a limb feel 0.
        padded = jnp.concatenate([felt, jnp.zeros_like(felt[:1])])
        return padded[np.array(self.limbs.limb)]


def find_limbs(
    tree: Tree, limbs: tuple[str, ...], joints: tuple[str, ...], where: tuple[str | int, ...]
) -> Limbs:
    """Return limbs by the patterns of their first bodies, in the order of bodies.

    Raises:
        CouplingError: a pattern matches nothing, a limb is part of another limb or has none of the
            joints.
    """
    first = sorted(matching_bodies(tree, limbs, (*where, "limbs"), CouplingError))
    if not first:
        raise CouplingError("names no limb", (*where, "limbs"))
    among = set(listed_oscillators(tree, joints, (*where, "joints")))
    owner: list[int] = []
    for body, parent in enumerate(tree.parents):
        above = owner[parent] if parent >= 0 else len(first)
        if body in first and above < len(first):
            names = f"{tree.names[body]!r} is part of the limb {tree.names[first[above]]!r}"
            raise CouplingError(names, (*where, "limbs"))
        owner.append(first.index(body) if body in first else above)
    limb = [owner[body] if i in among else len(first) for i, body in enumerate(tree.dof_bodies)]
    for i, body in enumerate(first):
        if i not in limb:
            problem = f"matches no joint of the limb {tree.names[body]!r}"
            raise CouplingError(problem, (*where, "joints"))
    bodies = tuple(
        tuple(body for body, own in enumerate(owner) if own == i) for i in range(len(first))
    )
    return Limbs(bodies, tuple(limb))


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
    """Build the feedback into the oscillators of a tree, sampled once a control step (s).

    Raises:
        CouplingError: the creature lacks a limb or joint that the settings name.
    """
    genes = itertools.count()

    def gain(weight: Weight) -> Gain:
        return Gain(*weight, next(genes)) if isinstance(weight, tuple) else Gain(weight)

    stretch = tuple(
        StretchSense(
            gain(one.angle_weight),
            gain(one.rate_weight),
            *_spread(tree, one, i),
            make_delay(one.delay, control_step),
        )
        for i, one in enumerate(settings.stretch)
    )
    load = tuple(
        Load(
            find_limbs(tree, one.limbs, one.joints, ("feedback", "load", i)),
            gain(one.weight),
            gain(one.neighbour_weight),
            make_delay(one.delay, control_step),
        )
        for i, one in enumerate(settings.load)
    )
    limit = settings.limit * max_tonic_input
    return Feedback(next(genes), stretch, load, limit, max_tonic_input)


def first_memory(
    feedback: Feedback, count: int, batch: tuple[int, ...], dtype: jnp.dtype | type
) -> Memory:
    """Return the memory at the start of a trial: all senses were 0."""
    stretch, load = (
        tuple(
            jnp.zeros((samples, count, *batch), dtype) if samples else None
            for samples in (sense.delay.samples for sense in senses)
        )
        for senses in (feedback.stretch, feedback.load)
    )
    return Memory(stretch, load)


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
    """
    # Input of the extensors. Flexors receive the negative.
    total = jnp.zeros_like(joint_angle)
    stretched, loaded = [], []
    for sense, past in zip(feedback.stretch, memory.stretch, strict=True):
        delayed, past = sense.delay.after(sense.now(genes, joint_angle, joint_rate), past)
        total -= delayed
        stretched.append(past)
    for sense, past in zip(feedback.load, memory.load, strict=True):
        if load is None:
            raise ValueError("the spinal cord feels the load of limbs, but got no Observation.load")
        delayed, past = sense.delay.after(sense.now(genes, load), past)
        total += delayed
        loaded.append(past)
    bounded = jnp.clip(feedback.unit * total, -feedback.limit, feedback.limit)
    return jnp.stack([bounded, -bounded]), Memory(tuple(stretched), tuple(loaded))
