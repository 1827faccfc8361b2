"""An animal whose nervous system an experimenter has changed: cuts, silenced senses, fixed drive.

The genes of an individual are the settings of one experiment. So one program computes many
experiments, as it computes a population. A *preparation* wraps a `BrainCpg`. Each control step
calls the same three parts, `BrainCpg.descending`, `BrainCpg.cord` and `BrainCpg.command`, with
other inputs and other couplings:

    u_i = k_i u_i(brain) + v_i,    b_i = k_i b_i(brain) + c_i,    A_ij -> m_ij A_ij

k is 0 behind a cut, v and c are the tonic input and the adaptation gain that replace the brain's,
and m is 0 for couplings across a cut. The same holds for feedback from joints across a cut. Without
a brain k is 0 everywhere.
"""

import dataclasses
import math
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from evo_cpg.control.brain_cpg import BrainCpg, Decoded
from evo_cpg.control.controller import Command, Controller, Observation
from evo_cpg.control.matsuoka import MatsuokaState
from evo_cpg.creature.algebra.linear import expand_dims_like, of_each
from evo_cpg.creature.algebra.numerics import Numbers

SENSES = ("light", "pressure", "balance", "joints", "depth", "sensors", "feedback")
"""Senses that can be silenced. ``joints`` is what the brain senses of the joints, and ``feedback``
is what the spinal cord senses."""


class Surgery(NamedTuple):
    """Changes of one nervous system. The trailing axes are individuals.

    Attributes:
        kept: k, fraction of the brain's signals that reaches each oscillator.
        tonic: v, tonic input of each neuron in addition, extensors first.
        gain: c, adaptation gain of each oscillator in addition.
        coupled: m, factor of each element of ``MatsuokaNetwork.weights``.
        own_coupled: m, factor of each element of ``MatsuokaNetwork.own_weights``.
        felt: m, factor of each element of the ``rows`` of all senses of stretch.
        heard: factor of each of the `SENSES`.
    """

    kept: Float[Numbers, "d *n"]
    tonic: Float[Numbers, "2 d *n"]
    gain: Float[Numbers, "d *n"]
    coupled: Float[Numbers, "k d *n"]
    own_coupled: Float[Numbers, "m d *n"]
    felt: Float[Numbers, "f d *n"]
    heard: Float[Numbers, "s *n"]

    def flat(self) -> Float[np.ndarray, " g"]:
        """Return all numbers of one individual as a vector."""
        return np.concatenate([np.asarray(part, np.float32).reshape(-1) for part in self])


class Preparation(Controller):
    """A brain and a spinal cord with changes. The genes are the animal's, then a `Surgery`.

    Attributes:
        animal: the nervous system without changes.
        trained: whether the genes of the animal come first.
        awake: whether the brain drives the cord. If not, only the `Surgery` does.
    """

    animal: BrainCpg
    trained: bool = eqx.field(static=True)
    awake: bool = eqx.field(static=True)

    @property
    def gene_count(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Number of genes of the animal, plus the numbers of a `Surgery`."""
        animal = self.animal.gene_count if self.trained else 0
        return animal + sum(map(math.prod, self._shapes))

    @property
    def uses_load(self) -> bool:
        """Return whether the spinal cord feels the load of limbs."""
        return self.animal.uses_load

    @property
    def _shapes(self) -> tuple[tuple[int, ...], ...]:
        network, feedback = self.animal.network, self.animal.feedback
        count = network.oscillator_count
        diagonals = len(network.offsets), len(network.own_offsets)
        stretch = feedback.stretch if feedback else ()
        return (
            (count,),
            (2, count),
            (count,),
            *((diagonal, count) for diagonal in diagonals),
            (sum(len(each.offsets) for each in stretch), count),
            (len(SENSES),),
        )

    def intact(self) -> Surgery:
        """Return a surgery that changes nothing, for one individual."""
        kept, tonic, gain, *factors = (np.ones(shape) for shape in self._shapes)
        return Surgery(kept, 0 * tonic, 0 * gain, *factors)

    def random_genes(
        self, key: Array, batch: tuple[int, ...], dtype: jnp.dtype | type
    ) -> Float[Array, "g *n"]:
        """Return intact animals with random brains."""
        intact = expand_dims_like(self.intact().flat(), jnp.zeros((1, *batch), dtype))
        intact = jnp.broadcast_to(intact, (len(intact), *batch))
        animal = [self.animal.random_genes(key, batch, dtype)] if self.trained else []
        return jnp.concatenate([*animal, intact])

    def initial_state(self, batch: tuple[int, ...], dtype: jnp.dtype | type) -> MatsuokaState:
        """Return the initial state of the animal without changes."""
        return self.animal.initial_state(batch, dtype)

    def decode(self, genes: Float[Array, "g *n"]) -> tuple[Decoded | None, Surgery]:
        """Return the decoded genes of the animal (None without genes), and the surgery."""
        animal, parts, first = None, [], 0
        if self.trained:
            first = self.animal.gene_count
            animal = self.animal.decode(genes[:first])
        for shape in self._shapes:
            last = first + math.prod(shape)
            parts.append(genes[first:last].reshape(*shape, *genes.shape[1:]))
            first = last
        return animal, Surgery(*parts)

    def act(
        self,
        decoded: tuple[Decoded | None, Surgery],
        state: MatsuokaState,
        observation: Observation,
    ) -> tuple[MatsuokaState, Command]:
        """Run one control step of the changed animal."""
        animal, surgery = decoded
        tonic, gain, senses = map(jnp.asarray, (surgery.tonic, surgery.gain, surgery.heard))
        if self.awake:
            assert animal is not None
            sensed = silenced(observation, senses)
            own_tonic, own_gain = self.animal.descending(animal, state, sensed)
            tonic = tonic + surgery.kept[None] * own_tonic
            gain = gain + surgery.kept * own_gain
        heard = senses[SENSES.index("feedback")]
        load = observation.load
        proprioception = observation._replace(
            joint_angle=_heard(heard, observation.joint_angle),
            joint_rate=_heard(heard, observation.joint_rate),
            load=None if load is None else _heard(heard, load),
        )
        genes = animal.feedback if animal is not None else None
        # The animal with the couplings and the feedback of each individual.
        network, feedback = self.animal.network, self.animal.feedback
        weights, own = (
            factor * expand_dims_like(weight, jnp.asarray(factor))
            for factor, weight in (
                (surgery.coupled, network.weights),
                (surgery.own_coupled, network.own_weights),
            )
        )
        network = dataclasses.replace(network, weights=weights, own_weights=own)
        if feedback is not None:
            stretch, first = [], 0
            for sense in feedback.stretch:
                felt = surgery.felt[first : first + len(sense.offsets)]
                rows = felt * expand_dims_like(sense.rows, jnp.asarray(felt))
                stretch.append(dataclasses.replace(sense, rows=rows))
                first += len(sense.offsets)
            feedback = dataclasses.replace(feedback, stretch=tuple(stretch))
        changed = dataclasses.replace(self.animal, network=network, feedback=feedback)
        state = changed.cord(state, tonic, gain, proprioception, genes)
        return state, self.animal.command(state, observation)

    def within(self, surgery: Surgery, side: Int[np.ndarray, " d"]) -> Surgery:
        """Return the surgery without couplings and feedback between the sides of a cut."""
        network, feedback = self.animal.network, self.animal.feedback
        stretch = feedback.stretch if feedback else ()
        senses = [factors_within(sense.offsets, side) for sense in stretch]
        return surgery._replace(
            coupled=factors_within(network.offsets, side),
            own_coupled=factors_within(network.own_offsets, side),
            felt=np.concatenate([surgery.felt[:0], *senses]),
        )


def silenced(observation: Observation, heard: Float[Array, "s *n"]) -> Observation:
    """Return the observation of a brain with silenced senses, whose readings are 0."""
    light, pressure, balance, joints, depth, sensors, _ = heard
    return observation._replace(
        light=_heard(light, observation.light),
        pressure=_heard(pressure, observation.pressure),
        vertical_cosine=_heard(balance, observation.vertical_cosine),
        vertical_sine=_heard(balance, observation.vertical_sine),
        joint_angle=_heard(joints, observation.joint_angle),
        joint_rate=_heard(joints, observation.joint_rate),
        depth=_heard(depth, observation.depth),
        custom=None if observation.custom is None else _heard(sensors, observation.custom),
    )


def factors_within(
    offsets: tuple[int, ...], side: Int[np.ndarray, " d"]
) -> Float[np.ndarray, "k d"]:
    """Return factors of a matrix by its diagonals: 1 within a side, 0 between sides."""
    others = np.array(offsets, int).reshape(-1, 1) + np.arange(len(side))
    return (side[np.clip(others, 0, len(side) - 1)] == side).astype(float)


def _heard(factor: Float[Array, "*n"], readings: Float[Array, "s *n"]) -> Float[Array, "s *n"]:
    return of_each(factor, readings) * readings
