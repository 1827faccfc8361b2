"""The spinal cord: a network of Matsuoka neurons built on the creature's tree.

Iwadate 2010, eqs. 4-6, for neuron i with the others j acting on it:

    T_r dx_i/dt + x_i = -sum_j a_ji y_j - b z_i + u_i + s      (4)
    T_a dz_i/dt + z_i = y_i                                    (5)
    y_i = max(0, x_i)                                          (6)

| symbol | name |
|---|---|
| x | ``potential`` |
| z | ``adaptation`` |
| y_e - y_f | ``output``: extensor minus flexor |
| u | ``tonic_input`` |
| b | ``adaptation_gain`` |
| s | ``constant_input`` |
| a | ``pair_weight`` |
| T_r, T_a | ``rise_time``, ``adaptation_time`` (s) |

Every degree of freedom has one *oscillator*: an extensor and a flexor neuron that inhibit each
other with weight a. Oscillators of one axis on successive bodies inhibit each other
contralaterally (extensor to flexor, flexor to extensor). Inhibition is stronger from parent to
child than back. That asymmetry makes the wave run from head to tail.

A joint axis may point against its parent's axis, such as the axis of a right leg that swings
forwards by a turn about -z. Inhibition of opposite muscles then couples extensor with extensor and
flexor with flexor. The axes of one joint may inhibit each other contralaterally, too
(``cross_weight``). Any oscillators may be coupled one by one or around a ring
(`evo_cpg.control.couplings`). One signed matrix (oscillator by oscillator) holds all this. Its
positive elements A inhibit the opposite neuron (extensor to flexor). The sizes of its negative
elements, B, inhibit the equal neuron (extensor to extensor):

    T_r dx_e/dt + x_e = -A y_f - B y_e - b z_e + u_e + s,    and the same with e and f exchanged.

Differs from Iwadate 2010: the paper prints no connections between joints, and its T_r and T_a
admit no oscillation. The default exchanges the two (``docs/models/controller.md`` derives why).

Layout: ``(2, oscillators, *n)``, extensors first. The matrix has few non-zero diagonals (three
for a chain), so its product is a sum of shifted rows. One `advance` of 27 oscillators and 112
individuals takes 10 us on one core in float32.
"""

import dataclasses
import itertools
import math
from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from evo_cpg.control.couplings import (
    Coupling,
    Ring,
    axis_directions,
    axis_parents,
    explicit_weights,
    matching_bodies,
    start_phases,
)
from evo_cpg.control.feedback import FeedbackSettings
from evo_cpg.creature.algebra.decisions import chosen
from evo_cpg.creature.algebra.linear import expand_dims_like
from evo_cpg.creature.algebra.numerics import Number, Numbers, xp
from evo_cpg.creature.tree import Tree
from evo_cpg.native.fuse import fuse

# (T_r, T_a) in s: Iwadate 2010, Table 3, swapped and as printed.
TIME_CONSTANTS = {"swapped": (0.153337, 1.181958), "as_printed": (1.181958, 0.153337)}

# Largest Runge-Kutta substep as a fraction of the shorter time constant. At 1/60 s and b = 5 the
# signals then stay within 1e-3 (rms) of the exact ones for 33 s, phase included.
SUBSTEP_FRACTION = 0.25

# Largest number of substeps that are unrolled. More substeps run in `jax.lax.scan`.
_UNROLLED = 3

# Initial potential of extensors as a fraction of the largest tonic input. Flexors start at 0 unless
# a phase lag is set. A pair that starts with equal neurons would never oscillate.
INITIAL_FRACTION = 0.1


@dataclasses.dataclass(frozen=True)
class CpgSettings:
    """Constants of the Matsuoka network.

    Attributes:
        constants: which of the two times of Table 3 is T_r: ``swapped`` (0.153 s) oscillates,
            ``as_printed`` (1.182 s) does not.
        time_scale: factor on T_r and T_a, more than 0. It divides frequencies exactly and changes
            nothing else.
        pair_weight: a, between extensor and flexor of one oscillator, at least 0.
        parent_weight: inhibition from the parent's oscillator, in units of ``pair_weight``, at
            least 0.
        child_weight: inhibition from a child's oscillator, in units of ``pair_weight``, at least 0.
        cross_weight: mutual inhibition of successive axes of one joint, in units of
            ``pair_weight``, at least 0. The axes then swing nearly in phase: both signals are
            positive together.
        opposite: bodies, or patterns such as ``front_*``, whose couplings to the parent's
            oscillators change their sign. So front legs step against hind legs.
        couplings: couplings between chosen oscillators. They replace the tree's couplings between
            the same oscillators. All other couplings of the tree stay.
        rings: rings of oscillators with a constant lag from one to the next. They replace the
            tree's couplings between the oscillators of the ring.
        constant_input: the constant s of eq. 4, equal for every neuron.
        max_tonic_input: u_max, more than 0. Outputs are proportional to it.
        min_adaptation_gain: smallest b, more than 0.
        max_adaptation_gain: largest b.
        feedback: feedback of the senses into the oscillators, or None for none.

    Raises:
        ValueError: a value is outside its range.
    """

    constants: Literal["swapped", "as_printed"] = "swapped"
    time_scale: float = 1.0
    pair_weight: float = 1.070772
    parent_weight: float = 1.0
    child_weight: float = 0.2
    cross_weight: float = 0.0
    opposite: tuple[str, ...] = ()
    couplings: tuple[Coupling, ...] = ()
    rings: tuple[Ring, ...] = ()
    constant_input: float = 0.0
    max_tonic_input: float = 1.0
    min_adaptation_gain: float = 1.0
    max_adaptation_gain: float = 10.0
    feedback: FeedbackSettings | None = None

    def __post_init__(self):
        for name in ("time_scale", "max_tonic_input", "min_adaptation_gain"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} must be positive, got {getattr(self, name)}")
        for name in ("pair_weight", "parent_weight", "child_weight", "cross_weight"):
            if not getattr(self, name) >= 0:
                raise ValueError(
                    f"{name} is the strength of an inhibition and must not be negative, "
                    f"got {getattr(self, name)}"
                )
        if not self.max_adaptation_gain >= self.min_adaptation_gain:
            raise ValueError(
                f"max_adaptation_gain ({self.max_adaptation_gain}) must not be smaller than "
                f"min_adaptation_gain ({self.min_adaptation_gain})"
            )


class MatsuokaNetwork(eqx.Module):
    """Connections and time constants, with one oscillator per degree of freedom of the tree.

    Attributes:
        offsets: offsets of the nonzero diagonals of A, the inhibition by the opposite neuron.
            Offset k means that oscillator i + k inhibits oscillator i.
        weights: these diagonals, ``weights[m, i] = A[i, i + offsets[m]]``, 0 outside.
        own_offsets: offsets of the nonzero diagonals of B, the inhibition by the equal neuron.
        own_weights: these diagonals of B, 0 outside.
        rise_time: T_r, s.
        adaptation_time: T_a, s.
        constant_input: s.
        initial_potential: initial potential of each neuron, extensors first.
    """

    offsets: tuple[int, ...] = eqx.field(static=True)
    weights: Float[Numbers, "k o *n"]
    own_offsets: tuple[int, ...] = eqx.field(static=True)
    own_weights: Float[Numbers, "m o *n"]
    rise_time: Number
    adaptation_time: Number
    constant_input: Number
    initial_potential: Float[Numbers, "2 o"]

    @property
    def oscillator_count(self) -> int:
        """Number of extensor/flexor pairs."""
        return self.weights.shape[1]

    @property
    def matrix(self) -> Float[np.ndarray, "o o"]:
        """Inhibition of oscillators (rows) by oscillators (columns), see `inhibition_matrix`."""
        count = self.oscillator_count
        matrix = np.zeros((count, count))
        for sign, offsets, weights in (
            (1, self.offsets, self.weights),
            (-1, self.own_offsets, self.own_weights),
        ):
            for offset, row in zip(offsets, weights, strict=True):
                places = np.arange(max(0, -offset), count - max(0, offset))
                matrix[places, places + offset] += sign * row[places]
        return matrix

    def substeps(self, h: float) -> int:
        """Return the number of Runge-Kutta steps for a step of h (s)."""
        times = self.rise_time, self.adaptation_time
        return chosen(lambda: max(1, math.ceil(h / (SUBSTEP_FRACTION * min(times)))))


class Oscillators(NamedTuple):
    """The oscillators of a controller.

    Attributes:
        settings: settings that the oscillators were built from.
        network: one oscillator per degree of freedom.
        rate_gain: joint rate per unit of output of each oscillator, rad/s.
    """

    settings: CpgSettings
    network: MatsuokaNetwork
    rate_gain: Float[Numbers, " d"]


class MatsuokaState(eqx.Module):
    """State of every neuron, extensors first.

    Attributes:
        potential: x, in the unit of the tonic input.
        adaptation: z, in the unit of the tonic input.
    """

    potential: Float[Array, "2 o *n"]
    adaptation: Float[Array, "2 o *n"]


def inhibition_matrix(tree: Tree, settings: CpgSettings) -> Float[Numbers, "o o"]:
    """Return the inhibition of each oscillator (row) by each other one (column).

    An oscillator is coupled to the oscillator of the same axis on the nearest ancestor of its body
    that has this axis. An ancestor's oscillator may be coupled to several others (a trunk with
    limbs).

    Returns:
        Matrix, positive for inhibition by the other side, negative for the same side.

    Raises:
        ValueError: no body matches ``opposite``, or couplings do not fit the creature.
    """
    weights: dict[tuple[int, int], Number] = {(i, i): 1.0 for i in range(tree.dof_count)}
    direction = axis_directions(tree)
    opposite = matching_bodies(tree, settings.opposite, ("cpg", "opposite"))
    for child, parent in enumerate(axis_parents(tree)):
        if parent is not None:
            turned = -1 if tree.dof_bodies[child] in opposite else 1
            side = direction[child] * direction[parent] * turned
            weights[child, parent] = side * settings.parent_weight
            weights[parent, child] = side * settings.child_weight
    for i, (body, following) in enumerate(itertools.pairwise(tree.dof_bodies)):
        if body == following:
            weights[i, i + 1] = weights[i + 1, i] = settings.cross_weight
    weights |= explicit_weights(tree, settings.couplings, settings.rings)
    # Elements may be traced, so that they are placed by their numbers. Others are zero.
    place = np.zeros((tree.dof_count, tree.dof_count), int)
    place[tuple(np.array(list(weights)).T)] = 1 + np.arange(len(weights))
    return settings.pair_weight * xp.array([0.0, *weights.values()])[place]


def build_network(tree: Tree, settings: CpgSettings) -> MatsuokaNetwork:
    """Build the network on a creature's tree."""
    rise_time, adaptation_time = TIME_CONSTANTS[settings.constants]
    matrix = inhibition_matrix(tree, settings)
    fraction = xp.cos(start_phases(tree, settings.couplings, settings.rings, matrix))
    sides = xp.maximum(xp.stack([fraction, -fraction]), 0)
    return MatsuokaNetwork(
        **_connections(matrix),
        rise_time=settings.time_scale * rise_time,
        adaptation_time=settings.time_scale * adaptation_time,
        constant_input=settings.constant_input,
        initial_potential=INITIAL_FRACTION * settings.max_tonic_input * sides,
    )


def parts(network: MatsuokaNetwork) -> list[tuple[int, ...]]:
    """Return groups of oscillators that are coupled to each other, directly or through others.

    Axes that do not inhibit each other have independent rhythms, each with its own phase.
    """
    joined = (
        (network.matrix != 0)
        | (network.matrix.T != 0)
        | np.eye(network.oscillator_count, dtype=bool)
    )
    for _ in range(network.oscillator_count.bit_length()):
        joined = joined @ joined
    return list(dict.fromkeys(tuple(map(int, np.flatnonzero(row))) for row in joined))


def sub_network(network: MatsuokaNetwork, oscillators: tuple[int, ...]) -> MatsuokaNetwork:
    """Return the network of some oscillators, with the couplings between them."""
    connections = _connections(network.matrix[np.ix_(oscillators, oscillators)])
    start = network.initial_potential[:, list(oscillators)]
    return dataclasses.replace(network, **connections, initial_potential=start)


def _connections(matrix: Float[Numbers, "o o"]) -> dict[str, Any]:
    """Return the fields of a `MatsuokaNetwork` for an inhibition matrix."""
    signs, count = chosen(lambda: np.sign(matrix)), len(matrix)
    fields: dict[str, Any] = {}
    for prefix, sign in (("", 1), ("own_", -1)):
        there = signs == sign
        offsets = [k for k in range(1 - count, count) if np.diagonal(there, k).any()]
        kept = xp.where(there, sign * matrix, 0.0)
        # Rows ``kept[i, i + k]``, 0 outside the matrix.
        diagonals = [xp.pad(xp.diagonal(kept, k), (max(0, -k), max(0, k))) for k in offsets]
        fields[f"{prefix}offsets"] = tuple(offsets)
        fields[f"{prefix}weights"] = xp.stack(diagonals) if diagonals else np.zeros((0, count))
    return fields


def initial_state(
    network: MatsuokaNetwork, batch: tuple[int, ...] = (), dtype: jnp.dtype | type = jnp.float32
) -> MatsuokaState:
    """Return neurons at their initial potentials, with all adaptations z at 0."""
    rest = jnp.zeros((2, network.oscillator_count, *batch), dtype)
    return MatsuokaState(rest + expand_dims_like(network.initial_potential, rest), rest)


def advance(
    network: MatsuokaNetwork,
    state: MatsuokaState,
    tonic_input: Float[Array, "2 o *n"],
    adaptation_gain: Float[Array, "o *n"],
    h: float,
    substeps: int | None = None,
) -> MatsuokaState:
    """Integrate eqs. 4-6 over h (s) by classical Runge-Kutta steps, with constant inputs.

    Explicit Euler is unsuitable. Its error acts as negative damping, and at 1/60 s it makes a
    damped pair oscillate if b > 4.25.

    Args:
        network: connections and time constants.
        state: state at the start of the step.
        tonic_input: u of each neuron, extensors first.
        adaptation_gain: b of each oscillator.
        h: step, s. It is divided into substeps if it is long compared with T_r or T_a.
        substeps: number of substeps, or None for `MatsuokaNetwork.substeps`.
    """
    count = network.substeps(h) if substeps is None else substeps
    drive = tonic_input + network.constant_input

    def advance(state: MatsuokaState, drive: Array, adaptation_gain: Array) -> MatsuokaState:
        def substep(state: MatsuokaState, _) -> tuple[MatsuokaState, None]:
            return runge_kutta_step(network, h / count, state, drive, adaptation_gain), None

        if count <= _UNROLLED:
            for _ in range(count):
                state, _ = substep(state, None)
            return state
        return jax.lax.scan(substep, state, length=count)[0]

    batch_ndim = adaptation_gain.ndim - 1
    inputs = drive, adaptation_gain
    return fuse(advance, state, *inputs, batch_ndim=batch_ndim, name="oscillators")


def output(state: MatsuokaState) -> Float[Array, "o *n"]:
    """Return the motor signal of each oscillator, ``y_e - y_f``, in the unit of the tonic input.

    Its size never exceeds the largest u + s (or the initial potential), because inhibition and
    adaptation only lower a potential.
    """
    extensor, flexor = jnp.maximum(state.potential, 0.0)
    return extensor - flexor


def runge_kutta_step(
    network: MatsuokaNetwork,
    h: ArrayLike,
    state: MatsuokaState,
    drive: Float[Array, "2 o *n"],
    adaptation_gain: Float[Array, "o *n"],
) -> MatsuokaState:
    """Take one classical fourth-order step, written with the stages' states.

    s1, s2 and s3 are the states at which the second to fourth derivatives are computed. The usual
    ``s + h/6 (k1 + 2 k2 + 2 k3 + k4)`` is ``(s1 + 2 s2 + s3 - s) / 3 + h/6 k4``. So k1, k2 and k3
    need not be stored.

    Potentials have rows of zeros around them, so that each diagonal of A takes a plain slice.
    """
    count = network.oscillator_count
    margin = max(map(abs, network.offsets + network.own_offsets), default=0)
    zeros = jnp.zeros((2, margin, *drive.shape[2:]), drive.dtype)
    per_rise, per_adaptation = h / network.rise_time, h / network.adaptation_time

    def pad(potential: Array) -> Array:
        return jnp.concatenate([zeros, potential, zeros], axis=1)

    def rows(padded: Array, offset: int = 0) -> Array:
        return padded[:, margin + offset : margin + offset + count]

    def change(padded: Array, adaptation: Array) -> tuple[Array, Array]:
        """Return ``T_r dx/dt`` and ``T_a dz/dt``."""
        firing = jnp.maximum(padded, 0.0)
        other = zip(network.offsets, network.weights, strict=True)
        own = zip(network.own_offsets, network.own_weights, strict=True)
        inhibition = sum(
            expand_dims_like(weight[None], drive) * rows(side, offset)
            for side, diagonals in ((firing[::-1], other), (firing, own))
            for offset, weight in diagonals
        )
        excess = drive - rows(padded) - inhibition - adaptation_gain[None] * adaptation
        return excess, rows(firing) - adaptation

    def stage(fraction: float, padded: Array, adaptation: Array) -> tuple[Array, Array]:
        d_x, d_z = change(padded, adaptation)
        return pad(x + fraction * per_rise * d_x), z + fraction * per_adaptation * d_z

    x, z = state.potential, state.adaptation
    x1, z1 = stage(1 / 2, pad(x), z)
    x2, z2 = stage(1 / 2, x1, z1)
    x3, z3 = stage(1, x2, z2)
    d_x, d_z = change(x3, z3)
    x1, x2, x3 = map(rows, (x1, x2, x3))
    return MatsuokaState(
        (1 / 3) * (x1 + 2 * x2 + x3 - x) + per_rise / 6 * d_x,
        (1 / 3) * (z1 + 2 * z2 + z3 - z) + per_adaptation / 6 * d_z,
    )
