"""Different bodies in one program: a batch of simulations that differ only in numbers.

A number of a simulation (a mass, a size, a drag coefficient) is a constant of the compiled program.
That makes the program fast. Numbers that differ between simulations become inputs of the program,
one value for each individual. Numbers that all simulations have in common stay constant, most of
all the zeros in matrices. A compiled program also serves other bodies that differ in the same
numbers.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Float, Int

from evo_cpg.creature.algebra.numerics import MixedArray, is_number
from evo_cpg.simulation.simulation import NumberBuilder, Simulation

# Differences up to this fraction of an array's largest number are rounding errors.
_ROUNDING = 16 * np.finfo(float).eps


class LayoutError(ValueError):
    """Raised for simulations that differ in more than numbers."""


class Inputs(NamedTuple):
    """Places of the numbers of a simulation that are inputs of its program.

    Attributes:
        places: indices of the pytree leaves that contain such numbers.
        elements: for each of these leaves, flattened, indices of the numbers that are inputs.
    """

    places: tuple[int, ...]
    elements: tuple[Int[np.ndarray, " _"], ...]

    def of(self, simulation: Simulation) -> list[np.ndarray]:
        """Return the values of the inputs, leaf by leaf."""
        leaves = jax.tree.leaves(simulation)
        return [
            np.asarray(leaves[place], float).reshape(-1)[own]
            for place, own in zip(self.places, self.elements, strict=True)
        ]

    def put(self, simulation: Simulation, values: Sequence[Array]) -> Simulation:
        """Return the simulation with these inputs, which may be traced. Other numbers stay."""
        leaves, structure = jax.tree.flatten(simulation)
        for place, own, value in zip(self.places, self.elements, values, strict=True):
            known = np.asarray(leaves[place], float)
            if known.ndim and len(own) < known.size:
                leaves[place] = MixedArray(known, own, value)
            else:
                leaves[place] = value.reshape(known.shape)
        return jax.tree.unflatten(structure, leaves)


def inputs_of(builder: NumberBuilder, simulation: Simulation) -> tuple[Inputs, list[int]]:
    """Return the places of a builder's numbers in a simulation.

    A changed simulation, such as one with another task, may lack some of the leaves.

    Returns:
        The inputs, and the index of each among `NumberBuilder.inputs`.
    """
    paths = jax.tree_util.tree_flatten_with_path(simulation)[0]
    places = {jax.tree_util.keystr(path): place for place, (path, _) in enumerate(paths)}
    given = builder.inputs
    there = [i for i, (path, _) in enumerate(given) if path in places]
    found = sorted((places[given[i][0]], i) for i in there)
    inputs = Inputs(tuple(x for x, _ in found), tuple(given[i][1] for _, i in found))
    return inputs, [i for _, i in found]


class BatchedSimulation(NamedTuple):
    """Simulations that differ in some numbers, one for each individual.

    Attributes:
        common: a simulation of the same plan, for the numbers that all simulations have in common.
        inputs: the numbers that differ: `Inputs`, or of plans
            `evo_cpg.simulation.planned.PlanInputs`.
        values: values of the inputs, leaf by leaf, with the individuals on the last axis.
    """

    common: Simulation
    inputs: Any
    values: Sequence[Float[np.ndarray | Array, "_ n"]]

    def __getitem__(self, individual: int) -> Simulation:
        """Return the simulation of one individual, with all numbers known."""
        own = [np.asarray(value[:, individual]) for value in self.values]
        leaves, structure = jax.tree.flatten(self.common)
        parts = zip(self.inputs.places, self.inputs.elements, own, strict=True)
        for place, elements, value in parts:
            array = np.array(leaves[place], float, order="C")
            array.reshape(-1)[elements] = value
            leaves[place] = array if array.ndim else float(array)
        return jax.tree.unflatten(structure, leaves)

    @property
    def size(self) -> int:
        """Number of individuals."""
        return self.values[0].shape[1]


def batch(
    common: Simulation, simulations: Sequence[Simulation], like: BatchedSimulation | None = None
) -> BatchedSimulation:
    """Combine simulations into a batch.

    Args:
        common: a simulation of the same plan.
        simulations: at least one simulation. All simulations have bodies of one plan in worlds of
            one kind.
        like: a batch whose compiled program should serve these simulations too. The simulations
            must have its constants, and may differ only in its inputs.

    Raises:
        LayoutError: the simulations differ in more than numbers.
        ValueError: the simulations differ in other numbers than those of ``like``, or in none.
    """
    every = [like.common if like else common, *simulations]
    (first, structure), *others = map(jax.tree.flatten, every)
    paths = jax.tree_util.tree_leaves_with_path(every[0])
    names = [jax.tree_util.keystr(path)[1:] for path, _ in paths]
    if any(other != structure for _, other in others):
        raise LayoutError(
            "the simulations differ in more than numbers (in parts, names, joints or groups of "
            "bodies)"
        )
    differing: dict[int, np.ndarray] = {}
    for place, leaf in enumerate(first):
        theirs = [leaves[place] for leaves, _ in others]
        if any(np.shape(other) != np.shape(leaf) for other in theirs):
            raise LayoutError(f"{names[place]} has different shapes in the simulations")
        each = np.stack([np.asarray(x) for x in (leaf, *theirs)])
        if np.issubdtype(each.dtype, np.floating):
            finite = np.isfinite(each)
            largest = np.abs(each, where=finite, out=np.zeros_like(each)).max(initial=0.0)
            # isclose accepts equal infinities, such as unlimited torques.
            same = np.isclose(each, each[:1], rtol=0, atol=_ROUNDING * largest)
        else:
            same = each == each[:1]
        moves = np.any(~same, axis=0)
        if moves.any():
            if not is_number(leaf):
                raise ValueError(f"{names[place]} differs, but is not a real number")
            differing[place] = np.flatnonzero(moves)
    if not (like or differing):
        raise ValueError("all simulations equal the configuration")
    inputs = like.inputs if like else Inputs(tuple(differing), tuple(differing.values()))
    allowed = dict(zip(inputs.places, inputs.elements, strict=True))
    for place, elements in differing.items():
        if not np.isin(elements, allowed.get(place, ())).all():
            raise ValueError(f"{names[place]} differs, but is not an input of the program")
    values = zip(*(inputs.of(simulation) for simulation in simulations), strict=True)
    return BatchedSimulation(every[0], inputs, tuple(np.stack(each, axis=-1) for each in values))
