"""Chains of oscillators, each the child of the oscillator before it."""

import dataclasses
import itertools
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from evo_cpg.control.couplings import explicit_weights
from evo_cpg.control.matsuoka import CpgSettings, build_network, inhibition_matrix, parts
from evo_cpg.creature.tree import Tree

# Axes count as perpendicular if the cosine of their angle is less.
_SQUARE = 1e-6


class OscillatorChain(NamedTuple):
    """Oscillators of one axis. Each is the child of the oscillator before it, which inhibits it.

    Attributes:
        name: name of the first degree of freedom, and number of followers.
        oscillators: oscillators from head to tail.
        part: all oscillators connected to the chain, directly or not, if neighbours are coupled.
        sides: sign for each pair of neighbours. 1: they inhibit opposite sides, and swing together
            except for the lag. -1: they inhibit the same side, and swing in opposition.
    """

    name: str
    oscillators: tuple[int, ...]
    part: tuple[int, ...]
    sides: Float[np.ndarray, " gaps"]


def chains(tree: Tree, settings: CpgSettings) -> list[OscillatorChain]:
    """Return all maximal chains, the longest first, then in the order of the bodies."""
    down = CpgSettings(pair_weight=1.0, child_weight=0.0, opposite=settings.opposite)
    links = inhibition_matrix(tree, down) - np.eye(tree.dof_count)
    for place in explicit_weights(tree, settings.couplings, settings.rings):
        # An explicit weight in the settings replaces the coupling from the parent.
        links[place] = 0
    # Treat neighbours as coupled, whatever the present settings.
    coupled = dataclasses.replace(settings, pair_weight=1.0, parent_weight=1.0, child_weight=1.0)
    joined = parts(build_network(tree, coupled))
    found = []
    for last in np.flatnonzero(~links.any(0)):
        path = [int(last)]
        while links[path[0]].any():
            path.insert(0, int(links[path[0]].nonzero()[0][0]))
        part = next(part for part in joined if path[0] in part)
        found.append(
            OscillatorChain(
                name=tree.dof_names[path[0]] + (f" + {len(path) - 1}" if path[1:] else ""),
                oscillators=tuple(path),
                part=part,
                sides=np.array([links[b, a] for a, b in itertools.pairwise(path)]),
            )
        )
    return sorted(found, key=lambda chain: (-len(chain.oscillators), chain.oscillators[0]))


def joint_rows(tree: Tree) -> list[tuple[int, ...]]:
    """Return the degrees of freedom of each chain of a creature, whatever couples its oscillators.

    These are the chains of oscillators with default settings.
    """
    return [chain.oscillators for chain in chains(tree, CpgSettings())]


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
