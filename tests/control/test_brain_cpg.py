"""The whole controller: inputs and outputs of the brain, and commands to the motors."""

import dataclasses
import doctest
import math
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from evo_cpg.control import controller as protocol
from evo_cpg.control import matsuoka
from evo_cpg.control.brain import BrainSettings
from evo_cpg.control.brain_cpg import AxisSettings, BrainCpgSettings, build_brain_cpg, max_amplitude
from evo_cpg.control.controller import Observation
from evo_cpg.control.couplings import Coupling, Ring, UnfitError
from evo_cpg.control.feedback import FeedbackSettings, StretchFeedback
from evo_cpg.control.matsuoka import CpgSettings
from evo_cpg.control.postures import PostureSettings
from evo_cpg.creature.creature import Muscle, Tendon, TorqueMotor
from evo_cpg.creature.laws import laws_of
from evo_cpg.creature.tree import build_tree
from evo_cpg.io.build import build_creature
from evo_cpg.io.load import load_config
from tiny_run import REPOSITORY


def observe(rng, dofs, batch=(), lights=1, pressures=10, gauges=0):
    """Return random senses within their ranges."""
    tilt = rng.uniform(0, np.pi, (lights, *batch))
    values = (
        rng.uniform(0, 1, (lights, *batch)),
        rng.integers(0, 2, (pressures, *batch)).astype(float),
        np.cos(tilt),
        np.sin(tilt),
        rng.uniform(-1, 1, (dofs, *batch)),
        rng.uniform(-8, 8, (dofs, *batch)),
        rng.uniform(0, 1, (gauges, *batch)),
    )
    return Observation(*map(jnp.asarray, values))


@pytest.mark.parametrize(
    ("drive", "outputs", "genes"),
    [("shared", 7, 1639), ("per_joint", 27, 1979), ("per_dof", 81, 2897)],
)
def test_swimmer_has_the_expected_number_of_genes(chain, drive, outputs, genes):
    grown = build_brain_cpg(chain(10, "xyz"), 1, 10, BrainCpgSettings(drive=drive))
    assert grown.brain.sizes == (94, 16, outputs)
    assert grown.gene_count == genes
    assert grown.random_genes(jax.random.key(0), (3,), float).shape == (genes, 3)


def test_first_weights_fill_their_range_evenly(chain):
    grown = build_brain_cpg(chain(10, "xyz"), 1, 10)
    weights = np.asarray(grown.random_genes(jax.random.key(0), (50,), jnp.float32))
    assert weights.dtype == np.float32
    counts, _ = np.histogram(weights, bins=10, range=(-2, 2))
    assert counts.sum() == weights.size
    # Multinomial: each bin holds a tenth, within four standard deviations.
    expected = weights.size / 10
    assert np.abs(counts - expected).max() < 4 * np.sqrt(0.9 * expected)


def test_brain_senses_table_2_in_order(chain):
    settings = BrainCpgSettings(joint_rates=True)
    grown = build_brain_cpg(chain(3, "yz"), 2, 3, settings, depth_count=2)
    rng = np.random.default_rng(0)
    sense = observe(rng, 4, lights=2, pressures=3, gauges=2)
    state = matsuoka.MatsuokaState(jnp.asarray(rng.uniform(-1, 1.3, (2, 4))), jnp.zeros((2, 4)))
    firing = np.maximum(state.potential, 0)
    expected = np.concatenate(
        [
            sense.light,
            sense.pressure,
            sense.vertical_cosine,
            sense.vertical_sine,
            np.cos(sense.joint_angle),
            np.sin(sense.joint_angle),
            np.abs(firing[0] - firing[1]) / 1.3,
            np.clip(sense.joint_rate / 5.0, -1, 1),
            sense.depth,
        ]
    )
    np.testing.assert_allclose(grown.brain_inputs(state, sense), expected, rtol=0, atol=1e-15)
    assert len(expected) == grown.brain.sizes[0]
    numb = build_brain_cpg(
        chain(3, "yz"), 2, 3, BrainCpgSettings(senses_joints=False), depth_count=2
    )
    rest = np.concatenate([expected[:9], expected[-2:]])
    np.testing.assert_array_equal(numb.brain_inputs(state, sense), rest)
    assert len(rest) == numb.brain.sizes[0]


def test_brain_does_not_sense_its_place():
    """The half cheetah's root slides along x and z, and turns about y like its six joints."""
    path = REPOSITORY / "configs" / "half_cheetah.yaml"
    tree = build_tree(build_creature(load_config(path), path))
    grown = build_brain_cpg(tree, 0, 0, BrainCpgSettings(joint_rates=True))
    rng = np.random.default_rng(0)
    sense = observe(rng, 9, lights=0, pressures=0)
    state = matsuoka.MatsuokaState(jnp.asarray(rng.uniform(-1, 1, (2, 9))), jnp.zeros((2, 9)))
    firing = np.maximum(state.potential, 0)[:, 2:]
    angle, rate = sense.joint_angle[2:], sense.joint_rate[2:]
    size = np.abs(firing[0] - firing[1]) / 1.3
    expected = np.concatenate([np.cos(angle), np.sin(angle), size, np.clip(rate / 5.0, -1, 1)])
    np.testing.assert_allclose(grown.brain_inputs(state, sense), expected, rtol=0, atol=1e-15)
    assert grown.brain.sizes[0] == 28


OUTPUTS = {
    # Tonic inputs, steerings and adaptation gains, then the sources of b1.y, b1.z, b2.y and b2.z.
    "shared": ([0.1, 0.2], [0.0, 0.75], [0.3], [0, 1, 0, 1], [0, 0, 0, 0]),
    "per_joint": ([0.1, 0.2], [0.0, 0.75], [0.3, 0.4], [0, 0, 1, 1], [0, 0, 1, 1]),
    "per_dof": (
        [0.1, 0.2, 0.3, 0.4],
        [0.0, 0.25, 0.75, 1.0],
        [0.5, 0.6, 0.7, 0.8],
        [0, 1, 2, 3],
        [0, 1, 2, 3],
    ),
}


@pytest.mark.parametrize("drive", OUTPUTS)
def test_outputs_set_the_oscillators(chain, drive):
    settings = BrainCpgSettings(
        cpg=CpgSettings(max_tonic_input=2.0, min_adaptation_gain=1.0, max_adaptation_gain=10.0),
        drive=drive,
        steering_range=0.4,
    )
    tree = chain(3, "yz")
    assert tree.dof_names == ("b1.y", "b1.z", "b2.y", "b2.z")
    grown = build_brain_cpg(tree, 1, 3, settings)
    tonic, steering, gain, source, gain_source = map(np.array, OUTPUTS[drive])
    found, found_gain = grown.cpg_inputs(jnp.concatenate([tonic, steering, gain]))
    u, d = 2.0 * tonic[source], 0.4 * (2 * steering[source] - 1)
    np.testing.assert_allclose(found, [u * (1 + d), u * (1 - d)], rtol=0, atol=1e-15)
    np.testing.assert_allclose(found_gain, 1 + 9 * gain[gain_source], rtol=0, atol=1e-14)


def test_motor_command_follows_the_rhythm_and_centres_the_joint(chain):
    settings = BrainCpgSettings(
        rate_gain=4.0,
        centring=0.5,
        max_rate=1.5,
        axes={"y": AxisSettings(gain=0.0, centring=2.0), "z": AxisSettings(gain=2.0)},
    )
    tree = chain(4, "yz")
    grown = build_brain_cpg(tree, 1, 10, settings)
    rng = np.random.default_rng(3)
    sense = observe(rng, 6)
    decoded = grown.decode(grown.random_genes(jax.random.key(0), (), float))
    state = grown.initial_state((), float)
    act = eqx.filter_jit(grown.act)
    for _ in range(100):
        state, command = act(decoded, state, sense)
    signal = np.maximum(state.potential[0], 0) - np.maximum(state.potential[1], 0)
    np.testing.assert_allclose(command.signal, signal, rtol=0, atol=1e-15)
    weights = 4.0 * np.array([0.0, 2.0] * 3)
    rate = weights * signal - np.array([2.0, 0.5] * 3) * np.asarray(sense.joint_angle)
    np.testing.assert_allclose(command.target_rate, np.clip(rate, -1.5, 1.5), atol=1e-14)


def test_neurons_activate_the_muscles_of_their_side(chain):
    """ML = min(1, y_e / u_max), MR = min(1, y_f / u_max). Muscles have no target rate."""
    motor = Muscle(area=1e-4, arm=0.01, fibre_length=0.05)
    laws = laws_of([Tendon("", (), actuator=each) for each in (motor, None)], np.ones(2))
    tree = dataclasses.replace(chain(3, "z"), muscles=laws["muscles"])
    settings = BrainCpgSettings(cpg=CpgSettings(max_tonic_input=2.0), rate_gain=3.0)
    grown = build_brain_cpg(tree, 1, 3, settings)
    state = grown.initial_state((), float)
    potential = jnp.array([[1.5, 3.0], [-1.0, 0.5]])
    state = eqx.tree_at(lambda s: s.potential, state, potential)
    command = grown.command(state, observe(np.random.default_rng(0), 2))
    np.testing.assert_allclose(command.activation, [[0.75, 1.0], [0.0, 0.25]])
    assert command.target_rate[0] == 0 and command.target_rate[1] != 0


def test_neurons_command_torque_motors_like_rigid_muscles(chain):
    """Torque gear (ML - MR). Torque motors have no target rate."""
    laws = laws_of([Tendon("", (), actuator=each) for each in (TorqueMotor(8.0), None)], np.ones(2))
    tree = dataclasses.replace(chain(3, "z"), torque_motors=laws["torque_motors"])
    grown = build_brain_cpg(tree, 1, 3, BrainCpgSettings(cpg=CpgSettings(max_tonic_input=2.0)))
    state = grown.initial_state((), float)
    state = eqx.tree_at(lambda s: s.potential, state, jnp.array([[1.5, 3.0], [0.5, 0.5]]))
    command = grown.command(state, observe(np.random.default_rng(0), 2))
    np.testing.assert_allclose(command.torque, [8.0 * (0.75 - 0.25), 0.0])
    assert command.activation is None
    assert command.target_rate[0] == 0 and command.target_rate[1] != 0


def test_neurons_command_angles_to_motors_with_a_spring(chain):
    """Angle A (ML - MR), within the limits. Such a motor has a target rate of 0."""
    tree = chain(4, "z")
    stiffness, upper = np.array([2.0, 2.0, 0.0]), np.array([9.0, 0.1, 9.0])
    tree = dataclasses.replace(tree, servo_stiffness=stiffness, upper=upper)
    sense = observe(np.random.default_rng(0), 3)
    commands = []
    for size in (60.0, 0.0):
        settings = BrainCpgSettings(cpg=CpgSettings(max_tonic_input=2.0), angle_range_deg=size)
        grown = build_brain_cpg(tree, 1, 3, settings)
        state = grown.initial_state((), float)
        potential = jnp.array([[1.5, 1.5, 3.0], [0.5, 0.5, 0.5]])
        state = eqx.tree_at(lambda s: s.potential, state, potential)
        commands.append(grown.command(state, sense))
    angles, none = commands
    np.testing.assert_allclose(angles.target_angle, [np.pi / 3 * 0.5, 0.1, 0.0])
    np.testing.assert_array_equal(angles.target_rate != 0, [False, False, True])
    assert none.target_angle is None and (none.target_rate != 0).all()


@pytest.mark.parametrize("drive", ["shared", "per_dof"])
@pytest.mark.slow
def test_batch_equals_single_and_vmap(chain, drive):
    grown = build_brain_cpg(chain(5, "xyz"), 1, 10, BrainCpgSettings(drive=drive))
    sense = observe(np.random.default_rng(4), 12, (3,))
    genes = grown.random_genes(jax.random.key(1), (3,), float)

    def trial(genes, state, sense):
        decoded = grown.decode(genes)
        return jax.lax.scan(lambda state, _: grown.act(decoded, state, sense), state, length=20)[
            1
        ].target_rate

    start = grown.initial_state((3,), float)
    batched = jax.jit(trial)(genes, start, sense)
    mapped = jax.jit(jax.vmap(trial, in_axes=-1, out_axes=-1))(genes, start, sense)
    np.testing.assert_allclose(mapped, batched, rtol=0, atol=1e-12)
    single = jax.jit(trial)(
        genes[:, 1], grown.initial_state((), float), jax.tree.map(lambda v: v[:, 1], sense)
    )
    np.testing.assert_allclose(single, batched[..., 1], rtol=0, atol=1e-12)


def test_closed_loop_keeps_senses_in_range_and_oscillates(chain):
    # The joint is kinematic: its angle follows the command up to a stop at 60 degrees.
    grown = build_brain_cpg(chain(10, "z"), 1, 10, BrainCpgSettings())
    population = 40
    sense = observe(np.random.default_rng(5), 9, (population,))
    decoded = grown.decode(grown.random_genes(jax.random.key(2), (population,), float))

    def step(carry, _):
        state, angle = carry
        seen = sense._replace(joint_angle=angle)
        largest = jnp.abs(grown.brain_inputs(state, seen)).max()
        state, command = grown.act(decoded, state, seen)
        angle = jnp.clip(angle + command.target_rate / 60, -1.05, 1.05)
        return (state, angle), (command.signal, largest)

    start = grown.initial_state((population,), float), jnp.zeros((9, population))
    signals, largest = jax.jit(lambda c: jax.lax.scan(step, c, length=1500)[1])(start)
    assert largest.max() <= 1.0
    late = np.asarray(signals[750:])
    reversing = np.minimum(late.max(axis=0), -late.min(axis=0)) / np.abs(late).max(axis=0)
    # If a random brain steers hard at a small b, one side keeps firing (31 of 40 swing).
    assert np.mean(reversing.min(axis=0) > 0.2) > 0.7


@pytest.mark.slow
def test_gradient_flows_through_brain_and_cord(chain):
    grown = build_brain_cpg(chain(3, "yz"), 1, 10, BrainCpgSettings())
    sense = observe(np.random.default_rng(6), 4)
    genes = grown.random_genes(jax.random.key(3), (), float)
    direction = jax.random.normal(jax.random.key(4), genes.shape, float)

    @jax.jit
    def late_signal(t):
        decoded = grown.decode(genes + t * direction)

        def step(state, _):
            state, command = grown.act(decoded, state, sense)
            return state, command.signal[1]

        return jax.lax.scan(step, grown.initial_state((), float), length=60)[1][-1]

    difference = (late_signal(1e-6) - late_signal(-1e-6)) / 2e-6
    assert jax.jit(jax.grad(late_signal))(0.0) == pytest.approx(float(difference), rel=1e-6)


def test_creature_without_joints_is_refused(grow):
    with pytest.raises(ValueError, match="a creature with at least one joint"):
        build_brain_cpg(grow({"stone": (None, "")}), 1, 1)


@pytest.mark.parametrize(
    ("changes", "where", "word"),
    [
        ({"axes": {"x": AxisSettings(0.5)}}, ("axes", "x"), r"valid here: y, z"),
        ({"groups": {"legs": ("b1", "leg*")}}, ("groups", "legs", 1), r"valid here: b0, b1"),
        ({"groups": {"legs": ("b{i}x",)}}, ("groups", "legs", 0), r"write 'b\*x'"),
        ({"groups": {"root": ("b0",)}}, ("groups", "root"), "with one: b1, b2"),
        ({"groups": {"front": ("b1",), "all": ("b*",)}}, ("groups", "all"), "both name 'b1'"),
    ],
)
def test_unknown_axes_and_bodies_are_refused(chain, changes, where, word):
    with pytest.raises(UnfitError, match=word) as caught:
        build_brain_cpg(chain(3, "yz"), 1, 1, BrainCpgSettings(**changes))
    assert caught.value.where == where


def test_a_group_of_bodies_has_separate_tonic_inputs_and_steerings(chain):
    settings = BrainCpgSettings(
        groups={"tail": ("b3", "b[4-9]")},
        steering_range=0.5,
        axes={"tail/z": AxisSettings(steering_range=1.0)},
    )
    grown = build_brain_cpg(chain(5, "yz"), 1, 3, settings)
    tonic, steering = np.array([0.1, 0.2, 0.3, 0.4]), np.array([0.9, 0.8, 0.7, 0.6])
    found, gain = grown.cpg_inputs(jnp.concatenate([tonic, steering, jnp.array([0.5])]))
    # In the order of their names: tail/y, tail/z, y, z.
    source = [2, 3, 2, 3, 0, 1, 0, 1]
    turn = (np.array([0.5, 1.0, 0.5, 0.5]) * (2 * steering - 1))[source]
    u = tonic[source]
    np.testing.assert_allclose(found, [u * (1 + turn), u * (1 - turn)], rtol=0, atol=1e-15)
    np.testing.assert_allclose(gain, 5.5)
    assert max_amplitude(settings) == 2.0


@pytest.mark.parametrize(
    ("settings", "key", "value"),
    [
        (BrainCpgSettings, "steering_range", 1.5),
        (BrainCpgSettings, "max_rate", 0.0),
        (BrainCpgSettings, "centring", -1.0),
        (BrainCpgSettings, "angle_range_deg", -1),
        (AxisSettings, "steering_range", 1.5),
        (AxisSettings, "centring", -1.0),
        (BrainSettings, "hidden", (16, 0)),
        (BrainSettings, "temperature", 0.0),
        (BrainSettings, "init_range", -1.0),
        (CpgSettings, "time_scale", 0.0),
        (CpgSettings, "max_tonic_input", -1.0),
        (CpgSettings, "child_weight", -0.2),
        (CpgSettings, "min_adaptation_gain", 11.0),
        (partial(Coupling, "a.y", "b.y", lag_deg=90.0), "weight", -1.0),
        (partial(Coupling, "a.y", "b.y"), "lag_deg", 200.0),
        (partial(Ring, ("a.y",)), "lag_deg", math.nan),
        (partial(Ring, ("a.y",), 0.0), "weight", -1.0),
        (StretchFeedback, "delay", -0.1),
        (StretchFeedback, "angle_weight", (1.0, 1.0)),
        (StretchFeedback, "from_parents", -1),
        (FeedbackSettings, "limit", 0),
        (PostureSettings, "postures", 0),
        (PostureSettings, "bits_per_joint", 0),
        (PostureSettings, "period", 0.0),
        (PostureSettings, "period", math.inf),
        (PostureSettings, "angle_step", -20.0),
        (PostureSettings, "lowest_angle", math.nan),
        (PostureSettings, "neutral_angle", math.inf),
    ],
)
def test_settings_out_of_range_are_refused(settings, key, value):
    with pytest.raises(ValueError, match=key):
        settings(**{key: value})


def test_example_in_the_protocol_works():
    names: dict = {}
    example = doctest.DocTestFinder().find(protocol.Controller, "Controller")[0]
    outcome = doctest.DocTestRunner().run(example, clear_globs=False)
    assert outcome.attempted > 0
    assert outcome.failed == 0
    names = example.globs
    sine = names["SineController"]()
    genes = jnp.array([[2.0], [0.5]])
    state = sine.initial_state((1,), float)
    assert sine.random_genes(jax.random.key(0), (1,), float).shape == (2, 1)
    sense = observe(np.random.default_rng(0), 3, (1,))
    for _ in range(30):
        state, command = sine.act(genes, state, sense)
    # After half a second of 0.5 Hz, the wave is at its crest.
    np.testing.assert_allclose(command.target_rate, 2.0, rtol=1e-12)
    assert command.signal.shape == (3, 1)
