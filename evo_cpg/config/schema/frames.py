"""Places, directions and rotations, moved into other frames and mirrored in a plane of theirs."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from evo_cpg.config.schema.copies import MirrorAxis
from evo_cpg.spatial.numerics import Number, Triple, as_vector, xp


def unit(vector: Any) -> Triple:
    """The direction of a vector that is not zero."""
    direction = xp.array(vector, float)
    return as_vector(direction / xp.linalg.norm(direction))


def moved(place: Triple, origin: np.ndarray) -> Triple:
    """A place in a frame that is moved to ``origin``; as it is where the frame stays."""
    return as_vector(xp.array(place) - origin) if origin.any() else place


def reflected(place: Triple, axis: MirrorAxis) -> Triple:
    """The image of a place in the plane with this normal."""
    x, y, z = (-value if name == axis else value for name, value in zip("xyz", place, strict=True))
    return x, y, z


def opposed(turn: Sequence[Number], axis: MirrorAxis) -> Triple:
    """The image of a rotation: of its axis, or of its roll, pitch and yaw.

    What turns counterclockwise about a normal of the mirror still does in its image; about
    directions in the mirror it turns the other way.
    """
    x, y, z = (value if name == axis else -value for name, value in zip("xyz", turn, strict=True))
    return x, y, z
