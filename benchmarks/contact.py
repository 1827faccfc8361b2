"""Measure the accuracy of contact: `python -m benchmarks.contact [ANIMAL ...] [--count 64]`.

Animals thrash about on their own ground, with the commands of the benchmark's exercises. Each
physics step gives:

- The residual of the solved problem, as a fraction of the forces that act.
- The error in Coulomb's law with the step's own normal forces, as a fraction of the load.
- The depth of every contact point after the step, and the overlap of bodies of one animal.

In float64, every window of 0.1 s also gives the growth of a disturbance of the state by 1e-9. The
figures are in docs/models/contact.md.
"""

import argparse
import functools
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from rich.console import Console
from rich.progress import track

from benchmarks.animals import ANIMALS
from benchmarks.exercise import Exercise
from evo_cpg.physics.contact.contact_points import clearance
from evo_cpg.physics.contact.pairs import separations
from evo_cpg.physics.step.step import first_warmstart, step
from evo_cpg.physics.tree.kinematics import kinematics
from evo_cpg.physics.tree.state import State, resting_state

# Norm of the change of the state at the start of a window, and length of a window, s.
DISTURBANCE, WINDOW = 1e-9, 0.1

_ON_LAND = ("quadruped", "salamander-land")


class Thrashing(NamedTuple):
    """Results of every physics step ``t`` and window ``w``.

    Attributes:
        touches: whether any contact point had a normal force.
        solved: residual of the solved problem, a fraction.
        coulomb: error in Coulomb's law, a fraction.
        depth: depth of every contact point, m, negative above the ground.
        overlap: deepest overlap of bodies of one animal, m. It is 0 without pairs to keep apart.
        growth: factor by which the disturbance grew in every window, empty in float32.
    """

    touches: Float[np.ndarray, "t n"]
    solved: Float[np.ndarray, "t n"]
    coulomb: Float[np.ndarray, "t n"]
    depth: Float[np.ndarray, "t p n"]
    overlap: Float[np.ndarray, "t n"]
    growth: Float[np.ndarray, "w n"]


def thrash(exercise: Exercise, count: int, seconds: float, dtype: type) -> Thrashing:
    """Simulate a population that thrashes about on the ground.

    Args:
        exercise: commands of the population.
        count: number of individuals.
        seconds: duration, s, rounded to whole windows.
        dtype: type of all numbers. In float64 every individual has a disturbed twin.
    """
    simulation = exercise.experiment.simulation
    world, h = simulation.world, simulation.step_length
    contact_model = world.contact_model
    assert contact_model is not None
    pairs = dtype is np.float64
    lanes = np.asarray(exercise.lanes(count), dtype)
    lanes = np.concatenate([lanes, lanes], 1) if pairs else lanes
    commands = exercise.prepare(jnp.asarray(lanes))
    place = simulation.situations[0].start_position
    state = resting_state(world.tree, lanes.shape[1:], dtype, position=place)
    warmstart = first_warmstart(world, lanes.shape[1:], lanes.dtype)

    def advance(carry: tuple, index: Array) -> tuple[tuple, tuple]:
        state, warmstart = carry
        new, effort = step(world, state, exercise.command(commands, index), h, warmstart)
        kin = kinematics(world.tree, new)
        assert effort.contact_frame_force is not None and effort.residual is not None
        touches = (effort.contact_frame_force[2] > 0).any(0)
        overlap = jnp.zeros_like(effort.energy)
        if world.pairs is not None:
            overlap = jnp.maximum(-separations(world.pairs, kin).gap.min(0), 0.0)
        seen = touches, *effort.residual, -clearance(contact_model, kin), overlap
        return (new, effort.warmstart), jax.tree.map(lambda x: x[..., :count], seen)

    size = round(WINDOW / h)
    window = jax.jit(lambda carry, first: jax.lax.scan(advance, carry, first + jnp.arange(size)))
    rng = np.random.default_rng(0)
    found, growth = [], []
    windows = range(round(seconds / WINDOW))
    for i in track(windows, "thrashing", transient=True, console=Console(stderr=True)):
        if pairs:
            state = _disturbed(state, count, rng)
            # A disturbed twin starts each window with the warm start of its original.
            warmstart = jax.tree.map(_twice(count), warmstart)
            before = _distance(state, count)
        (state, warmstart), seen = window((state, warmstart), jnp.int32(i * size))
        if pairs:
            growth.append(_distance(state, count) / before)
        found.append(jax.tree.map(np.asarray, seen))
    parts = [np.concatenate(part) for part in zip(*found, strict=True)]
    return Thrashing(*parts, growth=np.array(growth))  # pyright: ignore[reportCallIssue]


def _twice(count: int) -> Callable[[Array], Array]:
    """Return a function that appends an array's first individuals to themselves."""
    return lambda x: jnp.concatenate([x[..., :count], x[..., :count]], -1)


def _disturbed(state: State, count: int, rng: np.random.Generator) -> State:
    """Return the first individuals, followed by disturbed copies of them."""
    parts = [np.asarray(part)[..., :count] for part in jax.tree.leaves(state)]
    directions = [rng.normal(size=part.shape) for part in parts]
    norm = np.sqrt(sum((direction**2).sum(0) for direction in directions))
    moved = [
        part + DISTURBANCE * direction / norm
        for part, direction in zip(parts, directions, strict=True)
    ]
    both = [np.concatenate(pair, -1) for pair in zip(parts, moved, strict=True)]
    return jax.tree.unflatten(jax.tree.structure(state), [jnp.asarray(part) for part in both])


def _distance(state: State, count: int) -> Float[np.ndarray, " n"]:
    """Return the norm of the difference between each individual's state and its twin's."""
    apart = [
        np.asarray(x)[..., count:] - np.asarray(x)[..., :count] for x in jax.tree.leaves(state)
    ]
    return np.sqrt(sum((x**2).sum(0) for x in apart))


def row(animal: str, dtype: type, found: Thrashing) -> str:
    """Return an animal's row of the table.

    Residuals and Coulomb errors are counted in contact steps, depths at all points in all steps,
    and overlaps in all steps.
    """
    fraction = functools.partial(_fraction, found.touches)
    growth = (
        ""
        if not found.growth.size
        else " / ".join(
            f"{x:.2g}" for x in [*np.quantile(found.growth, [0.5, 0.99]), found.growth.max()]
        )
    )
    cells = [
        animal,
        np.dtype(dtype).name,
        f"{found.touches.mean():.0%}",
        f"{fraction(found.solved, 1e-3):.3g}",
        f"{fraction(found.coulomb, 1e-2):.3g} / {fraction(found.coulomb, 1.0):.3g}",
        f"{100 * (found.depth > 1e-3).mean():.2g} / {100 * (found.depth > 3e-3).mean():.2g}",
        f"{1e3 * found.depth.max():.2g}",
        f"{100 * (found.overlap > 3e-3).mean():.2g}, {1e3 * found.overlap.max():.2g}",
        growth,
    ]
    return "| " + " | ".join(cells) + " |"


HEADER = """\
| animal | numbers | steps in contact | residual > 1e-3, % | Coulomb > 1e-2 / > 1, % | \
deeper than 1 / 3 mm, % | deepest, mm | limbs deeper than 3 mm, % of steps; deepest, mm | \
growth: median / 99 % / most |
|---|---|---|---|---|---|---|---|---|"""


def _fraction(touches: np.ndarray, residual: np.ndarray, bound: float) -> float:
    """Return the percentage of contact steps with a residual above a bound."""
    return 100 * float((residual[touches] > bound).mean())


def main() -> None:
    """Simulate the animals, and print the table of their contacts."""
    parser = argparse.ArgumentParser(description=str(__doc__).split("\n", 1)[0])
    parser.add_argument("animals", nargs="*", metavar="ANIMAL", default=_ON_LAND)
    parser.add_argument("--count", type=int, default=64, help="number of individuals")
    parser.add_argument("--seconds", type=float, default=20.0, help="simulated time, s")
    given = parser.parse_args()
    console = Console()
    console.print(HEADER, soft_wrap=True)
    for animal in given.animals or _ON_LAND:
        for dtype in (np.float32, np.float64):
            with jax.enable_x64(dtype is np.float64):
                found = thrash(ANIMALS[animal]().exercise, given.count, given.seconds, dtype)
            console.print(row(animal, dtype, found), soft_wrap=True)


if __name__ == "__main__":
    main()
