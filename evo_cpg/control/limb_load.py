"""Load of the limbs, felt by their oscillators.

The load n of a limb is the vertical force of the ground on all its bodies, in units of the animal's
weight. It excites the extensors of the limb, and inhibits its flexors:

    s_e = -s_f = w n_own(t - D) + v sum_others n(t - D).                                    (1)

A negative weight excites the flexors. The extensor pulls the joint to positive angles.

| symbol | name |
|---|---|
| w, v | ``weight``, ``neighbour_weight`` |
| D | ``delay`` (s) |
"""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.control.afferent import (
    Delay,
    Gain,
    MakeGain,
    Weight,
    check_delay,
    check_weights,
    make_delay,
)
from evo_cpg.control.couplings import CouplingError, listed_oscillators, matching_bodies
from evo_cpg.creature.tree import Tree


@dataclasses.dataclass(frozen=True)
class LoadFeedback:
    """Load of limbs, which enters the oscillators of these limbs.

    Attributes:
        limbs: bodies, or patterns such as ``*_thigh``. Each one is the first body of a limb. All
            bodies behind it belong to the limb.
        joints: degrees of freedom of the limbs whose oscillators receive the load. They are names
            or patterns such as ``*.y``.
        weight: input per load of the own limb, in units of ``max_tonic_input``. A positive weight
            excites the extensor and inhibits the flexor. The load is 1 if the limb carries the
            whole animal. Two numbers are the range of a weight that evolves.
        neighbour_weight: the same for the sum of the loads of the other limbs in the list.
        delay: time from the ground to the neuron, s, 0 to 1.

    Raises:
        ValueError: a value is outside its range.
    """

    limbs: tuple[str, ...]
    joints: tuple[str, ...] = ("*",)
    weight: Weight = 0.0
    neighbour_weight: Weight = 0.0
    delay: float = 0.0

    def __post_init__(self):
        check_weights(self, "weight", "neighbour_weight")
        check_delay(self.delay)


class Limbs(eqx.Module):
    """Limbs of a creature, and the oscillators that feel them.

    Attributes:
        bodies: bodies of each limb.
        limb: limb whose load each oscillator feels, or the number of limbs for none.
    """

    bodies: tuple[tuple[int, ...], ...] = eqx.field(static=True)
    limb: tuple[int, ...] = eqx.field(static=True)

    def loads(self, load: Float[Array, "b *n"]) -> Float[Array, "l *n"]:
        """Return the load of each limb from the load of each body."""
        return jnp.stack([load[np.array(own)].sum(0) for own in self.bodies])

    def of_oscillators(self, values: Float[Array, "l *n"]) -> Float[Array, "o *n"]:
        """Return the value of each oscillator's limb, 0 for oscillators without a limb."""
        padded = jnp.concatenate([values, jnp.zeros_like(values[:1])])
        return padded[np.array(self.limb)]


class Load(eqx.Module):
    """One `LoadFeedback` on a creature's tree.

    Attributes:
        limbs: the limbs.
        weight: w.
        neighbour_weight: v.
        delay: D.
    """

    limbs: Limbs
    weight: Gain
    neighbour_weight: Gain
    delay: Delay

    def now(
        self, genes: Float[Array, "g *n"] | None, load: Float[Array, "b *n"]
    ) -> Float[Array, "o *n"]:
        """Return s_e of eq. 1 before the delay, in units of u_max.

        Args:
            genes: genes of the feedback, or None if no weight evolves.
            load: load of each body.
        """
        own = self.limbs.loads(load)
        others = own.sum(0, keepdims=True) - own
        felt = self.weight.times(own, genes) + self.neighbour_weight.times(others, genes)
        return self.limbs.of_oscillators(felt)


def build_load(
    tree: Tree, settings: LoadFeedback, number: int, gain: MakeGain, control_step: float
) -> Load:
    """Build one sense of load for a creature's tree.

    Args:
        tree: the creature.
        settings: settings.
        number: index of the settings in their list, for messages.
        gain: builds the gain of a weight.
        control_step: time between two samples, s.

    Raises:
        CouplingError: limbs or joints do not fit the creature.
    """
    limbs = find_limbs(tree, settings.limbs, settings.joints, ("feedback", "load", number))
    gains = gain(settings.weight), gain(settings.neighbour_weight)
    return Load(limbs, *gains, make_delay(settings.delay, control_step))


def find_limbs(
    tree: Tree, limbs: tuple[str, ...], joints: tuple[str, ...], where: tuple[str | int, ...]
) -> Limbs:
    """Return limbs by the patterns of their first bodies, in the order of bodies.

    Raises:
        CouplingError: a pattern matches nothing, a limb is part of another limb or has none of the
            joints.
    """
    first = sorted(matching_bodies(tree, limbs, (*where, "limbs"), CouplingError))
    if not first:
        raise CouplingError("names no limb", (*where, "limbs"))
    among = set(listed_oscillators(tree, joints, (*where, "joints")))
    owner: list[int] = []
    for body, parent in enumerate(tree.parents):
        above = owner[parent] if parent >= 0 else len(first)
        if body in first and above < len(first):
            names = f"{tree.names[body]!r} is part of the limb {tree.names[first[above]]!r}"
            raise CouplingError(names, (*where, "limbs"))
        owner.append(first.index(body) if body in first else above)
    limb = [owner[body] if i in among else len(first) for i, body in enumerate(tree.dof_bodies)]
    for i, body in enumerate(first):
        if i not in limb:
            problem = f"matches no joint of the limb {tree.names[body]!r}"
            raise CouplingError(problem, (*where, "joints"))
    bodies = tuple(
        tuple(body for body, own in enumerate(owner) if own == i) for i in range(len(first))
    )
    return Limbs(bodies, tuple(limb))
