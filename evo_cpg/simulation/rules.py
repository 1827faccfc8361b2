"""Rules that disqualify an animal in the control step in which it breaks them.

Evolution exploits the errors of a simulator. A rule removes such a motion from the search at once.
Otherwise only an audit of the champion (`evo-cpg audit`) would find it.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from evo_cpg.creature.algebra.linear import expand_dims_like
from evo_cpg.creature.algebra.numerics import Number
from evo_cpg.physics.contact.contact_points import clearance
from evo_cpg.physics.contact.pairs import Pairs, separations
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.kinematics import kinematics
from evo_cpg.physics.tree.state import State


class Rules(eqx.Module):
    """Limits on the motion of an animal. None is no limit.

    Attributes:
        speed: largest speed of the root, m/s.
        power: largest power of all motors together, mean over a control step, W.
        penetration: largest depth of a contact point in the ground, m.
        overlap: largest overlap of two bodies, m.
        pairs: pairs of bodies that are checked for overlap, or None if no bodies can touch.
    """

    speed: Number | None = None
    power: Number | None = None
    penetration: Number | None = None
    overlap: Number | None = None
    pairs: Pairs | None = None


def keeps(
    rules: Rules, world: World, state: State, energy: Float[Array, " *n"], duration: Number
) -> Bool[Array, " *n"]:
    """Return whether every animal keeps the rules in a control step.

    Args:
        rules: the rules.
        world: the animals and their environment.
        state: state at the end of the control step.
        energy: energy spent by all motors in the step, J.
        duration: duration of a control step, s.
    """
    valid = jnp.ones(energy.shape, bool)
    if rules.speed is not None:
        linear = state.linear_velocity
        valid &= (linear * linear).sum(0) <= rules.speed**2
    if rules.power is not None:
        valid &= energy <= rules.power * duration
    kin = kinematics(world.tree, state)
    if rules.penetration is not None and world.contact_model is not None:
        valid &= (clearance(world.contact_model, kin) >= -rules.penetration).all(0)
    if rules.overlap is not None and rules.pairs is not None:
        gap = separations(rules.pairs, kin).gap
        # Pairs without stiffness cannot touch in this creature, only in others of its plan.
        passes = expand_dims_like(rules.pairs.stiffness, gap) == 0
        valid &= ((gap >= -rules.overlap) | passes).all(0)
    return valid
