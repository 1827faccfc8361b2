"""Slender chains: trunks, tails, fins, legs and forks."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from creatures import box_chain, hinge
from evo_cpg.creature.algebra.decisions import recording_decisions, replaying_decisions
from evo_cpg.creature.creature import Body, Creature, Material
from evo_cpg.creature.shapes import Box, Capsule, Shape
from evo_cpg.creature.slender import slender_chains

FLESH = Material(1000.0)


def limb(name: str, shape: Shape, parent: str, at, child_at) -> Body:
    """A body with a hinge."""
    return Body(name, shape, FLESH, hinge(parent, at, child_at))


def named(creature: Creature) -> list[list[str]]:
    """The names of the bodies of each chain."""
    return [[creature.bodies[i].name for i in chain.bodies] for chain in slender_chains(creature)]


TRUNK = Body("trunk", Box((0.4, 0.1, 0.1)), FLESH)
TAIL = limb("tail", Box((0.3, 0.05, 0.1)), "trunk", (-0.2, 0.0, 0.0), (0.15, 0.0, 0.0))
END = limb("end", Box((0.2, 0.02, 0.1)), "tail", (-0.15, 0.0, 0.0), (0.1, 0.0, 0.0))
HEAD = limb("head", Box((0.1, 0.1, 0.1)), "trunk", (0.2, 0.0, 0.0), (-0.05, 0.0, 0.0))


def test_a_chain_runs_from_nose_to_tail():
    (chain,) = slender_chains(box_chain(5, "z", size=(0.2, 0.1, 0.1), gap=0.02))
    assert chain.bodies == (0, 1, 2, 3, 4)
    assert float(chain.lengths.sum()) == pytest.approx(5 * 0.2 + 4 * 0.02)
    np.testing.assert_allclose(chain.lengths, [0.21, 0.22, 0.22, 0.22, 0.21])
    np.testing.assert_allclose(chain.tangents, [[1, 0, 0]] * 5, atol=1e-12)
    np.testing.assert_allclose(chain.front[0], [0.1, 0, 0])
    np.testing.assert_allclose(chain.rear[-1], [-0.1, 0, 0], atol=1e-12)


def test_the_root_may_be_in_the_middle():
    creature = Creature("fish", (TRUNK, TAIL, END, HEAD))
    assert named(creature) == [["head", "trunk", "tail", "end"]]


def test_fins_start_their_own_chains():
    fins = [
        limb(
            f"fin{side}", Box((0.1, 0.2, 0.01)), "trunk", (0.1, 0.05 * s, 0.0), (0.0, -0.1 * s, 0.0)
        )
        for side, s in (("+", 1), ("-", -1))
    ]
    dorsal = limb("dorsal", Box((0.2, 0.01, 0.1)), "trunk", (0.0, 0.0, 0.05), (0.0, 0.0, -0.05))
    creature = Creature("fish", (TRUNK, *fins, dorsal, TAIL))
    assert named(creature) == [["trunk", "tail"], ["fin+"], ["fin-"], ["dorsal"]]


def test_legs_are_chains_of_their_own():
    """From the hip down, though a leg stands across."""
    down = ((0.0, 0.0, -1.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0))
    thigh = hinge("trunk", (0.1, 0.05, 0.0), (0.1, 0.0, 0.0), "y", orientation=down)
    upright = Body("thigh", Capsule(0.02, 0.16), FLESH, thigh)
    shank = limb("shank", Capsule(0.02, 0.16), "thigh", (-0.1, 0.0, 0.0), (0.1, 0.0, 0.0))
    creature = Creature("walker", (TRUNK, TAIL, shank, upright))
    assert named(creature) == [["trunk", "tail"], ["thigh", "shank"]]


@pytest.mark.parametrize("order", [1, -1])
def test_a_fork_of_equal_bodies_ends_the_chain(order):
    """Either order of the two lobes gives the same chains."""
    lobes = [
        limb(f"lobe{s}", Box((0.2, 0.02, 0.1)), "tail", (-0.15, 0.02 * s, 0.0), (0.1, -0.02 * s, 0))
        for s in (1, -1)
    ]
    chains = named(Creature("fluke", (TRUNK, TAIL, *lobes[::order])))
    assert sorted(chains) == [["lobe-1"], ["lobe1"], ["trunk", "tail"]]


def test_the_wider_body_of_a_fork_continues_the_chain():
    small = limb("small", Box((0.2, 0.02, 0.05)), "tail", (-0.15, 0.02, 0.0), (0.1, 0.0, 0.0))
    chains = named(Creature("fish", (TRUNK, TAIL, small, END)))
    assert sorted(chains) == [["small"], ["trunk", "tail", "end"]]


def test_bodies_of_very_different_width_are_not_linked():
    whisker = limb("whisker", Capsule(0.01, 0.2), "trunk", (0.2, 0.0, 0.0), (-0.11, 0.0, 0.0))
    assert named(Creature("fish", (TRUNK, TAIL, whisker))) == [["trunk", "tail"], ["whisker"]]


def test_a_thin_fin_at_the_end_may_be_wider_than_its_peduncle():
    """A thick body or a trunk in the fin's place is not linked, nor is a fin across the chain."""
    peduncle = limb("peduncle", Box((0.2, 0.02, 0.03)), "tail", (-0.15, 0.0, 0.0), (0.1, 0.0, 0.0))
    joint = ("peduncle", (-0.1, 0.0, 0.0), (0.05, 0.0, 0.0))

    def last(*bodies: Body) -> list[str]:
        return named(Creature("fish", (TRUNK, TAIL, peduncle, *bodies)))[0]

    fin = limb("fin", Box((0.1, 0.01, 0.3)), *joint)
    assert last(fin)[-1] == "fin"
    spike = limb("spike", Capsule(0.01, 0.02), "fin", (-0.05, 0.0, 0.1), (0.02, 0.0, 0.0))
    assert last(fin, spike)[-1] == "peduncle"
    assert last(limb("fin", Box((0.1, 0.1, 0.3)), *joint))[-1] == "peduncle"
    across = ("peduncle", (-0.1, 0.0, 0.0), (0.005, 0.0, 0.0))
    assert last(limb("fin", Box((0.01, 0.3, 0.3)), *across))[-1] == "peduncle"


def test_a_body_without_size_keeps_its_place():
    """The last body of a traced chain has no size. It has no length, and finite tangents."""

    def chain(scale):
        lost = limb(
            "lost", Capsule(0.05 * scale, 0.1 * scale), "end", (-0.1, 0, 0), (0.1 * scale, 0, 0)
        )
        (found,) = slender_chains(Creature("fish", (TRUNK, TAIL, END, lost)))
        return found

    with recording_decisions() as decisions:
        assert chain(1.0).bodies == (0, 1, 2, 3)

    def replayed(scale):
        with replaying_decisions(decisions):
            found = chain(scale)
        return found.lengths, found.tangents

    lengths, tangents = jax.jit(replayed)(jnp.array(0.0))
    np.testing.assert_allclose(lengths, [0.4, 0.3, 0.2, 0.0], atol=1e-7)
    assert np.isfinite(tangents).all()
