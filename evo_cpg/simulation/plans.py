"""Programs that serve all animals of one plan: worlds that differ in numbers alone.

A trial has its numbers as constants, which makes it fast. What is computed once per animal, such as
where it stands at the start, takes them as arguments instead, and is compiled once for them all.
"""

from collections.abc import Callable
from typing import Any, Generic, NamedTuple, TypeVar

import jax
import numpy as np
from jaxtyping import Array

from evo_cpg.physics.world import World
from evo_cpg.spatial.numerics import TABLES, is_number

_Program = TypeVar("_Program")

# Programs of a kind that are kept.
_MOST = 8


class WorldPlan:
    """What worlds have in common that differ in numbers alone.

    Args:
        world: one of them.
    """

    def __init__(self, world: World):
        leaves, self._layout = jax.tree_util.tree_flatten_with_path(world)
        self._count = len(leaves)
        # Everything that is no number stays as it is.
        self._fixed = {i: leaf for i, (path, leaf) in enumerate(leaves) if not _varies(path, leaf)}

    def numbers(self, world: World) -> list[Any]:
        """Those of a world of this plan."""
        leaves = jax.tree.leaves(world)
        return [leaf for i, leaf in enumerate(leaves) if i not in self._fixed]

    def world(self, numbers: list[Array]) -> World:
        """The world that has these numbers, which may be traced."""
        others = iter(numbers)
        every = [self._fixed[i] if i in self._fixed else next(others) for i in range(self._count)]
        return jax.tree.unflatten(self._layout, every)

    def is_of(self, world: World) -> bool:
        """Whether a world has this plan."""
        leaves, layout = jax.tree_util.tree_flatten_with_path(world)
        return layout == self._layout and all(
            np.array_equal(self._fixed[i], leaf) if i in self._fixed else _varies(path, leaf)
            for i, (path, leaf) in enumerate(leaves)
        )


class _Made(NamedTuple):
    """A program with what it was made for."""

    plan: WorldPlan
    settings: tuple[Any, ...]
    program: Any


class Programs(Generic[_Program]):
    """Programs of a kind, one for each plan; those that were used last are kept.

    Args:
        make: a program, for a plan and some settings.
    """

    def __init__(self, make: Callable[..., _Program]):
        self._make, self.kept = make, []

    def of(self, world: World, *settings: Any) -> tuple[_Program, list[Any]]:
        """The program for a world, and the world's numbers.

        Args:
            world: of any plan.
            settings: arrays and numbers for which it is made.
        """
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
