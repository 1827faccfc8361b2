"""Limb oscillators against their equations, and commands of motors and muscles."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from creatures import box_chain, quick_jit
from evo_cpg.control.controller import Observation
from evo_cpg.control.limb_oscillators import GENES, LimbOscillatorSettings, build_limb_oscillators
from evo_cpg.creature.creature import Muscle
from evo_cpg.creature.tree import build_tree

# Axes of each limb, and the axis whose oscillator drives it (None: the limb is on the root).
LIMBS = {
    "tail": ("b0", "z", None),
    "arm": ("b0", "zy", None),
    "forearm": ("arm", "y", "arm.z"),
    "wrist": ("forearm", "", None),
    "hand": ("wrist", "xyz", "forearm.y"),
    "finger": ("hand", "yz", "hand.x"),
    "thumb": ("hand", "z", "hand.x"),
}
STEP = 1 / 240
# T_r and T_a (Iwadate 2010, Table 3, exchanged), the weight a, and the first x over u_max.
RISE, ADAPTATION, PAIR, FIRST = 0.153337, 1.181958, 1.5, 0.1


@pytest.fixture(scope="module")
def body(grow):
    """Return the tree of `LIMBS`, and the driver of each degree of freedom, -1 for none."""
    tree = grow({"b0": (None, "")} | {name: limb[:2] for name, limb in LIMBS.items()})
    names = list(tree.dof_names)
    drivers = [LIMBS[name.split(".")[0]][2] for name in names]
    return tree, np.array([-1 if name is None else names.index(name) for name in drivers])


def observation(angle) -> Observation:
    none, angle = jnp.zeros((0, *angle.shape[1:])), jnp.asarray(angle)
    return Observation(none, none, none, none, angle, 0 * angle, none)


def rhythm(controller, genes, seconds: float, angle=None):
    """Return the potentials ``(step, 2, d)`` and the commands of a controller."""
    count = controller.tree.dof_count
    seen = observation(np.zeros(count) if angle is None else angle)

    @quick_jit
    def run(genes):
        decoded, state = controller.decode(genes), controller.initial_state((), float)

        def advance(state, _):
            state, command = controller.act(decoded, state, seen)
            return state, (state.potential, command)

        return jax.lax.scan(advance, state, length=round(seconds / controller.control_step))[1]

    return jax.tree.map(np.asarray, run(jnp.asarray(genes)))


def integrated(genes, drivers, seconds: float, own: LimbOscillatorSettings) -> np.ndarray:
    """Return potentials ``(step, 2, d)`` of the equations from SciPy's integrator."""
    amplitude, period, coupling, steering, start = genes.reshape(len(GENES), -1)
    d, u = own.steering_range * (2 * steering - 1), own.max_tonic_input * amplitude
    tonic = np.stack([u * (1 + d), u * (1 - d)])
    b = own.min_adaptation_gain + (own.max_adaptation_gain - own.min_adaptation_gain) * period
    w = own.max_coupling * (2 * coupling - 1)
    count = len(drivers)

    def change(_, y):
        x, z = y.reshape(2, 2, count)
        firing = np.maximum(x, 0)
        dx = np.zeros_like(x)
        for i in range(count):
            for own_side, other in ((0, 1), (1, 0)):
                received = PAIR * firing[other, i]
                if drivers[i] >= 0:
                    received += max(w[i], 0) * firing[other, drivers[i]]
                    received += max(-w[i], 0) * firing[own_side, drivers[i]]
                dx[own_side, i] = tonic[own_side, i] - received - b[i] * z[own_side, i]
        dx = (dx - x) / (RISE * own.time_scale)
        return np.concatenate([dx, (firing - z) / (ADAPTATION * own.time_scale)]).ravel()

    first = FIRST * own.max_tonic_input
    y = np.concatenate([first * start, first * (1 - start), np.zeros(2 * count)])
    time = STEP * np.arange(1, 1 + round(seconds / STEP))
    found = solve_ivp(change, (0, time[-1]), y, "RK45", time, rtol=1e-8, atol=1e-10, max_step=0.01)
    return found.y[: 2 * count].T.reshape(len(time), 2, count)


@pytest.mark.parametrize(
    ("seed", "settings"),
    [
        (0, {}),
        (1, {"time_scale": 0.7, "max_tonic_input": 2.0, "max_coupling": 1.0}),
        pytest.param(2, {"steering_range": 1.0}, marks=pytest.mark.slow),
        pytest.param(3, {"max_adaptation_gain": 5.0}, marks=pytest.mark.slow),
    ],
)
def test_the_rhythm_follows_its_equations(body, seed, settings):
    """SciPy's potentials after 4 s differ by the error of the fixed step, 1e-4 of the amplitude."""
    tree, drivers = body
    own = LimbOscillatorSettings(**settings)
    genes = np.random.default_rng(seed).uniform(0, 1, len(GENES) * tree.dof_count)
    found, _ = rhythm(build_limb_oscillators(tree, own, STEP), genes, 4.0)
    expected = integrated(genes, drivers, 4.0, own)
    assert np.ptp(expected, axis=0).max() > 0.2 * own.max_tonic_input
    assert np.abs(found - expected).max() < 1e-4 * own.max_tonic_input
    # Another driver gives another rhythm.
    other = integrated(genes, np.where(drivers >= 0, 0, -1), 4.0, own)
    assert np.abs(found - other).max() > 1e-2 * own.max_tonic_input


def test_a_limb_on_the_root_receives_nothing(body):
    """Its rhythm does not depend on its coupling, nor on the genes of other limbs."""
    tree, drivers = body
    controller = build_limb_oscillators(tree, LimbOscillatorSettings(), STEP)
    rng = np.random.default_rng(0)
    genes = rng.uniform(0.3, 1, (len(GENES), tree.dof_count))
    own = drivers < 0
    changed = np.where(own, genes, rng.uniform(0, 1, genes.shape))
    changed[GENES.index("coupling"), own] = 0.0
    one, _ = rhythm(controller, genes.ravel(), 2.0)
    other, _ = rhythm(controller, changed.ravel(), 2.0)
    assert own.sum() == 3
    np.testing.assert_array_equal(one[..., own], other[..., own])
    # Only a limb without coupling ignores its driver.
    coupled = genes.copy()
    coupled[GENES.index("coupling")] = 0.5
    driven = coupled.copy()
    driven[GENES.index("amplitude"), own] = 0.1
    one, other = (rhythm(controller, each.ravel(), 2.0)[0] for each in (coupled, driven))
    np.testing.assert_array_equal(one[..., ~own], other[..., ~own])
    assert np.abs(one[..., own] - other[..., own]).max() > 0.1


def test_motors_follow_the_rhythm_and_the_neutral_angle(body):
    """The rate is ``rate_gain (y_e - y_f) - centring angle``, at most ``max_rate``."""
    tree, _ = body
    own = LimbOscillatorSettings(rate_gain=4.0, centring=2.0, max_rate=1.0)
    controller = build_limb_oscillators(tree, own, STEP)
    rng = np.random.default_rng(0)
    angle = rng.uniform(-0.5, 0.5, tree.dof_count)
    genes = rng.uniform(0, 1, len(GENES) * tree.dof_count)
    potential, command = rhythm(controller, genes, 2.0, angle)
    extensor, flexor = np.moveaxis(np.maximum(potential, 0), 1, 0)
    np.testing.assert_allclose(command.signal, extensor - flexor, atol=1e-12)
    rate = 4.0 * (extensor - flexor) - 2.0 * angle
    assert np.abs(rate).max() > 1.0
    np.testing.assert_allclose(command.target_rate, np.clip(rate, -1.0, 1.0), atol=1e-12)
    assert command.activation is None


def test_firing_activates_muscles():
    """The activations are firing over the largest tonic input, at most 1."""
    tree = build_tree(box_chain(3, "z", Muscle(area=1e-4, arm=0.01, fibre_length=0.05)))
    controller = build_limb_oscillators(tree, LimbOscillatorSettings(max_tonic_input=2.0), STEP)
    genes = np.full((len(GENES), 2), 0.5)
    genes[GENES.index("start")], genes[GENES.index("amplitude")] = 0.9, 1.0
    genes[GENES.index("steering")] = 1.0
    potential, command = rhythm(controller, genes.ravel(), 2.0)
    expected = np.clip(potential / 2.0, 0.0, 1.0)
    np.testing.assert_allclose(command.activation, expected, atol=1e-12)
    assert expected.max() > 0.3 and (potential < 0).any()


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"time_scale": 0.0}, "time_scale must be positive, got 0.0"),
        ({"max_tonic_input": -1.0}, "max_tonic_input must be positive"),
        ({"min_adaptation_gain": 0.0}, "min_adaptation_gain must be positive"),
        ({"max_rate": float("nan")}, "max_rate must be positive, got nan"),
        ({"max_coupling": -0.1}, "max_coupling must not be negative, got -0.1"),
        ({"rate_gain": -1.0}, "rate_gain must not be negative"),
        ({"centring": -1.0}, "centring must not be negative"),
        ({"max_adaptation_gain": 0.5}, r"max_adaptation_gain \(0.5\) must not be smaller"),
        ({"steering_range": 1.5}, "steering_range must be from 0 to 1, got 1.5"),
    ],
)
def test_wrong_settings_are_named(settings, words):
    with pytest.raises(ValueError, match=words):
        dataclasses.replace(LimbOscillatorSettings(), **settings)


def test_a_creature_without_joints_is_refused(grow):
    with pytest.raises(ValueError, match="needs a creature with at least one joint"):
        build_limb_oscillators(grow({"b0": (None, "")}), LimbOscillatorSettings(), STEP)
