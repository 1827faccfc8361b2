"""The state of the whole animal at an instant, for tasks and sensors.

Derived quantities are computed on access only, so unused ones cost nothing. Bodies and degrees of
freedom are in the order of the tree (`Snapshot.body` and `Snapshot.dof` find them by name). Contact
points are in the order of the contact model. Trailing axes are individuals.
"""

import dataclasses
import functools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float, Int

from evo_cpg.creature.algebra.linear import cross, expand_dims_like, matvec
from evo_cpg.creature.algebra.numerics import Numbers
from evo_cpg.creature.per_body import take
from evo_cpg.physics.contact.contact_points import contact_points
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.kinematics import Kinematics, kinematics
from evo_cpg.physics.tree.state import State


class Forces(NamedTuple):
    """Forces of motors and ground, means over the physics steps of a control step.

    Attributes:
        torque: torque of the motors, N m.
        contact_force: force of the ground on every contact point, world axes, N. There are no
            points without ground.
        pair_force: force between touching limbs, at every point of the pairs in ``world.pairs``
            (`Pairs.owners`), N. There are no points if no limbs can touch.
        holding: moment (N m) about the root's centre and force (N) that hold the root still, world
            axes, or None for a free root.
        acceleration: change of the velocities of the bodies' centres, divided by the duration,
            m/s^2, or None if no sensor needs it.
    """

    torque: Float[Array, "d *n"]
    contact_force: Float[Array, "3 p *n"]
    pair_force: Float[Array, "k *n"]
    holding: Float[Array, "6 *n"] | None = None
    acceleration: Float[Array, "3 b *n"] | None = None


@dataclasses.dataclass(frozen=True)
class Snapshot:
    """Pose and velocities of the animal in its world.

    Attributes:
        world: model of the animal and its environment: ``world.tree.mass`` (kg),
            ``world.gravity`` (m/s^2), ``world.water``, ``world.ground``.
        control_step: length of a control step, s.
        state: pose and velocity of the root, joint angles and rates.
        light_position: place of the light in this trial, m, or None for a task without a light.
    """

    world: World
    control_step: float
    state: State
    light_position: Float[Array, "3 *#n"] | None = None

    @functools.cached_property
    def kinematics(self) -> Kinematics:
        """Positions, axes and velocities of the bodies' origins (`tree.kinematics`)."""
        return kinematics(self.world.tree, self.state)

    @property
    def rotation(self) -> Float[Array, "3 3 b *n"]:
        """Rotations from body to world axes."""
        return self.kinematics.rotation

    @functools.cached_property
    def position(self) -> Float[Array, "3 b *n"]:
        """Centres of the bodies in the world, m: centres of mass of bodies of uniform density."""
        return self.kinematics.origin + self._lever_of(self.world.tree.centre)

    @functools.cached_property
    def velocity(self) -> Float[Array, "3 b *n"]:
        """Velocities of the bodies' centres, m/s."""
        lever = self._lever_of(self.world.tree.centre)
        return self.kinematics.linear + cross(self.kinematics.angular, lever)

    @property
    def angular_velocity(self) -> Float[Array, "3 b *n"]:
        """Angular velocities of the bodies, world axes, rad/s."""
        return self.kinematics.angular

    @functools.cached_property
    def centre_of_mass(self) -> Float[Array, "3 *n"]:
        """Centre of mass of the whole animal, m."""
        if self.world.tree.centre_of_volume is None:
            return self._mean(self.position)
        return self._mean(self.kinematics.origin + self._lever_of(self.world.tree.com))

    @functools.cached_property
    def centre_of_mass_velocity(self) -> Float[Array, "3 *n"]:
        """Velocity of the whole animal's centre of mass, m/s."""
        if self.world.tree.centre_of_volume is None:
            return self._mean(self.velocity)
        kin = self.kinematics
        return self._mean(kin.linear + cross(kin.angular, self._lever_of(self.world.tree.com)))

    @property
    def contact_bodies(self) -> Int[np.ndarray, " p"]:
        """Index of the body that each contact point belongs to."""
        contact_model = self.world.contact_model
        return np.array(() if contact_model is None else contact_model.bodies, int)

    @property
    def contact_position(self) -> Float[Array, "3 p *n"]:
        """Contact points in the world, m: lowest corners, and lowest points of round shapes."""
        offset, _ = self._lowest
        return take(self.kinematics.origin, self.contact_bodies) + offset

    @property
    def contact_velocity(self) -> Float[Array, "3 p *n"]:
        """Velocities of the material at the contact points, m/s."""
        offset, _ = self._lowest
        linear, angular = (
            take(x, self.contact_bodies) for x in (self.kinematics.linear, self.angular_velocity)
        )
        return linear + cross(angular, offset)

    @property
    def clearance(self) -> Float[Array, "p *n"]:
        """Heights of the contact points above the ground, m, negative where they penetrate."""
        return self._lowest[1]

    def body(self, name: str) -> int:
        """Return the index of a body.

        Raises:
            ValueError: no body has that name.
        """
        return _index(self.world.tree.names, name, "body")

    def dof(self, name: str) -> int:
        """Return the index of a degree of freedom, ``body.axis``.

        Raises:
            ValueError: no degree of freedom has that name.
        """
        return _index(self.world.tree.dof_names, name, "degree of freedom")

    def contacts_of(self, names: Sequence[str]) -> Int[np.ndarray, " k"]:
        """Return the indices of the contact points of some bodies, with their further parts.

        Raises:
            ValueError: no body has that name.
        """
        wholes = np.array(self.world.tree.wholes)[self.contact_bodies]
        return np.flatnonzero(np.isin(wholes, [self.body(name) for name in names]))

    def _lever_of(self, place: Float[Numbers, "3 b"]) -> Array:
        """Return vectors from the bodies' origins to places on them, world axes."""
        return matvec(self.rotation, expand_dims_like(place, self.kinematics.origin))

    @functools.cached_property
    def _lowest(self) -> tuple[Array, Array]:
        """Vectors from the bodies' origins to the contact points (world axes), and clearances."""
        if self.world.contact_model is None:
            origin = self.kinematics.origin
            return origin[:, :0], origin[0, :0]
        offset, _, gap, *_ = contact_points(self.world.contact_model, self.kinematics)
        return offset, gap

    def _mean(self, of_bodies: Float[Array, "3 b *n"]) -> Float[Array, "3 *n"]:
        """Return the mean over the bodies, weighted by mass."""
        mass = expand_dims_like(self.world.tree.mass, of_bodies[0])
        return (of_bodies * mass[None]).sum(1) / mass.sum()


def _index(names: tuple[str, ...], name: str, kind: str) -> int:
    if name not in names:
        raise ValueError(f"there is no {kind} {name!r}. Allowed: {', '.join(names)}")
    return names.index(name)
