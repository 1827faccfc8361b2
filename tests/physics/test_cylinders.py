"""Cylinders in water and on the ground, against measurements and closed forms."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad

from evo_cpg.creature.creature import Body, Creature, Material
from evo_cpg.creature.cylinder import Cylinder
from evo_cpg.creature.surface import outer_surfaces
from evo_cpg.creature.tree import build_tree
from evo_cpg.physics.contact.contact_points import contact_points
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.kinematics import kinematics
from evo_cpg.physics.tree.state import resting_state
from evo_cpg.physics.water.added_mass import ellipsoid
from evo_cpg.physics.water.buoyancy import displacement, make_cells
from evo_cpg.physics.water.viscous_bodies import make_viscous_drag
from evo_cpg.physics.water.water import Water
from measured_water import CYLINDER, CYLINDER_ALONG, SHORT_CYLINDER
from on_ground import GRAVITY, H, alone, record, released

WATER, VISCOSITY, D = 1000.0, 1e-3, 0.1
HALF = np.sqrt(0.5)
UPRIGHT = (HALF, 0.0, -HALF, 0.0)


def drag_coefficients(shape: Cylinder, reynolds: float) -> np.ndarray:
    """Return the coefficients along and across a cylinder of diameter D, on its frontal areas."""
    creature = Creature("single", (Body("b", shape, Material(WATER)),))
    tree = build_tree(creature)
    form, skin = ({"b": outer_surfaces(creature, n)[0]} for n in (2, 1))
    law = make_viscous_drag(creature, tree, form, skin, VISCOSITY)
    world = World(tree, 0.0, Water(WATER), (law,))
    speed = reynolds * VISCOSITY / (WATER * D)
    velocity = np.zeros((6, 1, 2))
    velocity[3, 0, 0] = velocity[4, 0, 1] = speed
    state = resting_state(tree, (2,), jnp.float64)
    bodies = world.bodies(kinematics(tree, state), 0.01).moving(jnp.asarray(velocity))
    force = np.asarray(law.wrench(bodies))
    areas = np.array([np.pi / 4 * D**2, D * shape.length])
    return -np.array([force[3, 0, 0], force[4, 0, 1]]) / (0.5 * WATER * speed**2 * areas)


@pytest.mark.parametrize(("ratio", "measured"), CYLINDER_ALONG)
@pytest.mark.slow
def test_drag_along_a_cylinder_is_as_measured(ratio, measured):
    """Compare with Kritzinger and the data book at Re 1e4 and 1e5, within 15 %."""
    for reynolds in (1e4, 1e5):
        found = drag_coefficients(Cylinder(D / 2, ratio * D), reynolds)[0]
        assert found == pytest.approx(measured, rel=0.15)


@pytest.mark.parametrize(("ratio", "measured"), SHORT_CYLINDER)
def test_drag_across_a_short_cylinder_is_as_measured(ratio, measured):
    """Compare with Wieselsberger at Re 1e5, within 10 %."""
    found = drag_coefficients(Cylinder(D / 2, ratio * D), 1e5)[1]
    assert found == pytest.approx(measured, rel=0.1)


@pytest.mark.parametrize(("reynolds", "measured"), CYLINDER)
def test_drag_across_a_long_cylinder_is_as_measured(reynolds, measured):
    """Compare with Wieselsberger from Re 0.73 to 1.1e5, within 25 %."""
    found = drag_coefficients(Cylinder(D / 2, 100 * D), reynolds)[1]
    assert found == pytest.approx(measured, rel=0.25)


def test_added_mass_has_the_limits_of_discs_and_rods():
    """A disc carries 8/3 rho r^3, a rod rho pi r^2 L across and rho pi r^2 L^3 / 12 in turns."""
    disc, rod = ellipsoid(Cylinder(0.1, 1e-4)), ellipsoid(Cylinder(0.01, 1.0))
    assert disc[3] == pytest.approx(8 / 3 * 0.1**3, rel=2e-3)
    assert rod[4] == pytest.approx(np.pi * 0.01**2, rel=5e-3)
    assert rod[1] == pytest.approx(np.pi * 0.01**2 / 12, rel=2e-2)


@pytest.mark.parametrize(("ratio", "measured"), [(1.2, 0.62), (2.5, 0.78), (5.0, 0.9), (9.0, 0.96)])
def test_added_mass_across_is_that_of_the_offshore_tables(ratio, measured):
    """Compare with table A-2 of DNV-RP-H103, within 5 %."""
    shape = Cylinder(0.5, ratio)
    assert ellipsoid(shape)[4] / shape.volume == pytest.approx(measured, rel=0.05)


@pytest.mark.parametrize("tilt", [0.0, 0.5, 1.2, np.pi / 2])
def test_buoyancy_is_the_volume_below_the_surface(tilt):
    """Compare volume and first moment with an integral over discs.

    The distribution of a disc is a polynomial, with an error of 0.004 of the volume.
    """
    r, length = 0.1, 0.3
    creature = Creature("float", (Body("b", Cylinder(r, length), Material(500.0)),))
    cells = make_cells(creature, build_tree(creature))
    sine, cosine = np.sin(tilt), np.cos(tilt)
    for height in (-0.12, -0.03, 0.05):

        def disc(x, height=height):
            # Height of the surface above the axis, in the plane of a disc.
            d = np.clip((-height - x * sine) / max(cosine, 1e-9), -r, r)
            area = r * r * (np.pi / 2 + np.arcsin(d / r)) + d * np.sqrt(r * r - d * d)
            return area, -2 / 3 * (r * r - d * d) ** 1.5

        wet = quad(lambda x: disc(x)[0], -length / 2, length / 2, limit=200)[0]
        along = quad(lambda x: x * disc(x)[0], -length / 2, length / 2, limit=200)[0]
        across = quad(lambda x: disc(x)[1], -length / 2, length / 2, limit=200)[0]
        pose = jnp.asarray([sine, 0.0, cosine, height]).reshape(4, 1, 1)
        volume, moment = displacement(cells, pose)
        whole = np.pi * r * r * length
        assert float(volume[0, 0]) == pytest.approx(wet, abs=0.006 * whole)
        found = np.asarray(moment)[:, 0, 0]
        np.testing.assert_allclose(found, [along, 0.0, across], atol=0.004 * whole * length)


@pytest.mark.slow
def test_cylinders_stand_tip_and_roll():
    """Release five cylinders at once, and compare each with its closed form.

    - One stands, and one returns to its foot from a tilt of 20 degrees. The edge is at 26.6.
    - One tilted by 32 degrees falls on its side.
    - One rolls without slip: v = w r.
    - One slides at first, and rolls at 2/3 of its speed.
    """
    r, length = 0.1, 0.4
    world = alone(Cylinder(r, length))
    tilts = np.radians([0.0, 20.0, 32.0])
    place, velocity = np.zeros((3, 5)), np.zeros((6, 5))
    place[2, :3] = length / 2 * np.cos(tilts) + r * np.sin(tilts)
    place[2, 3:] = r
    velocity[0, 3], velocity[4, 3], velocity[4, 4] = -5.0, 0.5, 1.0
    turns = np.zeros((4, 5))
    turns[0, :3], turns[2, :3] = np.cos(np.pi / 4 + tilts / 2), -np.sin(np.pi / 4 + tilts / 2)
    turns[0, 3:] = 1.0
    state = dataclasses.replace(released(world, place, velocity), orientation=jnp.asarray(turns))
    states, force = record(world, state, 480)
    end = {name: getattr(states, name)[-1] for name in ("position", "velocity", "orientation")}
    axis = 2 * (end["orientation"][1] * end["orientation"][3]) - 2 * (
        end["orientation"][0] * end["orientation"][2]
    )
    np.testing.assert_allclose(np.abs(axis[:3]), [1.0, 1.0, 0.0], atol=2e-3)
    weight = float(world.tree.mass[0]) * GRAVITY
    np.testing.assert_allclose(force[-1, 2, :, 0].sum(), weight, rtol=1e-6)
    assert (force[-1, 2, :, 0] > 0.3 * weight).sum() == 3
    assert end["velocity"][4, 3] == pytest.approx(0.5, rel=1e-6)
    assert end["position"][1, 3] == pytest.approx(0.5 * 480 * H, rel=1e-6)
    assert end["velocity"][4, 4] == pytest.approx(2 / 3, rel=1e-3)
    np.testing.assert_allclose(
        end["velocity"][4, 3:], -r * end["velocity"][0, 3:], rtol=0, atol=1e-6
    )


@pytest.mark.parametrize("upright", [UPRIGHT, (1.0, 0.0, 0.0, 0.0), (0.9, 0.1, -0.4, 0.15)])
def test_the_lowest_contact_point_is_the_lowest_point(upright):
    """The lowest point of a tilted cylinder is known in closed form."""
    r, length = 0.1, 0.4
    world = alone(Cylinder(r, length))
    turn = np.array(upright) / np.linalg.norm(upright)
    state = released(world, [[0.0], [0.0], [1.0]], orientation=tuple(turn))
    kin = kinematics(world.tree, state)
    up = np.asarray(kin.rotation)[2, 0, 0, 0]
    lowest = 1.0 - length / 2 * abs(up) - r * np.sqrt(max(0.0, 1 - up * up))
    gap = np.asarray(contact_points(world.contact_model, kin).gap)
    assert gap.min() == pytest.approx(lowest, abs=5e-5 * r)
