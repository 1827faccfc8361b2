"""Fit the constants of `evo_cpg.native.machine_constants` to this machine.

    python -m benchmarks.fit_constants [NAME ...] [--rounds 7]

This tries candidates for each constant. It prints the time of the work relative to the time with
the present value, and the compile time. Candidates take turns (`benchmarks.timing`), so that a slow
moment of the machine affects all of them. Nothing is changed: write a clear winner into the file by
hand, with the figures. All work runs on one core, in float32.
"""

import argparse
import dataclasses
import functools
import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from rich.console import Console
from rich.table import Table

from benchmarks.animals import ANIMALS
from benchmarks.ours import compile_motion, full_lanes
from benchmarks.plan import experiment_of, random_genes
from benchmarks.timing import Contender, race, ratio_quartiles, seconds
from evo_cpg.native import machine_constants
from evo_cpg.simulation.backward import Backward
from evo_cpg.simulation.rollout import rollout
from evo_cpg.training.devices import population_mesh, use_cores
from evo_cpg.training.evaluate import compile_trials

# Steps in a call of a physics program, and individuals in seven vectors.
_STEPS, _INDIVIDUALS = 400, 112
# Control steps of a trial, and a population that fills the widest chunk that is tried.
_CONTROL_STEPS, _POPULATION = 30, 2048
# Control steps of the trials whose gradients are computed, for one vector of individuals.
_SLOPE_STEPS = 120

Call = Callable[[], object]


class Constant(NamedTuple):
    """A constant that can be fitted.

    Attributes:
        candidates: values to try in addition to the present one.
        works: work to time, by name. Each function returns a call of a program. The program is
            compiled with the constants as they are then, in the first call at the latest.
    """

    candidates: Sequence[Any]
    works: dict[str, Callable[[], Call]]


def _physics(animal: str) -> Call:
    exercise, mesh = ANIMALS[animal]().exercise, population_mesh(1)
    program = compile_motion(exercise, exercise.lanes(full_lanes(_INDIVIDUALS, mesh)), mesh)
    return functools.partial(program.run, _STEPS)


def _large_population() -> Call:
    simulation = experiment_of("iwadate2010_swimmer").simulation
    simulation = dataclasses.replace(simulation, steps=_CONTROL_STEPS)
    genes = random_genes(simulation, _POPULATION)
    return functools.partial(compile_trials(simulation, population_mesh(1)), genes)


def _slopes() -> Call:
    simulation = experiment_of("iwadate2010_swimmer").simulation
    simulation = dataclasses.replace(simulation, steps=_SLOPE_STEPS)
    genes = jnp.asarray(random_genes(simulation, machine_constants.LANES))

    def distance(genes: jax.Array) -> jax.Array:
        return rollout(simulation, genes, backward=Backward()).terms["distance"].sum()

    gradient = jax.jit(jax.grad(distance))
    return lambda: jax.block_until_ready(gradient(genes))


_PHYSICS = {
    f"physics of the {name}": functools.partial(_physics, name) for name in ("swimmer", "quadruped")
}

CONSTANTS = {
    "VALUE_REGISTERS": Constant((0.5, 0.625, 0.6875, 0.8125, 0.875), _PHYSICS),
    "LLVM_EFFORT": Constant((0, 1, 3), _PHYSICS),
    "WIDEST_CHUNK": Constant((1, 4, 16, 128), {"trials of swimmers": _large_population}),
    "LARGEST_RESIDUALS": Constant((0,), {"gradients of swimmers": _slopes}),
}


class Found(NamedTuple):
    """Result of one value of a constant.

    Attributes:
        value: value of the constant.
        compile_seconds: time until the end of the first call, less the time of another call, s.
        time: time of the work relative to the present value's: lower quartile, median, upper
            quartile.
    """

    value: Any
    compile_seconds: float
    time: tuple[float, float, float]


def compare(name: str, constant: Constant, work: str, rounds: int) -> list[Found]:
    """Return the results of one work with the present value, then with each candidate."""
    present = getattr(machine_constants, name)
    values = [present, *(value for value in constant.candidates if value != present)]
    contenders, compiling = [], {}
    try:
        for value in values:
            setattr(machine_constants, name, value)
            start = time.perf_counter()
            call = constant.works[work]()
            call()
            whole = time.perf_counter() - start
            compiling[value] = max(whole - seconds(call), 0.0)
            # Each call divides the population into chunks, whose width depends on the constant. The
            # constant must therefore have the contender's value during the contender's calls.
            contenders.append(Contender(str(value), 1.0, _with(name, value, call)))
    finally:
        setattr(machine_constants, name, present)
    rates = race(contenders, rounds)
    return [
        Found(value, compiling[value], ratio_quartiles(rates, str(present), str(value)))
        for value in values
    ]


def _with(name: str, value: Any, call: Call) -> Call:
    def timed() -> None:
        before = getattr(machine_constants, name)
        setattr(machine_constants, name, value)
        try:
            call()
        finally:
            setattr(machine_constants, name, before)

    return timed


def main(names: Sequence[str], rounds: int) -> None:
    """Time the candidates of each constant and print the results.

    Args:
        names: names of constants, or none for all.
        rounds: number of rounds.
    """
    use_cores(1)
    jax.config.update("jax_enable_compilation_cache", False)
    console = Console()
    for name in names or CONSTANTS:
        for work in CONSTANTS[name].works:
            table = Table("value", "time", "quartiles", "compile, s", title=f"{name}: {work}")
            for found in compare(name, CONSTANTS[name], work, rounds):
                low, middle, high = found.time
                table.add_row(
                    str(found.value),
                    f"{middle:.2f}",
                    f"{low:.2f} to {high:.2f}",
                    f"{found.compile_seconds:.1f}",
                )
            console.print(table)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=str(__doc__).split("\n", 1)[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"default: {', '.join(CONSTANTS)}")
    parser.add_argument("--rounds", type=int, default=7)
    arguments = parser.parse_args()
    if unknown := set(arguments.names) - set(CONSTANTS):
        parser.error(f"unknown constant: {', '.join(unknown)}. Allowed: {', '.join(CONSTANTS)}")
    main(arguments.names, arguments.rounds)
