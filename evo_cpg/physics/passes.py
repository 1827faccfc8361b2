"""The motion of a step whose laws have kinks: motors with limits, contact with the ground.

Each pass replaces every law by a line that meets it at the motion found last (`Laws`), solves for
the motion under these lines, and looks at the laws again: Newton's method for the contacts that
open and close, with secants for friction and half secants for overloaded motors. Friction's limits
follow the normal forces from pass to pass.

After a few passes the forces are cut back to what motors and ground can give, and imposed. If all
has converged nothing changes by that. If not, forces that had balanced each other may not do so any
more, and the ground would throw the animal about: so contact forces are scaled down, all by the
same factor, until the ground does no work (`work_share`).

A line search between the passes was tried and gave nothing: of the points of tumbling quadrupeds as
many were too deep, for half as much work again.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from evo_cpg.fusion.converge import converge
from evo_cpg.physics.articulated import Accelerations, solve
from evo_cpg.physics.contact import (
    ContactLaw,
    Contacts,
    contact_equations,
    end_velocity,
    find_contacts,
    first_law,
    imposed_force,
    next_law,
    pressed,
    work_share,
)
from evo_cpg.physics.joints import (
    clamp_torque,
    overloaded,
    passive_torque,
    servo_slope,
    servo_torque,
)
from evo_cpg.physics.kinematics import Kinematics, kinematics
from evo_cpg.physics.spatial_algebra import Inertia, Wrench
from evo_cpg.physics.state import State
from evo_cpg.physics.world import World, body_equations
from evo_cpg.spatial.linear import expand_dims_like, matvec_t

# Solves with lines before the forces are imposed. On the ground: of the points of tumbling
# quadrupeds without motors, 1.2 % are more than 1 mm deep with 3, 0.75 % with 4. In water, for
# motors alone: of 200 random swimmers with limits of 20 (5) N m, 39 (28) diverge with 5, none (5)
# with 10.
_GROUND_PASSES, _MOTOR_PASSES = 4, 10

# Slope given to a saturated servo, as a share of its secant. With the tangent (0) the passes cycle
# between the two limits where inertias are small, and over half of such swimmers blew up. The
# secant (1) never overshoots but takes twice the passes; from 1/2 on convergence is assured,
# because the piecewise quadratic energy of the servos then lies below its model.
_SECANT_SHARE = 0.5


class Equations(NamedTuple):
    """What stays the same throughout the passes of a step.

    Attributes:
        kin, inertia, bias, passive, derivative: as `solve` takes them, without motors and ground.
        wanted: motor torques at the present rates, N m.
        contacts: None without ground.
    """

    kin: Kinematics
    inertia: Inertia
    bias: Wrench
    passive: Array
    derivative: Array
    wanted: Array
    contacts: Contacts | None


class Laws(NamedTuple):
    """Lines in the place of the laws.

    Attributes:
        torque: of the motors at the present rates, N m.
        slope: torque lost per end-of-step rate, N m s/rad.
        contact: None without ground.
    """

    torque: Array
    slope: Array
    contact: ContactLaw | None


class Imposed(NamedTuple):
    """What a step came to.

    Attributes:
        accelerations: of the creature.
        torque: that the motors applied, N m.
        support: force of the ground on every place, in its frame, N; None without ground.
        contact_force: the same in world axes.
    """

    accelerations: Accelerations
    torque: Float[Array, "d *n"]
    support: Float[Array, "3 p *n"] | None = None
    contact_force: Float[Array, "3 p *n"] | None = None


def prepare(
    world: World, h: float, state: State, target_rate: Array, target_angle: Array | None
) -> tuple[Equations, Laws]:
    """The equations of motion, and a first guess at the laws."""
    tree = world.tree
    with jax.named_scope("kinematics"):
        kin = kinematics(tree, state)
    with jax.named_scope("forces"):
        inertia, bias = body_equations(world, kin, h)
        passive, derivative = passive_torque(tree, state, h)
        derivative = derivative + expand_dims_like(tree.armature, derivative)
        wanted = servo_torque(tree, state, target_rate, target_angle, h)
        slope = jnp.broadcast_to(servo_slope(tree, wanted, h), wanted.shape)
        contacts = law = None
        if world.footing is not None:
            contacts = find_contacts(world.footing, kin, h)
            law = first_law(world.gravity, world.footing, contacts, h)
    equations = Equations(kin, inertia, bias, passive, derivative, wanted, contacts)
    return equations, Laws(wanted, slope, law)


def solve_with(world: World, h: float, equations: Equations, laws: Laws) -> Accelerations:
    """The motion under given lines."""
    inertia, bias = equations.inertia, equations.bias
    if world.footing is not None and equations.contacts is not None and laws.contact is not None:
        inertia, bias = contact_equations(
            world.footing, equations.contacts, laws.contact, inertia, bias, h
        )
    torque = equations.passive + laws.torque
    derivative = equations.derivative + h * laws.slope
    return solve(world.tree, equations.kin, inertia, bias, torque, derivative)


def search(
    world: World, h: float, state: State, target_rate: Array, target_angle: Array | None
) -> Imposed:
    """The motion under motors and ground, neither of which gives more than it can."""
    equations, laws = prepare(world, h, state, target_rate, target_angle)

    def again(laws: Laws) -> Laws:
        return _refined(world, h, equations, laws, solve_with(world, h, equations, laws))

    if world.footing is None:
        laws = converge(again, laws, _MOTOR_PASSES - 1)
    else:
        # Written out: what a round of a loop reads and writes would be more than the cache holds.
        for _ in range(_GROUND_PASSES - 1):
            laws = again(laws)
    found = solve_with(world, h, equations, laws)
    return _impose(world, h, equations, *_cut_back(world, h, equations, laws, found))


def _refined(
    world: World, h: float, equations: Equations, laws: Laws, found: Accelerations
) -> Laws:
    """Lines that meet the laws at the motion found with the last ones."""
    wanted = equations.wanted
    gain = servo_slope(world.tree, wanted, h)
    asked = wanted - h * gain * found.qdd
    limit = clamp_torque(world.tree, asked)
    over = overloaded(world.tree, asked)
    secant = gain * limit / jnp.where(over, asked, 1.0)
    slope = jnp.where(over, _SECANT_SHARE * secant, gain)
    torque = jnp.where(over, limit + h * slope * found.qdd, wanted)
    footing, contacts, law = world.footing, equations.contacts, laws.contact
    if footing is not None and contacts is not None and law is not None:
        velocity = end_velocity(footing, contacts, found, h)
        law = next_law(footing, contacts, law, velocity, h)
    return Laws(torque, slope, law)


def _cut_back(
    world: World, h: float, equations: Equations, laws: Laws, found: Accelerations
) -> tuple[Float[Array, "d *n"], Float[Array, "3 p *n"] | None]:
    """The motor torques and contact forces found, as far as motors and ground can give them."""
    gain = servo_slope(world.tree, equations.wanted, h)
    torque = clamp_torque(world.tree, equations.wanted - h * gain * found.qdd)
    footing, contacts, law = world.footing, equations.contacts, laws.contact
    if footing is None or contacts is None or law is None:
        return torque, None
    velocity = end_velocity(footing, contacts, found, h)
    return torque, imposed_force(footing, contacts, law, velocity)


def _impose(
    world: World, h: float, equations: Equations, torque: Array, force: Array | None
) -> Imposed:
    """The motion under given torques, and as much of the given forces as does no work."""
    held = Laws(torque, jnp.zeros_like(torque), None)
    footing, contacts = world.footing, equations.contacts
    if footing is None or contacts is None or force is None:
        return Imposed(solve_with(world, h, equations, held), torque)
    loaded = equations._replace(bias=pressed(footing, contacts, force, equations.bias))
    given, free = (solve_with(world, h, some, held) for some in (loaded, equations))
    velocity, without = (end_velocity(footing, contacts, some, h) for some in (given, free))
    share = work_share(contacts, force, velocity, without)

    def shared(alone: Array, loaded: Array) -> Array:
        return alone + jnp.expand_dims(share, tuple(range(alone.ndim - share.ndim))) * (
            loaded - alone
        )

    support = shared(jnp.zeros_like(force), force)
    contact_force = matvec_t(contacts.frame, support)
    return Imposed(jax.tree.map(shared, free, given), torque, support, contact_force)
