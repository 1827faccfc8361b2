"""Invariance to place, heading, and stepping individuals alone or together."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from creatures import in_water, quick_jit, random_creature, random_state
from evo_cpg.creature.creature import Actuator
from evo_cpg.physics.step.step import step
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.state import State

H = 1 / 120
STEPS = 100
INDIVIDUALS = 4
# A trunk with two limbs, of three axes and of one axis.
STRUCTURE = ((0, 3), (0, 1))


@pytest.fixture(scope="module")
def animal():
    """Return a branching creature with weak motors, springs, limits and random targets."""
    with jax.enable_x64(True):
        rng = np.random.default_rng(12)
        motor = Actuator(2.0, 0.5)
        creature = random_creature(rng, STRUCTURE, limits=0.8, motor=motor, axes_seed=4)
        dofs = sum(axes for _, axes in STRUCTURE)
        targets = jnp.asarray(rng.normal(scale=2.0, size=(STEPS, dofs, INDIVIDUALS)))
        return creature, targets


def rollout(world: World, state: State, targets) -> State:
    """Return the state after all targets."""
    return jax.lax.scan(lambda s, t: (step(world, s, t, H)[0], None), state, targets)[0]


def moved(state: State, turn: Rotation, shift: np.ndarray) -> State:
    """Return the state of one individual after a rotation and a shift."""
    matrix = turn.as_matrix()
    x, y, z, w = (turn * Rotation.from_quat(np.roll(state.orientation, -1))).as_quat()
    return State(
        position=matrix @ state.position + shift,
        orientation=jnp.asarray([w, x, y, z]),
        velocity=jnp.concatenate([matrix @ state.velocity[:3], matrix @ state.velocity[3:]]),
        q=state.q,
        qd=state.qd,
    )


def stack(states: list[State]) -> State:
    return jax.tree.map(lambda *parts: jnp.stack(parts, -1), *states)


def pick(states: State, n: int) -> State:
    return jax.tree.map(lambda x: x[..., n], states)


@pytest.mark.slow
def test_place_and_heading_do_not_matter(animal):
    """Turns and shifts of the initial state turn and shift the final state.

    The turn is about z if there is gravity. All individuals get equal targets. The tolerance is
    1e-10 after 100 steps, in which the motion is not chaotic. Rounding is about 1e-13.
    """
    creature, targets = animal
    targets = jnp.broadcast_to(targets[..., :1], targets.shape)
    world = in_water(creature, density=900.0)
    rng = np.random.default_rng(1)
    start = random_state(world.tree, rng)
    shifts = [np.zeros(3), *rng.normal(scale=5.0, size=(3, 3))]

    @quick_jit
    def run(gravity, states):
        return rollout(eqx.tree_at(lambda w: w.gravity, world, gravity), states, targets)

    for gravity in (9.81, 0.0):
        some = [
            Rotation.from_rotvec([0, 0, angle]) if gravity else Rotation.random(None, rng)
            for angle in (1.0, 2.5)
        ]
        turns = [Rotation.identity(), Rotation.identity(), *some]
        starts = [moved(start, turn, shift) for turn, shift in zip(turns, shifts, strict=True)]
        ends = run(gravity, stack(starts))
        reference = pick(ends, 0)
        assert np.linalg.norm(reference.position - start.position) > 0.05
        for n in range(1, INDIVIDUALS):
            expected, end = moved(reference, turns[n], shifts[n]), pick(ends, n)
            sign = np.sign(expected.orientation @ end.orientation)
            np.testing.assert_allclose(sign * end.orientation, expected.orientation, atol=1e-10)
            for name in ("position", "velocity", "q", "qd"):
                np.testing.assert_allclose(getattr(end, name), getattr(expected, name), atol=1e-10)


@pytest.mark.slow
def test_single_batched_and_vmapped_steps_agree(animal):
    """Step one by one, as a population, and under ``vmap`` with individuals on the last axis.

    At most the order of summation differs. The tolerance is 1e-12 after 100 steps.
    """
    creature, targets = animal
    world = in_water(creature, current=(0.2, 0.1, 0.0))
    starts = random_state(world.tree, np.random.default_rng(2), (INDIVIDUALS,))

    def run(state, targets):
        return rollout(world, state, targets)

    single = quick_jit(run)
    together = single(starts, targets)
    mapped = quick_jit(jax.vmap(run, in_axes=-1, out_axes=-1))(starts, targets)
    alone = stack([single(pick(starts, n), targets[..., n]) for n in range(INDIVIDUALS)])
    for name, expected in vars(together).items():
        if expected is None:
            continue
        np.testing.assert_allclose(getattr(mapped, name), expected, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(getattr(alone, name), expected, rtol=1e-12, atol=1e-12)
