"""Drag at any number of points of any bodies, in a loop whose code does not grow.

The law is that of `evo_cpg.physics.water.fluid` with ``law="normal"``. There, each body has points
of its own in the code of a program. Here the points are rows of a table, so that one program serves
every animal. A row without area has no force.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.creature.algebra.linear import matvec
from evo_cpg.creature.algebra.numerics import Numbers
from evo_cpg.physics.water.fluid import SPEED_FLOOR, Drag, DragOnPatches
from evo_cpg.physics.water.force_law import Bodies, WrenchPart, blocks

# Places of the 21 different numbers of a symmetric matrix of 6 rows, and the other way round.
_UPPER = np.triu_indices(6)
_WHOLE = np.zeros((6, 6), int)
_WHOLE[_UPPER] = _WHOLE.T[_UPPER] = np.arange(len(_UPPER[0]))


class PointTables(NamedTuple):
    """Points of form drag, then of skin friction, one per row.

    A row has the number of the body, ``1/2 rho C A`` (kg/m), and one or two rows of `Patch`, for
    the normal velocity or for two tangential ones.
    """

    form: Float[Numbers, "p 8"]
    skin: Float[Numbers, "q 14"]


class PointDrag(DragOnPatches):
    """Form drag and skin friction at the points of tables, of one individual.

    Attributes:
        tables: the points.
    """

    tables: PointTables

    def parts(self, bodies: Bodies) -> tuple[WrenchPart]:
        """Return the drag wrench with its D (`ForceLaw.parts`)."""
        velocity = bodies.relative
        found = jnp.zeros((velocity.shape[1], len(_UPPER[0])), velocity.dtype)
        for table, floor in zip(self.tables, (0.0, SPEED_FLOOR), strict=True):
            found = _with_points(found, jnp.asarray(table, velocity.dtype), velocity.T, floor)
        D = found.T[_WHOLE]
        return (WrenchPart(-matvec(D, velocity), bodies.h * blocks(D)),)


def point_tables(
    drag: Drag, density: float, places: np.ndarray, shapes: Sequence[tuple[int, int]]
) -> PointTables | None:
    """Return the tables of the drag of an animal, or None if it has too many points.

    Args:
        drag: the drag, with known points.
        density: density of the water, kg/m^3.
        places: number in the tables of each body.
        shapes: numbers of rows and columns of both tables.
    """
    tables = [np.zeros(shape) for shape in shapes]
    for k, table in enumerate(tables):
        rows = []
        for x in drag.patches:
            area = (drag.form_drag * x.normal_area, drag.skin_drag * x.tangential_area)[k]
            w = (x.normal, np.concatenate(x.tangential, 1))[k]
            own = np.column_stack([area, 0.5 * density * area, w])
            for body in x.bodies:
                own[:, 0] = places[body]
                rows.extend(own.tolist())
        if len(rows) > len(table):
            return None
        table[: len(rows)] = np.reshape(rows, (-1, table.shape[1]))
    return PointTables(*tables)


def _with_points(
    sums: Float[Array, "b 21"],
    table: Float[Array, "p c"],
    velocity: Float[Array, "b 6"],
    floor: float,
) -> Float[Array, "b 21"]:
    """Add ``c |v| w w^T`` of all points to the sums of their bodies."""

    def add(sums: Array, row: Array) -> tuple[Array, None]:
        body, w = row[0].astype(np.uint32), row[2:].reshape(-1, 6)
        own = jax.lax.dynamic_index_in_dim(velocity, body, 0, keepdims=False)
        v = (w * own[None]).sum(1)
        weight = row[1] * jnp.sqrt((v * v).sum() + floor)
        products = (w[:, _UPPER[0]] * w[:, _UPPER[1]]).sum(0)
        return sums.at[body].add(weight * products, mode="drop"), None

    return jax.lax.scan(add, sums, table)[0]
