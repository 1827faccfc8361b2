"""Creatures stand on slopes almost as steep as statics allows."""

import jax
import numpy as np
import pytest

from benchmarks.plan import experiment_of
from benchmarks.slopes import Standing, limit_of_statics, stander, stands, steepest
from evo_cpg.creature.creature import Actuator, Body, Creature, Joint, Material
from evo_cpg.creature.shapes import Box, Sphere
from evo_cpg.creature.tree import build_tree
from evo_cpg.physics.contact.contact_model import Ground, make_contact_model
from evo_cpg.physics.step.world import World


def test_the_limit_of_statics_equals_a_blocks():
    """A block slides beyond atan mu, or tips beyond atan (half length / height of its centre)."""
    corners = np.array([[x, y, 0] for x in (-0.1, 0.1) for y in (-0.1, 0.1)])
    for height, friction in ((0.05, 0.5), (0.3, 0.5), (0.3, 0.8)):
        standing = Standing(0.0, corners, np.full(4, friction), np.array([0, 0, height]))
        expected = np.rad2deg(min(np.arctan(friction), np.arctan(0.1 / height)))
        assert limit_of_statics(standing) == pytest.approx(expected, abs=0.15)


def table(friction: float) -> World:
    """Return a slab on three ball feet that are hinged and held by dashpots."""
    wood = Material(400.0, 0.0, friction, friction)
    bodies = [Body("slab", Box((0.5, 0.4, 0.05)), wood)]
    for name, x, y in (("a", 0.2, 0.15), ("b", 0.2, -0.15), ("c", -0.2, 0.0)):
        motor = Actuator(5.0, 20.0, stiffness=200.0)
        hinge = ((0.0, 1.0, 0.0),)
        limits = (-1.0,), (1.0,)
        joint = Joint("slab", (x, y, -0.025), (0, 0, 0.1), hinge, *limits, actuator=motor)
        bodies.append(Body(name, Sphere(0.05), wood, joint))
    creature = Creature("table", tuple(bodies))
    tree = build_tree(creature)
    return World(
        tree,
        9.81,
        contact_model=make_contact_model(creature, tree, Ground(0.0, friction, friction)),
    )


@pytest.mark.slow
@pytest.mark.parametrize(("friction", "creep"), [(0.4, 0.5e-3), (2.0, 1.5e-3)])
def test_a_table_stands_to_a_degree_below_the_limit(friction, creep):
    """It slides with little friction, and tips over with much friction.

    It tips at 50 degrees. Two of its feet then carry all weight, so they creep faster.
    """
    with jax.enable_x64(False):
        stand = stander(table(friction), 1 / 240)
        limit, slope, standing = steepest(stand)
        assert limit - slope < 1.4
        assert standing.creep < creep
        sliding = np.rad2deg(np.arctan(friction))
        assert (abs(limit - sliding) < 0.2) == (friction < 1)
        assert not stands(stand(slope + 2), stand(0.0))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "creep"),
    [("fukui2003_model1", 0.5e-3), ("fukui2003_model3", 0.5e-3), ("hexapod", 2.5e-3)],
)
def test_walkers_stand_to_a_degree_below_the_limit(name, creep):
    """The hexapod creeps faster: its light feet are soft, and four of them carry all weight."""
    with jax.enable_x64(False):
        simulation = experiment_of(name).simulation
        stand = stander(simulation.world, simulation.step_length)
        limit, slope, standing = steepest(stand)
        assert slope > 20
        assert limit - slope < 1.4
        assert standing.creep < creep
        assert not stands(stand(slope + 2), stand(0.0))
