"""Forces on a creature at rest, as functions of its pose.

Small coordinates x = (d, r, a) describe a pose near another one. They are the displacement d of the
root's centre (m), the rotation vector r of the root (rad), both in world axes, and the change a of
the joint angles (rad). Virtual work gives the generalised forces

    Q = (F, M, axis . M_outward + torque).

F and M are the sums of forces and of moments about the root's centre. M_outward is the sum of
moments on all bodies beyond a joint. The forces are weight, buoyancy, the ground, and all force
laws except the water's. Springs, soft limits and motors exert the torques. The motors hold their
joints at the neutral angle. Muscles are relaxed. Q vanishes at an equilibrium, and -dQ/dx is its
stiffness. The joint of a root that hangs on the world bears F and M, which then are zero.

The ground has the stiffness of a resting contact in a step of the simulation (`static_forces`). The
simulation therefore finds no motion in an equilibrium found here. Friction is Coulomb's law. A
spring of that stiffness holds a sticking point where it touched down. A point beyond the friction
cone slides. Friction then opposes the slip with its largest force.

Differs from the simulation, whose friction is a velocity law. A point with the tangential force f
creeps there at ``f / c`` (see `evo_cpg.physics.contact.contact`). Here it stays. The forces
nevertheless balance in the same poses. A slip s here has the force of the speed ``s / (5 h)``
there, because a fifth of a penetration is undone in a step of h.
"""

import dataclasses
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.creature.algebra.linear import cross, dot, expand_dims_like, matvec, matvec_t
from evo_cpg.creature.per_body import take
from evo_cpg.creature.tree import Tree
from evo_cpg.physics.contact.contact import BAUMGARTE_FRACTION
from evo_cpg.physics.contact.contact_points import contact_points
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree import joints
from evo_cpg.physics.tree.ball_limit import ball_laws
from evo_cpg.physics.tree.joint_torque import (
    Coordinates,
    MotorCommand,
    clamp_torque,
    limit_torque,
    motor_torque,
    passive_torque,
)
from evo_cpg.physics.tree.kinematics import kinematics
from evo_cpg.physics.tree.spatial_algebra import Wrench
from evo_cpg.physics.tree.state import State, resting_state
from evo_cpg.physics.tree.tendon import length_of, passive_force, torque_of
from evo_cpg.physics.water.force_law import weight


class FrictionState(NamedTuple):
    """Friction state of every contact point.

    Attributes:
        point: the body's contact point in the base pose, in body axes, m.
        place: position of the contact point in the base pose, in the world, m.
        slip: displacement from where the point touched down, m.
        limit: slip at which friction is largest, m. It is computed from the normal force in the
            base pose and then fixed, so that friction has a potential.
    """

    point: Float[Array, "3 p"]
    place: Float[Array, "3 p"]
    slip: Float[Array, "3 p"]
    limit: Float[Array, " p"]


class Touch(NamedTuple):
    """State of every contact point in a pose.

    Attributes:
        point: the body's contact point in this pose, in body axes, m.
        place: position of the contact point in the world, m.
        normal_force: normal force, N.
        slip: displacement from where the point touched down, m.
        limit: slip at which friction is largest with this normal force, m.
    """

    point: Float[Array, "3 p"]
    place: Float[Array, "3 p"]
    normal_force: Float[Array, " p"]
    slip: Float[Array, "3 p"]
    limit: Float[Array, " p"]


def static_forces(
    world: World, h: float, base: State, friction: FrictionState, x: Float[Array, " k"]
) -> tuple[Float[Array, " k"], Touch]:
    """Return the generalised forces on a creature at rest.

    Args:
        world: the creature and its environment. The water is taken as still.
        h: step of the simulation, which determines how far the creature sinks into the ground, s.
        base: pose from which x is measured.
        friction: friction state at the base.
        x: coordinates of the pose, m and rad.

    Returns:
        Forces (N) and torques (N m), and the state of the contact points.
    """
    tree, state = world.tree, base.displaced(world.tree, x)
    kin = kinematics(tree, state)
    bodies = world.bodies(kin, h)
    wrench = weight(bodies)
    still = dataclasses.replace(bodies, stream=jnp.zeros_like(bodies.stream))
    for law in world.forces:
        if not law.of_water:
            wrench = wrench + law.wrench(still)
    moment, force = matvec(kin.rotation, wrench[:3]), matvec(kin.rotation, wrench[3:])
    touch = Touch(*friction[:2], friction.limit, *friction[2:])
    if world.contact_model is not None:
        model, owners = world.contact_model, np.array(world.contact_model.bodies)
        rotation, origin = take(kin.rotation, owners, 2), take(kin.origin, owners)
        offset, _, gap, normal, *_ = contact_points(model, kin)
        # Normal force per depth (N/m), from v* = v_n + f_n / c. It holds up to a depth of 5/2 h m
        # (h in s), beyond which the exit speed is constant.
        stiffness = expand_dims_like(model.stiffness * BAUMGARTE_FRACTION / h**2, gap)
        depth, place = jnp.maximum(-gap, 0.0), origin + offset
        now = origin + matvec(rotation, friction.point)
        slip = friction.slip + now - friction.place
        slip = slip - dot(slip, normal)[None] * normal
        limit = expand_dims_like(model.static_friction, gap) * depth
        square, most = dot(slip, slip), friction.limit
        slides = square > most * most
        # Avoid the square root of 0, which has no derivative.
        size = jnp.sqrt(jnp.where(slides, square, 1.0))
        tangential = jnp.where(slides, most / size, 1.0)[None] * slip
        push = stiffness[None] * (depth[None] * normal - jnp.where(gap < 0, tangential, 0.0))
        touch = Touch(matvec_t(rotation, offset), place, stiffness * depth, slip, limit)
        owner = (owners[:, None] == np.arange(tree.body_count)).astype(float)
        moment, force = moment + cross(place - origin, push) @ owner, force + push @ owner
    # Moments about the world's origin add up over the bodies that a joint carries.
    about = moment + cross(kin.origin, force)
    # A table with 1 where a degree of freedom carries a body.
    chains = np.eye(tree.body_count)
    for i in range(1, tree.body_count):
        chains[i] += chains[tree.parents[i]]
    carried = chains[:, list(tree.dof_bodies)]
    joint = take(kin.origin, np.array(tree.dof_bodies, int))
    beyond = Wrench(about @ carried - cross(joint, force @ carried), force @ carried)
    on_joints = joints.torque_on_each(kin.axes, beyond)
    total, turning = force.sum(1), about.sum(1)
    on_root = total, turning - cross(state.position, total)
    if tree.hanging is not None:
        on_root = jnp.zeros_like(total), jnp.zeros_like(turning)
    return jnp.concatenate([*on_root, on_joints + joint_torque(tree, state.q)]), touch


def joint_torque(tree: Tree, q: Float[Array, " d"]) -> Float[Array, " d"]:
    """Return the torque of springs, limits, tendons and motors that hold the neutral pose, N m."""
    zero = jnp.zeros_like(q)
    state = resting_state(tree, (), q.dtype, angles=q)
    motor = clamp_torque(tree, motor_torque(tree, state, MotorCommand(zero), 0.0).start)
    own = passive_torque(tree, state, 0.0)[0] + limit_torque(tree, q, zero, 0.0)[0] + motor
    balls = ball_laws(tree.ball_limits, state)
    if balls is not None:
        stop = limit_torque(balls.limits, balls.angles.q, balls.angles.qd, 0.0)[0]
        own = own + balls.torque_of(stop, len(q))
    tendons = tree.tendons
    if tendons is None:
        return own
    length = length_of(tendons, q)
    still = jnp.zeros_like(length)
    lengths = Coordinates(length, still)
    motor = motor_torque(tendons, lengths, MotorCommand(still), 0.0).start
    # A motor without a spring would hold any length. A spring as stiff as a soft limit holds its
    # tendon, because no single coordinate of the search for rest stays fixed then.
    rigid = (tendons.servo_gain > 0) & (tendons.servo_stiffness == 0)
    hold = jnp.where(rigid, expand_dims_like(tendons.limit_stiffness, length), 0.0)
    motor = clamp_torque(tendons, motor - hold * length)
    limit, _ = limit_torque(tendons, length, still, 0.0)
    force = passive_force(tendons, lengths, 0.0)[0] + limit + motor
    return own + torque_of(tendons, force, len(q))


def radius_of_gyration(tree: Tree) -> float:
    """Return the radius of gyration about the root's centre in the neutral pose, m."""
    origins, turns, squares = [np.zeros(3)], [np.eye(3)], []
    for i, parent in enumerate(tree.parents):
        if parent >= 0:
            origins.append(origins[parent] + turns[parent] @ tree.joint_offset[:, i])
            turns.append(turns[parent] @ tree.joint_orientation[:, :, i])
        centre = origins[i] + turns[i] @ tree.com[:, i]
        own = np.trace(tree.inertia[:3, :3, i]) / 2 - tree.mass[i] * tree.com[:, i] @ tree.com[:, i]
        squares.append(own + tree.mass[i] * centre @ centre)
    return float(np.sqrt(np.sum(squares) / tree.mass.sum()))
