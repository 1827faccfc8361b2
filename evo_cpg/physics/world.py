"""A creature and its surroundings, and the forces that are smooth in its velocities."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from evo_cpg.creature.self_collision import SelfCollision
from evo_cpg.creature.tree import Tree
from evo_cpg.physics.added_mass import carried_water
from evo_cpg.physics.buoyancy import Cells, Displacement, buoyancy, displacement
from evo_cpg.physics.current import stream
from evo_cpg.physics.fluid import Patch, Water, drag
from evo_cpg.physics.footing import Footing, Ground
from evo_cpg.physics.gyroscopic import central_inertia, gyroscopic_change
from evo_cpg.physics.kinematics import Kinematics, Motion
from evo_cpg.physics.pairs import Pairs
from evo_cpg.physics.spatial_algebra import Inertia, Wrench, make_inertia
from evo_cpg.spatial.linear import (
    array_of,
    cross,
    expand_dims_like,
    matmul,
    matmul_t,
    matvec,
    matvec_t,
)
from evo_cpg.spatial.numerics import Number, Numbers, is_traced, xp

# Radius of gyration below which rounding would turn a body that falls, m.
_TURNS_EASILY = 0.01


class World(eqx.Module):
    """A creature and its surroundings, ready to be stepped.

    Attributes:
        tree: the creature.
        gravity: m/s^2, pulling along -z.
        water: None on dry land.
        patches: the surface points that meet the water.
        footing: the contact points; None where there is nothing to stand on.
        cells: the bodies' volumes; none are needed where water is everywhere.
        added_inertia: of the water that the bodies carry; None to leave it out.
        pairs: bodies that must not pass through each other; None where none can meet.
    """

    tree: Tree
    gravity: Number
    water: Water | None = None
    patches: tuple[Patch, ...] = ()
    footing: Footing | None = None
    cells: tuple[Cells, ...] = ()
    added_inertia: Float[Numbers, "6 6 b"] | None = None
    pairs: Pairs | None = None

    def __repr__(self) -> str:
        water = "no water" if self.water is None else "water everywhere"
        if self.water is not None and self.water.surface is not None:
            water = f"water up to {self.water.surface} m"
        ground = "no ground" if self.footing is None else "ground"
        return f"World(gravity {self.gravity} m/s^2, {water}, {ground})"

    @property
    def pair_names(self) -> list[tuple[str, str]]:
        """Bodies that must not pass through each other."""
        if self.pairs is None:
            return []
        names = self.tree.names
        return [
            (names[i], names[j]) for i, j in zip(self.pairs.first, self.pairs.second, strict=True)
        ]

    @property
    def watched(self) -> SelfCollision:
        """Bodies of which an audit asks how deep they get into each other.

        Those that the rule keeps apart, whatever the user says, and those that are kept apart
        besides.
        """
        return SelfCollision(include=tuple(self.pair_names))

    @property
    def submerged(self) -> bool:
        """Whether the creature is in deep water, always and everywhere."""
        return self.water is not None and self.water.surface is None and self.footing is None

    @property
    def ground(self) -> Ground | None:
        """None where there is nothing to stand on."""
        return None if self.footing is None else self.footing.ground

    def with_friction(self, factor: Float[Numbers, " *n"] | Array | float) -> "World":
        """The same on ground with more or less friction, static and dynamic.

        Raises:
            ValueError: there is no ground.
        """
        if self.footing is None:
            raise ValueError("there is no ground to be rough")
        axes = (1,) * np.ndim(factor)
        factor = xp.asarray(factor)[None] if axes else factor
        static, dynamic = (
            mu.reshape(-1, *axes) * factor
            for mu in (self.footing.static_friction, self.footing.dynamic_friction)
        )
        rougher = self.footing._replace(static_friction=static, dynamic_friction=dynamic)
        return eqx.tree_at(lambda world: world.footing, self, rougher)


class Immersion(NamedTuple):
    """How the bodies lie and move in the water.

    Attributes:
        velocity: of every body relative to the water, in body axes: angular, then linear.
        stream: velocity of the water at the bodies' centres of mass, in body axes, m/s.
        pose: upward unit vector in the axes of every body, and the height of its origin above the
            surface, m; None where water is everywhere.
        displaced: likewise.
    """

    velocity: Float[Array, "6 b *n"]
    stream: Float[Array, "3 b *#n"]
    pose: Float[Array, "4 b *n"] | None
    displaced: Displacement | None


def immersion(world: World, kin: Kinematics) -> Immersion | None:
    """See `Immersion`; None on dry land."""
    water = world.water
    if water is None:
        return None
    velocity = body_velocity(kin)
    current = matvec_t(kin.rotation, _stream(water, world.tree, kin))
    relative = jnp.concatenate([velocity[:3], velocity[3:] - current])
    pose = displaced = None
    if water.surface is not None:
        pose = jnp.concatenate([kin.rotation[2], (kin.origin[2] - water.surface)[None]])
        displaced = displacement(world.cells, pose)
    return Immersion(relative, current, pose, displaced)


def body_velocity(kin: Kinematics) -> Float[Array, "6 b *n"]:
    """Of the bodies at their origins, in body axes: angular (rad/s), then linear (m/s)."""
    return _in_body_axes(kin.rotation, kin.angular, kin.linear)


def body_equations(world: World, kin: Kinematics, h: float) -> tuple[Inertia, Wrench]:
    """Inertia ``I + h D`` and bias wrench of every body, in world axes.

    With drag, weight and buoyancy; `evo_cpg.physics.step_problem` adds contacts. Drag depends on
    velocities as the pose at the start of the step has them, so D is not in the bias wrench, which
    is for velocity-product accelerations: these are of the pose as it changes.
    """
    tree = world.tree
    rotation = kin.rotation
    velocity, wet = body_velocity(kin), immersion(world, kin)
    wrench = weight(world, kin, wet.displaced if wet else None)
    constant = expand_dims_like(tree.inertia, velocity, velocity.ndim + 1)
    blocks = _blocks(constant)
    accelerations = _in_body_axes(rotation, kin.bias_angular, kin.bias_linear)
    wrench = wrench - matvec(constant, accelerations)
    if world.water is not None and wet is not None:
        resistance, derivative = drag(world.water, world.patches, wet.velocity, wet.pose)
        wrench = wrench + resistance
        blocks = blocks + h * derivative
        if world.added_inertia is not None:
            own, entering = _carried_inertia(world, kin, velocity, wet, h)
            wrench = wrench + carried_water(own, velocity, wet.stream)
            wrench = wrench - matvec(own, accelerations) - matvec(entering, wet.velocity) / h
            blocks = blocks + _blocks(own) + _blocks(entering)
    needed = _gyration(world, velocity) - wrench
    moment, force = needed[:3], needed[3:]
    if not world.submerged:
        # In water drag holds spins back.
        moment = moment + gyroscopic_change(tree, velocity[:3], h)
    angular, mixed, linear = (matmul_t(matmul(rotation, block), rotation) for block in blocks)
    bias = Wrench(matvec(rotation, moment), matvec(rotation, force))
    return make_inertia(angular, mixed, linear), bias


def bias_of_mean(world: World, kin: Kinematics, moving: Motion, h: float) -> Wrench:
    """What the mean of two motions' velocity products adds to the bias wrench, world axes.

    Args:
        world: the creature and its surroundings.
        kin: kinematics at the start of the step.
        moving: how its bodies move at the end, in the same pose.
        h: s.
    """
    rotation, tree = kin.rotation, world.tree
    velocity = body_velocity(kin)
    other = _in_body_axes(rotation, moving.angular, moving.linear)
    accelerations = _in_body_axes(
        rotation, moving.bias_angular - kin.bias_angular, moving.bias_linear - kin.bias_linear
    )
    constant = expand_dims_like(tree.inertia, velocity, velocity.ndim + 1)
    needed = _gyration(world, other) - _gyration(world, velocity)
    needed = needed + matvec(constant, accelerations)
    wet = immersion(world, kin)
    if wet is not None and world.added_inertia is not None:
        own, _ = _carried_inertia(world, kin, velocity, wet, h)
        needed = needed + carried_water(own, velocity, wet.stream)
        needed = needed - carried_water(own, other, wet.stream) + matvec(own, accelerations)
    moment, force = 0.5 * needed[:3], 0.5 * needed[3:]
    if not world.submerged:
        moment = moment - gyroscopic_change(tree, velocity[:3], h)
    return Wrench(matvec(rotation, moment), matvec(rotation, force))


def _in_body_axes(
    rotation: Float[Array, "3 3 b *n"], angular: Float[Array, "3 b *n"], linear: Array
) -> Float[Array, "6 b *n"]:
    return jnp.concatenate([matvec_t(rotation, angular), matvec_t(rotation, linear)])


def _gyration(world: World, velocity: Float[Array, "6 b *n"]) -> Float[Array, "6 b *n"]:
    """``V x* I V``."""
    inertia = expand_dims_like(world.tree.inertia, velocity, velocity.ndim + 1)
    momentum, w, v = matvec(inertia, velocity), velocity[:3], velocity[3:]
    across = momentum[3:]
    small = _turn_easily(world.tree)
    # In deep water drag holds bodies back that fall.
    if not world.submerged and (is_traced(small) or small.any()):
        # The part m v of the momentum adds nothing but rounding to the moment v x m v.
        without = xp.where(small[None, None], 0.0, world.tree.inertia[3:, 3:])
        rows = xp.concatenate([world.tree.inertia[3:, :3], without], 1)
        across = matvec(expand_dims_like(rows, velocity, velocity.ndim + 1), velocity)
    moment = cross(w, momentum[:3]) + cross(v, across)
    return jnp.concatenate([moment, cross(w, momentum[3:])])


def _turn_easily(tree: Tree) -> Bool[Numbers, " b"]:
    """Bodies that rounding of ``v x m v`` would turn, by about ``1e-7 v^2 / r^2`` rad/s^2.

    Larger bodies keep the rounding of earlier versions.
    """
    least = xp.diagonal(central_inertia(tree)).min(1)
    return least < _TURNS_EASILY**2 * tree.mass


def _carried_inertia(
    world: World, kin: Kinematics, velocity: Float[Array, "6 b *n"], wet: Immersion, h: float
) -> tuple[Float[Array, "6 6 b *#n"], Float[Array, "6 6 b *#n"]]:
    """Inertia of the water that the bodies carry along, and of what they set in motion.

    At a surface it is the share of the body's volume that is under water; what more gets under
    within the step is set in motion by an impact without bounce.
    """
    assert world.added_inertia is not None
    added = expand_dims_like(world.added_inertia, velocity, velocity.ndim + 1)
    if wet.pose is None or wet.displaced is None:
        return added, jnp.zeros_like(added)
    sinking = h * jnp.concatenate([cross(wet.pose[:3], velocity[:3]), kin.linear[2:]])
    ahead = displacement(world.cells, wet.pose + sinking).volume
    volume = expand_dims_like(world.tree.volume, ahead)
    gained = jnp.maximum(ahead - wet.displaced.volume, 0.0) / volume
    return added * (wet.displaced.volume / volume)[None, None], added * gained[None, None]


def weight(
    world: World, kin: Kinematics, displaced: Displacement | None = None
) -> Float[Array, "6 b *n"]:
    """Weight and buoyancy, in body axes (Iwadate 2010, eq. 7).

    Args:
        world: the creature and its surroundings.
        kin: its present kinematics.
        displaced: at a surface; None where the whole creature is in water or on dry land, and all
            acts at the centre of mass.
    """
    tree, water = world.tree, world.water
    under = water.density * tree.volume if water is not None and displaced is None else 0.0
    up = kin.rotation[2]
    force = expand_dims_like((under - tree.mass) * world.gravity, up[0])[None] * up
    wrench = jnp.concatenate([cross(expand_dims_like(tree.com, up), force), force])
    if water is None or displaced is None:
        return wrench
    return wrench + buoyancy(displaced, up, water.density * world.gravity)


def buoyancy_wrench(world: World, kin: Kinematics, wet: Immersion) -> Float[Array, "6 b *n"]:
    """Of the water that bodies push aside, in body axes: what `weight` has beside the weight."""
    up = kin.rotation[2]
    pull = expand_dims_like(world.tree.mass * world.gravity, up[0])[None] * up
    arm = expand_dims_like(world.tree.com, up)
    return weight(world, kin, wet.displaced) + jnp.concatenate([cross(arm, pull), pull])


def _stream(water: Water, tree: Tree, kin: Kinematics) -> Float[Array, "3 b *#n"]:
    """Velocity of the water at the bodies' centres of mass, in world axes."""
    if water.gradient is None and not water.vortices:
        return expand_dims_like(array_of(water.current), kin.linear)
    centres = kin.origin + matvec(kin.rotation, expand_dims_like(tree.com, kin.origin))
    return stream(water.current, water.gradient, water.vortices, centres)


def _blocks(m: Float[Array, "6 6 *rest"]) -> Float[Array, "3 3 3 *rest"]:
    """Angular-angular, angular-linear and linear-linear part of a symmetric matrix."""
    return jnp.stack([m[:3, :3], m[:3, 3:], m[3:, 3:]])
