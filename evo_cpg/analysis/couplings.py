"""The oscillators of a chain as a function of three unknowns: b and the couplings between bodies.

    x = log(b, s, r)

with the adaptation gain b, the stronger of the two couplings between neighbours s, and the weaker
in units of it, r. The wave runs away from the stronger: that is ``parent_weight`` where it runs
from head to tail and ``child_weight`` where it runs the other way.
"""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from evo_cpg.analysis.chains import Chain
from evo_cpg.control.matsuoka import (
    CpgSettings,
    MatsuokaNetwork,
    build_network,
    diagonal,
    inhibition_matrix,
    sub_network,
)
from evo_cpg.creature.tree import Tree

# Bounds of b, s and r. Beyond them there are waves that are ragged (r near 1: neighbours that are
# equally strong make none), take long to recover (r near 0) or are faint (large b).
GAINS, STRONGER, RATIOS = (1.0, 20.0), (0.5, 2.0), (0.05, 0.5)


class Problem(eqx.Module):
    """What the lag depends on, but for the unknowns.

    Attributes:
        template: the part with any couplings.
        parts: its ``weights`` and ``own_weights`` without couplings between bodies, what the
            stronger coupling adds when it is 1, and what the weaker adds.
        head_to_tail: whether the parent's coupling is the stronger.
        drive: tonic input and sensory feedback of each neuron.
        chain: places of its oscillators in the part.
        sides: 1 where neighbours inhibit each other's other side, -1 where their own.
        present: x0.
        free: 1 for the unknowns that may change, else 0.
        bounds: of x, lowest first.
    """

    template: MatsuokaNetwork
    parts: tuple[tuple[np.ndarray, ...], ...]
    head_to_tail: bool
    drive: np.ndarray
    chain: tuple[int, ...] = eqx.field(static=True)
    sides: np.ndarray
    present: np.ndarray
    free: np.ndarray
    bounds: np.ndarray


def problem_of(
    tree: Tree,
    settings: CpgSettings,
    chain: Chain,
    gain: float,
    head_to_tail: bool,
    hold_gain: bool,
) -> Problem:
    """State the problem.

    Args:
        tree: the creature.
        settings: at present.
        chain: whose lag is meant.
        gain: b at present.
        head_to_tail: which way the wave is to run.
        hold_gain: b is no unknown.
    """
    part = list(chain.part)
    template = sub_network(
        build_network(tree, dataclasses.replace(settings, parent_weight=1.0, child_weight=1.0)),
        chain.part,
    )

    def weights(parent: float, child: float) -> tuple[np.ndarray, np.ndarray]:
        these = dataclasses.replace(settings, parent_weight=parent, child_weight=child)
        matrix = inhibition_matrix(tree, these)[np.ix_(part, part)]
        rows = [
            [diagonal(np.maximum(sign * matrix, 0), offset) for offset in offsets]
            for sign, offsets in ((1, template.offsets), (-1, template.own_offsets))
        ]
        return np.reshape(rows[0], (-1, len(part))), np.reshape(rows[1], (-1, len(part)))

    none = weights(0.0, 0.0)
    added = [
        tuple(one - zero for one, zero in zip(weights(*which), none, strict=True))
        for which in ((1.0, 0.0), (0.0, 1.0))
    ]
    low, high = np.log([GAINS, STRONGER, RATIOS]).T
    pair = np.array([settings.parent_weight, settings.child_weight])
    stronger = max(pair.max(), STRONGER[0])
    present = np.clip(np.log([gain, stronger, max(pair.min() / stronger, RATIOS[0])]), low, high)
    if hold_gain:
        present[0] = low[0] = high[0] = np.log(gain)
    return Problem(
        template=template,
        parts=(none, *(added if head_to_tail else added[::-1])),
        head_to_tail=head_to_tail,
        drive=np.full((2, len(part)), settings.max_tonic_input + settings.sensory_feedback),
        chain=chain.places,
        sides=chain.sides,
        present=present,
        free=np.array([0.0 if hold_gain else 1.0, 1.0, 1.0]),
        bounds=np.array([low, high]),
    )


def network_at(problem: Problem, x: Array) -> tuple[MatsuokaNetwork, Array]:
    """The part with the couplings of x, and b of each oscillator."""
    gain, stronger, ratio = jnp.exp(x)
    weights = [
        none + stronger * (one + ratio * other)
        for none, one, other in zip(*problem.parts, strict=True)
    ]
    network = eqx.tree_at(lambda n: (n.weights, n.own_weights), problem.template, weights)
    return network, jnp.full(problem.drive.shape[1], gain)
