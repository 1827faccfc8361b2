"""One oscillator for each joint axis, coupled along the tree, without a brain.

Each axis has an oscillator of two Matsuoka neurons (`evo_cpg.control.matsuoka`), with genes of its
own. All axes of a limb receive the firing of the limb's *driver*: the first axis of the nearest
joint towards the root, so that a rhythm travels from limb to limb. With the driver's firing y_d and
the neuron i opposite to j:

    T_r dx_i/dt + x_i = -a y_j - w_+ y_dj - w_- y_di - b z_i + u_i,    T_a dz_i/dt + z_i = y_i,

where w_+ and w_- are the positive and the negative part of w. A positive w makes a wave, a negative
w makes the limb follow its driver. Genes g from 0 to 1 set the numbers of an axis (`GENES`):

| gene | sets |
|---|---|
| amplitude | u = u_max g |
| period | b = b_min + (b_max - b_min) g |
| coupling | w = w_max (2 g - 1) |
| steering | d = d_max (2 g - 1): u_e = u (1 + d), u_f = u (1 - d) |
| start | initial x of the extensor, 0.1 u_max g, and of the flexor, 0.1 u_max (1 - g) |

The parents of bodies may differ between individuals (`evo_cpg.creature.walk`).
"""

import dataclasses
import math
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float
from typing_extensions import override

from evo_cpg.control.controller import Command, Controller, Observation
from evo_cpg.control.matsuoka import (
    INITIAL_FRACTION,
    SUBSTEP_FRACTION,
    TIME_CONSTANTS,
    MatsuokaState,
    output,
)
from evo_cpg.creature.per_body import in_dof_order, of_joints
from evo_cpg.creature.tree import Tree
from evo_cpg.creature.walked import outwards

GENES = ("amplitude", "period", "coupling", "steering", "start")
"""Names of the genes of each joint axis."""

# Inhibition between the two neurons of an axis. A pair alone keeps its rhythm above 1.13
# (docs/models/controller.md), and the value of Iwadate 2010, 1.07, lets limbs on the root stop.
_PAIR_WEIGHT = 1.5


@dataclasses.dataclass(frozen=True)
class LimbOscillatorSettings:
    """Settings of the limb oscillators.

    Attributes:
        time_scale: factor on the time constants T_r and T_a, more than 0.
        max_tonic_input: u_max, more than 0.
        min_adaptation_gain: b_min, more than 0.
        max_adaptation_gain: b_max.
        max_coupling: w_max, at least 0.
        steering_range: d_max, 0 to 1.
        rate_gain: joint rate per unit of output, rad/s. Muscles ignore it.
        centring: rate at which a joint returns to its neutral angle, 1/s. Muscles ignore it.
        max_rate: largest commanded rate of a motor, rad/s, more than 0.

    Raises:
        ValueError: a value is outside its range.
    """

    time_scale: float = 1.0
    max_tonic_input: float = 1.0
    min_adaptation_gain: float = 1.0
    max_adaptation_gain: float = 10.0
    max_coupling: float = 2.0
    steering_range: float = 0.5
    rate_gain: float = 5.0
    centring: float = 1.0
    max_rate: float = 5.0

    def __post_init__(self):
        for name in ("time_scale", "max_tonic_input", "min_adaptation_gain", "max_rate"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} must be positive, got {getattr(self, name)}")
        for name in ("max_coupling", "rate_gain", "centring"):
            if not getattr(self, name) >= 0:
                raise ValueError(f"{name} must not be negative, got {getattr(self, name)}")
        if not self.max_adaptation_gain >= self.min_adaptation_gain:
            raise ValueError(
                f"max_adaptation_gain ({self.max_adaptation_gain}) must not be smaller than "
                f"min_adaptation_gain ({self.min_adaptation_gain})"
            )
        if not 0 <= self.steering_range <= 1:
            raise ValueError(f"steering_range must be from 0 to 1, got {self.steering_range}")


class LimbRhythm(NamedTuple):
    """Decoded genes: numbers of every oscillator, ``(2, d, *n)`` (extensors first) or ``(d, *n)``.

    Attributes:
        tonic_input: u of each neuron.
        adaptation_gain: b.
        coupling: w.
        start: initial potentials x.
    """

    tonic_input: Array
    adaptation_gain: Array
    coupling: Array
    start: Array


class LimbState(MatsuokaState):
    """State of the neurons, and whether the trial has started, ``(*n)``."""

    started: Array


class LimbOscillators(Controller):
    """Limb oscillators of one creature. A genome has five genes for each degree of freedom.

    The genes of one kind are next to each other, in the order of `GENES`.

    Attributes:
        tree: the creature.
        settings: settings of the oscillators.
        control_step: length of a control step, s.
    """

    tree: Tree
    settings: LimbOscillatorSettings = eqx.field(static=True)
    control_step: float = eqx.field(static=True)
    gene_count: int = eqx.field(static=True)

    uses_senses = False
    signal_label = "CPG output (no unit)"

    @override
    def random_genes(
        self, key: Array, batch: tuple[int, ...], dtype: jnp.dtype | type
    ) -> Float[Array, "g *n"]:
        return jax.random.uniform(key, (self.gene_count, *batch), dtype)

    @override
    def initial_state(self, batch: tuple[int, ...], dtype: jnp.dtype | type) -> LimbState:
        rest = jnp.zeros((2, self.tree.dof_count, *batch), dtype)
        return LimbState(rest, rest, jnp.zeros(batch, bool))

    @override
    def decode(self, genes: Float[Array, "g *n"]) -> LimbRhythm:
        own = self.settings
        every = jnp.clip(genes, 0.0, 1.0).reshape(len(GENES), -1, *genes.shape[1:])
        amplitude, period, coupling, steering, start = every
        tonic = own.max_tonic_input * amplitude
        turn = own.steering_range * (2.0 * steering - 1.0)
        span = own.max_adaptation_gain - own.min_adaptation_gain
        first = INITIAL_FRACTION * own.max_tonic_input
        return LimbRhythm(
            jnp.stack([tonic * (1.0 + turn), tonic * (1.0 - turn)]),
            own.min_adaptation_gain + span * period,
            own.max_coupling * (2.0 * coupling - 1.0),
            jnp.stack([first * start, first * (1.0 - start)]),
        )

    @override
    def act(
        self, decoded: LimbRhythm, state: LimbState, observation: Observation
    ) -> tuple[LimbState, Command]:
        """Advance the rhythm by one control step, and command motors and muscles."""
        own, x = self.settings, jnp.where(state.started, state.potential, decoded.start)
        moved = self.advanced(decoded, dataclasses.replace(state, potential=x))
        x = moved.potential
        signal = output(moved)
        rate = own.rate_gain * signal - own.centring * observation.joint_angle
        active = None
        if self.tree.muscles is not None:
            active = jnp.minimum(jnp.maximum(x, 0.0) * (1.0 / own.max_tonic_input), 1.0)
        return moved, Command(jnp.clip(rate, -own.max_rate, own.max_rate), signal, None, active)

    def advanced(self, decoded: LimbRhythm, state: LimbState) -> LimbState:
        """Return the neurons after one control step, in classical Runge-Kutta steps."""
        rise, adaptation = (self.settings.time_scale * time for time in TIME_CONSTANTS["swapped"])
        count = max(1, math.ceil(self.control_step / (SUBSTEP_FRACTION * min(rise, adaptation))))
        x, z, h = state.potential, state.adaptation, self.control_step / count

        def change(x: Array, z: Array) -> tuple[Array, Array]:
            firing = jnp.maximum(x, 0.0)
            felt = self._received(firing)
            inhibition = _PAIR_WEIGHT * firing[::-1]
            inhibition = inhibition + jnp.maximum(decoded.coupling, 0.0)[None] * felt[::-1]
            inhibition = inhibition + jnp.maximum(-decoded.coupling, 0.0)[None] * felt
            excess = decoded.tonic_input - x - inhibition - decoded.adaptation_gain[None] * z
            return excess / rise, (firing - z) / adaptation

        for _ in range(count):
            first = change(x, z)
            second = change(x + 0.5 * h * first[0], z + 0.5 * h * first[1])
            third = change(x + 0.5 * h * second[0], z + 0.5 * h * second[1])
            last = change(x + h * third[0], z + h * third[1])
            x, z = (
                old + h / 6 * (a + 2 * b + 2 * c + d)
                for old, a, b, c, d in zip((x, z), first, second, third, last, strict=True)
            )
        return LimbState(x, z, jnp.ones_like(state.started))

    def _received(self, firing: Float[Array, "2 d *n"]) -> Float[Array, "2 d *n"]:
        """Return the firing of the driver of each axis, 0 for a limb on the root."""
        tree, ndim = self.tree, firing.ndim - 2
        none = jnp.zeros_like(firing[:, 0])
        bodies, received = outwards(tree, none, ndim), []
        if tree.hanging is not None:
            received.append(jnp.zeros_like(firing[:, tree.hanging.dofs]))
        for group in tree.groups:
            driver = bodies.of_parents(group)
            shape = (2, group.axes, *driver.shape[1:])
            received.append(in_dof_order(jnp.broadcast_to(driver[:, None], shape), ndim))
            own = of_joints(firing, group, ndim)
            for axis in reversed(range(group.axes)):
                driver = self._first(group.dofs.start + axis, own[:, axis], driver)
            bodies = bodies.followed_by(driver)
        return jnp.concatenate([firing[:, :0], *received], 1)

    def _first(self, dof: int, own: Array, other: Array) -> Array:
        """Return the firing of an axis, or the other firing where the axis is absent."""
        walk = self.tree.walk
        return own if walk is None else jnp.where(jnp.abs(walk.turns[dof]) > 0, own, other)


def build_limb_oscillators(
    tree: Tree, settings: LimbOscillatorSettings, control_step: float
) -> LimbOscillators:
    """Build the controller for a creature's tree.

    Raises:
        ValueError: the creature has no joint.
    """
    if not tree.dof_count:
        raise ValueError("the controller needs a creature with at least one joint")
    count = len(GENES) * tree.dof_count
    return LimbOscillators(
        tree=tree, settings=settings, control_step=control_step, gene_count=count
    )
