"""Estimate the number of operations in the native code of a trial, without compiling it.

Every scalar of a control step becomes one operation, and the code of each limb is written out, even
for equal limbs (`evo_cpg.fusion`). The number of operations grows with the creature, and the
compile time with that number. The code of a loop contains one round only, so the numbers of steps
and individuals do not count.

The weights are fitted to the true numbers of the shipped creatures and of random creatures with 2
to 100 bodies, on land and in water.
"""

from typing import NamedTuple

import numpy as np

from evo_cpg.creature.reach import chain_to_root
from evo_cpg.creature.tree import Tree
from evo_cpg.physics.contact_model import CORNERS, ContactModel
from evo_cpg.physics.pairs import KINDS, Pairs
from evo_cpg.physics.step import needs_iteration
from evo_cpg.physics.terrain import Plane
from evo_cpg.simulation.simulation import Simulation

# Operations for each item that `_counts` counts.
_WEIGHTS = {
    "bodies": {"body": 340.0, "axis": 300.0},
    "limits": {"axis": 340.0, "axis below axis": 30.0},
    "ground": {
        "body": 400.0,
        "box": 2000.0,
        "mesh": 2400.0,
        "corner of a mesh": 45.0,
        "ball": 440.0,
        "ellipsoid": 500.0,
        "point on uneven floor": 420.0,
    },
    "obstacles": {
        "box": 1500.0,
        "capsule": 820.0,
        "ball": 500.0,
        "ellipsoid": 880.0,
        "mesh": 2400.0,
        "corner of a mesh": 45.0,
    },
    "pairs": {
        "lines": 470.0,
        "flat": 420.0,
        "boxes": 1750.0,
        "line and box": 1000.0,
        "rounded": 620.0,
        "axis of a point": 23.0,
        "two axes of a point": 2.5,
    },
    "looped pairs": {"any": 12_700.0, "kind": 2900.0, "two axes": 22.0},
    "brain": {"gene": 1.9},
    "noise": {"any": 6300.0},
}


class Operations(NamedTuple):
    """Approximate numbers of operations in a trial, by cause.

    Attributes:
        bodies: bodies and their joints.
        ground: contact with the floor.
        obstacles: contact with obstacles on the floor.
        pairs: contact between bodies.
        water: all force laws, those of water and any others.
        controller: nervous system.
        noise: noise.
    """

    bodies: float
    ground: float
    obstacles: float
    pairs: float
    water: float
    controller: float
    noise: float

    @property
    def total(self) -> float:
        """Number of operations in the whole trial."""
        return sum(self)


def estimate_operations(simulation: Simulation) -> Operations:
    """Estimate the operations of a trial."""
    parts = {
        part: sum(_WEIGHTS[part][name] * count for name, count in counts.items())
        for part, counts in _counts(simulation).items()
    }
    return Operations(
        parts["bodies"] + parts["limits"],
        parts["ground"],
        parts["obstacles"],
        parts["pairs"] + parts["looped pairs"],
        sum(law.operations() for law in simulation.world.forces),
        parts["brain"],
        parts["noise"],
    )


def _counts(simulation: Simulation) -> dict[str, dict[str, float]]:
    """Count the items that need operations."""
    world, tree = simulation.world, simulation.world.tree
    axes = tree.dof_count
    chains = [set(chain_to_root(tree, body)) for body in range(tree.body_count)]
    below = sum(other in chains[one] for one in tree.dof_bodies for other in tree.dof_bodies)
    return {
        "bodies": {"body": tree.body_count, "axis": axes},
        "limits": {"axis": axes, "axis below axis": below} if needs_iteration(world) else {},
        "ground": {} if world.contact_model is None else _on_ground(tree, world.contact_model),
        "obstacles": {} if world.contact_model is None else _at_obstacles(world.contact_model),
        "pairs": {} if world.pairs is None else _of_pairs(tree, chains, world.pairs),
        "looped pairs": {} if world.pairs is None else _of_loops(tree, chains, world.pairs),
        "brain": {"gene": simulation.controller.gene_count},
        "noise": {"any": not simulation.noise.silent},
    }


def _on_ground(tree: Tree, contact_model: ContactModel) -> dict[str, float]:
    meshes = contact_model.meshes.shape[-1]
    # A cylinder has as many points as a box.
    boxes = contact_model.boxes.shape[-1] + contact_model.cylinders.shape[-1]
    balls, ellipsoids = contact_model.radii.shape[-1], contact_model.semi_axes.shape[-1]
    points = CORNERS * (boxes + meshes) + balls + ellipsoids
    return {
        "body": tree.body_count,
        "box": boxes,
        **_of_meshes(contact_model),
        "ball": balls,
        "ellipsoid": ellipsoids,
        "point on uneven floor": 0 if isinstance(contact_model.ground.floor, Plane) else points,
    }


def _at_obstacles(contact_model: ContactModel) -> dict[str, float]:
    if contact_model.solids is None:
        return {}
    boxes, lines, balls, ellipsoids, _ = contact_model.solids
    kinds = {"box": boxes, "capsule": lines, "ball": balls, "ellipsoid": ellipsoids}
    count = len(contact_model.ground.obstacles)
    found = {name: count * len(parts.bodies) for name, parts in kinds.items()}
    return found | _of_meshes(contact_model)


def _of_meshes(contact_model: ContactModel) -> dict[str, float]:
    _, corners, meshes = contact_model.meshes.shape
    return {"mesh": meshes, "corner of a mesh": corners * meshes}


def _of_pairs(tree: Tree, chains: list[set[int]], pairs: Pairs) -> dict[str, float]:
    """Count the items whose code is written out for each pair of bodies."""
    if pairs.looped:
        return {}
    axes = np.array([_between(tree, chains, *pair) for pair in zip(*pairs.owners, strict=True)])
    counts: dict[str, float] = {name: 0 for name in KINDS}
    for run in pairs.runs:
        counts[run.kind] += run.count
    return counts | {"axis of a point": axes.sum(), "two axes of a point": (axes**2).sum()}


def _of_loops(tree: Tree, chains: list[set[int]], pairs: Pairs) -> dict[str, float]:
    """Count the items in loops over pairs: one round for each kind."""
    if not pairs.looped:
        return {}
    longest = max(
        _between(tree, chains, *pair) for pair in zip(pairs.first, pairs.second, strict=True)
    )
    kinds = len(pairs.runs)
    return {"any": 1, "kind": kinds, "two axes": kinds * longest**2}


def _between(tree: Tree, chains: list[set[int]], first: int, second: int) -> int:
    """Count the joint axes between two bodies."""
    between = chains[first] ^ chains[second]
    return sum(body in between for body in tree.dof_bodies)
