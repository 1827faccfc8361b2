"""Initial situation of a trial: pose of the animal, and place of the light.

An individual may have several situations, one in each of its trials. Trials run side by side on the
batch axes (lanes). The number of a lane's trial selects its situation. If all trials have the same
situation, its numbers are constants of the compiled program.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from evo_cpg.creature.algebra.linear import array_of
from evo_cpg.creature.algebra.numerics import Number, Triple, xp
from evo_cpg.creature.tree import Tree
from evo_cpg.physics.tree.hanging import Base
from evo_cpg.physics.tree.kinematics import kinematics
from evo_cpg.physics.tree.state import State, resting_state


class Situation(NamedTuple):
    """Initial pose and light of one trial.

    Attributes:
        start_position: initial position of the root's centre, m, or of the frame on which a root
            hangs.
        start_heading: initial turn of the root or that frame about z, rad.
        light: place of the light, m, or None for the task's light.
        start_orientation: initial orientation of the root, unit quaternion (w, x, y, z), or None
            for a turn about z by ``start_heading``.
        start_angles: initial joint angles, rad, or None for the neutral pose.
    """

    start_position: Triple = (0.0, 0.0, 0.0)
    start_heading: Number = 0.0
    light: Triple | None = None
    start_orientation: tuple[Number, Number, Number, Number] | None = None
    start_angles: tuple[Number, ...] | None = None

    @property
    def orientation(self) -> tuple[Number, Number, Number, Number]:
        """Initial orientation of the root (w, x, y, z), by default a turn about z."""
        if self.start_orientation is not None:
            return self.start_orientation
        half = self.start_heading / 2
        return xp.cos(half), 0.0, 0.0, xp.sin(half)


def starting_state(
    situations: tuple[Situation, ...],
    trial: Int[Array, " *n"] | None,
    tree: Tree,
    batch: tuple[int, ...],
    dtype: jnp.dtype,
) -> State:
    """Return the initial pose of each trial, with all velocities zero.

    Args:
        situations: situations of the trials.
        trial: number of each lane's trial, or None for the first in all lanes.
        tree: the creature.
        batch: trailing axes.
        dtype: floating-point type of every array.
    """
    first = situations[0]
    state = resting_state(
        tree, batch, dtype, first.start_position, first.orientation, first.start_angles
    )
    if trial is None or len(situations) == 1:
        return state
    angles = state.q
    if any(situation.start_angles is not None for situation in situations):
        neutral = (0.0,) * tree.dof_count
        poses = [neutral if s.start_angles is None else s.start_angles for s in situations]
        angles = _chosen(array_of(poses), trial, dtype)
    positions = array_of([situation.start_position for situation in situations])
    turns = array_of([situation.orientation for situation in situations])
    place = _chosen(positions, trial, dtype), _chosen(turns, trial, dtype)
    base = None if tree.hanging is None else Base(*place)
    return State(*place, state.velocity, angles, state.qd, base).placed(tree)


def starting_pose(
    situation: Situation, tree: Tree, names: list[str]
) -> tuple[Float[np.ndarray, "b 3"], Float[np.ndarray, "b 3 3"]]:
    """Return the initial centres (m) and rotations of these bodies."""
    order = [tree.names.index(name) for name in names]
    kin = kinematics(tree, starting_state((situation,), None, tree, (), jnp.dtype(jnp.float32)))
    rotation = np.moveaxis(np.asarray(kin.rotation, float), -1, 0)
    centre = np.asarray(kin.origin, float).T + np.einsum("bij,jb->bi", rotation, tree.centre)
    return centre[order], rotation[order]


def light_places(
    lights: tuple[Triple | None, ...], trial: Int[Array, " *n"] | None, dtype: jnp.dtype
) -> Float[np.ndarray, "3"] | Float[Array, "3 *#n"] | None:
    """Return the place of the light in each lane of the batch, m, or one place if all are equal.

    Args:
        lights: place of the light in each trial. In the dark all are None.
        trial: number of each lane's trial, or None for the first in all lanes.
        dtype: floating-point type.
    """
    if lights[0] is None:
        return None
    if trial is None or len(lights) == 1:
        return array_of(lights[0])
    return _chosen(array_of(lights), trial, dtype)


def _chosen(
    rows: Float[np.ndarray, "situations k"] | Float[Array, "situations k"],
    trial: Int[Array, " *n"],
    dtype: jnp.dtype,
) -> Float[Array, "k *n"]:
    """Return the rows that the trials of the lanes select, as columns."""
    return jnp.asarray(rows.T, dtype)[:, trial]
