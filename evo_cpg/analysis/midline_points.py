"""Points on the midline of a recorded animal, from the nose to the tip of the tail.

The midline is the slender chain of the root (`evo_cpg.creature.slender`): bodies joined end to end.
Its points are the nose, all joints of the chain, and the tip of the tail.
"""

import numpy as np
from jaxtyping import Float

from evo_cpg.creature.creature import Creature
from evo_cpg.creature.slender import LEAST_BODIES, SlenderChain, slender_chains
from evo_cpg.simulation.recording import Recording


def midline_chain(creature: Creature) -> SlenderChain | None:
    """Return the slender chain of the root, or None if it has fewer than three bodies."""
    root = next(i for i, body in enumerate(creature.bodies) if body.joint is None)
    chain = next(chain for chain in slender_chains(creature) if root in chain.bodies)
    return chain if len(chain.bodies) >= LEAST_BODIES else None


def midline_points(chain: SlenderChain, recording: Recording) -> Float[np.ndarray, "t p 3"]:
    """Return the paths of the points, m.

    Args:
        chain: chain of `midline_chain`.
        recording: motion of the creature, with the bodies in its order.
    """
    bodies = list(chain.bodies)
    position = np.asarray(recording.position, float)[:, bodies]
    rotation = np.asarray(recording.rotation, float)[:, bodies]
    front = position + np.einsum("tbij,bj->tbi", rotation, np.asarray(chain.front, float))
    rear = position[:, -1] + rotation[:, -1] @ np.asarray(chain.rear[-1], float)
    return np.concatenate([front, rear[:, None]], axis=1)
