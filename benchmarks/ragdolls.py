"""Measure the energy of ragdolls: `python -m benchmarks.ragdolls`.

Quadrupeds of Model 1 without motors are thrown down in any pose. Nothing gives them energy, so
their energy must never rise. The largest rise above an earlier energy, as a fraction of the initial
energy, is an error of the simulator. The figures are in docs/models/contact.md.
"""

import argparse
import dataclasses
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from rich.console import Console

from benchmarks.plan import experiment_of
from evo_cpg.analysis.energy import mechanical_energy
from evo_cpg.physics.step.step import first_warmstart, step
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.state import State, resting_state
from evo_cpg.simulation.judge import is_sane
from evo_cpg.simulation.snapshot import Snapshot
from evo_cpg.training.conditions import limp

RESTITUTIONS, SPEEDS = (0.0, 0.3, 0.9), (1.0, 10.0)

HEADER = """\
| restitution | thrown down at, m/s | energy rises by, % (median, most) | diverged |
|---|---|---|---|"""


class Fall(NamedTuple):
    """Results of falling ragdolls.

    Attributes:
        rise: largest rise of each ragdoll's energy above an earlier energy, as a fraction of its
            initial energy. Diverged ragdolls are left out.
        diverged: number of diverged ragdolls.
    """

    rise: Float[np.ndarray, " n"]
    diverged: int


def fall(world: World, count: int, seconds: float, speed: float, h: float) -> Fall:
    """Throw ragdolls down.

    Args:
        world: world of a creature without motors.
        count: number of ragdolls.
        seconds: duration, s.
        speed: downward speed, m/s, added to random velocities of some 1 m/s and 1 rad/s.
        h: length of a step, s.
    """

    def advance(carry: tuple, _: None) -> tuple[tuple, Array]:
        state, warmstart = carry
        state, effort = step(world, state, jnp.zeros_like(state.q), h, warmstart=warmstart)
        energy = mechanical_energy(Snapshot(world, h, state))
        return (state, effort.warmstart), jnp.where(is_sane(state), energy, jnp.nan)

    @jax.jit
    def run(state: State) -> tuple[Array, Array]:
        first = mechanical_energy(Snapshot(world, h, state))
        begin = state, first_warmstart(world, (count,), jnp.dtype(jnp.float64))
        return first, jax.lax.scan(advance, begin, None, round(seconds / h))[1]

    with jax.enable_x64(True):
        first, energy = map(np.asarray, run(_thrown(world, count, speed)))
    diverged = np.isnan(energy).any(0)
    energy = energy[:, ~diverged]
    least = np.minimum.accumulate(np.concatenate([first[None, ~diverged], energy]))[1:]
    return Fall((energy - least).max(0) / first[~diverged], int(diverged.sum()))


def _thrown(world: World, count: int, speed: float) -> State:
    """Return states 1 m above the origin in random poses, with downward and random velocities."""
    rng = np.random.default_rng(0)
    turns = rng.normal(size=(4, count))
    velocity = rng.normal(size=(6, count))
    velocity[5] -= speed
    state = resting_state(world.tree, (count,), jnp.float64, position=(0.0, 0.0, 1.0))
    return dataclasses.replace(
        state,
        orientation=jnp.asarray(turns / np.linalg.norm(turns, axis=0)),
        velocity=jnp.asarray(velocity),
        q=jnp.asarray(rng.uniform(-0.5, 0.5, (world.tree.dof_count, count))),
    )


def main() -> None:
    """Throw ragdolls down with every restitution and speed, and print the table of energies."""
    parser = argparse.ArgumentParser(description=str(__doc__).split("\n", 1)[0])
    parser.add_argument("--count", type=int, default=24, help="number of ragdolls")
    parser.add_argument("--seconds", type=float, default=5.0, help="simulated time, s")
    parser.add_argument("--step", type=float, default=1 / 240, help="physics step, s")
    arguments = parser.parse_args()
    console = Console()
    console.print(HEADER, soft_wrap=True)
    world = limp(experiment_of("fukui2003_model1").simulation).world
    contact_model = world.contact_model
    assert contact_model is not None
    for restitution in RESTITUTIONS:
        every = np.full_like(np.asarray(contact_model.restitution), restitution)
        own = eqx.tree_at(
            lambda w: w.contact_model, world, contact_model._replace(restitution=every)
        )
        for speed in SPEEDS:
            found = fall(own, arguments.count, arguments.seconds, speed, arguments.step)
            rise = f"{100 * np.median(found.rise):.2g}, {100 * found.rise.max():.2g}"
            console.print(f"| {restitution} | {speed:g} | {rise} | {found.diverged} |")


if __name__ == "__main__":
    main()
