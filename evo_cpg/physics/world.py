"""A creature and its surroundings, and the forces that are smooth in its velocities."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from evo_cpg.creature.tree import Tree
from evo_cpg.physics.added_mass import carried_water
from evo_cpg.physics.buoyancy import Cells, Displacement, buoyancy, displacement
from evo_cpg.physics.current import stream
from evo_cpg.physics.fluid import Patch, Water, drag
from evo_cpg.physics.footing import Footing, Ground
from evo_cpg.physics.gyroscopic import gyroscopic_change
from evo_cpg.physics.kinematics import Kinematics
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
from evo_cpg.spatial.numerics import Number, Numbers


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
    def submerged(self) -> bool:
        """Whether the creature is in deep water, always and everywhere."""
        return self.water is not None and self.water.surface is None and self.footing is None

    @property
    def ground(self) -> Ground | None:
        """None where there is nothing to stand on."""
        return None if self.footing is None else self.footing.ground


def body_equations(world: World, kin: Kinematics, h: float) -> tuple[Inertia, Wrench]:
    """Inertia ``I + h D`` and bias wrench of every body, in world axes.

    With drag, weight and buoyancy; contacts join later (`evo_cpg.physics.newton`).
    """
    tree = world.tree
    rotation = kin.rotation
    velocity = jnp.concatenate([matvec_t(rotation, kin.angular), matvec_t(rotation, kin.linear)])
    pose = displaced = None
    if world.water is not None and world.water.surface is not None:
        pose = jnp.concatenate([rotation[2], (kin.origin[2] - world.water.surface)[None]])
        displaced = displacement(world.cells, pose)
    wrench = weight(world, kin, displaced)
    constant = expand_dims_like(tree.inertia, velocity, velocity.ndim + 1)
    momentum = matvec(constant, velocity)
    blocks = _blocks(constant)
    if world.water is not None:
        current = matvec_t(rotation, _stream(world.water, tree, kin))
        relative = jnp.concatenate([velocity[:3], velocity[3:] - current])
        resistance, derivative = drag(world.water, world.patches, relative, pose)
        wrench = wrench + resistance
        blocks = blocks + h * derivative
        if world.added_inertia is not None:
            added = expand_dims_like(world.added_inertia, velocity, velocity.ndim + 1)
            push, carried = _carried(world, kin, velocity, added, current, h, pose, displaced)
            wrench, blocks = wrench + push, blocks + carried
    w, v = velocity[:3], velocity[3:]
    moment = cross(w, momentum[:3]) + cross(v, momentum[3:]) - wrench[:3]
    force = cross(w, momentum[3:]) - wrench[3:]
    if not world.submerged:
        # In water drag holds spins back.
        moment = moment + gyroscopic_change(tree, w, h)

    angular, mixed, linear = (matmul_t(matmul(rotation, block), rotation) for block in blocks)
    inertia = make_inertia(angular, mixed, linear)
    bias = Wrench(
        matvec(rotation, moment)
        + matvec(inertia.angular, kin.bias_angular)
        + matvec(inertia.mixed, kin.bias_linear),
        matvec(rotation, force)
        + matvec_t(inertia.mixed, kin.bias_angular)
        + matvec(inertia.linear, kin.bias_linear),
    )
    return inertia, bias


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


def _stream(water: Water, tree: Tree, kin: Kinematics) -> Float[Array, "3 b *#n"]:
    """Velocity of the water at the bodies' centres of mass, in world axes."""
    if water.gradient is None and not water.vortices:
        return expand_dims_like(array_of(water.current), kin.linear)
    centres = kin.origin + matvec(kin.rotation, expand_dims_like(tree.com, kin.origin))
    return stream(water.current, water.gradient, water.vortices, centres)


def _carried(
    world: World,
    kin: Kinematics,
    velocity: Float[Array, "6 b *n"],
    added: Float[Array, "6 6 b *#n"],
    current: Float[Array, "3 b *#n"],
    h: float,
    pose: Float[Array, "4 b *n"] | None,
    displaced: Displacement | None,
) -> tuple[Float[Array, "6 b *n"], Float[Array, "3 3 3 b *n"]]:
    """Wrench (body axes) and inertia of the water that the bodies carry along.

    At a surface it is the share of the body's volume that is under water; what more gets under
    within the step is set in motion by an impact without bounce.
    """
    if pose is None or displaced is None:
        return carried_water(added, velocity, current), _blocks(added)
    sinking = h * jnp.concatenate([cross(pose[:3], velocity[:3]), kin.linear[2:]])
    ahead = displacement(world.cells, pose + sinking).volume
    volume = expand_dims_like(world.tree.volume, ahead)
    gained = jnp.maximum(ahead - displaced.volume, 0.0) / volume
    entering = added * gained[None, None]
    relative = jnp.concatenate([velocity[:3], velocity[3:] - current])
    own = added * (displaced.volume / volume)[None, None]
    impact = -matvec(entering, relative) / h
    return impact + carried_water(own, velocity, current), _blocks(entering) + _blocks(own)


def _blocks(m: Float[Array, "6 6 *rest"]) -> Float[Array, "3 3 3 *rest"]:
    """Angular-angular, angular-linear and linear-linear part of a symmetric matrix."""
    return jnp.stack([m[:3, :3], m[:3, 3:], m[3:, 3:]])
