"""Chains of oscillators: from a first one to its child's, and on to the last."""

import dataclasses
import itertools
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from evo_cpg.analysis.limit_cycle import parts
from evo_cpg.control.couplings import explicit_weights
from evo_cpg.control.matsuoka import CpgSettings, build_network, inhibition_matrix
from evo_cpg.creature.tree import Tree
from evo_cpg.simulation.simulation import Simulation

# Axes are square to each other if the cosine of their angle is less.
_SQUARE = 1e-6


class Chain(NamedTuple):
    """Oscillators of one axis, each inhibited by the one before it as by its parent.

    Attributes:
        name: of its first degree of freedom, and how many follow.
        oscillators: from head to tail.
        part: all oscillators that are joined to it, directly or not, where neighbours are coupled.
        places: of the chain's in the part.
        sides: of each gap, 1 where neighbours inhibit each other's other side, so that they swing
            together but for the lag, and -1 where their own, so that they swing against each other.
    """

    name: str
    oscillators: tuple[int, ...]
    part: tuple[int, ...]
    places: tuple[int, ...]
    sides: Float[np.ndarray, " gaps"]


def chains(tree: Tree, settings: CpgSettings) -> list[Chain]:
    """All chains that cannot be made longer; the longest first, else in the order of the bodies."""
    down = CpgSettings(pair_weight=1.0, child_weight=0.0, opposite=settings.opposite)
    links = inhibition_matrix(tree, down) - np.eye(tree.dof_count)
    for place in explicit_weights(tree, settings.couplings, settings.rings):
        # Something else is written in the place of the parent's coupling.
        links[place] = 0
    # Whether neighbours are coupled at present or not.
    coupled = dataclasses.replace(settings, pair_weight=1.0, parent_weight=1.0, child_weight=1.0)
    joined = parts(build_network(tree, coupled))
    found = []
    for last in np.flatnonzero(~links.any(0)):
        path = [int(last)]
        while links[path[0]].any():
            path.insert(0, int(links[path[0]].nonzero()[0][0]))
        part = next(part for part in joined if path[0] in part)
        found.append(
            Chain(
                name=tree.dof_names[path[0]] + (f" + {len(path) - 1}" if path[1:] else ""),
                oscillators=tuple(path),
                part=part,
                places=tuple(map(part.index, path)),
                sides=np.array([links[b, a] for a, b in itertools.pairwise(path)]),
            )
        )
    return sorted(found, key=lambda chain: (-len(chain.oscillators), chain.oscillators[0]))


def joint_rows(simulation: Simulation) -> list[tuple[int, ...]]:
    """The degrees of freedom of each of `chains`; as by default if there are no oscillators."""
    oscillators = simulation.controller.rhythm_generator
    settings = CpgSettings() if oscillators is None else oscillators.settings
    return [chain.oscillators for chain in chains(simulation.world.tree, settings)]


def axis_signs(tree: Tree, rows: Iterable[Sequence[int]]) -> Float[np.ndarray, " d"]:
    """Signs with which the angles of joints in a row are about the same direction.

    -1 where, in the neutral pose, an axis points against that of the first of its row; 1 elsewhere,
    also where it is square to it.

    Args:
        tree: the creature.
        rows: degrees of freedom along a body, such as `joint_rows`, which share none but with rows
            that begin with the same one.
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
