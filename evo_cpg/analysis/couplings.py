"""Oscillators of a chain as a function of three unknowns: b and the couplings between bodies.

    x = log(b, s, r)

with the adaptation gain b, the stronger coupling s between neighbours, and the ratio r of the
weaker coupling to the stronger one. The stronger coupling is ``parent_weight`` for a wave from head
to tail, and ``child_weight`` for a wave from tail to head.
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

# Bounds of b, s and r. Beyond them waves are irregular (r near 1: equal couplings make no wave),
# recover slowly (r near 0) or are faint (large b).
GAINS, STRONGER, RATIOS = (1.0, 20.0), (0.5, 2.0), (0.05, 0.5)


class Problem(eqx.Module):
    """Inputs for the search of unknowns x that give a chain a desired lag.

    Attributes:
        template: network of all oscillators connected to the chain. `network_at` replaces its
            couplings between bodies.
        parts: three pairs of ``weights`` and ``own_weights`` of this network. The first pair has no
            couplings between bodies. The second is what a stronger coupling of 1 adds, and the
            third what a weaker coupling of 1 adds.
        head_to_tail: whether ``parent_weight`` is the stronger coupling.
        drive: sum of tonic input and sensory feedback of each neuron.
        chain: places of the chain's oscillators in the network.
        sides: 1 if neighbours inhibit opposite sides, -1 if they inhibit the same side.
        present: unknowns x0 of the present settings.
        free: 1 for unknowns that may change, else 0.
        bounds: lower and upper bounds of x.
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
    """Set up the problem of a chain.

    Args:
        tree: the creature.
        settings: present settings.
        chain: chain whose lag is computed.
        gain: present value of b.
        head_to_tail: whether the wave runs from head to tail.
        hold_gain: whether b is fixed.
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
        drive=np.full((2, len(part)), settings.max_tonic_input + settings.constant_input),
        chain=chain.places,
        sides=chain.sides,
        present=present,
        free=np.array([0.0 if hold_gain else 1.0, 1.0, 1.0]),
        bounds=np.array([low, high]),
    )


def network_at(problem: Problem, x: Array) -> tuple[MatsuokaNetwork, Array]:
    """Return the chain's network with the couplings of x, and b of each oscillator."""
    gain, stronger, ratio = jnp.exp(x)
    weights = [
        none + stronger * (one + ratio * other)
        for none, one, other in zip(*problem.parts, strict=True)
    ]
    network = eqx.tree_at(lambda n: (n.weights, n.own_weights), problem.template, weights)
    return network, jnp.full(problem.drive.shape[1], gain)
