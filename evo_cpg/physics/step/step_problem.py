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

from evo_cpg.creature.algebra.linear import cross, dot, matvec, where_each
from evo_cpg.creature.algebra.numerics import xp
from evo_cpg.creature.per_body import take
from evo_cpg.native.fuse import solve_symmetric
from evo_cpg.physics.contact.contact import ContactLinearization
from evo_cpg.physics.contact.pair_contacts import PairForces
from evo_cpg.physics.step.equations import Equations
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.articulated import solve
from evo_cpg.physics.tree.ball_limit import BallForce
from evo_cpg.physics.tree.generalized import (
    body_accelerations,
    generalized_equations,
    generalized_force,
    mass_matrix,
)
from evo_cpg.physics.tree.joint_torque import changes_overload, linearized_torque
from evo_cpg.physics.tree.root import JOINTS, ROOT_DOFS
from evo_cpg.physics.tree.tendon import TendonForce, length_of

# Fraction of the other forces (drag, springs, velocity products) in the norm of all forces. It
# matters only if there is neither weight nor load nor torque.
_OTHER_FORCES = 1e-3

# Turn of a joint in a step (rad) beyond which the initial mass matrix is wrong at the end.
_LARGEST_TURN = 0.3

# Joint axes in a chain beyond which equations are solved body by body. Residuals in float32 for a
# chain of boxes on the ground: below 1e-3 with 10 joints, at times 1e-3 with 20, 0.2 with 40.
_LONGEST_ELIMINATED = 16

# Joint axes of a walk beyond which equations are solved body by body: any two bodies may be on one
# branch, so elimination fills the whole matrix.
_LARGEST_DENSE = 12

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
        mass, force = generalized_equations(
            world.tree,
            equations.kin,
            equations.inertia,
            equations.bias,
            equations.passive,
            equations.derivative,
        )
        if equations.tendons is not None:
            laws = equations.tendons
            springs = TendonForce(laws.tendons, laws.passive, laws.derivative)
            mass, force = springs.added_to(mass, force)
        return cls(world, h, equations, mass, force)

    def under(
        self, restitution: Float[Array, "*n"], bias: Float[Array, "k *n"] | None = None
    ) -> "StepProblem":
        """Return the problem with a fraction (0 to 1) of the restitution, and another pair bias."""
        equations = self.equations
        if equations.contacts is not None:
            equations = equations._replace(contacts=equations.contacts.bounded(restitution))
        if equations.pairs is not None and bias is not None:
            equations = equations._replace(pairs=equations.pairs.with_bias(bias))
        return self._replace(equations=equations)

    def velocity(self, y: Float[Array, "v *n"]) -> Float[Array, "3 p *n"] | None:
        """Return the contact points' final velocities, contact frame, m/s. None without ground."""
        contacts = self.equations.contacts
        if contacts is None:
            return None
        return contacts.unconstrained_velocity + self.change_of_velocity(y)

    def change_of_velocity(self, y: Float[Array, "v *n"]) -> Float[Array, "3 p *n"]:
        """Return the change of the contact points' velocities due to accelerations, m/s."""
        contacts = self.equations.contacts
        assert contacts is not None
        accelerations = body_accelerations(self.world.tree, self.equations.kin, y)
        angular, linear = (take(x, np.array(contacts.model.bodies)) for x in accelerations)
        return self.h * matvec(contacts.frame, linear + cross(angular, contacts.offset))

    def linearized(
        self,
        radius: Float[Array, "p *n"],
        qdd: Float[Array, "d *n"],
        velocity: Float[Array, "3 p *n"] | None,
        pair_sums: Any = None,
    ) -> Linearization:
        """Return the laws linearized at a motion."""
        tree, equations = self.world.tree, self.equations
        state, motor = equations.state, equations.motor
        torque, derivative = linearized_torque(tree, motor, state, qdd, self.h)
        contacts, pairs = equations.contacts, equations.pairs
        tendons, balls = equations.tendons, equations.balls
        return Linearization(
            torque,
            derivative,
            None if contacts is None or velocity is None else contacts.linearized(radius, velocity),
            None if pairs is None else pairs.at(qdd, pair_sums),
            None if tendons is None else tendons.linearized(qdd, self.h),
            None if balls is None else balls.linearized(qdd, self.h),
        )

    def motion(self, linear: Linearization) -> Float[Array, "v *n"]:
        """Return the accelerations under linearized laws.

        Elimination in generalized coordinates loses digits with the number of joints in a chain.
        With 40 joints on the ground float32 has none left. Long creatures are therefore solved body
        by body, except in steps in which pairs push, because these join branches of the tree.
        Tendons join branches in every step.
        """
        tree, equations, contacts = self.world.tree, self.equations, self.equations.contacts
        depth = np.zeros(tree.body_count, int)
        axes = np.bincount(np.array(tree.dof_bodies, int), minlength=tree.body_count)
        for body, parent in enumerate(tree.parents):
            if parent >= 0:
                depth[body] = depth[parent] + axes[body]
        joined = linear.tendons is not None or linear.balls is not None
        dense = tree.walk is not None and tree.dof_count > _LARGEST_DENSE
        if joined or (depth.max() <= _LONGEST_ELIMINATED and not dense):
            return self._by_elimination(linear)
        inertia, bias = equations.inertia, equations.bias
        if contacts is not None and linear.contact is not None:
            blocks = linear.contact.inertia(contacts, inertia)
            inertia = jax.tree.map(jnp.add, inertia, blocks)
            wrench = contacts.wrench(linear.contact.at(contacts.unconstrained_velocity), bias)
            bias = jax.tree.map(jnp.subtract, bias, wrench)
        torque = equations.passive + linear.torque
        resistance = equations.derivative + self.h * linear.derivative
        free = jnp.concatenate(solve(tree, equations.kin, inertia, bias, torque, resistance))
        if linear.pairs is None:
            return free
        pushed = linear.pairs.load > 0
        joined = jax.lax.cond(
            jnp.any(pushed), lambda: self._by_elimination(linear), lambda: jnp.zeros_like(free)
        )
        return where_each(pushed, joined, free)

    def _by_elimination(self, linear: Linearization) -> Float[Array, "v *n"]:
        tree, h, equations = self.world.tree, self.h, self.equations
        contacts = equations.contacts
        matrix, force, torque = self.mass, self.force, linear.torque
        if contacts is not None and linear.contact is not None:
            blocks = linear.contact.inertia(contacts, equations.inertia)
            matrix = matrix + mass_matrix(tree, equations.kin, blocks)
            force = force + self._ground(linear.contact.at(contacts.unconstrained_velocity))
        dofs = ROOT_DOFS + np.arange(tree.dof_count)
        matrix = matrix.at[dofs, dofs].add(h * linear.derivative)
        if linear.pairs is not None:
            pushes, stiffening = linear.pairs.newton()
            torque, matrix = torque + pushes, matrix.at[JOINTS, JOINTS].add(stiffening)
        if linear.tendons is not None:
            matrix, force = linear.tendons.added_to(matrix, force)
        if linear.balls is not None:
            matrix, force = linear.balls.added_to(matrix, force)
        return solve_symmetric(matrix, force.at[JOINTS].add(torque))

    def residual(self, y: Float[Array, "v *n"], linear: Linearization) -> Float[Array, "*n"]:
        """Return the error of the force laws at a motion, relative to `square_of_forces`.

        Both are norms of generalized forces. Each force is divided by the root of its inertia, the
        diagonal of M. The norm is therefore one of accelerations, weighted with masses.
        """
        law = jnp.zeros_like(self.force).at[JOINTS].add(self.torque(y, linear))
        if linear.contact is not None:
            law = law + self._ground(linear.contact.force)
        if linear.pairs is not None:
            law = law.at[JOINTS].add(linear.pairs.torque)
        missed = self._square(self.resistance(y) - law)
        return jnp.sqrt(missed / self.square_of_forces(y, linear))

    def square_of_forces(
        self, y: Float[Array, "v *n"], linear: Linearization
    ) -> Float[Array, "*n"]:
        """Return the squared norm of the forces, in the norm of `residual`, N^2/kg.

        The norm has three parts: the load (`load`) on the whole mass, the torques of motors and
        limits of joints, and a thousandth of the other forces.
        """
        torque = jnp.zeros_like(self.force).at[JOINTS].add(self.torque(y, linear))
        mass = xp.sum(self.world.tree.mass)
        total = self.load(linear) ** 2 / mass + self._square(torque)
        return total + _OTHER_FORCES**2 * self._square(self.force)

    def resistance(self, y: Float[Array, "v *n"]) -> Float[Array, "v *n"]:
        """Return the force that the laws need to supply: M y minus the other forces."""
        return matvec(self.mass, y) - self.force

    def torque(self, y: Float[Array, "v *n"], linear: Linearization) -> Float[Array, "d *n"]:
        """Return the torque of motors and limits of joints and tendons, linearized, N m."""
        torque = linear.torque - self.h * linear.derivative * y[JOINTS]
        if linear.tendons is not None:
            torque = torque + linear.tendons.torque(y[JOINTS])
        return torque if linear.balls is None else torque + linear.balls.at(y[JOINTS])

    def coulomb_error(
        self,
        radius: Float[Array, "p *n"],
        allowed: Float[Array, "p *n"],
        velocity: Float[Array, "3 p *n"] | None,
        linear: Linearization,
    ) -> Float[Array, "*n"]:
        """Return the Coulomb error of the friction forces, relative to the total normal load.

        ``radius`` are the radii of the cones in the solved problem, ``allowed`` those from the
        normal forces of its solution, N.
        """
        contacts = self.equations.contacts
        if contacts is None or velocity is None:
            return jnp.zeros(linear.torque.shape[1:], linear.torque.dtype)
        change = contacts.friction_change(radius, allowed, velocity)
        return jnp.sqrt((change * change).sum(0)) / self.load(linear)

    def load(self, linear: Linearization) -> Float[Array, "*n"]:
        """Return the total force of ground and pairs, or the weight if that is more, N."""
        weight = self.world.gravity * xp.sum(self.world.tree.mass)
        carried = jnp.zeros_like(linear.torque[:0]).sum(0)
        if linear.contact is not None:
            carried = carried + linear.contact.force[2].sum(0)
        if linear.pairs is not None:
            carried = carried + linear.pairs.load
        return jnp.maximum(carried, xp.maximum(weight, _NONE))

    def cone_radius(self, velocity: Float[Array, "3 p *n"] | None) -> Float[Array, "p *n"]:
        """Return the radii of the friction cones from the normal forces at a velocity, N."""
        contacts = self.equations.contacts
        if contacts is None or velocity is None:
            return self.force[:0]
        return contacts.cone_radius(velocity)

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
        lifting = jnp.maximum(contacts.rest_velocity * force[2], 0.0).sum(0)
        power = dot(mean, self._ground(force)) - lifting
        whirls = (self.h * jnp.abs(state.qd + self.h * y[JOINTS]) > _LARGEST_TURN).any(0)
        return ((power > 0) | whirls) & (contacts.bounce > 0).any(0)

    def needs_contact_or_other_limits(self, y: Float[Array, "v *n"]) -> Bool[Array, "*n"]:
        """Return for which individuals a free motion is wrong.

        `step_solver.free_motion` has no contact forces. It holds motors at their limits, and joints
        at sticking or sliding, as at zero acceleration.
        """
        equations, qdd, h, velocity = self.equations, y[JOINTS], self.h, self.velocity(y)
        found = changes_overload(self.world.tree, equations.motor, equations.state, qdd, h)
        if equations.contacts is not None and velocity is not None:
            found = found | (equations.contacts.target_velocity > velocity[2]).any(0)
        if equations.pairs is not None:
            found = found | equations.pairs.touches(qdd)
        if equations.tendons is None:
            return found
        laws, tendons = equations.tendons, equations.tendons.tendons
        change = length_of(tendons, qdd)
        return found | changes_overload(tendons, laws.motor, laws.lengths, change, h)

    @property
    def pair_bias(self) -> Float[Array, "k *n"]:
        """Velocity-product bias of the pairs (`pair_contacts.PairContacts`)."""
        pairs = self.equations.pairs
        return self.force[:0] if pairs is None else pairs.bias

    def _square(self, force: Float[Array, "v *n"]) -> Float[Array, "*n"]:
        """Return the sum of squared generalized forces, each divided by its inertia in M."""
        own = np.arange(len(force))
        return (force * force * (1.0 / self.mass[own, own])).sum(0)

    def _ground(self, force: Float[Array, "3 p *n"]) -> Float[Array, "v *n"]:
        """Return the generalized force of forces on the contact points."""
        equations = self.equations
        assert equations.contacts is not None
        wrench = equations.contacts.wrench(force, equations.bias)
        return generalized_force(self.world.tree, equations.kin, wrench)
