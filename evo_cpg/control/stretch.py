"""StretchSense of the body's two sides, felt by the oscillators.

The extensor of an oscillator pulls its joint to positive angles. At an angle q > 0 the extensor's
side of the joint is short, and the flexor's side is stretched:

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
"""

import dataclasses

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.control.afferent import (
    Delay,
    Gain,
    MakeGain,
    Weight,
    check_delay,
    check_weights,
    make_delay,
    spread,
)
from evo_cpg.control.couplings import axis_directions, axis_parents, listed_oscillators
from evo_cpg.creature.algebra.numerics import Numbers
from evo_cpg.creature.tree import Tree


@dataclasses.dataclass(frozen=True)
class StretchFeedback:
    """StretchSense of joints, which enters their oscillators and those of neighbours.

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
        check_weights(self, "angle_weight", "rate_weight")
        check_delay(self.delay)
        for name in ("from_parents", "from_children"):
            if not getattr(self, name) >= 0:
                raise ValueError(f"{name} must not be negative, got {getattr(self, name)}")


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
        """Return s_f of eq. 1 before the delay, in units of u_max.

        Args:
            genes: genes of the feedback, or None if no weight evolves.
            joint_angle: joint angles, rad.
            joint_rate: joint rates, rad/s.
        """
        angle = self.angle_weight.times(joint_angle, genes)
        return spread(self.offsets, self.rows, angle + self.rate_weight.times(joint_rate, genes))


def build_stretch(
    tree: Tree, settings: StretchFeedback, number: int, gain: MakeGain, control_step: float
) -> StretchSense:
    """Build one sense of stretch for a creature's tree.

    Args:
        tree: the creature.
        settings: settings.
        number: index of the settings in their list, for messages.
        gain: builds the gain of a weight.
        control_step: time between two samples, s.

    Raises:
        CouplingError: the creature lacks a joint that the settings name.
    """
    offsets, rows = _spread(tree, settings, number)
    gains = gain(settings.angle_weight), gain(settings.rate_weight)
    return StretchSense(*gains, offsets, rows, make_delay(settings.delay, control_step))


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
