"""A trial as reverse-mode differentiation goes back through it.

Two things are done that change nothing forwards. Memory: of each control step the way back needs
what its programs started from (see `fusion.frontend.derivatives`), which is kept; where that is too
much for the whole trial, only what goes from one segment to the next is, and the rest computed
again (Griewank's checkpoints in two levels). Horizon: a small change
early in a trial changes what comes later the more, the later it is, and where the motion is chaotic
the exact slope of the end says little about any finite step. A *faded* slope forgets: on its way
back it shrinks by a factor in every control step, except for what it says of the root's position,
which only ever adds up. On the ground some moments are so chaotic that no fading holds: there a
slope is cut as well, to what a state can sensibly say about the way that is still to come.
"""

import dataclasses
import math
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import Literal
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from evo_cpg.fusion import machine_constants
from evo_cpg.physics.state import State

Carry = TypeVar("Carry")
Values = TypeVar("Values")

# What of a slope fades, beside nerves. On rough ways the height is one of them, and together they
# are at most so many times as large (in SI units) as what the slope says of the place.
_FADING = "orientation", "velocity", "q", "qd"
_STEEPEST = 10.0


class Backward(NamedTuple):
    """How a trial is differentiated.

    Attributes:
        retention: share of a slope that is left of it one control step further back; None to
            leave the slope exact, which 1 does as well.
        copies: of the trial that are computed at once by `jax.vmap` and share the memory.
        rough: the way leads over ground, on which slopes may grow a millionfold in a tenth of a
            second. They are cut, and what they say of the height fades.
    """

    retention: Float[Array, " *#n"] | float | None = None
    copies: int = 1
    rough: bool = False

    def scan(self, advance: Callable, carry: Carry, steps: int) -> Carry:
        """`jax.lax.scan` of a function of the carry and the number of the step, for its carry.

        Args:
            advance: one control step; what it gives beside the carry is dropped.
            carry: at the start.
            steps: how many.
        """

        def segment(length: int) -> Callable:
            def walk(carry: Carry, first: ArrayLike) -> tuple[Carry, None]:
                numbers = first + jnp.arange(length)
                return jax.lax.scan(step, carry, numbers)[0], None

            return walk

        def step(carry: Carry, number: ArrayLike) -> tuple[Carry, None]:
            return advance(carry, number)[0], None

        kept = _kept_bytes(step, carry)
        if self.copies * steps * kept <= machine_constants.LARGEST_RESIDUALS:
            return segment(steps)(carry, 0)[0]
        # The least memory for the states between segments and for one segment together.
        length = max(1, math.isqrt(steps * _bytes(jax.tree.leaves(carry)) // kept))
        count, rest = divmod(steps, length)
        whole_segment = jax.checkpoint(segment(length), prevent_cse=False)
        carry, _ = jax.lax.scan(whole_segment, carry, length * jnp.arange(count))
        return segment(rest)(carry, count * length)[0] if rest else carry

    def forget(self, state: State, nerves: Any) -> tuple[State, Any]:
        """Body and nerves as they are; slopes that come back through here fade and are cut.

        Args:
            state: of the body.
            nerves: whatever else goes on from step to step.
        """
        if self.retention is not None:
            kept = jnp.asarray(self.retention, state.q.dtype)
            moving = {name: getattr(state, name) for name in _FADING}
            moving, nerves = _fading((moving, nerves), kept)
            if self.rough:
                height = _fading(state.position[2:], kept)
                moving["position"] = jnp.concatenate([state.position[:2], height])
            state = dataclasses.replace(state, **moving)
        return _cut(state) if self.rough else state, nerves


def retention(horizon: Float[np.ndarray, " *n"], control_rate: float) -> Float[np.ndarray, " *n"]:
    """Of slopes that fade to 1/e within the horizon (s); infinity keeps them."""
    return np.exp(-1.0 / (horizon * control_rate))


def _kept_bytes(step: Callable, carry: Any) -> int:
    """What one control step leaves for the way back, bytes; not what is the same for all steps."""
    pure, shared = jax.closure_convert(lambda carry: step(carry, jnp.zeros((), int))[0], carry)

    def leave(carry: Any, *shared: Array) -> list[Array]:
        return jax.tree.leaves(jax.vjp(pure, carry, *shared)[1])

    jaxpr = jax.make_jaxpr(leave)(carry, *shared).jaxpr
    moving = set(jaxpr.invars[: len(jax.tree.leaves(carry))])
    for equation in jaxpr.eqns:
        if any(x in moving for x in equation.invars if not isinstance(x, Literal)):
            moving.update(equation.outvars)
    left = {x for x in jaxpr.outvars if not isinstance(x, Literal) and x in moving}
    return _bytes(x.aval for x in left)


def _bytes(arrays: Iterable[Any]) -> int:
    return sum(x.size * x.dtype.itemsize for x in arrays)


def _fading(values: Values, factor: Array) -> Values:
    """The same values; slopes with respect to them are multiplied by the factor."""
    return jax.tree.map(
        lambda x: _faded(x, factor) if jnp.issubdtype(x.dtype, jnp.inexact) else x, values
    )


@jax.custom_jvp
def _faded(x: Array, factor: Array) -> Array:
    del factor
    return x


@_faded.defjvp
def _faded_jvp(primals: tuple[Array, Array], tangents: tuple[Array, Array]) -> tuple[Array, Array]:
    (x, factor), (gradient, _) = primals, tangents
    rows = (1,) * (x.ndim - factor.ndim)
    return x, factor.reshape(*rows, *factor.shape) * gradient


@jax.custom_vjp
def _cut(state: State) -> State:
    """The same state; slopes with respect to it are no steeper than `_STEEPEST` allows.

    Where a slope says nothing of the place it is left as it is.
    """
    return state


def _cut_forward(state: State) -> tuple[State, None]:
    return state, None


def _cut_backward(_: None, gradient: State) -> tuple[State]:
    place, height = gradient.position[:2], gradient.position[2:]
    moving = {name: getattr(gradient, name) for name in _FADING}
    size = jnp.sqrt(sum((x * x).sum(0) for x in (height, *moving.values())))
    said = jnp.sqrt((place * place).sum(0))
    most = jnp.where(said > 0, _STEEPEST * said, jnp.inf)
    fraction = jnp.minimum(1.0, most / jnp.maximum(size, jnp.finfo(size.dtype).tiny))
    fraction = jnp.where(jnp.isfinite(size), fraction, 0.0)

    def shrink(x: Array) -> Array:
        return jnp.where(fraction[None] > 0, fraction[None] * x, 0.0)

    place = jnp.where(jnp.isfinite(place), place, 0.0)
    cut = {name: shrink(x) for name, x in moving.items()}
    return (State(position=jnp.concatenate([place, shrink(height)]), **cut),)


_cut.defvjp(_cut_forward, _cut_backward)
