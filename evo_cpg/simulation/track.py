"""Track of a trial: columns of its motion at given times, as from a camera or motion tracker."""

import dataclasses
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.creature.algebra.rotation import quaternion_to_matrix
from evo_cpg.physics.tree.state import State
from evo_cpg.simulation.observers import States
from evo_cpg.simulation.rollout import rollout
from evo_cpg.simulation.simulation import Simulation

# Columns: position of the root's centre (m), and its attitude (rad) as yaw, then pitch, then roll
# about its own axes. All others are joint angles (rad), by the names of their axes.
POSITION, ATTITUDE = ("x", "y", "z"), ("roll", "pitch", "yaw")

# Kinds of changes to the initial state: the first parts of names such as ``velocity.x``.
BEGINNINGS = ("velocity", "spin", "angle", "rate")


def column_names(simulation: Simulation) -> tuple[str, ...]:
    """Return the names of all columns."""
    return (*POSITION, *ATTITUDE, *simulation.world.tree.dof_names)


def beginning_names(simulation: Simulation) -> tuple[str, ...]:
    """Return the names of changes to the initial state.

    ``velocity.x`` (m/s), ``spin.x`` (rad/s, world axes), ``angle.DOF`` (rad) and ``rate.DOF``
    (rad/s) are added to the configuration's state. A root that hangs on the world has only the
    last two.
    """
    tree = simulation.world.tree
    dofs, free = tree.dof_names, POSITION if tree.hanging is None else ()
    axes = {"velocity": free, "spin": free, "angle": dofs, "rate": dofs}
    return tuple(f"{kind}.{axis}" for kind in BEGINNINGS for axis in axes[kind])


def track(
    simulation: Simulation,
    genes: Float[Array, "g"],
    times: Float[np.ndarray, " t"],
    columns: Sequence[str],
    beginning: dict[str, Float[Array, ""]] | None = None,
) -> Float[Array, "t c"]:
    """Return columns of numbers (positions, angles) of a trial at given times.

    Positions and joint angles are interpolated by cubics (Hermite) between control steps, so they
    are as exact as the steps themselves. Orientations are interpolated linearly.

    Args:
        simulation: the trial, in its first situation.
        genes: genes of the animal.
        times: times since the start of the trial, s, at most its duration.
        columns: names from `column_names`.
        beginning: changes to the initial state, by `beginning_names`.
    """
    dofs = simulation.world.tree.dof_names
    given = beginning or {}

    def begin(state: State) -> State:
        velocity, q, qd = state.velocity, state.q, state.qd
        for name, value in given.items():
            kind, _, axis = name.partition(".")
            if kind in ("angle", "rate"):
                i = dofs.index(axis)
                q = q.at[i].add(value) if kind == "angle" else q
                qd = qd.at[i].add(value) if kind == "rate" else qd
            else:
                i = POSITION.index(axis) + (3 if kind == "velocity" else 0)
                velocity = velocity.at[i].add(value)
        changed = dataclasses.replace(state, velocity=velocity, q=q, qd=qd)
        return changed.placed(simulation.world.tree)

    states = rollout(simulation, genes, observers=States(), begin=begin)
    length = 1.0 / float(simulation.control_rate)
    place = np.clip(times / length, 0.0, simulation.steps)
    first = np.minimum(place.astype(int), simulation.steps - 1)
    fraction = (place - first)[:, None]

    def curve(value: Array, rate: Array) -> Array:
        a, b = value[first], value[first + 1]
        da, db = length * rate[first], length * rate[first + 1]
        u = fraction
        return (
            a * (1 - u) ** 2 * (1 + 2 * u)
            + da * u * (1 - u) ** 2
            + b * u**2 * (3 - 2 * u)
            - db * u**2 * (1 - u)
        )

    parts = [curve(states.position, states.velocity[:, 3:])]
    a, b = jnp.asarray(states.orientation)[first], states.orientation[first + 1]
    # q and -q are one orientation. Take the nearer one.
    b = b * jnp.where((a * b).sum(1, keepdims=True) < 0, -1.0, 1.0)
    turn = (1 - fraction) * a + fraction * b
    turn = turn / jnp.sqrt((turn * turn).sum(1, keepdims=True))
    rotation = quaternion_to_matrix(jnp.asarray(turn).T)
    attitude = [
        jnp.arctan2(rotation[2, 1], rotation[2, 2]),
        -jnp.arcsin(jnp.clip(rotation[2, 0], -1.0, 1.0)),
        jnp.arctan2(rotation[1, 0], rotation[0, 0]),
    ]
    if any(name in ATTITUDE for name in columns):
        parts.append(jnp.stack(attitude, 1))
    else:
        parts.append(jnp.zeros((len(times), 3), states.position.dtype))
    parts.append(curve(states.q, states.qd))
    numbers = [column_names(simulation).index(name) for name in columns]
    return jnp.concatenate(parts, 1)[:, np.array(numbers, int)]
