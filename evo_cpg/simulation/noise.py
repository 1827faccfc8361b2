"""Noise in a trial: changes of the initial pose, pushes on the root, and changes of friction.

Fukui 2003, chapter 4, finds that his simulation is not perfectly repeatable, so chance affects
selection. Here a trial repeats to the last bit. Noise is added on purpose, from random numbers of
the trial alone (see `evo_cpg.training.experiment.trial_keys`).

The friction of the ground varies between trials. It is constant within a trial.

A root that hangs on the world has no tilt, and a push moves it along its slides only. Slides start
without noise, because the size of the noise is an angle. A ball that starts beyond its limit turns
back about the same direction to the limit. If the noise would let the animal penetrate the ground,
the root is lifted, or the frame on which it hangs.

The push is a random walk added to the root's velocity. Its standard deviation over a time t is
``push sqrt(t)``, for any length of a control step.
"""

import dataclasses
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Shaped, UInt32

from evo_cpg.creature.algebra.linear import expand_dims_like
from evo_cpg.creature.algebra.numerics import is_traced
from evo_cpg.creature.algebra.rotation import integrate_quaternion
from evo_cpg.creature.tree import Tree
from evo_cpg.physics.contact.contact_points import clearance
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree import ball_limit, hanging
from evo_cpg.physics.tree.kinematics import kinematics
from evo_cpg.physics.tree.state import State

# Tag of a trial's key for its course, and tags that keep the streams of its noise apart.
_COURSE = 0
_START, _PUSH, _FRICTION = 0, 1, 2
# The sense with the number k has the stream SENSES + k.
SENSES = 3


class Noise(eqx.Module):
    """Sizes of the noise. A size of 0 costs no time.

    Attributes:
        joint_angle: standard deviation of every initial joint angle, rad, and of each component of
            a ball's rotation. Angles are clipped to the joint limits.
        tilt: standard deviation of the root's initial roll and pitch, rad.
        push: standard deviation of the random change of the root's velocity along each axis in one
            second, m/s per square root of a second.
        friction: largest relative change of the ground's static and dynamic friction in a trial,
            up or down.
        senses: whether a sense has noise (`evo_cpg.simulation.imperfect`).
    """

    joint_angle: float = 0.0
    tilt: float = 0.0
    push: float = 0.0
    friction: float = 0.0
    senses: bool = eqx.field(static=True, default=False)

    @property
    def silent(self) -> bool:
        """Return whether no noise is set. A noise of traced size counts as set."""
        sizes = self.joint_angle, self.tilt, self.push, self.friction
        return not self.senses and all(is_none(size) for size in sizes)


def disturb_start(
    noise: Noise, world: World, state: State, keys: UInt32[Array, "w *n"] | None
) -> State:
    """Return the initial pose with noise, lifted if it would penetrate the ground.

    ``keys`` are raw random keys of the trials, or None without noise.
    """
    if keys is None or (is_none(noise.joint_angle) and is_none(noise.tilt)):
        return state
    tree = world.tree
    turn, bend = jnp.split(normals(keys, _START, 2 + tree.dof_count), [2])
    # Rotate by the rotation vector: an angular velocity of this size for one second.
    tilt = noise.tilt * jnp.concatenate([turn, jnp.zeros_like(turn[:1])])
    lower, upper = (expand_dims_like(limit, state.q) for limit in (tree.lower, tree.upper))
    orientation = state.orientation
    if not is_none(noise.tilt):
        orientation = integrate_quaternion(orientation, tilt, 1.0)
    if tree.slides.any():
        bend = bend * expand_dims_like(1.0 - tree.slides, bend)
    q = jnp.clip(state.q + noise.joint_angle * bend, lower, upper)
    q = ball_limit.within(tree.ball_limits, q)
    state = dataclasses.replace(state, orientation=orientation, q=q).placed(tree)
    if world.contact_model is None:
        return state
    depth = -clearance(world.contact_model, kinematics(tree, state)).min(0)
    lift = [jnp.zeros_like(state.position[:2]), jnp.maximum(depth, 0.0)[None]]
    if state.base is not None:
        base = state.base._replace(position=state.base.position + jnp.concatenate(lift))
        return dataclasses.replace(state, base=base).placed(tree)
    return eqx.tree_at(lambda s: s.position, state, state.position + jnp.concatenate(lift))


def disturb_motion(
    noise: Noise,
    tree: Tree,
    state: State,
    keys: UInt32[Array, "w *n"] | None,
    index: Array,
    duration: float,
) -> State:
    """Return the state after the push of one control step, which has a duration (s)."""
    if keys is None or is_none(noise.push):
        return state
    push = noise.push * float(np.sqrt(duration)) * normals(keys, _PUSH, 3, index)
    if state.base is not None:
        slides = np.array(tree.root_slides, int)
        along = hanging.pushed(tree, state.base, state.q, push) if len(slides) else push[:0]
        return dataclasses.replace(state, qd=state.qd.at[slides].add(along)).placed(tree)
    velocity = state.velocity + jnp.concatenate([jnp.zeros_like(push), push])
    return eqx.tree_at(lambda s: s.velocity, state, velocity)


def friction_scale_of(
    noise: Noise, keys: UInt32[Array, "w *n"] | None
) -> Float[Array, " *n"] | None:
    """Return the factor on friction in each trial, or None if it is always 1."""
    if keys is None or is_none(noise.friction):
        return None

    def of_trial(key: Shaped[Array, ""]) -> Float[Array, ""]:
        draw = jax.random.uniform(jax.random.fold_in(key, _FRICTION), (), jnp.float32, -1.0, 1.0)
        return 1.0 + noise.friction * draw

    return _of_each(of_trial, keys)


def is_none(size: ArrayLike) -> bool:
    """Return whether the size of a noise is 0. A traced size counts as not 0."""
    return not (is_traced(size) or size)


def normals(
    keys: UInt32[Array, "w *n"], stream: int, count: int, index: Array | int = 0
) -> Float[Array, "count *n"]:
    """Return normal deviates of every trial, independent of the other trials in the batch."""

    def of_trial(key: Shaped[Array, ""]) -> Float[Array, " count"]:
        key = jax.random.fold_in(jax.random.fold_in(key, stream), index)
        return jax.random.normal(key, (count,), jnp.float32)

    return _of_each(of_trial, keys)


def raw_keys(keys: Shaped[Array, " *n"]) -> UInt32[Array, "4 *n"]:
    """Return the raw random keys of trials, given a key of each: for its noise and its course."""
    noise = jax.random.key_data(keys)
    course = jax.random.key_data(jnp.vectorize(jax.random.fold_in)(keys, _COURSE))
    return jnp.moveaxis(jnp.concatenate([noise, course], -1), -1, 0)


def uniforms(keys: UInt32[Array, "w *n"], count: int, tag: int) -> Float[Array, "count *n"]:
    """Return uniform deviates of every trial, from 0 to 1, for one purpose."""

    def of_trial(key: Array) -> Array:
        return jax.random.uniform(jax.random.fold_in(key, tag), (count,), jnp.float32)

    return _of_each(of_trial, keys)


def _of_each(
    of_trial: Callable[[Shaped[Array, ""]], Array], keys: UInt32[Array, "w *n"]
) -> Float[Array, "..."]:
    """Return the draws of every trial with its key, with the trials on the trailing axes."""
    batch = keys.shape[1:]
    if not batch:
        return of_trial(jax.random.wrap_key_data(keys))
    flat = jax.random.wrap_key_data(keys.reshape(len(keys), -1).T)
    drawn = jax.vmap(of_trial, out_axes=-1)(flat)
    return drawn.reshape(*drawn.shape[:-1], *batch)
