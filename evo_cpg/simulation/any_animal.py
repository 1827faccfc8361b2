"""Any drawn animal in deep water in one program, with the numbers of its own simulation.

The animal's own tree, masses, laws of joints and surface points are inputs of the program. So the
motion is that of its own simulation, up to rounding, and nothing is compiled for it. Each body of
the program has three joint axes in any directions. Axes and bodies that the animal does not have
are absent, as in `evo_cpg.simulation.planned`.
"""

import dataclasses
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from typing_extensions import override

from evo_cpg.creature.algebra.numerics import xp
from evo_cpg.creature.creature import NO_LIMIT
from evo_cpg.creature.tree import LEAST_VOLUME, Tree
from evo_cpg.creature.walk import TreeWalk, walk_of, walk_order
from evo_cpg.physics.step.step import needs_iteration
from evo_cpg.physics.step.world import World
from evo_cpg.physics.water.fluid import Drag
from evo_cpg.physics.water.point_drag import PointDrag, PointTables, point_tables
from evo_cpg.simulation.planned import TreeInputs, with_walk
from evo_cpg.simulation.simulation import Simulation

# Joint axes of each body of the program.
_AXES = 3
# Shapes of the tables of points: form drag, then skin friction. 20 ellipsoids have 820 and 500
# points.
_POINTS = (900, 8), (512, 14)
# Numbers of each body and of each joint axis, and their values where the animal has none.
_OF_BODIES = {
    "joint_offset": 0.0, "joint_orientation": np.eye(3)[..., None], "mass": 0.0,
    "volume": LEAST_VOLUME, "com": 0.0, "centre_of_volume": 0.0,
}  # fmt: skip
_OF_AXES = {
    "joint_axes": np.eye(3)[:, :1], "rest": 0.0, "stiffness": 0.0, "damping": 0.0, "armature": 1.0,
    "lower": -NO_LIMIT, "upper": NO_LIMIT, "servo_gain": 0.0, "servo_stiffness": 0.0,
    "limit_stiffness": 0.0, "limit_damping": 0.0,
}  # fmt: skip


class AnimalNumbers(NamedTuple):
    """Numbers of an animal for the program of ``b`` bodies with ``d`` joint axes.

    Attributes:
        tree: numbers of its tree (`_OF_BODIES`, `_OF_AXES`) and ``root_centre``.
        rotational: rotational inertias about the origins of the bodies, kg m^2.
        walk: parents of the bodies.
        points: points of drag.
        medium: gravity (m/s^2) and density of the water (kg/m^3).
        light: place of the light, m.
    """

    tree: dict[str, Float[Any, "..."]]
    rotational: Float[Any, "3 3 b"]
    walk: TreeWalk
    points: PointTables
    medium: Float[Any, "2"]
    light: Float[Any, "3"]


class AnimalInputs(TreeInputs):
    """Inputs of a program whose individuals are drawn animals.

    Args:
        star: simulation of a root with ``b - 1`` parts on it, with three axes each, in water.
    """

    def __init__(self, star: Simulation):
        tree = with_walk(star.world.tree)
        # These two are None if a creature does not need them.
        given = {"centre_of_volume": tree.centre, "rest": np.zeros(tree.dof_count)}
        tree = dataclasses.replace(tree, **given)
        assert tree.walk is not None
        nothing = PointDrag(PointTables(*map(np.zeros, _POINTS)))
        world = dataclasses.replace(star.world, tree=tree, forces=(nothing,))
        self.common = dataclasses.replace(star, world=world, rules=None)
        own = {name: getattr(tree, name) for name in (*_OF_BODIES, *_OF_AXES, "root_centre")}
        rotational, (medium, light) = np.zeros((3, 3, tree.body_count)), map(np.zeros, (2, 3))
        like = AnimalNumbers(own, rotational, tree.walk, nothing.tables, medium, light)
        self._like = jax.eval_shape(lambda: jax.tree.map(jnp.asarray, like))
        self._varying = self._find_varying()

    @override
    def _parts(self, common: Simulation, numbers: AnimalNumbers) -> dict[str, Any]:
        own, world, water = numbers.tree, common.world, common.world.water
        assert water is not None
        (x, y, z), none = own["com"], xp.zeros_like(own["mass"])
        mixed = own["mass"][None, None] * xp.stack(
            [xp.stack(row) for row in ((none, -z, y), (z, none, -x), (-y, x, none))]
        )
        linear = np.eye(3)[..., None] * own["mass"][None, None]
        rows = (numbers.rotational, mixed), (-mixed, linear)
        inertia = xp.concatenate([xp.concatenate(row, 1) for row in rows])
        tree = dataclasses.replace(world.tree, **own, inertia=inertia, walk=numbers.walk)
        gravity, density = numbers.medium
        world = dataclasses.replace(
            world,
            tree=tree,
            gravity=gravity,
            water=dataclasses.replace(water, density=density),
            forces=(PointDrag(numbers.points),),
        )
        controller = dataclasses.replace(common.controller, tree=tree)
        situation = common.situations[0]._replace(light=tuple(numbers.light))
        return {"world": world, "controller": controller, "situations": (situation,)}

    def values(
        self, own: Simulation
    ) -> tuple[Float[np.ndarray, " v"], Int[np.ndarray, " b"]] | None:
        """Return the inputs of an animal, and the place of each of its bodies in the program.

        Return None if the animal does not fit.

        Args:
            own: simulation of the animal, with a light.
        """
        world, tree, size = own.world, own.world.tree, self.common.world.tree.body_count
        if tree.body_count > size or not _is_common(world):
            return None
        parents = np.full(size, -1)
        parents[: tree.body_count] = tree.parents
        places, walk = jax.tree.map(np.asarray, _walk(parents))
        places = places[: tree.body_count]
        bodies = np.array(tree.dof_bodies, int)
        # The axes of a body come one after the other.
        dofs = _AXES * (places[bodies] - 1) + np.arange(len(bodies))
        dofs -= np.searchsorted(bodies, bodies)
        turns = np.zeros(_AXES * (size - 1))
        turns[dofs] = 1.0
        rotational = np.zeros((3, 3, size))
        rotational[..., places] = tree.inertia[:3, :3]
        (drag,), water = world.forces, world.water
        assert isinstance(drag, Drag) and water is not None
        points = point_tables(drag, water.density, places, _POINTS)
        if points is None:
            return None
        found = AnimalNumbers(
            self._spread(tree, places, dofs),
            rotational,
            dataclasses.replace(walk, turns=turns),
            points,
            np.array([world.gravity, water.density]),
            np.array(own.lights[0]),
        )
        return np.concatenate([np.ravel(x) for x in jax.tree.leaves(found)]), places

    def _spread(
        self, tree: Tree, places: Int[np.ndarray, " b"], dofs: Int[np.ndarray, " d"]
    ) -> dict[str, np.ndarray]:
        """Return `AnimalNumbers.tree`, given the places of bodies and axes in the program."""
        numbers = {"root_centre": tree.root_centre}
        for names, where in ((_OF_BODIES, places), (_OF_AXES, dofs)):
            for name, absent in names.items():
                own = getattr(tree, name)
                if own is None:
                    own = tree.com if name == "centre_of_volume" else 0.0
                numbers[name] = np.zeros(getattr(self.common.world.tree, name).shape) + absent
                numbers[name][..., where] = own
        return numbers


def _is_common(world: World) -> bool:
    """Return whether an animal and its water have nothing that the common program lacks."""
    tree, water = world.tree, world.water
    others = tree.hanging, tree.tendons, tree.muscles, tree.torque_motors
    return (
        all(other is None for other in others)
        and all(group.kind in ("turns", "weld") for group in tree.groups)
        and not needs_iteration(world)
        and world.submerged
        and all(isinstance(law, Drag) and law.law == "normal" for law in world.forces)
        and not (water and water.flows)
    )


@jax.jit
def _walk(parents: Int[Array, " n"]) -> tuple[Int[Array, " n"], TreeWalk]:
    """Return the places of the bodies of a tree in a program, and the walk without axes."""
    order, slots = walk_order(parents)
    places, own = jnp.argsort(order), parents[order]
    moved = jnp.where(own >= 0, places[own], -1)
    return places, walk_of(moved, slots, jnp.zeros(_AXES * (len(parents) - 1)))
