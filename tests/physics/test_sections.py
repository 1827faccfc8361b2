"""Added mass of the sections of chains, and the edges at which chains shed water."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from creatures import hinge
from evo_cpg.creature.algebra.decisions import recording_decisions, replaying_decisions
from evo_cpg.creature.creature import Body, Creature, Material
from evo_cpg.creature.shapes import Box, Capsule, Ellipsoid, Shape
from evo_cpg.creature.slender import slender_chains
from evo_cpg.creature.tree import build_tree
from evo_cpg.physics.water.reactive_thrust import chain_inertia, reactive_water, sections

WATER = 1000.0


def row(*shapes: Shape) -> Creature:
    """Shapes end to end, the first in front."""
    bodies = [Body("b0", shapes[0], Material(WATER))]
    for i, (ahead, own) in enumerate(itertools.pairwise(shapes), start=1):
        ends = (-ahead.half_extents[0], 0.0, 0.0), (own.half_extents[0], 0.0, 0.0)
        joint = hinge(f"b{i - 1}", *ends)
        bodies.append(Body(f"b{i}", own, Material(WATER), joint))
    return Creature("row", tuple(bodies))


def found_sections(*shapes: Shape):
    creature = row(*shapes)
    (chain,) = slender_chains(creature)
    return sections(creature, chain, WATER)


def across(found, direction) -> np.ndarray:
    """Added mass per length of each body for motion along a direction."""
    return (found.masses * (found.directions @ np.array(direction)) ** 2).sum(1)


@pytest.mark.parametrize(
    ("ratio", "factor"), [(0.1, 1.14), (0.2, 1.22), (0.5, 1.36), (1.0, 1.51), (2.0, 1.70)]
)
def test_rectangles_have_the_added_mass_of_the_panel_method(ratio, factor):
    """Moving along z, with the half-width 0.01 m along y. The chain is 300 times as long."""
    found = found_sections(*[Box((2.0, 0.02, 0.02 * ratio))] * 3)
    expected = factor * WATER * np.pi * 0.01**2
    np.testing.assert_allclose(across(found, (0, 0, 1)), expected, rtol=1e-3)


def test_round_bodies_have_the_added_mass_of_their_mean_section():
    """Capsules of circles, and ellipsoids of ellipses 2/3 as large as the widest."""
    circles = across(found_sections(*[Capsule(0.01, 2.0)] * 3), (0, 1, 0))
    np.testing.assert_allclose(circles, WATER * np.pi * 0.01**2, rtol=5e-3)
    ellipses = found_sections(*[Ellipsoid((1.0, 0.01, 0.02))] * 3)
    wide, narrow = (WATER * np.pi * b**2 * 2 / 3 for b in (0.02, 0.01))
    np.testing.assert_allclose(across(ellipses, (0, 1, 0)), wide, rtol=2e-3)
    np.testing.assert_allclose(across(ellipses, (0, 0, 1)), narrow, rtol=2e-3)


@pytest.mark.parametrize(("slenderness", "k"), [(2, 0.704), (4, 0.860), (6, 0.917), (10, 0.960)])
def test_short_chains_carry_less(slenderness, k):
    """Lamb's coefficient k_2 of spheroids (R&M 623)."""
    found = found_sections(*[Box((0.1 * slenderness / 3, 1e-4, 0.1))] * 3)
    thin = WATER * np.pi * 0.05**2 * (1 + 0.14 * 0.01)
    np.testing.assert_allclose(across(found, (0, 1, 0)), k * thin, rtol=2e-3)


def test_the_inertia_of_a_chain_is_the_integral_of_its_sections():
    """``m l`` across, and ``m l^3 / 12`` about the centre of each body."""
    creature = row(*[Box((0.2, 0.05, 0.1))] * 3)
    tree = build_tree(creature)
    (chain,) = slender_chains(creature)
    found = sections(creature, chain, WATER)
    inertia = chain_inertia(tree, creature, chain, found)[0]
    y, z = (float(across(found, axis)[0]) for axis in ((0, 1, 0), (0, 0, 1)))
    own = [0.0, z * 0.2**3 / 12, y * 0.2**3 / 12, 0.0, 0.2 * y, 0.2 * z]
    np.testing.assert_allclose(inertia, np.diag(own), atol=1e-12)


def edges(creature: Creature):
    """The law of a creature's edges."""
    tree = build_tree(creature)
    found = reactive_water(creature, tree, WATER, np.zeros((6, 6, tree.body_count)))
    assert found is not None
    return found[1]


def test_bodies_outside_of_chains_keep_their_own_added_mass():
    """A chain of two bodies is too short, too."""
    long, short = row(*[Capsule(0.05, 0.2)] * 3), row(*[Capsule(0.05, 0.2)] * 2)
    fin = hinge("b0", (0.0, 0.05, 0.0), (0.0, -0.1, 0.0), "x")
    creature = Creature(
        "fish", (*long.bodies, Body("fin", Box((0.05, 0.2, 0.01)), Material(WATER), fin))
    )
    tree, others = build_tree(creature), np.ones((6, 6, 4))
    found = reactive_water(creature, tree, WATER, others)
    assert found is not None
    kept = (found[0] == 1.0).all((0, 1))
    assert [name for name, own in zip(tree.names, kept, strict=True) if own] == ["fin"]
    assert reactive_water(short, build_tree(short), WATER, others[..., :2]) is None


def test_equal_bodies_shed_at_both_ends_alone():
    law = edges(row(*[Box((0.2, 0.05, 0.1))] * 4))
    assert law.bodies == (0, 3)
    np.testing.assert_allclose(law.edges.tangents.T, [[-1, 0, 0], [1, 0, 0]], atol=1e-15)
    np.testing.assert_allclose(law.edges.points[0], [0.1, -0.2], atol=1e-15)


def test_round_bodies_hand_all_water_on():
    assert edges(row(*(Capsule(r, 0.2) for r in (0.05, 0.04, 0.03)))).bodies == (0, 2)


def test_a_sharp_edge_sheds_the_difference():
    """Forwards the rear edge of the wider body, and backwards the front edge of a wider one."""
    shapes = [Box((0.2, 0.02, height)) for height in (0.05, 0.1, 0.06)]
    law = edges(row(*shapes))
    assert law.bodies == (0, 2, 1, 1)
    forwards = law.edges.tangents[0] > 0
    np.testing.assert_array_equal(forwards, [False, True, False, True])
    # The shed masses add up to the widest section in both directions of motion.
    widest = found_sections(*shapes).masses[1]
    np.testing.assert_allclose(law.edges.masses[:, forwards].sum(1).max(), widest.max())
    np.testing.assert_allclose(law.edges.masses[:, ~forwards].sum(1).max(), widest.max())


def test_a_caudal_fin_sheds_its_own_section():
    """A fin of 0.3 m behind a peduncle of 0.04 m: ``rho pi a^2 c(b/a)`` times Lamb's k_2."""
    row_of_bodies = row(*[Capsule(0.02, 0.31)] * 3, Box((0.15, 0.03, 0.3)))
    law = edges(row_of_bodies)
    (tail,) = np.flatnonzero(law.edges.tangents[0] > 0)
    assert law.bodies[tail] == 3
    sideways = int(np.abs(law.edges.directions[1, :, tail]).argmax())
    # The chain is 1.2 m long, four times as long as the fin is high.
    fin = WATER * np.pi * 0.15**2 * 1.14 * 0.860
    np.testing.assert_allclose(law.edges.masses[sideways, tail], fin, rtol=2e-3)


def test_a_body_without_size_sheds_nothing():
    """A chain whose last body has no size is the chain without the body."""

    def law(scale):
        shapes = [Capsule(0.05, 0.2)] * 3
        creature = row(*shapes, Capsule(0.05 * scale, 0.2 * scale))
        tree = build_tree(creature)
        others = np.zeros((6, 6, 4))
        found = reactive_water(creature, tree, WATER, others, every_edge=True)
        assert found is not None
        return found

    with recording_decisions() as decisions:
        law(1.0)

    def replayed(scale):
        with replaying_decisions(decisions), jax.numpy_rank_promotion("allow"):
            return law(scale)

    inertia, found = jax.jit(replayed)(jnp.array(0.0))
    shorter = edges(row(*[Capsule(0.05, 0.2)] * 3))
    bodies = np.array(found.bodies)
    assert not np.asarray(inertia[..., 3]).any()
    shed = {i: np.asarray(found.edges.masses)[:, bodies == i].sum(1) for i in range(4)}
    own = dict(zip(shorter.bodies, shorter.edges.masses.T, strict=True))
    for body in range(4):
        np.testing.assert_allclose(shed[body], own.get(body, np.zeros(2)), rtol=1e-6)
    assert np.isfinite(np.concatenate([np.ravel(x) for x in found.edges])).all()
