"""What a step's motion minimises: its laws have kinks, motors with limits and contact.

At the end of the step it minimises, over the accelerations y of the tree,

    1/2 (y - y_free)^T M (y - y_free)
    + 1/h times one convex potential for every contact point, pair, motor and limit of a joint,

whose derivatives are their laws: a one-sided spring along the normal, friction as Huber's function
(it sticks up to the radius of the friction cone, and slides under that), pushes of bodies on each
other and limits of joints as one-sided springs, motors up to their torque. M is the implicit mass
matrix, and M y_free the forces without these laws.

All is in generalized coordinates (`evo_cpg.physics.generalized`), of which there are few. With the
Jacobian J of the points, whose velocities are ``v = v_0 + h J y``, laws linearized as
``f = F - K (v - v_k)`` give

    (M + h J^T K J) y = M y_free + J^T (F + K (v_k - v_0)),

solved by elimination from the tips to the root (`evo_cpg.fusion.frontend.symmetric_solve`).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from evo_cpg.creature.tree import Tree
from evo_cpg.fusion.frontend.symmetric_solve import solve_symmetric
from evo_cpg.physics.articulated import solve
from evo_cpg.physics.contact import (
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
from evo_cpg.physics.equations import Equations
from evo_cpg.physics.generalized import body_accelerations, generalized_force, mass_matrix
from evo_cpg.physics.joint_torque import clamp_torque, limit_torque, overloaded, servo_slope
from evo_cpg.physics.pair_contacts import PairForces
from evo_cpg.physics.root import (
    joint_part,
    plus_joint_block,
    plus_joint_diagonal,
    plus_torque,
)
from evo_cpg.physics.spatial_algebra import Wrench
from evo_cpg.physics.world import World
from evo_cpg.spatial.linear import dot, expand_dims_like, matvec, where_each
from evo_cpg.spatial.numerics import Number, xp

# Fraction of the other forces (drag, springs, velocity products) that counts in the norm of all
# forces. It matters if there is neither weight nor load nor torque.
_OTHER_FORCES = 1e-3

# Torques are the same if they differ by less than this fraction of the motor's limit.
_SAME_TORQUE = 1e-3

# Turn of a joint in a step (rad) beyond which the mass matrix at its start says little of its end.
_LARGEST_TURN = 0.3

# Joint axes in a row beyond which equations are solved body by body. Measured in float32 on a chain
# of boxes on the ground: with 10 joints a step misses the laws by less than 1e-3, with 20 by 1e-3
# at times, with 40 by a fifth.
_LONGEST_ELIMINATED = 16

# Force (N) or torque (N m) that counts as none.
_NONE = 1e-12


class Linearization(NamedTuple):
    """The laws of motors, limits of joints, contacts and pairs, linearized.

    Attributes:
        torque: of motors and limits of joints without joint accelerations, N m.
        slope: torque lost per end-of-step rate, N m s/rad.
        contact: None without ground.
        pairs: None where none can touch.
    """

    torque: Float[Array, "d *n"]
    slope: Float[Array, "d *n"]
    contact: ContactLinearization | None
    pairs: PairForces | None


class StepProblem(NamedTuple):
    """What is minimised in a step.

    Attributes:
        world: the creature and its surroundings.
        h: s.
        equations: of this step.
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
        """That of a step."""
        tree, kin, bias = world.tree, equations.kin, equations.bias
        mass = plus_joint_diagonal(mass_matrix(tree, kin, equations.inertia), equations.derivative)
        force = generalized_force(tree, kin, Wrench(-bias.moment, -bias.force))
        force = plus_torque(force, equations.passive)
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
        """Of the contact points at the end of the step, contact frame, m/s; None without ground."""
        contacts = self.equations.contacts
        if contacts is None:
            return None
        return contacts.unconstrained_velocity + self.change_of_velocity(y)

    def change_of_velocity(self, y: Float[Array, "v *n"]) -> Float[Array, "3 p *n"]:
        """Of the contact points because of accelerations, m/s."""
        contact_model, contacts = self.world.contact_model, self.equations.contacts
        assert contact_model is not None and contacts is not None
        accelerations = body_accelerations(self.world.tree, self.equations.kin, y)
        return change_of_velocity(contact_model, contacts, accelerations, self.h)

    def linearized(
        self,
        radius: Float[Array, "p *n"],
        qdd: Float[Array, "d *n"],
        velocity: Float[Array, "3 p *n"] | None,
    ) -> Linearization:
        """Of the laws at some motion.

        Args:
            radius: of the friction cones, N.
            qdd: joint accelerations, rad/s^2.
            velocity: of the contact points, m/s; None without ground.
        """
        tree, equations = self.world.tree, self.equations
        state, start_torque = equations.state, equations.start_torque
        commanded = self.commanded_torque(qdd)
        over = overloaded(tree, commanded)
        torque = jnp.where(over, clamp_torque(tree, commanded), start_torque)
        slope = jnp.where(over, 0.0, servo_slope(tree, start_torque, self.h))
        change = self.h * qdd
        stop, stop_slope = limit_torque(tree, state.q, state.qd + change, self.h)
        torque, slope = torque + stop + stop_slope * change, slope + stop_slope
        contact_model, contacts, linear = self.world.contact_model, self.equations.contacts, None
        if contact_model is not None and contacts is not None and velocity is not None:
            linear = linearize_contacts(contact_model, contacts, radius, velocity, self.h)
        apart = self.equations.pairs
        pushes = None if apart is None else apart.at(qdd)
        return Linearization(torque, slope, linear, pushes)

    def motion(self, linear: Linearization) -> Float[Array, "v *n"]:
        """The accelerations under linearized laws.

        Elimination in generalized coordinates loses digits with the number of joints in a row: of
        40 on the ground float32 has none left. Long animals are solved body by body. Elimination
        remains for steps in which pairs push, because these join branches of the tree.
        """
        if not _is_long(self.world.tree):
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
        matrix = plus_joint_diagonal(matrix, h * linear.slope)
        if linear.pairs is not None:
            pushes, stiffening = linear.pairs.newton()
            torque, matrix = torque + pushes, plus_joint_block(matrix, stiffening)
        return solve_symmetric(matrix, plus_torque(force, torque))

    def _body_by_body(self, linear: Linearization) -> Float[Array, "v *n"]:
        """The accelerations without pairs, by the articulated-body algorithm."""
        equations, h = self.equations, self.h
        contact_model, contacts = self.world.contact_model, equations.contacts
        inertia, bias = equations.inertia, equations.bias
        if contact_model is not None and contacts is not None and linear.contact is not None:
            blocks = contact_inertia(contact_model, contacts, linear.contact, inertia, h)
            inertia = jax.tree.map(jnp.add, inertia, blocks)
            force = linearized_force(linear.contact, contacts.unconstrained_velocity)
            wrench = contact_wrench(contact_model, contacts, force, bias)
            bias = jax.tree.map(jnp.subtract, bias, wrench)
        torque, slope = equations.passive + linear.torque, equations.derivative + h * linear.slope
        found = solve(self.world.tree, equations.kin, inertia, bias, torque, slope)
        return jnp.concatenate(found)

    def residual(self, y: Float[Array, "v *n"], linear: Linearization) -> Float[Array, "*n"]:
        """What the forces at a motion miss the laws by, as a share of the forces that there are.

        Both are norms of generalized forces, each by the root of the inertia that it alone would
        move, the diagonal of M: accelerations, weighted with masses.

        Args:
            y: a motion.
            linear: the laws linearized there.
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
        """Of the forces that there are, in the norm of `residual`, N^2/kg.

        The weight, or what ground and pairs carry if that is more, as if it lifted the whole
        creature; torques; and a thousandth of the forces that no law is about.
        """
        torque = plus_torque(jnp.zeros_like(self.force), self.torque(y, linear))
        total = self.load(linear) ** 2 / self._total_mass() + self._square(torque)
        return total + _OTHER_FORCES**2 * self._square(self.force)

    def resistance(self, y: Float[Array, "v *n"]) -> Float[Array, "v *n"]:
        """What it takes of the laws to have the accelerations: M y less the other forces."""
        return matvec(self.mass, y) - self.force

    def torque(self, y: Float[Array, "v *n"], linear: Linearization) -> Float[Array, "d *n"]:
        """Of motors and limits of joints under linearized laws, N m."""
        return linear.torque - self.h * linear.slope * joint_part(y)

    def coulomb_error(
        self,
        radius: Float[Array, "p *n"],
        allowed: Float[Array, "p *n"],
        velocity: Float[Array, "3 p *n"] | None,
        linear: Linearization,
    ) -> Float[Array, "*n"]:
        """Return the Coulomb error of the friction forces, relative to the total normal load.

        Args:
            radius: of the cones with which the motion was found, N.
            allowed: radii that its own normal forces give, N.
            velocity: of the contact points in it.
            linear: the laws linearized there.
        """
        contact_model = self.world.contact_model
        if contact_model is None or velocity is None:
            return jnp.zeros(linear.torque.shape[1:], linear.torque.dtype)
        change = friction_change(contact_model, radius, allowed, velocity, self.h)
        return jnp.sqrt((change * change).sum(0)) / self.load(linear)

    def load(self, linear: Linearization) -> Float[Array, "*n"]:
        """What ground and pairs carry, or the weight if that is more, N."""
        weight = self.world.gravity * self._total_mass()
        carried = jnp.zeros_like(linear.torque[:0]).sum(0)
        if linear.contact is not None:
            carried = carried + linear.contact.force[2].sum(0)
        if linear.pairs is not None:
            carried = carried + linear.pairs.load
        return jnp.maximum(carried, xp.maximum(weight, _NONE))

    def cone_radius(self, velocity: Float[Array, "3 p *n"] | None) -> Float[Array, "p *n"]:
        """Of the friction cones, under the normal forces of the laws at some velocity, N."""
        contact_model, contacts = self.world.contact_model, self.equations.contacts
        if contact_model is None or contacts is None or velocity is None:
            return self.force[:0]
        return cone_radius(contact_model, contacts, velocity, self.h)

    def must_reduce_restitution(
        self, y: Float[Array, "v *n"], linear: Linearization
    ) -> Bool[Array, "*n"]:
        """Return where bouncing contacts do positive work on the creature, or a limb whirls.

        The work is that of the mean of the velocities before and after the step. Lifting points
        out of the ground does not count. A whirling limb turns by more than `_LARGEST_TURN` in the
        step: the mass matrix at its start is wrong at its end.
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
        """Return where a motion would need contact forces."""
        contacts, pairs, velocity = self.equations.contacts, self.equations.pairs, self.velocity(y)
        found = jnp.zeros(y.shape[1:], bool)
        if contacts is not None and velocity is not None:
            found = found | (contacts.target_velocity > velocity[2]).any(0)
        if pairs is not None:
            found = found | pairs.touches(joint_part(y))
        return found

    def changes_overload(self, y: Float[Array, "v *n"]) -> Bool[Array, "*n"]:
        """Return where a motion moves motors to other torque limits than zero acceleration does.

        `step_solver.free_motion` holds motors at their limits, so it gives them wrong torques.
        """
        tree, without = self.world.tree, self.equations.start_torque
        commanded = self.commanded_torque(joint_part(y))
        given = clamp_torque(tree, commanded)
        stays = jnp.where(overloaded(tree, without), clamp_torque(tree, without), commanded)
        least = _SAME_TORQUE * expand_dims_like(tree.torque_limit, given) + _NONE
        return (jnp.abs(given - stays) > least).any(0)

    def commanded_torque(self, qdd: Float[Array, "d *n"]) -> Float[Array, "d *n"]:
        """Return the torques that the servos command at the end of the step, N m."""
        start_torque = self.equations.start_torque
        return start_torque - self.h * servo_slope(self.world.tree, start_torque, self.h) * qdd

    @property
    def pair_bias(self) -> Float[Array, "k *n"]:
        """Velocity-product bias of the pairs (`evo_cpg.physics.pair_contacts.PairContacts`)."""
        pairs = self.equations.pairs
        return self.force[:0] if pairs is None else pairs.bias

    def pair_bias_at(self, qdd: Float[Array, "d *n"]) -> Float[Array, "k *n"]:
        """Return the velocity-product bias of the pairs at the joint rates after the step."""
        pairs = self.equations.pairs
        return self.force[:0] if pairs is None else pairs.bias_at(qdd)

    def drifts(self, qdd: Float[Array, "d *n"], bias: Float[Array, "k *n"]) -> Bool[Array, "*n"]:
        """Return where touching pairs would end elsewhere with another velocity-product bias."""
        pairs = self.equations.pairs
        return jnp.zeros(qdd.shape[1:], bool) if pairs is None else pairs.drifts(qdd, bias)

    def _total_mass(self) -> Number:
        """Of the creature, kg."""
        return xp.sum(self.world.tree.mass)

    def _square(self, force: Float[Array, "v *n"]) -> Float[Array, "*n"]:
        """Of generalized forces, each by the inertia that it alone would move."""
        own = np.arange(len(force))
        return (force * force * (1.0 / self.mass[own, own])).sum(0)

    def _ground(self, force: Float[Array, "3 p *n"]) -> Float[Array, "v *n"]:
        """What forces on the contact points are to the root and the joints."""
        contact_model, equations = self.world.contact_model, self.equations
        assert contact_model is not None and equations.contacts is not None
        wrench = contact_wrench(contact_model, equations.contacts, force, equations.bias)
        return generalized_force(self.world.tree, equations.kin, wrench)


def _is_long(tree: Tree) -> bool:
    """Whether so many joints are in a row that elimination loses too many digits."""
    depth = np.zeros(tree.body_count, int)
    axes = np.bincount(np.array(tree.dof_bodies, int), minlength=tree.body_count)
    for body, parent in enumerate(tree.parents):
        if parent >= 0:
            depth[body] = depth[parent] + axes[body]
    return bool(depth.max() > _LONGEST_ELIMINATED)
