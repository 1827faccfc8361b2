"""What a step's motion minimises: its laws have kinks, motors with limits and contact.

At the end of the step it minimises

    1/2 |x - x_free|^2 in the metric of the implicit mass matrix
    + h times one convex potential for every contact point, pair, motor and limit of a joint,

whose derivatives are their laws: a one-sided spring along the normal, friction as Huber's function
(it sticks up to the radius of the friction cone, and slides under that), pushes of bodies on each
other and limits of joints as one-sided springs, motors up to their torque.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from evo_cpg.physics.contact import (
    bounded,
    cone_radius,
    contact_work,
    end_velocity,
    friction_change,
    linearize_contacts,
    linearized_force,
)
from evo_cpg.physics.equations import Equations, Linearization, solve_with
from evo_cpg.physics.joints import clamp_torque, limit_torque, overloaded, servo_slope
from evo_cpg.physics.pairs import linearize_pairs, parting_velocity, sweep_at, swept
from evo_cpg.physics.world import World
from evo_cpg.spatial.linear import expand_dims_like
from evo_cpg.spatial.numerics import xp

# Rate (rad/s) whose torque by the slope of a joint's law is enough to measure what is missed by.
_SLOW = 1e-2

# By so much (m) a pair may come elsewhere within a step.
_STRAY = 2e-4

# Of forces (N) and torques (N m) that counts as none.
_NONE = 1e-12


class Iterate(NamedTuple):
    """A motion, and under which forces the creature has it.

    Attributes:
        root: spatial acceleration of the root.
        qdd: joint accelerations, rad/s^2.
        torque: of motors and limits of joints, N m.
        velocity: of the contact points at the end of the step, m/s; None without ground.
        force: on them, N; likewise.
        push: of pairs of bodies, N; None where none can touch.
    """

    root: Float[Array, "6 *n"]
    qdd: Float[Array, "d *n"]
    torque: Float[Array, "d *n"]
    velocity: Float[Array, "3 p *n"] | None = None
    force: Float[Array, "3 p *n"] | None = None
    push: Float[Array, "k *n"] | None = None


class ForceResidual(NamedTuple):
    """What an iterate has beyond the laws.

    Attributes:
        torque: of motors and limits of joints, N m.
        force: at the contact points, N; None without ground.
        push: of pairs of bodies, N; None where none can touch.
    """

    torque: Float[Array, "d *n"]
    force: Float[Array, "3 p *n"] | None
    push: Float[Array, "k *n"] | None


class StepProblem(NamedTuple):
    """What is minimised in a step."""

    world: World
    h: float
    equations: Equations

    def motion(self, linear: Linearization) -> Iterate:
        """The motion under linear, and what they give there."""
        equations, h = self.equations, self.h
        found, push = solve_with(self.world, h, equations, linear)
        torque = linear.torque - h * linear.slope * found.qdd
        velocity = force = None
        footing, contacts = self.world.footing, equations.contacts
        if footing is not None and contacts is not None and linear.contact is not None:
            velocity = end_velocity(footing, contacts, found, h)
            force = linearized_force(linear.contact, velocity)
        return Iterate(found.root, found.qdd, torque, velocity, force, push)

    def bounded(self, restitution: Float[Array, "*n"]) -> "StepProblem":
        """The problem with what is left of restitution."""
        equations = self.equations
        if equations.contacts is None:
            return self
        contacts = bounded(equations.contacts, restitution)
        return self._replace(equations=equations._replace(contacts=contacts))

    def swept(self, sweep: Float[Array, "k *n"]) -> "StepProblem":
        """The problem with another sweep of pairs of bodies (`evo_cpg.physics.pairs`), m/s^2."""
        equations = self.equations
        if equations.pairs is None:
            return self
        pairs = swept(equations.pairs, sweep, self.h)
        return self._replace(equations=equations._replace(pairs=pairs))

    def own_sweep(self, iterate: Iterate) -> Float[Array, "k *n"]:
        """The sweep that this problem has; none where no bodies can touch."""
        pairs = self.equations.pairs
        return iterate.qdd[:0] if pairs is None else pairs.sweep

    def sweep(self, iterate: Iterate) -> Float[Array, "k *n"]:
        """Of pairs of bodies at the joint rates of an iterate, m/s^2."""
        equations, pairs = self.equations, self.world.pairs
        if pairs is None or equations.pairs is None:
            return iterate.qdd[:0]
        rates = equations.state.qd + self.h * iterate.qdd
        return sweep_at(self.world.tree, pairs, equations.kin, equations.pairs, rates)

    def pushes(self, iterate: Iterate) -> Bool[Array, "*n"]:
        """Where pairs of bodies push each other, or should."""
        contacts = self.equations.pairs
        if contacts is None:
            return jnp.zeros(iterate.qdd.shape[1:], bool)
        return (contacts.wanted > parting_velocity(contacts, iterate.qdd, self.h)).any(0)

    def strays(self, iterate: Iterate, sweep: Float[Array, "k *n"]) -> Bool[Array, "*n"]:
        """Where pairs that push come elsewhere than they are to, for their sweep is another."""
        contacts = self.equations.pairs
        if contacts is None:
            return jnp.zeros(iterate.qdd.shape[1:], bool)
        velocity = parting_velocity(contacts, iterate.qdd, self.h)
        other = parting_velocity(swept(contacts, sweep, self.h), iterate.qdd, self.h)
        touches = (contacts.wanted > velocity) | (contacts.wanted > other)
        return (touches & (self.h * jnp.abs(other - velocity) > _STRAY)).any(0)

    def gains(self, iterate: Iterate) -> Bool[Array, "*n"]:
        """Where bouncing contacts give the creature energy."""
        contacts = self.equations.contacts
        if contacts is None or iterate.velocity is None or iterate.force is None:
            return jnp.zeros(iterate.qdd.shape[1:], bool)
        work = contact_work(contacts, iterate.velocity, iterate.force, self.h)
        return (work > 0) & (contacts.bounce > 0).any(0)

    def asked(self, qdd: Float[Array, "d *n"]) -> Float[Array, "d *n"]:
        """Of the motors at the end of the step, N m."""
        wanted = self.equations.wanted
        return wanted - self.h * servo_slope(self.world.tree, wanted, self.h) * qdd

    def cone_radius(self, iterate: Iterate) -> Float[Array, "p *n"]:
        """Of the friction cones, under the normal forces of the laws at an iterate, N."""
        footing, contacts = self.world.footing, self.equations.contacts
        if footing is None or contacts is None or iterate.velocity is None:
            return iterate.qdd[:0]
        return cone_radius(footing, contacts, iterate.velocity, self.h)

    def linearized_at(self, radius: Float[Array, "p *n"], iterate: Iterate) -> Linearization:
        """Of the laws at an iterate."""
        return self.linearized(radius, iterate.qdd, iterate.velocity)

    def linearized(
        self,
        radius: Float[Array, "p *n"],
        qdd: Float[Array, "d *n"],
        velocity: Float[Array, "3 p *n"] | None,
    ) -> Linearization:
        """Of the laws at some motion."""
        tree, state, wanted = self.world.tree, self.equations.state, self.equations.wanted
        asked = self.asked(qdd)
        over = overloaded(tree, asked)
        torque = jnp.where(over, clamp_torque(tree, asked), wanted)
        slope = jnp.where(over, 0.0, servo_slope(tree, wanted, self.h))
        change = self.h * qdd
        stop, stop_slope = limit_torque(tree, state.q, state.qd + change, self.h)
        torque, slope = torque + stop + stop_slope * change, slope + stop_slope
        footing, contacts, linear = self.world.footing, self.equations.contacts, None
        if footing is not None and contacts is not None and velocity is not None:
            linear = linearize_contacts(footing, contacts, radius, velocity, self.h)
        pairs, apart, pushes = self.world.pairs, self.equations.pairs, None
        if pairs is not None and apart is not None:
            pushes = linearize_pairs(pairs, apart, parting_velocity(apart, qdd, self.h), self.h)
        return Linearization(torque, slope, linear, pushes)

    def force_residual(self, iterate: Iterate, linear: Linearization) -> ForceResidual:
        """What an iterate's torques and forces have beyond the laws', linearized there."""
        torque = iterate.torque - (linear.torque - self.h * linear.slope * iterate.qdd)
        force = push = None
        if iterate.force is not None and linear.contact is not None:
            force = iterate.force - linear.contact.force
        if iterate.push is not None and linear.pairs is not None:
            push = iterate.push - linear.pairs.force
        return ForceResidual(torque, force, push)

    def residual(self, iterate: Iterate, linear: Linearization) -> Float[Array, "*n"]:
        """Norm of what the laws are missed by, as shares of motors' limits and of the load."""
        torque, force, push = self.force_residual(iterate, linear)
        limit = self.world.tree.torque_limit
        most = expand_dims_like(xp.where(xp.isfinite(limit), limit, 0.0), torque)
        most = jnp.maximum(jnp.maximum(most, jnp.abs(iterate.torque)), _SLOW * linear.slope)
        shares = torque / jnp.maximum(most, _NONE)
        total = (shares * shares).sum(0)
        if force is not None:
            total = total + (force * force).sum((0, 1)) / self.load(linear) ** 2
        if push is not None:
            total = total + (push * push).sum(0) / self.load(linear) ** 2
        return jnp.sqrt(total)

    def beyond_coulomb(
        self,
        radius: Float[Array, "p *n"],
        found: Float[Array, "p *n"],
        iterate: Iterate,
        linear: Linearization,
    ) -> Float[Array, "*n"]:
        """Norm of what friction misses its law by with a cone, as a share of the load.

        Args:
            radius: of the cone that the iterate was found with.
            found: the one that its own normal forces give.
            iterate: some motion.
            linear: the laws linearized there.
        """
        footing = self.world.footing
        if footing is None or iterate.velocity is None:
            return jnp.zeros(iterate.qdd.shape[1:], iterate.qdd.dtype)
        change = friction_change(footing, radius, found, iterate.velocity, self.h)
        return jnp.sqrt((change * change).sum(0)) / self.load(linear)

    def load(self, linear: Linearization) -> Float[Array, "*n"]:
        """What ground and pairs carry, or the weight if that is more, N."""
        weight = self.world.gravity * self.world.tree.mass.sum()
        carried = jnp.zeros_like(linear.torque[:0]).sum(0)
        if linear.contact is not None:
            carried = carried + linear.contact.force[2].sum(0)
        if linear.pairs is not None:
            carried = carried + linear.pairs.force.sum(0)
        return jnp.maximum(carried, xp.maximum(weight, _NONE))
