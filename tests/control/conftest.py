"""Creatures for the tests of controllers, which all run in double precision."""

import jax
import pytest

from evo_cpg.creature.creature import Actuator, Body, Creature, Joint, Material
from evo_cpg.creature.shapes import Box
from evo_cpg.creature.tree import Tree, build_tree

# A capital letter is the axis in the opposite direction.
UNIT = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0), "Z": (0.0, 0.0, -1.0)}


@pytest.fixture(autouse=True)
def double_precision():
    """Every test of the controller runs in float64."""
    with jax.enable_x64(True):
        yield


@pytest.fixture(scope="session")
def grow():
    """Function that builds a tree from ``{body: (parent, axes)}``, ``(None, "")`` for the root."""
    return grow_tree


@pytest.fixture(scope="session")
def chain():
    """Function that builds a chain from a number of bodies and the axes of each joint."""

    def build(bodies: int, axes: str) -> Tree:
        plan = {f"b{i}": (f"b{i - 1}", axes) for i in range(1, bodies)}
        return grow_tree({"b0": (None, "")} | plan)

    return build


def grow_tree(plan: dict[str, tuple[str | None, str]]) -> Tree:
    """Return the tree of a creature of equal boxes."""
    bodies = []
    for name, (parent, axes) in plan.items():
        joint = None
        if parent is not None:
            joint = Joint(
                parent=parent,
                parent_anchor=(-0.11, 0.0, 0.0),
                child_anchor=(0.11, 0.0, 0.0),
                axes=tuple(UNIT[axis] for axis in axes),
                lower=(-1.0,) * len(axes),
                upper=(1.0,) * len(axes),
                actuator=Actuator(gain=1.0),
            )
        bodies.append(Body(name, Box((0.2, 0.1, 0.1)), Material(1000.0), joint))
    return build_tree(Creature("test", tuple(bodies)))
