"""An animal with cuts, silenced senses and a fixed drive, against animals of the parts."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from evo_cpg.control import matsuoka
from evo_cpg.control.brain import BrainSettings
from evo_cpg.control.brain_cpg import BrainCpgSettings, build_brain_cpg
from evo_cpg.control.controller import Observation
from evo_cpg.control.feedback import FeedbackSettings, StretchFeedback
from evo_cpg.control.matsuoka import CpgSettings, sub_network
from evo_cpg.control.preparation import SENSES, Preparation

STEPS = 240
FEEDBACK = FeedbackSettings((StretchFeedback(angle_weight=0.5, from_parents=2, from_children=1),))


def animal_of(tree, feedback=None):
    settings = BrainCpgSettings(CpgSettings(feedback=feedback), BrainSettings(hidden=(4,)))
    return build_brain_cpg(tree, 1, 2, settings)


def senses(rng, dofs):
    """Return the senses of `STEPS` steps."""
    count = {"light": 1, "pressure": 2, "vertical_cosine": 1, "vertical_sine": 1, "depth": 0}
    values = {name: rng.uniform(-1, 1, (STEPS, size)) for name, size in count.items()}
    angle, rate = rng.uniform(-0.5, 0.5, (2, STEPS, dofs))
    return Observation(**values, joint_angle=angle, joint_rate=rate)


def outputs(controller, genes, observed):
    """Return the outputs of the oscillators after every step."""
    decoded = controller.decode(jnp.asarray(genes))
    state = controller.initial_state(np.shape(genes)[1:], float)

    def advance(state, each):
        state, command = controller.act(decoded, state, each)
        return state, command.signal

    observed = jax.tree.map(jnp.asarray, observed)
    return jax.jit(lambda: jax.lax.scan(advance, state, observed)[1])()


@pytest.mark.parametrize("feedback", [None, FEEDBACK])
@pytest.mark.slow
def test_intact_preparation_is_the_animal(chain, feedback):
    animal = animal_of(chain(5, "z"), feedback)
    rng = np.random.default_rng(0)
    genes = np.asarray(animal.random_genes(jax.random.key(1), (), float))
    observed = senses(rng, 4)
    prepared = Preparation(animal, trained=True, awake=True)
    whole = np.concatenate([genes, prepared.intact().flat()])
    expected = outputs(animal, genes, observed)
    np.testing.assert_allclose(outputs(prepared, whole, observed), expected, atol=1e-12)
    assert np.ptp(expected) > 0.1


@pytest.mark.parametrize("feedback", [None, FEEDBACK])
def test_parts_of_a_cut_cord_are_cords_of_their_own(chain, feedback):
    """Each side of the cut has the rhythm of the network of its own oscillators."""
    tree = chain(7, "z")
    animal = animal_of(tree, feedback)
    prepared = Preparation(animal, trained=False, awake=False)
    surgery, side = prepared.intact(), np.array([0, 0, 1, 1, 1, 1])
    tonic = np.where(side, 0.4, 0.9) * np.ones((2, 1))
    surgery = prepared.within(surgery._replace(tonic=tonic, gain=np.full(6, 3.0)), side)
    observed = senses(np.random.default_rng(2), 6)
    found = outputs(prepared, surgery.flat().astype(float), observed)
    for one, u in ((0, 0.9), (1, 0.4)):
        own = np.flatnonzero(side == one)
        network = sub_network(animal.network, tuple(own.tolist()))
        state = matsuoka.initial_state(network, (), float)
        gains = jnp.full(len(own), 3.0)
        advance = jax.jit(functools.partial(matsuoka.advance, network, h=1 / 60))
        expected = []
        for angle in observed.joint_angle[:60]:
            drive = u * np.ones((2, len(own)))
            if feedback:
                felt = sum_within(angle[own])
                drive += np.stack([-felt, felt])
            state = advance(state, jnp.asarray(drive), gains)
            expected.append(matsuoka.output(state))
        np.testing.assert_allclose(found[:60, own], expected, atol=1e-7)


def sum_within(angle):
    """Return the feedback of `FEEDBACK` within a chain of joints."""
    from_parents, from_children = {1: 2 / 3, 2: 1 / 3}, {1: 1 / 2}
    felt = angle.copy()
    for i in range(len(angle)):
        for steps, share in from_parents.items():
            felt[i] += share * angle[i - steps] if i >= steps else 0.0
        for steps, share in from_children.items():
            felt[i] += share * angle[i + steps] if i + steps < len(angle) else 0.0
    return np.clip(0.5 * felt, -1, 1)


def test_cord_behind_a_cut_falls_silent_without_drive(chain):
    animal = animal_of(chain(5, "z"))
    prepared = Preparation(animal, trained=False, awake=False)
    cut, side = prepared.intact(), np.array([0, 0, 1, 1])
    cut = cut._replace(tonic=0.8 * np.ones((2, 4)), gain=np.full(4, 3.0))
    silent = cut._replace(tonic=cut.tonic * (side == 0))
    observed = senses(np.random.default_rng(0), 4)
    whole, late = (
        np.ptp(outputs(prepared, one.flat().astype(float), observed)[180:], axis=0)
        for one in (cut, prepared.within(silent, side))
    )
    assert (whole > 0.2).all()
    assert (late[:2] > 0.2).all() and (late[2:] < 0.1 * whole[2:]).all()


@pytest.mark.slow
@pytest.mark.parametrize("sense", ["light", "joints", "feedback"])
def test_silenced_sense_is_a_sense_that_reads_0(chain, sense):
    animal = animal_of(chain(4, "z"), FEEDBACK)
    genes = np.asarray(animal.random_genes(jax.random.key(3), (), float))
    prepared = Preparation(animal, trained=True, awake=True)
    heard = np.array([float(name != sense) for name in SENSES])
    deaf = np.concatenate([genes, prepared.intact()._replace(heard=heard).flat()])
    observed = senses(np.random.default_rng(4), 3)
    found = outputs(prepared, deaf, observed)
    assert np.abs(found - outputs(animal, genes, observed)).max() > 1e-3
    if sense == "light":
        dark = observed._replace(light=0 * observed.light)
        np.testing.assert_allclose(found, outputs(animal, genes, dark), atol=1e-12)
    if sense == "feedback":
        numb = dataclasses.replace(animal, feedback=None)
        np.testing.assert_allclose(found, outputs(numb, genes, observed), atol=1e-12)
