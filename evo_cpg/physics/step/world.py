"""A creature and its environment: the medium, the ground, and the force laws."""

import dataclasses
import math
from typing import TypeVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.creature.algebra.numerics import Number, Numbers, xp
from evo_cpg.creature.self_collision import SelfCollision
from evo_cpg.creature.tree import Tree
from evo_cpg.physics.contact.contact_model import ContactModel, Ground
from evo_cpg.physics.contact.pairs import Pairs
from evo_cpg.physics.tree.kinematics import Kinematics
from evo_cpg.physics.water.buoyancy import Cells
from evo_cpg.physics.water.force_law import Bodies, ForceLaw, bodies_in
from evo_cpg.physics.water.water import Water

_Law = TypeVar("_Law", bound=ForceLaw)


class World(eqx.Module):
    """A creature and its environment, as `evo_cpg.physics.step.step` simulates them.

    Attributes:
        gravity: acceleration of gravity along -z, m/s^2.
        forces: force laws besides weight, buoyancy, joints and contact, in the order of their sum.
        contact_model: the contact points, or None without ground.
        cells: simple volumes that make up the bodies. Empty without a water surface.
        pairs: bodies that must not pass through each other, or None if none can meet.
        held: whether the root is held still. Steps that need iteration cannot hold it.
    """

    tree: Tree
    gravity: Number
    water: Water | None = None
    forces: tuple[ForceLaw, ...] = ()
    contact_model: ContactModel | None = None
    cells: tuple[Cells, ...] = ()
    pairs: Pairs | None = None
    held: bool = eqx.field(static=True, default=False)

    def __repr__(self) -> str:
        water = "no water" if self.water is None else "water everywhere"
        if self.water is not None and self.water.surface is not None:
            water = f"water up to {self.water.surface} m"
        ground = "no ground" if self.contact_model is None else "ground"
        return f"World(gravity {self.gravity} m/s^2, {water}, {ground})"

    def bodies(self, kin: Kinematics, h: float) -> Bodies:
        """Return the pose and motion of all bodies, as input of the force laws."""
        return bodies_in(self.tree, self.gravity, self.water, self.cells, h, kin)

    def at(self, time: Number) -> "World":
        """Return the world at a time, s, or the same world if its water does not change."""
        if self.water is None or not self.changes:
            return self
        return dataclasses.replace(self, water=self.water.at(time))

    @property
    def changes(self) -> bool:
        """Whether the water's velocity changes in time."""
        return self.water is not None and self.water.changes

    def law(self, kind: type[_Law]) -> _Law | None:
        """Return the first force law of a kind, or None if there is none."""
        return next((law for law in self.forces if isinstance(law, kind)), None)

    @property
    def weight(self) -> Float[Array, ""]:
        """Weight of the animal out of the water, N."""
        return jnp.asarray(self.tree.mass).sum() * self.gravity

    @property
    def water_level(self) -> Number:
        """Height of the water's surface, m; infinite without a surface, -infinite without water."""
        if self.water is None:
            return -math.inf
        return math.inf if self.water.surface is None else self.water.surface

    @property
    def pair_names(self) -> list[tuple[str, str]]:
        """Names of the bodies of each pair that must not pass through each other."""
        if self.pairs is None:
            return []
        names = self.tree.names
        return [
            (names[i], names[j]) for i, j in zip(self.pairs.first, self.pairs.second, strict=True)
        ]

    @property
    def watched(self) -> SelfCollision:
        """Pairs of bodies whose overlap an audit measures.

        They are the pairs that the rule keeps apart without the user's settings, and `pairs`.
        """
        return SelfCollision(include=tuple(self.pair_names))

    @property
    def submerged(self) -> bool:
        """True if water is everywhere, without surface and ground."""
        return self.water is not None and self.water.surface is None and self.contact_model is None

    @property
    def ground(self) -> Ground | None:
        """The ground, or None without ground."""
        return None if self.contact_model is None else self.contact_model.ground

    def with_friction(self, factor: Float[Numbers, " *n"] | Array | float) -> "World":
        """Return the world with its static and dynamic friction scaled by a factor.

        Raises:
            ValueError: there is no ground.
        """
        if self.contact_model is None:
            raise ValueError("the world has no ground, so friction cannot be scaled")
        axes = (1,) * np.ndim(factor)
        factor = xp.asarray(factor)[None] if axes else factor
        static, dynamic = (
            mu.reshape(-1, *axes) * factor
            for mu in (self.contact_model.static_friction, self.contact_model.dynamic_friction)
        )
        rougher = self.contact_model._replace(static_friction=static, dynamic_friction=dynamic)
        return eqx.tree_at(lambda world: world.contact_model, self, rougher)

    def with_drag(self, factor: float) -> "World":
        """Return the world with both kinds of drag scaled by a factor.

        Raises:
            ValueError: there is no water.
        """
        if self.water is None:
            raise ValueError("the world has no water, so drag cannot be scaled")
        return dataclasses.replace(self, forces=tuple(law.scaled(factor) for law in self.forces))
