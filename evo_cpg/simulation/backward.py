"""Reverse-mode differentiation of a trial: memory and fading of gradients.

Neither changes the forward computation.

*Memory.* The backward pass needs the inputs of the programs of each control step
(`fusion.native`), which are kept. If they are too large for the whole trial, only the
states between segments are kept. Each segment is then recomputed (Griewank's checkpoints in two
levels).

*Horizon.* A small early change grows with time. In chaotic motion the exact gradient of the result
says little about the effect of a finite change. A *faded* gradient is multiplied by a factor below
1 in every control step on the backward pass. The gradient with respect to the root's position does
not fade, because a change of place only shifts the motion. On the ground fading is not enough at
some moments. There the norm of the faded gradients is also limited to a multiple of the norm of the
horizontal position's gradient.
"""

import dataclasses
import functools
import math
from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import Literal
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from evo_cpg.creature.algebra.linear import expand_dims_like
from evo_cpg.native import machine_constants
from evo_cpg.physics.tree.state import State

Carry = TypeVar("Carry")
Values = TypeVar("Values")

# Fields of the body's state whose gradients fade. Gradients of the controller's state fade, too,
# and in motion over ground (`Backward.rough`) also the gradient of the height.
_FADING = "orientation", "velocity", "q", "qd"
# Largest norm of the gradients of these fields and of the height (SI units), for motion over
# ground. The unit is the norm of the horizontal position's gradient.
_STEEPEST = 10.0


class Backward(NamedTuple):
    """Settings for the reverse-mode differentiation of a trial.

    Attributes:
        retention: fraction of a gradient that is left one control step further back. None or 1
            leaves the gradient exact.
        rough: True for motion over ground, where gradients may grow a millionfold in 0.1 s. Their
            norm is then limited, and the gradient of the height fades, too.
        slides: degrees of freedom on which a root slides. Their gradients are those of its
            position, so they neither fade nor are limited.
    """

    retention: Float[Array, ""] | float | None = None
    rough: bool = False
    slides: tuple[int, ...] = ()

    def scan(self, advance: Callable, carry: Carry, steps: int, batch: tuple[int, ...]) -> Carry:
        """Run `jax.lax.scan` over the step numbers 0, 1, ..., and return the last carry.

        Args:
            advance: one control step, ``(carry, number) -> (carry, result)``. Its results are
                dropped.
            carry: initial carry.
            steps: number of steps.
            batch: lengths of the batch axes. A vector of individuals is computed at once even if
                there is none, because native code and `jax.vmap` add their own.
        """

        def step(carry: Carry, number: ArrayLike) -> tuple[Carry, None]:
            return advance(carry, number)[0], None

        def segment(length: int, carry: Carry, first: ArrayLike) -> tuple[Carry, None]:
            return jax.lax.scan(step, carry, first + jnp.arange(length))[0], None

        # Bytes that each control step keeps for the backward pass.
        pure, shared = jax.closure_convert(lambda carry: step(carry, jnp.zeros((), int))[0], carry)

        def leave(carry: Any, *shared: Array) -> list[Array]:
            return jax.tree.leaves(jax.vjp(pure, carry, *shared)[1])

        jaxpr = jax.make_jaxpr(leave)(carry, *shared).jaxpr
        moving = set(jaxpr.invars[: len(jax.tree.leaves(carry))])
        for equation in jaxpr.eqns:
            if any(x in moving for x in equation.invars if not isinstance(x, Literal)):
                moving.update(equation.outvars)
        left = {x for x in jaxpr.outvars if not isinstance(x, Literal) and x in moving}
        kept = sum(x.aval.size * x.aval.dtype.itemsize for x in left)
        copies = max(machine_constants.LANES // max(math.prod(batch), 1), 1)
        if copies * steps * kept <= machine_constants.LARGEST_RESIDUALS:
            return segment(steps, carry, 0)[0]
        # This length minimises the memory for states between segments plus one segment.
        carried = sum(x.size * x.dtype.itemsize for x in jax.tree.leaves(carry))
        length = max(1, math.isqrt(steps * carried // kept))
        count, rest = divmod(steps, length)
        whole_segment = jax.checkpoint(functools.partial(segment, length), prevent_cse=False)
        carry, _ = jax.lax.scan(whole_segment, carry, length * jnp.arange(count))
        return segment(rest, carry, count * length)[0] if rest else carry

    def forget(self, state: State, nerves: Any) -> tuple[State, Any]:
        """Return body and nerves unchanged, but fade and cut gradients that pass back through.

        Args:
            state: state of the body.
            nerves: everything else that is carried from step to step: the controller's state and
                the warm start of the physics.
        """
        if self.retention is not None:
            kept = jnp.asarray(self.retention, state.q.dtype)
            moving = {name: getattr(state, name) for name in _FADING}
            moving, nerves = jax.tree.map(
                lambda x: _faded(x, kept) if jnp.issubdtype(x.dtype, jnp.inexact) else x,
                (moving, nerves),
            )
            if self.slides:
                stays = np.isin(np.arange(len(state.q)), self.slides)
                stays = expand_dims_like(stays, state.q)
                moving["q"] = jnp.where(stays, state.q, moving["q"])
            if self.rough:
                height = _faded(state.position[2:], kept)
                moving["position"] = jnp.concatenate([state.position[:2], height])
            state = dataclasses.replace(state, **moving)
        return _cut(self.slides, state) if self.rough else state, nerves


def retention(horizon: Float[np.ndarray, " *n"], control_rate: float) -> Float[np.ndarray, " *n"]:
    """Return the retention of gradients that fade to 1/e within the horizon (s, or infinity)."""
    return np.exp(-1.0 / (horizon * control_rate))


@jax.custom_jvp
def _faded(x: Array, factor: Array) -> Array:
    """Return x, with gradients with respect to it multiplied by the factor."""
    del factor
    return x


@_faded.defjvp
def _faded_jvp(primals: tuple[Array, Array], tangents: tuple[Array, Array]) -> tuple[Array, Array]:
    (x, factor), (gradient, _) = primals, tangents
    rows = (1,) * (x.ndim - factor.ndim)
    return x, factor.reshape(*rows, *factor.shape) * gradient


@functools.partial(jax.custom_vjp, nondiff_argnums=(0,))
def _cut(slides: tuple[int, ...], state: State) -> State:
    """Return the state unchanged, with the norm of its gradient limited by `_STEEPEST`.

    If the gradient of the horizontal position, or of the slides, is zero, there is no limit.
    """
    del slides
    return state


def _cut_forward(slides: tuple[int, ...], state: State) -> tuple[State, None]:
    del slides
    return state, None


def _cut_backward(slides: tuple[int, ...], _: None, gradient: State) -> tuple[State]:
    place, height = gradient.position[:2], gradient.position[2:]
    moving = {name: getattr(gradient, name) for name in _FADING}
    stays = expand_dims_like(np.isin(np.arange(len(gradient.q)), slides), gradient.q)
    if slides:
        place = jnp.concatenate([place, gradient.q[np.array(slides)]])
        moving["q"] = jnp.where(stays, 0.0, gradient.q)
    size = jnp.sqrt(sum((x * x).sum(0) for x in (height, *moving.values())))
    horizontal = jnp.sqrt((place * place).sum(0))
    most = jnp.where(horizontal > 0, _STEEPEST * horizontal, jnp.inf)
    fraction = jnp.minimum(1.0, most / jnp.maximum(size, jnp.finfo(size.dtype).tiny))
    fraction = jnp.where(jnp.isfinite(size), fraction, 0.0)
    place = jnp.where(jnp.isfinite(place), place, 0.0)
    cut = {
        name: jnp.where(fraction[None] > 0, fraction[None] * x, 0.0)
        for name, x in (moving | {"height": height}).items()
    }
    height = cut.pop("height")
    if slides:
        whole = jnp.where(jnp.isfinite(gradient.q), gradient.q, 0.0)
        cut["q"] = jnp.where(stays, whole, cut["q"])
        place = place[:2]
    return (dataclasses.replace(gradient, position=jnp.concatenate([place, height]), **cut),)


_cut.defvjp(_cut_forward, _cut_backward)
