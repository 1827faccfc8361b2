"""The implicit step against a dense solve of its equation,

    (M + h sum J_i^T D_i J_i + T) qdd = tau + sum J_i^T f_i - bias.

MuJoCo computes M, the bias and J. NumPy sums drag, buoyancy and joint torques point by point, from
the formulas in the documentation.

The bias is the mean of two biases: with the velocities at the start of the step, and with those of
a first solution. The initial bias alone is used, except for each body's own gyroscopic torque, in
steps with contact and in steps in which a motor reaches or leaves its limit.
"""

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from benchmarks.mujoco_model import mujoco_model
from creatures import STRUCTURES, in_water, quick_jit, random_creature, random_state
from evo_cpg.creature.creature import Actuator, Creature
from evo_cpg.creature.self_collision import SelfCollision
from evo_cpg.creature.surface import outer_surfaces
from evo_cpg.creature.tree import build_tree
from evo_cpg.io.models.mujoco_state import dof_order, load_state
from evo_cpg.physics.contact.contact import find_contacts
from evo_cpg.physics.contact.contact_model import Ground, make_contact_model
from evo_cpg.physics.contact.contact_points import clearance
from evo_cpg.physics.contact.pairs import make_pairs, separations
from evo_cpg.physics.step.equations import prepare, solve_at_once
from evo_cpg.physics.step.outer_updates import Cone, reduced
from evo_cpg.physics.step.step import needs_iteration, step
from evo_cpg.physics.step.step_problem import StepProblem
from evo_cpg.physics.step.step_solver import free_motion
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.joint_torque import MotorCommand
from evo_cpg.physics.tree.kinematics import kinematics
from evo_cpg.physics.tree.state import State, resting_state
from evo_cpg.physics.water import fluid

H = 1 / 120
CURRENT = (0.3, -0.2, 0.1)
STATES = 6


class Drag(NamedTuple):
    """Wrench (moment, force) and D, about a body's origin in its own axes."""

    wrench: np.ndarray
    derivative: np.ndarray


def point_drag(world: World, surface, centre, velocity) -> Drag:
    """Return the drag summed over a body's surface points, and its derivative D.

    Args:
        world: world with water.
        surface: points, normals and areas in the body's geometric frame.
        centre: origin of the geometric frame.
        velocity: (angular, linear) at the origin, relative to the water.
    """
    law, half = world.law(fluid.Drag), 0.5 * world.water.density
    wrench, derivative = np.zeros(6), np.zeros((6, 6))
    for point, normal, area in zip(*surface, strict=True):
        r = point + centre
        skew = np.array([[0, -r[2], r[1]], [r[2], 0, -r[0]], [-r[1], r[0], 0]])
        jacobian = np.hstack([-skew, np.eye(3)])
        v = jacobian @ velocity
        along = np.outer(normal, normal)
        across = np.eye(3) - along
        if law.law == "normal":
            c_n = half * law.form_drag * area * abs(normal @ v)
            c_t = half * law.skin_drag * area * np.linalg.norm(across @ v)
            resistance = slope = c_n * along + c_t * across
        else:
            total = law.form_drag + law.skin_drag
            resistance = slope = half * total * area * np.linalg.norm(v) * np.eye(3)
        wrench -= jacobian.T @ resistance @ v
        derivative += jacobian.T @ slope @ jacobian
    return Drag(wrench, derivative)


def gyroscopic_change(inertia, spin):
    """Return the mean of w x I w over a step by Kahan's method, minus w x I w at its start."""

    def of(first, second):
        return (np.cross(first, inertia @ second) + np.cross(second, inertia @ first)) / 2

    slope = np.array([2 * of(spin, unit) for unit in np.eye(3)]).T
    change = np.linalg.solve(inertia + H / 2 * slope, -H * of(spin, spin))
    return of(spin, spin + change) - of(spin, spin)


def at_later_velocities(world: World, states: State, target, angle=None):
    """Return the states with velocities after a step without contact, and a mask of contacts."""

    @quick_jit
    def first(states, target):
        equations = prepare(world, H, states, MotorCommand(target, angle))
        if needs_iteration(world):
            problem = StepProblem.of(world, H, equations)
            y = free_motion(problem)
            return (y[:6], y[6:]), problem.needs_contact_or_other_limits(y)
        return solve_at_once(world, H, equations), jnp.zeros(states.q.shape[1:], bool)

    (root, qdd), touches = first(states, target)
    velocity, qd = states.velocity + H * root, states.qd + H * qdd
    return dataclasses.replace(states, velocity=velocity, qd=qd), np.asarray(touches)


def dense_accelerations(
    creature: Creature,
    world: World,
    state: State,
    later: State | None,
    torque,
    motor_derivative,
    ends=None,
    pushes=(),
):
    """Return root (angular, linear of its centre) and joint accelerations by a dense solve.

    Args:
        creature: the creature.
        world: its world.
        state: state of one individual.
        later: state with the velocities after the step, or None to use the initial velocities.
        torque: torques of the motors at the present rates.
        motor_derivative: term of the motors in T.
        ends: joint rates at the end of the step, if a search finds them.
        pushes: index of the body, point and force in the world, for every contact.
    """
    tree = world.tree
    model = mujoco_model(creature, {"gravity": f"0 0 {-world.gravity}"})
    data, order = mujoco.MjData(model), dof_order(model, tree)
    right = np.zeros(model.nv)
    for each in (later or state, state):
        root = load_state(model, data, tree, each)
        mujoco.mj_forward(model, data)
        right -= data.qfrc_bias / 2
    mass = np.zeros((model.nv, model.nv))
    for column, unit in zip(mass, np.eye(model.nv), strict=True):
        mujoco.mj_mulM(model, data, column, unit)

    surfaces = dict(
        zip([b.name for b in creature.bodies], outer_surfaces(creature, 2), strict=True)
    )
    for i, name in enumerate(tree.names):
        body = model.body(name).id
        rotation, origin = data.xmat[body].reshape(3, 3), data.xpos[body]
        jacobian = np.zeros((6, model.nv))
        mujoco.mj_jac(model, data, jacobian[3:], jacobian[:3], origin, body)
        to_body = np.kron(np.eye(2), rotation.T)
        velocity = jacobian @ data.qvel
        relative = velocity - np.concatenate([np.zeros(3), world.water.streams[0].origin])
        drag = point_drag(world, surfaces[name], tree.com[:, i], to_body @ relative)
        derivative = to_body.T @ drag.derivative @ to_body
        lift = np.array([0, 0, world.water.density * tree.volume[i] * world.gravity])
        buoyancy = np.concatenate([np.cross(rotation @ tree.com[:, i], lift), lift])
        right += jacobian.T @ (to_body.T @ drag.wrench + buoyancy)
        mass += H * jacobian.T @ derivative @ jacobian
        if later is None and not world.submerged:
            frame = data.ximat[body].reshape(3, 3)
            inertia = frame @ np.diag(model.body_inertia[body]) @ frame.T
            right -= jacobian[:3].T @ gyroscopic_change(inertia, velocity[:3])

    for i, place, force in pushes:
        jacobian = np.zeros((3, model.nv))
        mujoco.mj_jac(model, data, jacobian, None, place, model.body(tree.names[i]).id)
        right += jacobian.T @ force

    q, qd = np.asarray(state.q), np.asarray(state.qd)
    joint = torque - tree.stiffness * (q + H * qd) - tree.damping * qd
    diagonal = motor_derivative + H * (tree.damping + H * tree.stiffness)
    ahead = q + H * qd
    slope = tree.limit_damping + H * tree.limit_stiffness
    for sign, limit in ((1, tree.upper), (-1, tree.lower)):
        # A limit acts if the final rate exceeds the rate to the limit, or the return rate.
        beyond = sign * (q - limit)
        back = np.where(beyond > 0, -tree.limit_stiffness * beyond / slope, -beyond / H)
        stops = sign * ends > back if ends is not None else sign * (ahead - limit) > 0
        if ends is None:
            back = -tree.limit_stiffness * beyond / slope
        joint -= np.where(stops, slope * (qd - sign * back), 0.0)
        diagonal += np.where(stops, H * slope, 0.0)
    right[6 + order] += joint
    mass[6 + order, 6 + order] += diagonal
    qacc = np.linalg.solve(mass, right)
    return np.concatenate([root @ qacc[3:6], qacc[:3], qacc[6 + order]])


def worst_error(number: int, torque_limit: float, law: str = "normal") -> tuple[float, int]:
    """Return the largest relative error over some states, and the number of saturated motors."""
    rng = np.random.default_rng(number)
    motor = Actuator(2.0, torque_limit, stiffness=5.0)
    creature = random_creature(rng, STRUCTURES[number], limits=0.7, motor=motor, axes_seed=number)
    world = in_water(creature, current=CURRENT, law=law)
    tree = world.tree
    states = random_state(tree, rng, (STATES,))
    target = rng.normal(scale=3.0, size=(tree.dof_count, STATES))
    angle = rng.normal(scale=0.5, size=(tree.dof_count, STATES))
    new, effort = quick_jit(lambda s, t, a: step(world, s, MotorCommand(t, a), H))(
        states, jnp.asarray(target), jnp.asarray(angle)
    )

    def motor_law(n: int, rate: np.ndarray) -> np.ndarray:
        """Return the torque at the end of the step for a given final rate."""
        ahead = np.asarray(states.q[:, n]) + H * rate
        return motor.gain * (target[:, n] - rate) + motor.stiffness * (angle[:, n] - ahead)

    afterwards, unlike = at_later_velocities(world, states, jnp.asarray(target), jnp.asarray(angle))
    change = [
        np.asarray((after - before) / H)
        for after, before in ((new.velocity, states.velocity), (new.qd, states.qd))
    ]
    ours = np.concatenate(change)
    worst, saturated = 0.0, 0
    for n in range(STATES):
        state, later = (
            jax.tree.map(lambda x, n=n: x[..., n], each) for each in (states, afterwards)
        )
        later = None if unlike[n] else later
        expected = motor_law(n, np.asarray(state.qd))
        implicit = np.full_like(expected, H * (motor.gain + H * motor.stiffness))
        applied = np.asarray(effort.torque[:, n])
        ends = np.asarray(new.qd[:, n]) if np.isfinite(torque_limit) else None
        if (np.abs(applied) >= torque_limit).any():
            saturated += int((np.abs(applied) >= torque_limit).sum())
            expected, implicit = applied, np.zeros_like(implicit)
        theirs = dense_accelerations(creature, world, state, later, expected, implicit, ends)
        worst = max(worst, np.abs(ours[:, n] - theirs).max() / np.abs(theirs).max())
        # Motors within their limits end the step with the torque of their final rate.
        end = motor_law(n, np.asarray(new.qd[:, n]))
        if (np.abs(applied) < torque_limit).all():
            np.testing.assert_allclose(applied, end, rtol=1e-9, atol=1e-9)
    return worst, saturated


@pytest.mark.slow
@pytest.mark.parametrize(("number", "law"), [(1, "normal"), (4, "isotropic")])
def test_step_solves_its_dense_equation(number, law):
    """Combine drag, current, buoyancy, servos, limits and springs. The tolerance is 1e-9.

    Condition numbers of up to about 1e5 give rounding errors of about 1e-11. The floor of the
    tangential speed, 1e-6 m/s, adds its square relative to 1 m/s: 1e-12.
    """
    worst, _ = worst_error(number, np.inf, law)
    assert worst < 1e-9


@pytest.mark.slow
def test_accelerations_follow_from_the_limited_torques():
    """The returned torques of motors at their limits yield the accelerations."""
    worst, saturated = worst_error(1, 1.0)
    assert saturated > STATES
    assert worst < 1e-9


@pytest.mark.slow
def test_motion_follows_from_the_reported_forces():
    """Creatures with weak motors on a floor under water move by the reported forces.

    The forces obey their laws. Normal forces are not negative, friction is within its cone, motors
    apply their clipped torques, and pressed points end the step near the floor.
    """
    rng, friction, count = np.random.default_rng(5), 0.6, 4 * STATES
    creature = random_creature(
        rng, STRUCTURES[1], limits=0.7, motor=Actuator(2.0, 1.0), axes_seed=1
    )
    world = in_water(creature, current=CURRENT)
    tree = world.tree
    floor = Ground(1.0, friction, friction, friction_rule="min")
    pairs = make_pairs(creature, tree, SelfCollision())
    world = dataclasses.replace(
        world, contact_model=make_contact_model(creature, tree, floor), pairs=pairs
    )
    contact_model, states = world.contact_model, random_state(tree, rng, (count,))
    gaps = quick_jit(lambda s: clearance(contact_model, kinematics(tree, s)))
    up = np.array([0, 0, 1.0])[:, None]
    states = dataclasses.replace(
        states,
        position=states.position - up * np.asarray(gaps(states)).min(0),
        velocity=states.velocity.at[5].add(-3.0),
    )
    target = jnp.asarray(rng.normal(scale=3.0, size=(tree.dof_count, count)))
    new, effort = quick_jit(lambda s, t: step(world, s, t, H))(states, target)

    afterwards, touched = at_later_velocities(world, states, target)
    assert touched.sum() > count / 2

    @quick_jit
    def touching(state):
        kin = kinematics(tree, state)
        origin = kin.origin[:, np.array(contact_model.bodies)]
        arms = find_contacts(contact_model, kin, H).offset
        return origin + arms, separations(pairs, kin)

    places, apart = jax.tree.map(np.asarray, touching(states))
    after = np.asarray(gaps(new))
    force, torque = np.asarray(effort.contact_force), np.asarray(effort.torque)
    coulomb = np.asarray(effort.residual.coulomb)
    assert (np.asarray(effort.residual.solved) < 1e-9).all()
    change = ((new.velocity - states.velocity) / H, (new.qd - states.qd) / H)
    ours = np.concatenate([np.asarray(part) for part in change])
    pair_force = np.asarray(effort.pair_force)
    assert pair_force.min() >= 0
    pressed, saturated, limbs, ends_at = 0, 0, int((pair_force > 0).sum()), []
    for n in range(count):
        state, later = (jax.tree.map(lambda x, n=n: x[..., n], x) for x in (states, afterwards))
        later = None if touched[n] else later
        pushes = [(i, places[:, k, n], force[:, k, n]) for k, i in enumerate(contact_model.bodies)]
        for bodies, points, sign in zip(pairs.owners, apart[2:4], (-1, 1), strict=True):
            push = sign * pair_force[:, n] * apart.normal[..., n]
            pushes += zip(bodies, points[..., n].T, push.T, strict=True)
        ends = np.asarray(new.qd[:, n])
        none = np.zeros(tree.dof_count)
        theirs = dense_accelerations(
            creature, world, state, later, torque[:, n], none, ends, pushes
        )
        assert np.abs(ours[:, n] - theirs).max() < 1e-7 * np.abs(theirs).max()
        law = np.clip(2.0 * (np.asarray(target[:, n]) - ends), -1.0, 1.0)
        np.testing.assert_allclose(torque[:, n], law, atol=1e-8)
        saturated += int((np.abs(law) == 1.0).sum())
        up, along = force[2, :, n], np.hypot(*force[:2, :, n])
        load = max(up.sum(), 9.81 * tree.mass.sum())
        assert up.min() >= 0
        assert (along <= friction * up + (coulomb[n] + 1e-9) * load).all()
        pressed += int((up > 0).sum())
        ends_at += after[up > 0, n].tolist()
    # A corner that turns by 0.1 rad in the step moves on an arc: mostly upwards, or 3 mm down.
    assert min(ends_at) > -4e-3 and np.median(ends_at) < 1e-2
    assert pressed > count and saturated > count and limbs > 3


@pytest.mark.slow
def test_residuals_have_the_type_of_the_state(x64):
    """Float32 stays float32 with float64 enabled, because a scan could not carry another type."""
    creature = random_creature(np.random.default_rng(0), STRUCTURES[0])
    tree = build_tree(creature)
    world = World(tree, 9.81, contact_model=make_contact_model(creature, tree, Ground()))
    state = resting_state(tree, (2,), jnp.float32)
    _, effort = jax.eval_shape(lambda s: step(world, s, jnp.zeros_like(s.q), 1 / 240), state)
    assert {leaf.dtype for leaf in jax.tree.leaves(effort)} == {np.dtype(np.float32)}


def test_cone_iteration_solves_linear_fixed_point_in_three_rounds():
    """``L = a L + b`` has the solution b / (1 - a), which one secant step (Anderson) finds."""
    gain, offset = 0.6, 2.0
    cone = Cone.first(jnp.array([[1.0]], jnp.float32))
    plain = 1.0
    for _ in range(3):
        cone = cone.updated(gain * cone.radius + offset)
        plain = gain * plain + offset
    np.testing.assert_allclose(cone.radius, offset / (1 - gain), rtol=1e-6)
    assert abs(plain - offset / (1 - gain)) > 0.5
    assert int(cone.rounds[0]) == 3


def test_first_cone_update_takes_allowed_radius():
    cone = Cone.first(jnp.array([[1.0]])).updated(jnp.array([[5.0]]))
    assert float(cone.radius[0, 0]) == 5.0


def test_cone_radius_is_never_negative():
    cone = Cone.first(jnp.array([[1.0]])).updated(jnp.array([[0.5]])).updated(jnp.array([[0.0]]))
    assert float(cone.radius[0, 0]) == 0.0


def test_restitution_is_halved_twice_then_zero():
    values, fraction = [], jnp.float32(1)
    for _ in range(4):
        fraction = reduced(fraction)
        values.append(float(fraction))
    assert values == [0.5, 0.25, 0.0, 0.0]
