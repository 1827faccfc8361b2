"""Chance in a trial: where the animal starts, and how it is pushed about.

Fukui 2003, chapter 4, finds that his simulation is not perfectly repeatable, so that chance
decides who is kept. Here a trial repeats to the last bit, and chance is put in on purpose, from
random numbers that belong to the trial alone (see `evo_cpg.training.experiment.trial_keys`).

How rough the ground is differs from trial to trial, and not within one.

The push is a random walk added to the root's velocity: over a time t its standard deviation is
``push sqrt(t)``, however long a control step is.
"""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Shaped, UInt32

from evo_cpg.physics.contact_points import clearance
from evo_cpg.physics.kinematics import kinematics
from evo_cpg.physics.state import State
from evo_cpg.physics.world import World
from evo_cpg.spatial.linear import expand_dims_like
from evo_cpg.spatial.numerics import is_traced
from evo_cpg.spatial.rotation import integrate_quaternion

# Tags that keep the random streams of one trial apart.
_START, _PUSH, _FRICTION = 0, 1, 2


class Noise(eqx.Module):
    """How large chance is; what is 0 costs nothing.

    Attributes:
        joint_angle: standard deviation of every joint angle at the start, rad; no joint starts
            beyond its limits.
        tilt: standard deviation of the root's roll and of its pitch at the start, rad.
        push: of the root in each direction, m/s per square root of a second.
        friction: by up to such a share the ground's friction, static and dynamic, differs from
            trial to trial, up and down.
    """

    joint_angle: float = 0.0
    tilt: float = 0.0
    push: float = 0.0
    friction: float = 0.0

    @property
    def silent(self) -> bool:
        """Whether every trial of an individual is the same; never where a size is traced."""
        return all(
            _is_none(size) for size in (self.joint_angle, self.tilt, self.push, self.friction)
        )


def disturb_start(
    noise: Noise, world: World, state: State, keys: UInt32[Array, "w *n"] | None
) -> State:
    """The pose at the start, as chance has it; lifted where that would be in the ground.

    Args:
        noise: how large chance is.
        world: the creature and its surroundings.
        state: the pose without noise.
        keys: raw random keys of the trials; None without noise.
    """
    if keys is None or (_is_none(noise.joint_angle) and _is_none(noise.tilt)):
        return state
    tree = world.tree
    turn, bend = jnp.split(_normals(keys, _START, 2 + tree.dof_count), [2])
    # The rotation vector as a rate that is held for a second.
    tilt = noise.tilt * jnp.concatenate([turn, jnp.zeros_like(turn[:1])])
    lower, upper = (expand_dims_like(limit, state.q) for limit in (tree.lower, tree.upper))
    state = State(
        state.position,
        state.orientation
        if _is_none(noise.tilt)
        else integrate_quaternion(state.orientation, tilt, 1.0),
        state.velocity,
        jnp.clip(state.q + noise.joint_angle * bend, lower, upper),
        state.qd,
    )
    if world.contact_model is None:
        return state
    depth = -clearance(world.contact_model, kinematics(tree, state)).min(0)
    lift = [jnp.zeros_like(state.position[:2]), jnp.maximum(depth, 0.0)[None]]
    return eqx.tree_at(lambda s: s.position, state, state.position + jnp.concatenate(lift))


def disturb_motion(
    noise: Noise,
    state: State,
    keys: UInt32[Array, "w *n"] | None,
    index: Array,
    duration: float,
) -> State:
    """The state after the push of one control step.

    Args:
        noise: how large chance is.
        state: before it.
        keys: raw random keys of the trials; None without noise.
        index: number of the control step.
        duration: of a control step, s.
    """
    if keys is None or _is_none(noise.push):
        return state
    push = noise.push * float(np.sqrt(duration)) * _normals(keys, _PUSH, 3, index)
    velocity = state.velocity + jnp.concatenate([jnp.zeros_like(push), push])
    return eqx.tree_at(lambda s: s.velocity, state, velocity)


def friction_scale_of(
    noise: Noise, keys: UInt32[Array, "w *n"] | None
) -> Float[Array, " *n"] | None:
    """Return the factor on friction in each trial; None if it is always 1."""
    if keys is None or _is_none(noise.friction):
        return None

    def of_trial(key: Shaped[Array, ""]) -> Float[Array, ""]:
        draw = jax.random.uniform(jax.random.fold_in(key, _FRICTION), (), jnp.float32, -1.0, 1.0)
        return 1.0 + noise.friction * draw

    return _of_each(of_trial, keys)


def _is_none(size: ArrayLike) -> bool:
    """Whether there is no such noise; a traced size is one."""
    return not (is_traced(size) or size)


def _normals(
    keys: UInt32[Array, "w *n"], stream: int, count: int, index: Array | int = 0
) -> Float[Array, "count *n"]:
    """Normal deviates of every trial: each has its own, whoever else there is."""

    def of_trial(key: Shaped[Array, ""]) -> Float[Array, " count"]:
        key = jax.random.fold_in(jax.random.fold_in(key, stream), index)
        return jax.random.normal(key, (count,), jnp.float32)

    return _of_each(of_trial, keys)


def _of_each(
    of_trial: Callable[[Shaped[Array, ""]], Array], keys: UInt32[Array, "w *n"]
) -> Float[Array, "..."]:
    """What is drawn with the key of every trial, on the trailing axes."""
    batch = keys.shape[1:]
    if not batch:
        return of_trial(jax.random.wrap_key_data(keys))
    flat = jax.random.wrap_key_data(keys.reshape(len(keys), -1).T)
    drawn = jax.vmap(of_trial, out_axes=-1)(flat)
    return drawn.reshape(*drawn.shape[:-1], *batch)
