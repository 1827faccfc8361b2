"""Direction that an imported animal faces, from the names and places of its bodies."""

import re
from collections.abc import Iterator

import numpy as np

from evo_cpg.creature.creature import Creature, neutral_pose

# Smallest ratio of the length along y to the length along x of an animal that may face y, if its
# names do not say where its left side is.
_LONGER = 1.5

# Smallest mean distance between left and right bodies, as a fraction of the animal's size. The
# fingers of a gripper are nearer to each other, and do not show the front.
_APART = 0.1

# Largest angle from the x axis of an animal that faces +x, degrees.
_AHEAD = 45.0


def facing_note(creature: Creature) -> str | None:
    """Return a sentence about an animal that probably does not face +x, or None.

    Bodies whose names differ only in left and right, such as ``FL_foot`` and ``FR_foot``, show the
    animal's left side. Without such names, its longest direction counts.

    Args:
        creature: the animal.
    """
    centres, turns = map(np.asarray, neutral_pose(creature))
    names = [body.name for body in creature.bodies]
    sides = [centres[i, :2] - centres[k, :2] for i, k in _left_and_right(names)]
    x, y = np.mean(sides, axis=0) if sides else (0.0, 0.0)
    half = np.array([body.shape.half_extents for body in creature.bodies])
    reach = np.einsum("bij,bj->bi", np.abs(turns), half)
    lengths = (centres + reach).max(0) - (centres - reach).min(0)
    if np.hypot(x, y) > _APART * lengths.max():
        # The front is a quarter of a turn to the right of the left side.
        front = float(np.rad2deg(np.arctan2(-x, y)))
        if abs(front) <= _AHEAD:
            return None
        seen = "the names of left and right bodies show that the animal does not face +x"
        turn = f"{-90 * round(front / 90) or 180}"
    elif lengths[1] <= _LONGER * lengths[0]:
        return None
    else:
        seen = f"the animal is {lengths[0]:.2g} m long along x, but {lengths[1]:.2g} m along y"
        turn = "-90 if it faces +y, or 90 if it faces -y"
    return (
        f"{seen}. The task rewards displacement along +x. To turn the animal at the start, set "
        f"simulation.start_heading_deg: {turn}"
    )


def _left_and_right(names: list[str]) -> Iterator[tuple[int, int]]:
    """Yield the indices of bodies whose names differ only in left and right, the left one first."""
    for i, name in enumerate(names):
        for found in re.finditer("left|l", name, re.IGNORECASE):
            word = found.group()
            other = {"l": "r", "L": "R", "left": "right", "Left": "Right", "LEFT": "RIGHT"}
            partner = name[: found.start()] + other.get(word, word) + name[found.end() :]
            if partner != name and partner in names:
                yield i, names.index(partner)
