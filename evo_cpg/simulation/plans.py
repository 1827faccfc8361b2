"""Programs that serve all animals of one plan. Worlds of one plan differ only in numbers.

A trial has its numbers as constants, which makes it fast. Programs that run once per animal, such
as the search for its initial pose, take the numbers as arguments. They are compiled once per plan.
"""

from collections.abc import Callable
from typing import Any, Generic, NamedTuple, TypeVar

import jax
import numpy as np
from jaxtyping import Array

from evo_cpg.creature.algebra.numerics import TABLES, is_number
from evo_cpg.physics.step.world import World

_Program = TypeVar("_Program")

# Largest number of programs that one `Programs` keeps.
_MOST = 8


class WorldPlan:
    """Common part of worlds that differ only in numbers."""

    def __init__(self, world: World):
        leaves, self._layout = jax.tree_util.tree_flatten_with_path(world)
        self._count = len(leaves)
        # Leaves that are not numbers are fixed.
        self._fixed = {i: leaf for i, (path, leaf) in enumerate(leaves) if not _varies(path, leaf)}

    def numbers(self, world: World) -> list[Any]:
        """Return the numbers of a world of this plan."""
        leaves = jax.tree.leaves(world)
        return [leaf for i, leaf in enumerate(leaves) if i not in self._fixed]

    def world(self, numbers: list[Array]) -> World:
        """Return the world with these numbers, which may be traced."""
        others = iter(numbers)
        every = [self._fixed[i] if i in self._fixed else next(others) for i in range(self._count)]
        return jax.tree.unflatten(self._layout, every)

    def is_of(self, world: World) -> bool:
        """Return whether a world has this plan."""
        leaves, layout = jax.tree_util.tree_flatten_with_path(world)
        return layout == self._layout and all(
            np.array_equal(self._fixed[i], leaf) if i in self._fixed else _varies(path, leaf)
            for i, (path, leaf) in enumerate(leaves)
        )


class _Made(NamedTuple):
    """A program with the plan and settings that it was made for."""

    plan: WorldPlan
    settings: tuple[Any, ...]
    program: Any


class Programs(Generic[_Program]):
    """Programs of one function, one for each plan and settings. The last used ones are kept.

    A function makes each program from its plan and settings (arrays and numbers).
    """

    def __init__(self, make: Callable[..., _Program]):
        self._make, self.kept = make, []

    def of(self, world: World, *settings: Any) -> tuple[_Program, list[Any]]:
        """Return the program for a world, and the world's numbers."""
        for i, made in enumerate(self.kept):
            if made.plan.is_of(world) and all(map(np.array_equal, made.settings, settings)):
                self.kept.append(self.kept.pop(i))
                return made.program, made.plan.numbers(world)
        plan = WorldPlan(world)
        self.kept.append(_Made(plan, settings, self._make(plan, *settings)))
        del self.kept[:-_MOST]
        return self.kept[-1].program, plan.numbers(world)


def _varies(path: tuple[Any, ...], leaf: Any) -> bool:
    return is_number(leaf) and getattr(path[-1], "name", None) not in TABLES
