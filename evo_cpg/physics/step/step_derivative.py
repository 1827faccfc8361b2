"""Derivatives of a solved step, by the implicit function theorem.

One more Newton step at a solution changes nothing, and its derivative is the derivative of the
solution. A single step at the end is not enough, because a round of friction cones takes its radii
from the solution before, and the rounds are cut off before they converge. `replay` therefore takes
a Newton step in every round of cones, and under every further pair bias. The search notes the
solutions at which it does so.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from evo_cpg.creature.algebra.linear import where_each
from evo_cpg.physics.step.newton import full_step
from evo_cpg.physics.step.outer_updates import Cone, Outer, most_updates
from evo_cpg.physics.step.step_problem import StepProblem
from evo_cpg.physics.tree.root import JOINTS


class SolvedStep(NamedTuple):
    """The solution y, and the parameters of its problem (`Outer`)."""

    y: Float[Array, "v *n"]
    radius: Float[Array, "p *n"]
    restitution: Float[Array, "*n"]
    bias: Float[Array, "k *n"]


class Visited(NamedTuple):
    """Intermediate solutions of a search.

    Attributes:
        cones: accelerations under each round of cones with the first pair bias.
        biases: accelerations under each further pair bias.
        last_round: number of the last round of cones under the first pair bias.
    """

    cones: tuple[Float[Array, "v *n"], ...]
    biases: tuple[Float[Array, "v *n"], ...]
    last_round: Int[Array, "*n"]

    @classmethod
    def first(cls, problem: StepProblem, y: Float[Array, "v *n"]) -> "Visited":
        """Return the notes of a search at its first iterate."""
        rounds, biases = most_updates(problem.world)
        return cls((y,) * rounds, (y,) * (biases - 1), jnp.zeros(y.shape[1:], jnp.int32))

    def updated(
        self, y: Float[Array, "v *n"], outer: Outer, change_cone: Bool[Array, "*n"]
    ) -> "Visited":
        """Return the notes with a solution under some parameters, before these change."""
        rounds, updates = outer.cone.rounds, outer.bias_updates
        cones = (
            where_each((updates == 0) & (rounds == k), y, old) for k, old in enumerate(self.cones)
        )
        biases = (where_each(updates == k, y, old) for k, old in enumerate(self.biases, 1))
        last = jnp.where(updates > 0, self.last_round, rounds + change_cone)
        return Visited(tuple(cones), tuple(biases), last)


class SearchRecord(NamedTuple):
    """Input of `replay`: the solutions of `Visited`, and the final parameters of `Outer`."""

    cones: tuple[Float[Array, "v *n"], ...]
    biases: tuple[Float[Array, "v *n"], ...]
    restitution: Float[Array, "*n"]
    bias_updates: Int[Array, "*n"]


def replay(problem: StepProblem, radius: Float[Array, "p *n"], record: SearchRecord) -> SolvedStep:
    """Return the solution by one Newton step under every cone and pair bias, for derivatives."""

    # `jit` traces all these steps once.
    @jax.jit
    def stepped(restitution: Array, bias: Array | None, radius: Array, point: Array) -> Array:
        return full_step(problem.under(restitution, bias), radius, point)

    bias, pairs = problem.pair_bias, problem.equations.pairs
    ones, end = jnp.ones_like(record.restitution), record.restitution
    start = problem.under(ones)
    first, *further = record.cones
    cone = Cone.first(radius)
    y = stepped(ones if further else end, bias, radius, first)
    for k, point in enumerate(further, 1):
        cone = cone.updated(start.cone_radius(start.velocity(y)))
        y = stepped(end if k == len(further) else ones, bias, cone.radius, point)
    for k, point in enumerate(record.biases, 1):
        assert pairs is not None
        new = pairs.bias_at(y[JOINTS])
        there = stepped(end, new, cone.radius, point)
        y, bias = where_each(record.bias_updates >= k, (there, new), (y, bias))
    return SolvedStep(y, cone.radius, record.restitution, bias)
