"""Transforms of positions, directions and rotations to shifted frames and mirror images."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from evo_cpg.creature.algebra.numerics import Number, Triple, as_vector, xp
from evo_cpg.io.schema.copies import MirrorAxis


def unit(vector: Any) -> Triple:
    """Return the direction of a nonzero vector."""
    direction = xp.array(vector, float)
    return as_vector(direction / xp.linalg.norm(direction))


def moved(place: Triple, origin: np.ndarray) -> Triple:
    """Return a position in a frame that is shifted to ``origin``."""
    return as_vector(xp.array(place) - origin) if origin.any() else place


def reflected(place: Triple, axis: MirrorAxis) -> Triple:
    """Return the mirror image of a position in the plane with this normal."""
    x, y, z = (-value if name == axis else value for name, value in zip("xyz", place, strict=True))
    return x, y, z


def opposed(turn: Sequence[Number], axis: MirrorAxis) -> Triple:
    """Return the mirror image of a rotation axis, or of roll, pitch and yaw.

    A mirrored rotation keeps its sense about the mirror's normal. The sense about directions in
    the mirror plane is reversed.
    """
    x, y, z = (value if name == axis else -value for name, value in zip("xyz", turn, strict=True))
    return x, y, z
