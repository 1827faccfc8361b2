"""The three outer updates that turn a convex step problem into Coulomb contact.

Newton's method (`evo_cpg.physics.step.newton`) solves a problem in which the friction-cone radii,
the restitution and the velocity-product bias of touching limbs are fixed. Each of the three has an
update here. `evo_cpg.physics.step.step_solver` applies them.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from evo_cpg.creature.algebra.linear import where_each
from evo_cpg.physics.step.newton import Iterate, tolerances
from evo_cpg.physics.step.step_problem import StepProblem
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.root import JOINTS

# Most rounds of friction cones, and most values of the pair bias, in a step.
_CONE_ROUNDS, _PAIR_BIASES = 8, 3

# Largest Coulomb error (`StepProblem.coulomb_error`) at which float32 stops updating the cones.
_COULOMB = 1e-2

# Factor by which one update reduces the restitution, and the number of reductions before it is 0.
_REDUCTION, _REDUCTIONS = 0.5, 2

# Least squared force (N^2) to divide by.
_NONE = 1e-12


class Cone(NamedTuple):
    """Friction-cone radii ``L``, with the previous round for Anderson's acceleration.

    Attributes:
        radius: L in this round, N.
        allowed: mu f_n of the previous round, N. The first round does not use it.
        missed: `allowed` minus the radius of the previous round, N.
        rounds: number of completed rounds.
    """

    radius: Float[Array, "p *n"]
    allowed: Float[Array, "p *n"]
    missed: Float[Array, "p *n"]
    rounds: Int[Array, "*n"]

    @classmethod
    def first(cls, radius: Float[Array, "p *n"]) -> "Cone":
        """Return the cones of the first round."""
        return cls(radius, radius, radius, jnp.zeros(radius.shape[1:], jnp.int32))

    def updated(self, allowed: Float[Array, "p *n"]) -> "Cone":
        """Return the cones of the next round: ``L = mu f_n``, by Anderson's acceleration."""
        missed = allowed - self.radius
        change = missed - self.missed
        mixing = (missed * change).sum(0) / jnp.maximum((change * change).sum(0), _NONE)
        mixing = jnp.where(self.rounds > 0, jnp.clip(mixing, -1.0, 1.0), 0.0)
        radius = jnp.maximum(allowed - mixing[None] * (allowed - self.allowed), 0.0)
        return Cone(radius, allowed, missed, self.rounds + 1)


class Outer(NamedTuple):
    """Parameters of a step problem that Newton's method keeps fixed.

    Attributes:
        restitution: remaining fraction of the restitution, 0 to 1.
        bias: velocity-product bias of pairs (`evo_cpg.physics.contact.pair_contacts`).
        bias_updates: number of updates of the bias.
    """

    cone: Cone
    restitution: Float[Array, "*n"]
    bias: Float[Array, "k *n"]
    bias_updates: Int[Array, "*n"]


def most_updates(world: World) -> tuple[int, int]:
    """Return the largest numbers of rounds of friction cones, and of values of the pair bias."""
    rounds = 1 if world.contact_model is None else _CONE_ROUNDS
    return rounds, 1 if world.pairs is None else _PAIR_BIASES


def next_update(
    problem: StepProblem, outer: Outer, iterate: Iterate
) -> tuple[Outer, Bool[Array, "*n"], Bool[Array, "*n"]]:
    """Return the parameters after the first update that an iterate needs.

    Returns:
        The parameters, whether the iterate is the step's solution, and whether the cones changed.
    """
    y, velocity, pair_sums = iterate
    (rounds, biases), qdd, cone = most_updates(problem.world), y[JOINTS], outer.cone
    linear = problem.linearized(cone.radius, qdd, velocity, pair_sums)

    # Solved?
    tolerance, rough = tolerances(y)
    residual = problem.residual(y, linear)
    last_round = cone.rounds + 1 >= rounds
    solved = residual <= jnp.where(last_round, tolerance, rough)

    # Friction cone: float32 stops early once Coulomb's law holds.
    allowed = problem.cone_radius(velocity)
    coulomb = problem.coulomb_error(cone.radius, allowed, velocity, linear) <= _COULOMB
    early = (y.dtype != jnp.float64) & coulomb & (residual <= tolerance)
    cone_done = (solved & last_round) | early
    change_cone = solved & ~cone_done

    # Restitution.
    bounces = problem.must_reduce_restitution(y, linear) & (outer.restitution > 0)
    less = jnp.where(cone_done & bounces, reduced(outer.restitution), outer.restitution)

    # Pair bias.
    finished, bias, updates = cone_done & ~bounces, outer.bias, outer.bias_updates
    pairs = problem.equations.pairs
    if pairs is not None:
        new = pairs.bias_at(qdd)
        change_bias = pairs.drifts(qdd, new, finished & (updates + 1 < biases))
        bias, updates = where_each(change_bias, (new, updates + 1), (bias, updates))
        finished = finished & ~change_bias
    cone = where_each(change_cone, cone.updated(allowed), cone)
    return Outer(cone, less, bias, updates), finished, change_cone


def reduced(restitution: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """Halve the restitution, or return 0 after the last allowed halving."""
    less = _REDUCTION * restitution
    return jnp.where(less < _REDUCTION**_REDUCTIONS, 0.0, less)
