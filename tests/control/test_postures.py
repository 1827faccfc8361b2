"""The postures: meaning of every bit, and times of the switches."""

import dataclasses
import functools
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from creatures import quick_jit
from evo_cpg.control.controller import Observation
from evo_cpg.control.postures import (
    EXACT_PERIODS,
    TOLERANCE,
    PostureSettings,
    build_posture_controller,
)
from evo_cpg.creature.creature import Muscle, Tendon, TorqueMotor
from evo_cpg.creature.laws import laws_of

ANGLES = [110, 130, 150, 170, 190, 210, 230, 250]  # degrees: Fukui 2003, 2.5
LEGS = ("front_left", "front_right", "hind_left", "hind_right")


def plan(legs):
    """Return the plan of a torso with legs of two boxes each, hinged about y."""
    uppers = {f"{leg}_upper": ("torso", "y") for leg in legs}
    lowers = {f"{leg}_lower": (f"{leg}_upper", "y") for leg in legs}
    return {"torso": (None, "")} | uppers | lowers


def observe(dofs, batch=(), dtype=float):
    """Return senses, which the postures ignore."""
    nothing = np.zeros((0, *batch), dtype)
    joints = np.full((dofs, *batch), 0.3, dtype)
    return Observation(nothing, nothing, nothing, nothing, joints, joints, nothing)


def encode(numbers, bits):
    """Return the genome for a table of angle numbers, postures by joints."""
    text = "".join(f"{number:0{bits}b}" for row in numbers for number in row)
    return np.array([float(bit) for bit in text])


def act_for(controller, genes, steps):
    """Return the commands of a trial, stacked along the control steps."""
    batch = genes.shape[1:]
    sense = observe(controller.dof_count, batch, genes.dtype)
    start = controller.initial_state(batch, genes.dtype)

    @quick_jit
    def run(genes, start):
        decoded = controller.decode(genes)
        act = functools.partial(controller.act, decoded, observation=sense)
        return jax.lax.scan(lambda state, _: act(state), start, length=steps)[1]

    return run(genes, start)


def decode(controller, genes):
    return quick_jit(controller.decode)(genes)


def degrees_of(controller, genes):
    """Return decoded angles in degrees, relative to the neutral angle."""
    return jnp.rad2deg(controller.decode(genes))


def degrees(controller, genes):
    """Return decoded angles in degrees, as the thesis counts them."""
    return np.rad2deg(decode(controller, genes)) + controller.origin.settings.neutral_angle


@pytest.fixture(scope="session")
def quadruped(grow):
    return build_posture_controller(grow(plan(LEGS)), PostureSettings(), 1 / 60)


@pytest.fixture(scope="session")
def pendulum(grow):
    """Function that builds the controller of a single joint."""

    def build(control_step, **settings):
        tree = grow({"base": (None, ""), "leg": ("base", "y")})
        return build_posture_controller(tree, PostureSettings(**settings), control_step)

    return build


@pytest.mark.parametrize(("legs", "genes"), [(4, 192), (3, 144)])
def test_genome_is_as_long_as_in_the_thesis(grow, legs, genes):
    tree = grow(plan(LEGS[:legs]))
    controller = build_posture_controller(tree, PostureSettings(), 1 / 60)
    assert controller.gene_count == genes
    numbers = np.random.default_rng(legs).integers(0, 8, (8, 2 * legs))
    found = degrees(controller, encode(numbers, 3))
    np.testing.assert_allclose(found, np.array(ANGLES)[numbers], rtol=0, atol=1e-12)


def test_a_hand_made_genome_gives_its_angles(quadruped, grow):
    # Bits 24 to 47 are the second posture: upper legs 110, 130, 150, 170, lower legs 250, 230, 210,
    # 190.
    genes = np.zeros(192)
    genes[24:48] = [int(bit) for bit in "000001010011" + "111110101100"]
    expected = np.full((8, 8), 110.0)
    expected[1] = [110, 130, 150, 170, 250, 230, 210, 190]
    np.testing.assert_allclose(degrees(quadruped, jnp.array(genes)), expected, rtol=0, atol=1e-12)
    names = [f"{leg}_{part}.y" for part in ("upper", "lower") for leg in LEGS]
    assert list(grow(plan(LEGS)).dof_names) == names


def test_random_genes_are_fair_bits_that_give_all_angles(quadruped):
    genes = quadruped.random_genes(jax.random.key(0), (50,), float)
    assert genes.shape == (192, 50)
    assert set(np.unique(genes)) == {0.0, 1.0}
    # Five standard deviations of the mean of 9600 coins are 0.026.
    assert float(genes.mean()) == pytest.approx(0.5, abs=0.026)
    found = degrees(quadruped, genes)
    assert sorted(set(np.round(found).ravel().tolist())) == ANGLES
    np.testing.assert_allclose(found, np.round(found), rtol=0, atol=1e-12)


def test_half_counts_as_one(pendulum):
    controller = pendulum(1 / 60, postures=1)
    below = np.nextafter(0.5, 0)
    for genes, angle in [([below, 0.5, 7.0], 170), ([-3.0, 0.3, 0.9], 130)]:
        found = degrees(controller, jnp.array(genes))
        np.testing.assert_allclose(found, [[angle]], rtol=0, atol=1e-12)


def test_graded_genes_are_not_rounded(pendulum):
    controller = pendulum(1 / 60, postures=1, graded=True)
    # The angle is 110 degrees plus 80, 40 and 20 for each whole gene. Genes are clipped to 0 to 1.
    for genes, angle in [([0.25, 0.5, 0.1], 152), ([2.0, -1.0, 1.0], 210), ([0.0, 0.0, 0.0], 110)]:
        found = degrees(controller, jnp.array(genes))
        np.testing.assert_allclose(found, [[angle]], rtol=0, atol=1e-5)
    gradient = jax.jacfwd(lambda genes: degrees_of(controller, genes))(jnp.array([0.3, 0.6, 0.2]))
    np.testing.assert_allclose(gradient.ravel(), [80, 40, 20], rtol=1e-5)


def test_bits_mean_the_same_with_graded_genes(grow):
    build = [
        build_posture_controller(grow(plan(LEGS)), PostureSettings(graded=graded), 1 / 60)
        for graded in (False, True)
    ]
    genes = build[0].random_genes(jax.random.key(0), (20,), jnp.float32)
    np.testing.assert_array_equal(*(np.asarray(one.decode(genes)) for one in build))


@pytest.mark.parametrize(("postures", "bits"), [(1, 1), (3, 2), (5, 4)])
def test_numbers_of_postures_and_bits_can_be_set(chain, postures, bits):
    settings = PostureSettings(
        postures=postures,
        bits_per_joint=bits,
        lowest_angle=-30.0,
        angle_step=2.5,
        neutral_angle=-10.0,
    )
    controller = build_posture_controller(chain(3, "yz"), settings, 1 / 60)
    numbers = np.random.default_rng(0).integers(0, 2**bits, (postures, 4))
    genes = encode(numbers, bits)
    assert controller.gene_count == len(genes) == postures * 4 * bits
    np.testing.assert_allclose(degrees(controller, genes), -30 + 2.5 * numbers, rtol=0, atol=1e-12)
    angles = np.asarray(act_for(controller, genes, 21 * postures).target_angle)
    np.testing.assert_array_equal(angles[::20][:postures], decode(controller, genes))
    np.testing.assert_array_equal(angles[20 * postures], angles[0])


@pytest.mark.parametrize(
    ("control_step", "period", "held"),
    # The last period is 7.000000000000001 control steps in floating-point numbers.
    [(1 / 60, 1 / 3, 20), (1 / 240, 1 / 3, 80), (1 / 60, 0.3, 18), (0.1, 0.1, 1), (0.01, 0.07, 7)],
)
@pytest.mark.parametrize("batch", [(), (2,)])
def test_each_posture_is_held_for_its_period(chain, control_step, period, held, batch):
    settings = PostureSettings(period=period)
    controller = build_posture_controller(chain(3, "y"), settings, control_step)
    genes = controller.random_genes(jax.random.key(1), batch, float)
    # Neighbouring postures differ, so that every switch is seen.
    angles = np.asarray(decode(controller, genes))
    assert (np.abs(angles - np.roll(angles, 1, axis=0)).max(axis=1) > 0).all()
    expected = np.concatenate([np.repeat(angles, held, axis=0)] * 3)
    found = act_for(controller, genes, 3 * 8 * held)
    np.testing.assert_array_equal(found.target_angle, expected)
    np.testing.assert_array_equal(found.signal, expected)
    np.testing.assert_array_equal(found.target_rate, np.zeros_like(expected))


@pytest.mark.parametrize(
    "steps", [1.0, 17.5, 50 / 3, 20 + 4e-4, 20 - 4e-4, 20 + 1e-7, 1e3 * math.sqrt(2), 8000 - 1 / 7]
)
def test_switch_is_at_the_first_control_step_of_a_period(pendulum, steps):
    # Most of these periods are no whole number of control steps.
    control_step = 1 / 240
    controller = pendulum(control_step, postures=EXACT_PERIODS, period=steps * control_step)
    k = np.arange(1, EXACT_PERIODS)
    latest = np.ceil(k * steps - 1e-3 * TOLERANCE).astype(int)
    early = controller.posture(jnp.asarray(np.ceil(k * steps - 2 * TOLERANCE), jnp.int32) - 1)
    np.testing.assert_array_less(early, k)
    reached = controller.posture(jnp.asarray(latest, jnp.int32))
    np.testing.assert_array_equal(reached, k)


def test_postures_repeat_up_to_the_largest_step_number(pendulum):
    controller = pendulum(1 / 50, period=1 / 3)
    last = 2**31 - 1
    steps = np.concatenate([np.arange(1000), last - np.arange(1000)])
    found = controller.posture(jnp.asarray(steps, jnp.int32))
    np.testing.assert_array_equal(found, steps * 3 // 50 % 8)


@pytest.mark.parametrize("wide", [True, False])
def test_single_precision_is_kept(quadruped, wide):
    with jax.enable_x64(wide):
        genes = quadruped.random_genes(jax.random.key(3), (2,), jnp.float32)
        start = quadruped.initial_state((2,), jnp.float32)
        sense = observe(8, (2,), jnp.float32)
        state, command = eqx.filter_jit(quadruped.act)(quadruped.decode(genes), start, sense)
        assert (genes.dtype, state.dtype, start.dtype) == (jnp.float32, jnp.int32, jnp.int32)
        assert {x.dtype for x in command if x is not None} == {jnp.dtype(jnp.float32)}
        number = np.asarray(genes).reshape(8, 8, 3, 2)[0]
        number = 4 * number[:, 0] + 2 * number[:, 1] + number[:, 2]
        angle = np.deg2rad(20.0 * number - 70.0)
        np.testing.assert_allclose(command.target_angle, angle, rtol=0, atol=3e-7)


def test_creature_without_joints_is_refused(grow):
    with pytest.raises(ValueError, match="a creature with at least one joint"):
        build_posture_controller(grow({"stone": (None, "")}), PostureSettings(), 1 / 60)


@pytest.mark.parametrize("period", [0.01, 200.0])
def test_too_short_and_too_long_periods_are_refused(pendulum, period):
    with pytest.raises(ValueError, match=r"from 1 to 8000 control steps of 0.0166667 s, got"):
        pendulum(1 / 60, period=period)


@pytest.mark.parametrize(
    ("motor", "name", "word"),
    [
        (TorqueMotor(), "torque_motors", "b1.z takes torques"),
        (Muscle(1e-4, 0.01, 0.05), "muscles", "b1.z has muscles"),
    ],
)
def test_motors_without_an_angle_are_refused(chain, motor, name, word):
    laws = laws_of([Tendon("", (), actuator=each) for each in (motor, None)], np.ones(2))
    tree = dataclasses.replace(chain(3, "z"), **{name: laws[name]})
    with pytest.raises(ValueError, match=word):
        build_posture_controller(tree, PostureSettings(), 1 / 60)
