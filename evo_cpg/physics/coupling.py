"""The motion under linearized laws of contacts, motors and pairs of bodies.

Without pairs one articulated-body solve gives it. Pairs join branches of the tree: with the
response ``W = J M^-1 J^T`` of their velocities to forces on them, their forces p solve

    (1 / slope + h W) p = force / slope + velocity - v_0,

v_0 being their velocities without p. Each product with W is one more solve, and conjugate gradients
need no more of them than pairs touch (Hestenes and Stiefel 1952); animals of which none do need
none.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from evo_cpg.fusion.converge import implicit, while_each
from evo_cpg.physics.articulated import Accelerations
from evo_cpg.physics.pairs import PairContacts, PairLinearization, parting_change, parting_velocity
from evo_cpg.spatial.linear import of_each

# Share of the right-hand side's norm that may be left in float32, and in float64.
_TOLERANCE, _EXACT = 1e-5, 1e-13

# Rounds at most, per pair and beyond, for what rounding leaves.
_MORE = 4

# Of squared velocities (m^2/s^2) and of quotients that counts as none.
_NONE = 1e-30

Respond = Callable[[Float[Array, "p *n"]], Accelerations]


class _Descent(NamedTuple):
    """Conjugate gradients, and the motion that comes with the forces found.

    Attributes:
        force: N.
        motion: because of them.
        left: of the right-hand side, m/s.
        way: in which forces change next.
        square: of what is left.
        rounds: how many there were.
    """

    force: Float[Array, "p *n"]
    motion: Accelerations
    left: Float[Array, "p *n"]
    way: Float[Array, "p *n"]
    square: Float[Array, "*n"]
    rounds: Array


def couple(
    contacts: PairContacts,
    linear: PairLinearization,
    free: Accelerations,
    respond: Respond,
    h: float,
) -> tuple[Accelerations, Float[Array, "p *n"]]:
    """The motion with pairs that push as their linearized laws say, and their forces, N.

    Args:
        contacts: of this step.
        linear: their laws, linearized.
        free: the motion without them.
        respond: the motion under forces of pairs alone.
        h: s.
    """
    touches = jnp.where(linear.slope > 0, 1.0, 0.0).astype(linear.slope.dtype)
    give = touches / jnp.maximum(linear.slope, _NONE)

    def part(motion: Accelerations) -> Array:
        return parting_change(contacts, motion.qdd, h)

    def product(force: Array) -> Array:
        # Pairs that do not touch stand for themselves, so that it has an inverse.
        own = give + (1.0 - touches)
        return own * force + touches * part(respond(touches * force))

    def wanted() -> Array:
        start = parting_velocity(contacts, free.qdd, h)
        return give * linear.force + touches * (linear.velocity - start)

    def gradients(given: Array) -> _Descent:
        none = jax.tree.map(jnp.zeros_like, free)
        square = (given * given).sum(0)
        tolerance = _EXACT if given.dtype == jnp.float64 else _TOLERANCE
        enough = tolerance**2 * square + _NONE

        def goes_on(here: _Descent) -> Array:
            return (here.square > enough) & (here.rounds < given.shape[0] + _MORE)

        def advance(here: _Descent) -> _Descent:
            motion = respond(here.way)
            change = give * here.way + touches * part(motion)
            share = here.square / jnp.maximum((here.way * change).sum(0), _NONE)
            left = here.left - share[None] * change
            square = (left * left).sum(0)
            turn = square / jnp.maximum(here.square, _NONE)
            return _Descent(
                here.force + share[None] * here.way,
                jax.tree.map(lambda x, d: x + of_each(share, d) * d, here.motion, motion),
                left,
                left + turn[None] * here.way,
                square,
                here.rounds + 1,
            )

        rounds = jnp.zeros(square.shape, jnp.int32)
        begin = _Descent(jnp.zeros_like(given), none, given, given, square, rounds)
        return while_each(goes_on, advance, begin)

    def search(_: Array) -> tuple[tuple[Accelerations, Array], Array]:
        found = gradients(wanted())
        return (jax.tree.map(jnp.add, free, found.motion), found.force), found.force

    def replay(force: Array) -> tuple[Accelerations, Array]:
        def solve(_: Callable, given: Array) -> Array:
            return gradients(touches * given).force + (1.0 - touches) * given

        left = wanted() - product(force)
        force = force + jax.lax.custom_linear_solve(product, left, solve, symmetric=True)
        return jax.tree.map(jnp.add, free, respond(force)), force

    return implicit(search, replay, linear.force, linear.force)
