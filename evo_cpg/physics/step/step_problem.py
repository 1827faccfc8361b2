"""The convex minimisation problem of a step with contact or motor limits.

The accelerations y of the tree minimise

    1/2 (y - y_free)^T M (y - y_free)
    + 1/h times one convex potential for every contact point, pair, motor and limit of a joint.

M is the implicit mass matrix, and M y_free the forces without the laws of these potentials. The
derivatives of the potentials are the laws at the end of the step:

- normal contact forces, forces between bodies and joint limits: one-sided springs,
- friction: Huber's function, which sticks up to the radius of the friction cone and then slides,
- dry friction of a joint: Huber's function, too, with a given torque,
- motors: the servo's torque up to the torque limit. Muscles have no limit.
- tendons: the laws of joints, with the tendon's length for the angle.

The problem has generalized coordinates (`evo_cpg.physics.tree.generalized`), because there are few.
The points have the Jacobian J and the velocities ``v = v_0 + h J y``. Laws linearized as ``f = F -
K (v - v_k)`` give

    (M + h J^T K J) y = M y_free + J^T (F + K (v_k - v_0)),

solved by elimination from the tips to the root (`solve_symmetric`).
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from evo_cpg.creature.algebra.linear import dot, matvec, where_each
from evo_cpg.creature.algebra.numerics import Number, xp
from evo_cpg.creature.tree import Tree
from evo_cpg.native.fuse import solve_symmetric
from evo_cpg.physics.contact.contact import (
    ContactLinearization,
    bounded,
    change_of_velocity,
    cone_radius,
    contact_inertia,
    contact_wrench,
    friction_change,
    lifting_power,
    linearize_contacts,
    linearized_force,
)
from evo_cpg.physics.contact.pair_contacts import PairForces
from evo_cpg.physics.step.equations import Equations
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.articulated import solve
from evo_cpg.physics.tree.ball_limit import BallForce
from evo_cpg.physics.tree.generalized import body_accelerations, generalized_force, mass_matrix
from evo_cpg.physics.tree.joint_torque import changes_overload, linearized_torque
from evo_cpg.physics.tree.root import (
    joint_part,
    plus_joint_block,
    plus_joint_diagonal,
    plus_torque,
)
from evo_cpg.physics.tree.spatial_algebra import Wrench
from evo_cpg.physics.tree.tendon import TendonForce

# Fraction of the other forces (drag, springs, velocity products) in the norm of all forces. It
# matters only if there is neither weight nor load nor torque.
_OTHER_FORCES = 1e-3

# Turn of a joint in a step (rad) beyond which the initial mass matrix is wrong at the end.
_LARGEST_TURN = 0.3

# Joint axes in a chain beyond which equations are solved body by body. Residuals in float32 for a
# chain of boxes on the ground: below 1e-3 with 10 joints, at times 1e-3 with 20, 0.2 with 40.
_LONGEST_ELIMINATED = 16

# Force (N) or torque (N m) that counts as zero.
_NONE = 1e-12


class Linearization(NamedTuple):
    """The laws of motors, limits and friction of joints, contacts and pairs, linearized.

    Attributes:
        torque: torque of motors, limits and friction of joints at zero joint acceleration, N m.
        derivative: decrease of that torque per end-of-step rate, N m s/rad.
        contact: laws of the contact points, or None without ground.
        pairs: forces of the pairs, or None if no pair can touch.
        tendons: force of motors, limits and friction of tendons, or None without tendons.
        balls: torque of the limits of balls, or None without limits.
    """

    torque: Float[Array, "d *n"]
    derivative: Float[Array, "d *n"]
    contact: ContactLinearization | None
    pairs: PairForces | None
    tendons: TendonForce | None = None
    balls: BallForce | None = None


class StepProblem(NamedTuple):
    """Minimisation problem of a step.

    Attributes:
        world: the creature and its environment.
        h: step, s.
        equations: equations of motion of this step.
        mass: M, ``(v, v, *n)``, kg, kg m and kg m^2.
        force: M y_free, ``(v, *n)``: moment (N m) and force (N) at the root, torques (N m).
    """

    world: World
    h: float
    equations: Equations
    mass: Float[Array, "v v *n"]
    force: Float[Array, "v *n"]

    @classmethod
    def of(cls, world: World, h: float, equations: Equations) -> "StepProblem":
        """Return the problem of a step."""
        tree, kin, bias = world.tree, equations.kin, equations.bias
        mass = plus_joint_diagonal(mass_matrix(tree, kin, equations.inertia), equations.derivative)
        force = generalized_force(tree, kin, Wrench(-bias.moment, -bias.force))
        force = plus_torque(force, equations.passive)
        if equations.tendons is not None:
            mass, force = equations.tendons.springs().added_to(mass, force)
        return cls(world, h, equations, mass, force)

    def with_restitution(self, restitution: Float[Array, "*n"]) -> "StepProblem":
        """Return the problem with a fraction (0 to 1) of the restitution."""
        equations = self.equations
        if equations.contacts is None:
            return self
        contacts = bounded(equations.contacts, restitution)
        return self._replace(equations=equations._replace(contacts=contacts))

    def with_pair_bias(self, bias: Float[Array, "k *n"]) -> "StepProblem":
        """Return the problem with another velocity-product bias of its pairs."""
        equations = self.equations
        if equations.pairs is None:
            return self
        pairs = equations.pairs.with_bias(bias)
        return self._replace(equations=equations._replace(pairs=pairs))

    def velocity(self, y: Float[Array, "v *n"]) -> Float[Array, "3 p *n"] | None:
        """Return the contact points' final velocities, contact frame, m/s. None without ground."""
        contacts = self.equations.contacts
        if contacts is None:
            return None
        return contacts.unconstrained_velocity + self.change_of_velocity(y)

    def change_of_velocity(self, y: Float[Array, "v *n"]) -> Float[Array, "3 p *n"]:
        """Return the change of the contact points' velocities due to accelerations, m/s."""
        contact_model, contacts = self.world.contact_model, self.equations.contacts
        assert contact_model is not None and contacts is not None
        accelerations = body_accelerations(self.world.tree, self.equations.kin, y)
        return change_of_velocity(contact_model, contacts, accelerations, self.h)

    def linearized(
        self,
        radius: Float[Array, "p *n"],
        qdd: Float[Array, "d *n"],
        velocity: Float[Array, "3 p *n"] | None,
        pair_sums: Any = None,
    ) -> Linearization:
        """Return the laws linearized at a motion.

        Args:
            radius: radii of the friction cones, N.
            qdd: joint accelerations, rad/s^2.
            velocity: velocities of the contact points, m/s, or None without ground.
            pair_sums: `PairForces.sums` at this motion, or None to compute them.
        """
        tree, equations = self.world.tree, self.equations
        state, motor = equations.state, equations.motor
        torque, derivative = linearized_torque(tree, motor, state, qdd, self.h)
        contact_model, contacts, linear = self.world.contact_model, self.equations.contacts, None
        if contact_model is not None and contacts is not None and velocity is not None:
            linear = linearize_contacts(contact_model, contacts, radius, velocity, self.h)
        apart = self.equations.pairs
        pushes = None if apart is None else apart.at(qdd, pair_sums)
        tendons = equations.tendons
        pulls = None if tendons is None else tendons.linearized(qdd, self.h)
        balls = equations.balls
        stops = None if balls is None else balls.linearized(qdd, self.h)
        return Linearization(torque, derivative, linear, pushes, pulls, stops)

    def motion(self, linear: Linearization) -> Float[Array, "v *n"]:
        """Return the accelerations under linearized laws.

        Elimination in generalized coordinates loses digits with the number of joints in a chain.
        With 40 joints on the ground float32 has none left. Long creatures are therefore solved body
        by body, except in steps in which pairs push, because these join branches of the tree.
        Tendons join branches in every step.
        """
        joined = linear.tendons is not None or linear.balls is not None
        if joined or not _is_long(self.world.tree):
            return self._by_elimination(linear)
        free = self._body_by_body(linear)
        if linear.pairs is None:
            return free
        pushed = linear.pairs.load > 0
        joined = jax.lax.cond(
            jnp.any(pushed), lambda: self._by_elimination(linear), lambda: jnp.zeros_like(free)
        )
        return where_each(pushed, joined, free)

    def _by_elimination(self, linear: Linearization) -> Float[Array, "v *n"]:
        tree, equations, h = self.world.tree, self.equations, self.h
        contact_model, contacts = self.world.contact_model, equations.contacts
        matrix, force, torque = self.mass, self.force, linear.torque
        if contact_model is not None and contacts is not None and linear.contact is not None:
            blocks = contact_inertia(contact_model, contacts, linear.contact, equations.inertia, h)
            matrix = matrix + mass_matrix(tree, equations.kin, blocks)
            force = force + self._ground(
                linearized_force(linear.contact, contacts.unconstrained_velocity)
            )
        matrix = plus_joint_diagonal(matrix, h * linear.derivative)
        if linear.pairs is not None:
            pushes, stiffening = linear.pairs.newton()
            torque, matrix = torque + pushes, plus_joint_block(matrix, stiffening)
        if linear.tendons is not None:
            matrix, force = linear.tendons.added_to(matrix, force)
        if linear.balls is not None:
            matrix, force = linear.balls.added_to(matrix, force)
        return solve_symmetric(matrix, plus_torque(force, torque))

    def _body_by_body(self, linear: Linearization) -> Float[Array, "v *n"]:
        """Return the accelerations without pairs, by the articulated-body algorithm."""
        equations, h = self.equations, self.h
        contact_model, contacts = self.world.contact_model, equations.contacts
        inertia, bias = equations.inertia, equations.bias
        if contact_model is not None and contacts is not None and linear.contact is not None:
            blocks = contact_inertia(contact_model, contacts, linear.contact, inertia, h)
            inertia = jax.tree.map(jnp.add, inertia, blocks)
            force = linearized_force(linear.contact, contacts.unconstrained_velocity)
            wrench = contact_wrench(contact_model, contacts, force, bias)
            bias = jax.tree.map(jnp.subtract, bias, wrench)
        torque, resistance = (
            equations.passive + linear.torque,
            equations.derivative + h * linear.derivative,
        )
        found = solve(self.world.tree, equations.kin, inertia, bias, torque, resistance)
        return jnp.concatenate(found)

    def residual(self, y: Float[Array, "v *n"], linear: Linearization) -> Float[Array, "*n"]:
        """Return the error of the force laws at a motion, relative to `square_of_forces`.

        Both are norms of generalized forces. Each force is divided by the root of its inertia, the
        diagonal of M. The norm is therefore one of accelerations, weighted with masses.

        Args:
            y: accelerations.
            linear: laws linearized at y.
        """
        law = plus_torque(jnp.zeros_like(self.force), self.torque(y, linear))
        if linear.contact is not None:
            law = law + self._ground(linear.contact.force)
        if linear.pairs is not None:
            law = plus_torque(law, linear.pairs.torque)
        missed = self._square(self.resistance(y) - law)
        return jnp.sqrt(missed / self.square_of_forces(y, linear))

    def square_of_forces(
        self, y: Float[Array, "v *n"], linear: Linearization
    ) -> Float[Array, "*n"]:
        """Return the squared norm of the forces, in the norm of `residual`, N^2/kg.

        The norm has three parts: the load (`load`) on the whole mass, the torques of motors and
        limits of joints, and a thousandth of the other forces.
        """
        torque = plus_torque(jnp.zeros_like(self.force), self.torque(y, linear))
        total = self.load(linear) ** 2 / self._total_mass() + self._square(torque)
        return total + _OTHER_FORCES**2 * self._square(self.force)

    def resistance(self, y: Float[Array, "v *n"]) -> Float[Array, "v *n"]:
        """Return the force that the laws need to supply: M y minus the other forces."""
        return matvec(self.mass, y) - self.force

    def torque(self, y: Float[Array, "v *n"], linear: Linearization) -> Float[Array, "d *n"]:
        """Return the torque of motors and limits of joints and tendons, linearized, N m."""
        torque = linear.torque - self.h * linear.derivative * joint_part(y)
        if linear.tendons is not None:
            torque = torque + linear.tendons.torque(joint_part(y))
        return torque if linear.balls is None else torque + linear.balls.at(joint_part(y))

    def coulomb_error(
        self,
        radius: Float[Array, "p *n"],
        allowed: Float[Array, "p *n"],
        velocity: Float[Array, "3 p *n"] | None,
        linear: Linearization,
    ) -> Float[Array, "*n"]:
        """Return the Coulomb error of the friction forces, relative to the total normal load.

        Args:
            radius: radii of the cones in the solved problem, N.
            allowed: radii from the normal forces of its solution, N.
            velocity: velocities of the contact points in the solution, m/s.
            linear: laws linearized at the solution.
        """
        contact_model = self.world.contact_model
        if contact_model is None or velocity is None:
            return jnp.zeros(linear.torque.shape[1:], linear.torque.dtype)
        change = friction_change(contact_model, radius, allowed, velocity, self.h)
        return jnp.sqrt((change * change).sum(0)) / self.load(linear)

    def load(self, linear: Linearization) -> Float[Array, "*n"]:
        """Return the total force of ground and pairs, or the weight if that is more, N."""
        weight = self.world.gravity * self._total_mass()
        carried = jnp.zeros_like(linear.torque[:0]).sum(0)
        if linear.contact is not None:
            carried = carried + linear.contact.force[2].sum(0)
        if linear.pairs is not None:
            carried = carried + linear.pairs.load
        return jnp.maximum(carried, xp.maximum(weight, _NONE))

    def cone_radius(self, velocity: Float[Array, "3 p *n"] | None) -> Float[Array, "p *n"]:
        """Return the radii of the friction cones from the normal forces at a velocity, N."""
        contact_model, contacts = self.world.contact_model, self.equations.contacts
        if contact_model is None or contacts is None or velocity is None:
            return self.force[:0]
        return cone_radius(contact_model, contacts, velocity, self.h)

    def must_reduce_restitution(
        self, y: Float[Array, "v *n"], linear: Linearization
    ) -> Bool[Array, "*n"]:
        """Return for which individuals bouncing contacts do positive work, or a limb whirls.

        The work uses the mean of the velocities before and after the step. Lifting points out of
        the ground does not count. A whirling limb turns by more than `_LARGEST_TURN` in the step,
        so that the initial mass matrix is wrong at the end.
        """
        contacts, state = self.equations.contacts, self.equations.state
        if contacts is None or linear.contact is None:
            return jnp.zeros(linear.torque.shape[1:], bool)
        force = linear.contact.force
        mean = state.rates + 0.5 * self.h * y
        power = dot(mean, self._ground(force)) - lifting_power(contacts, force)
        whirls = (self.h * jnp.abs(state.qd + self.h * joint_part(y)) > _LARGEST_TURN).any(0)
        return ((power > 0) | whirls) & (contacts.bounce > 0).any(0)

    def touches(self, y: Float[Array, "v *n"]) -> Bool[Array, "*n"]:
        """Return for which individuals a motion would need contact forces."""
        contacts, pairs, velocity = self.equations.contacts, self.equations.pairs, self.velocity(y)
        found = jnp.zeros(y.shape[1:], bool)
        if contacts is not None and velocity is not None:
            found = found | (contacts.target_velocity > velocity[2]).any(0)
        if pairs is not None:
            found = found | pairs.touches(joint_part(y))
        return found

    def changes_overload(self, y: Float[Array, "v *n"]) -> Bool[Array, "*n"]:
        """Return for which individuals a motion overloads other motors than zero acceleration does.

        `step_solver.free_motion` holds motors at their limits, and joints at sticking or sliding.
        Its torques are then wrong.
        """
        equations, qdd, h = self.equations, joint_part(y), self.h
        found = changes_overload(self.world.tree, equations.motor, equations.state, qdd, h)
        tendons = equations.tendons
        return found if tendons is None else found | tendons.changes_overload(qdd, h)

    def commanded_torque(self, qdd: Float[Array, "d *n"]) -> Float[Array, "d *n"]:
        """Return the torques that motors and muscles command at the end of the step, N m."""
        return self.equations.motor.at(self.world.tree, qdd, self.h)

    @property
    def pair_bias(self) -> Float[Array, "k *n"]:
        """Velocity-product bias of the pairs (`pair_contacts.PairContacts`)."""
        pairs = self.equations.pairs
        return self.force[:0] if pairs is None else pairs.bias

    def pair_bias_at(self, qdd: Float[Array, "d *n"]) -> Float[Array, "k *n"]:
        """Return the velocity-product bias of the pairs at the joint rates after the step."""
        pairs = self.equations.pairs
        return self.force[:0] if pairs is None else pairs.bias_at(qdd)

    def drifts(self, qdd: Float[Array, "d *n"], bias: Float[Array, "k *n"]) -> Bool[Array, "*n"]:
        """Return for which individuals another velocity-product bias would move touching pairs."""
        pairs = self.equations.pairs
        return jnp.zeros(qdd.shape[1:], bool) if pairs is None else pairs.drifts(qdd, bias)

    def _total_mass(self) -> Number:
        """Return the mass of the creature, kg."""
        return xp.sum(self.world.tree.mass)

    def _square(self, force: Float[Array, "v *n"]) -> Float[Array, "*n"]:
        """Return the sum of squared generalized forces, each divided by its inertia in M."""
        own = np.arange(len(force))
        return (force * force * (1.0 / self.mass[own, own])).sum(0)

    def _ground(self, force: Float[Array, "3 p *n"]) -> Float[Array, "v *n"]:
        """Return the generalized force of forces on the contact points."""
        contact_model, equations = self.world.contact_model, self.equations
        assert contact_model is not None and equations.contacts is not None
        wrench = contact_wrench(contact_model, equations.contacts, force, equations.bias)
        return generalized_force(self.world.tree, equations.kin, wrench)


def _is_long(tree: Tree) -> bool:
    """Return whether a chain of joints is so long that elimination loses too many digits."""
    depth = np.zeros(tree.body_count, int)
    axes = np.bincount(np.array(tree.dof_bodies, int), minlength=tree.body_count)
    for body, parent in enumerate(tree.parents):
        if parent >= 0:
            depth[body] = depth[parent] + axes[body]
    return bool(depth.max() > _LONGEST_ELIMINATED)
