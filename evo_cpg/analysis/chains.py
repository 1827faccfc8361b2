"""Chains of oscillators, each the child of the oscillator before it."""

from collections.abc import Iterable, Sequence

import numpy as np
from jaxtyping import Float

from evo_cpg.control.couplings import explicit_weights
from evo_cpg.control.matsuoka import CpgSettings, inhibition_matrix
from evo_cpg.creature.tree import Tree

# Axes count as perpendicular if the cosine of their angle is less.
_SQUARE = 1e-6


def chains(tree: Tree, settings: CpgSettings) -> list[tuple[int, ...]]:
    """Return all maximal chains, the longest first, then in the order of the bodies.

    A chain has oscillators of one axis, from head to tail. Each is the child of the oscillator
    before it, which inhibits it.
    """
    down = CpgSettings(pair_weight=1.0, child_weight=0.0, opposite=settings.opposite)
    links = inhibition_matrix(tree, down) - np.eye(tree.dof_count)
    for place in explicit_weights(tree, settings.couplings, settings.rings):
        # An explicit weight in the settings replaces the coupling from the parent.
        links[place] = 0
    found = []
    for last in np.flatnonzero(~links.any(0)):
        path = [int(last)]
        while links[path[0]].any():
            path.insert(0, int(links[path[0]].nonzero()[0][0]))
        found.append(tuple(path))
    return sorted(found, key=lambda chain: (-len(chain), chain[0]))


def joint_rows(tree: Tree) -> list[tuple[int, ...]]:
    """Return the degrees of freedom of each chain of a creature, whatever couples its oscillators.

    These are the chains of oscillators with default settings.
    """
    return chains(tree, CpgSettings())


def axis_signs(tree: Tree, rows: Iterable[Sequence[int]]) -> Float[np.ndarray, " d"]:
    """Return signs that make joint angles in a row refer to one direction.

    The sign is -1 if, in the neutral pose, an axis points against the first axis of its row. It is
    1 for all other axes, also for perpendicular ones.

    Args:
        tree: the creature.
        rows: degrees of freedom along a body, such as `joint_rows`. Two rows share degrees of
            freedom only if both rows begin with the same one.
    """
    turns: list[np.ndarray] = []
    for i, parent in enumerate(tree.parents):
        own = np.asarray(tree.joint_orientation[..., i], float)
        turns.append(own if parent < 0 else turns[parent] @ own)
    pairs = zip(tree.dof_bodies, np.asarray(tree.joint_axes, float).T, strict=True)
    axes = [turns[body] @ axis for body, axis in pairs]
    signs = np.ones(tree.dof_count)
    for row in rows:
        for dof in row:
            signs[dof] = -1.0 if axes[dof] @ axes[row[0]] < -_SQUARE else 1.0
    return signs
