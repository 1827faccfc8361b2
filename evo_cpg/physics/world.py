"""A creature and its surroundings, and the forces that are smooth in its velocities."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from evo_cpg.creature.tree import Tree
from evo_cpg.fusion.kernels import symmetric
from evo_cpg.physics.articulated import Inertia, Wrench
from evo_cpg.physics.contact import Footing, Ground
from evo_cpg.physics.fluid import Patch, Water, drag
from evo_cpg.physics.kinematics import Kinematics
from evo_cpg.spatial.linear import cross, lift, matmul, matmul_t, matvec, matvec_t


class World(eqx.Module):
    """A creature and its surroundings, ready to be stepped.

    Attributes:
        tree: the creature.
        gravity: m/s^2, pulling along -z.
        water: None on dry land.
        patches: the surface points that meet the water.
        footing: the places that may touch the ground; None where there is nothing to stand on.
    """

    tree: Tree
    gravity: float
    water: Water | None = None
    patches: tuple[Patch, ...] = ()
    footing: Footing | None = None

    @property
    def ground(self) -> Ground | None:
        """None where there is nothing to stand on."""
        return None if self.footing is None else self.footing.ground


def body_equations(world: World, kin: Kinematics, h: float) -> tuple[Inertia, Wrench]:
    """Inertia ``I + h D`` and bias wrench of every body, in world axes.

    With drag, weight and buoyancy; contacts join later (`evo_cpg.physics.passes`).
    """
    tree = world.tree
    rotation = kin.rotation
    velocity = jnp.concatenate([matvec_t(rotation, kin.angular), matvec_t(rotation, kin.linear)])
    wrench = weight(world, kin)
    constant = lift(tree.inertia, velocity, velocity.ndim + 1)
    momentum = matvec(constant, velocity)
    blocks = jnp.stack([constant[:3, :3], constant[:3, 3:], constant[3:, 3:]])
    if world.water is not None:
        current = jnp.asarray(world.water.current, velocity.dtype)
        stream = matvec_t(rotation, lift(current, kin.linear))
        relative = jnp.concatenate([velocity[:3], velocity[3:] - stream])
        resistance, derivative = drag(world.water, world.patches, relative)
        wrench = wrench + resistance
        blocks = blocks + h * derivative
    w, v = velocity[:3], velocity[3:]
    moment = cross(w, momentum[:3]) + cross(v, momentum[3:]) - wrench[:3]
    force = cross(w, momentum[3:]) - wrench[3:]

    angular, mixed, linear = (matmul_t(matmul(rotation, block), rotation) for block in blocks)
    inertia = Inertia(symmetric(angular), mixed, symmetric(linear))
    bias = Wrench(
        matvec(rotation, moment)
        + matvec(inertia.angular, kin.bias_angular)
        + matvec(inertia.mixed, kin.bias_linear),
        matvec(rotation, force)
        + matvec_t(inertia.mixed, kin.bias_angular)
        + matvec(inertia.linear, kin.bias_linear),
    )
    return inertia, bias


def weight(world: World, kin: Kinematics) -> Float[Array, "6 b *n"]:
    """Weight less buoyancy, both at the centre of mass, in body axes (Iwadate 2010, eq. 7)."""
    tree = world.tree
    displaced = world.water.density * tree.volume if world.water is not None else 0.0
    up = kin.rotation[2]
    force = lift((displaced - tree.mass) * world.gravity, up[0])[None] * up
    return jnp.concatenate([cross(lift(tree.com, up), force), force])
