"""Every kernel of a step is small enough for LLVM to inline and vectorise, whatever the body."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from creatures import STRUCTURES, box_chain, in_water, random_creature
from evo_cpg.creature.creature import Actuator
from evo_cpg.fusion import kernels, schedule
from evo_cpg.physics.state import resting_state
from evo_cpg.physics.step import step

# LLVM inlines a function with one caller up to a cost of 15,000, five for each instruction.
INLINED = 3000
MOTOR = Actuator(2.0, 3.0)


@pytest.mark.parametrize(
    "creature",
    [
        random_creature(np.random.default_rng(0), STRUCTURES[0], 1.0, MOTOR),
        box_chain(2, "xyz", MOTOR),
    ],
    ids=["random", "chain"],
)
def test_no_kernel_is_too_large_to_be_inlined(monkeypatch, creature):
    """Both have kernels of more than 3000 where the schedule lets them have 3600 operations."""
    world = in_water(creature)
    pieces = []

    def cut(wanted):
        found = schedule.cut(wanted)
        pieces.extend(found)
        return found

    monkeypatch.setattr(kernels, "cut", cut)
    state = resting_state(world.tree, (16,))
    targets = jnp.zeros((world.tree.dof_count, 16), jnp.float32)
    jax.jit(functools.partial(step, world, h=1 / 120)).lower(state, targets)
    sizes = [
        len(piece) + len(schedule.read_by(piece)) + len(kept)
        for piece, kept in pieces
        if not piece[0].costly
    ]
    assert 0 < max(sizes) <= INLINED
