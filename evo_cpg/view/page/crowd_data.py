"""A crowd for the viewer: other animals of the same kind, as ghosts, in few bytes.

Places have 16 bits and rotations have 8 bits. If the numbers take too much room, there are fewer
instants per second, and then fewer animals. The viewer interpolates between instants.
"""

import math
from typing import Any

import numpy as np

from evo_cpg.creature.creature import Creature
from evo_cpg.training.crowd_motion import CrowdMotion
from evo_cpg.view.clip import quaternions
from evo_cpg.view.ghosts import coarse
from evo_cpg.view.look import Look
from evo_cpg.view.page.animal_data import Add, surface_data

# Most and least instants per second, and most bytes of numbers.
_RATE, _LEAST, _BYTES = 15.0, 8.0, 3e6
# Bytes of a body at an instant, and largest numbers of 16 and 8 bits.
_SIZE, _SHORT, _BYTE = 10, 65535, 127


def crowd_data(creature: Creature, crowd: CrowdMotion, look: Look, add: Add) -> dict[str, Any]:
    """Return a crowd.

    Args:
        creature: the animal.
        crowd: motion of the others.
        look: look of the world.
        add: function that stores an array (see `evo_cpg.view.page.animal_data`).
    """
    crowd = thinned(crowd)
    low, high = (end(crowd.position, axis=(0, 1, 2)) for end in (np.min, np.max))
    size = np.maximum(high - low, 1e-9)
    place = np.round((crowd.position - low) / size * _SHORT)
    return {
        "bodies": [_hull(body.shape, add) for body in creature.bodies],
        "count": crowd.count,
        "frames": len(crowd.time),
        "rate": 1 / float(np.diff(crowd.time[:2], append=1e9)[0]),
        "low": low.tolist(),
        "step": (size / _SHORT).tolist(),
        "position": add(place, "<u2"),
        "rotation": add(np.round(quaternions(crowd.rotation) * _BYTE), "i1"),
        "color": look.ghost,
    }


def thinned(crowd: CrowdMotion) -> CrowdMotion:
    """Return a crowd of about 15 instants per second, or of as much as there is room for.

    Fewer than 8 instants per second look jerky. So the rest are left out evenly among the animals.
    """
    instants, animals, bodies = crowd.position.shape[:3]
    if instants < 2:
        return crowd
    step = float(crowd.time[1] - crowd.time[0])
    room = _BYTES / (_SIZE * bodies * animals)
    every = max(round(1 / (_RATE * step)), math.ceil(instants / max(room, 1)), 1)
    every = min(every, max(math.floor(1 / (_LEAST * step)), 1))
    shown = slice(None, None, every)
    crowd = crowd._replace(
        time=crowd.time[shown], position=crowd.position[shown], rotation=crowd.rotation[shown]
    )
    most = max(int(_BYTES / (_SIZE * bodies * len(crowd.time))), 1)
    if most >= animals:
        return crowd
    return crowd.of(np.linspace(0, animals - 1, most).round().astype(int))


def _hull(shape: Any, add: Add) -> dict[str, Any] | None:
    if not shape.exists:
        return None
    points, faces = coarse(shape)
    outwards = points / np.linalg.norm(points, axis=1, keepdims=True)
    return surface_data(points, outwards, faces, add)
