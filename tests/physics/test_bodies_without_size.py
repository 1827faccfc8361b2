"""Bodies that evolution shrank to size 0 have no part in the forces of the water."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from creatures import AXES, quick_jit, surfaces_of
from evo_cpg.creature.creature import Body, Creature, Joint, Material
from evo_cpg.creature.shapes import Box, Capsule, Ellipsoid
from evo_cpg.creature.tree import build_tree
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.kinematics import kinematics
from evo_cpg.physics.tree.state import resting_state
from evo_cpg.physics.water.added_mass import AddedMass, added_inertia
from evo_cpg.physics.water.buoyancy import make_cells
from evo_cpg.physics.water.force_law import Bodies
from evo_cpg.physics.water.lift import make_plate_lift
from evo_cpg.physics.water.reactive_thrust import reactive_water
from evo_cpg.physics.water.viscous_bodies import make_viscous_drag
from evo_cpg.physics.water.water import Water

WATER, SAMPLES = 1000.0, 4
# Bodies of a unit size. A plate has lift.
SHAPES = {
    "box": lambda size: Box((0.1 * size, 0.02 * size, 0.06 * size)),
    "capsule": lambda size: Capsule(0.02 * size, 0.06 * size),
    "ellipsoid": lambda size: Ellipsoid((0.05 * size, 0.01 * size, 0.03 * size)),
}


def creature(shape, sizes: tuple[float, ...], fin: float | None) -> Creature:
    """A chain of bodies of some sizes, and a plate of some size at its head."""
    bodies = [Body("b0", shape(sizes[0]), Material(WATER))]
    for i, size in enumerate(sizes[1:]):
        ends = (-0.05 * sizes[i], 0.0, 0.0), (0.05 * size, 0.0, 0.0)
        joint = Joint(f"b{i}", *ends, (AXES["z"],), (-1.0,), (1.0,))
        bodies.append(Body(f"b{i + 1}", shape(size), Material(WATER), joint))
    if fin is None:
        return Creature("masked", tuple(bodies))
    joint = Joint("b0", (0, 0.01, 0), (0, -0.04 * fin, 0), (AXES["x"],), (-1.0,), (1.0,))
    plate = Box((0.06 * fin, 0.08 * fin, 0.004 * fin))
    return Creature("masked", (*bodies, Body("fin", plate, Material(WATER), joint)))


def world(animal: Creature, surface: float | None) -> World:
    """Water with all laws and the common layout of a batch."""
    tree = build_tree(animal)
    form, skin = surfaces_of(animal, 2, 1, layout="complete")
    found = reactive_water(animal, tree, WATER, added_inertia(animal, tree, WATER), True)
    lift = make_plate_lift(animal, tree, False, "complete")
    assert found is not None
    viscous = make_viscous_drag(
        animal, tree, form, skin, 0.001, surfacing=surface is not None, layout="complete"
    )
    cells = () if surface is None else make_cells(animal, tree)
    forces = (viscous, AddedMass(found[0]), found[1], *([lift] if lift else []))
    return World(tree, 0.0, Water(WATER, surface), forces, cells=cells)


def forces(world: World, velocity: np.ndarray) -> dict[str, list[np.ndarray]]:
    """Wrenches, resistances and inertias by law, with the bodies on the axis before the last."""

    @quick_jit
    def every(velocity):
        still = resting_state(world.tree, (SAMPLES,), jnp.float64)
        start = world.bodies(kinematics(world.tree, still), 0.01)
        moving: Bodies = start.moving(velocity)
        found = {}
        for law in world.forces:
            own = [x for part in law.parts(moving) for x in part] + [law.averaged(moving, start)]
            found[type(law).__name__] = [x for x in own if x is not None]
        return found

    return jax.tree.map(np.asarray, every(velocity))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "surface"),
    [
        ("box", 0.0),
        pytest.param("capsule", None, marks=pytest.mark.slow),
        pytest.param("ellipsoid", 0.0, marks=pytest.mark.slow),
    ],
)
def test_bodies_without_size_have_no_force(name, surface, x64):
    """The last body of a chain and a fin vanish: the others move as if the two did not exist."""
    part = world(creature(SHAPES[name], (1, 1, 1, 0), fin=0), surface)
    less = world(creature(SHAPES[name], (1, 1, 1), fin=None), surface)
    kept = [part.tree.names.index(body) for body in less.tree.names]
    gone = [i for i in range(part.tree.body_count) if i not in kept]
    velocity = np.random.default_rng(1).normal(size=(6, part.tree.body_count, SAMPLES))
    found, expected = forces(part, velocity), forces(less, velocity[:, kept])
    assert set(expected) == set(found) - {"PlateLift"}
    for own in (x for values in found.values() for x in values):
        assert np.isfinite(own).all()
        np.testing.assert_allclose(own[..., gone, :], 0.0, atol=1e-15)
    for law, values in expected.items():
        assert any(abs(x).max() > 0.1 for x in values), law
        for own, other in zip(found[law], values, strict=True):
            np.testing.assert_allclose(own[..., kept, :], other, atol=1e-12 * abs(other).max())
