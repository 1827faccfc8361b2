"""One step of our genetic algorithms alone, compared with a step of evosax's SimpleGA.

Both get the same fitness and breed a population of the same size and precision, on one core. The
operators differ. SimpleGA draws parents from the better half and adds normal noise to every gene.
Our algorithms draw by rank, cross, change some genes and keep elites.
"""

import dataclasses
import functools
import importlib
import importlib.util
import statistics
import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.plan import Plan, experiment_of
from benchmarks.rows import Row
from benchmarks.timing import Contender, count_lasting, race, ratio_quartiles
from evo_cpg.evolution.genetics import BitGenetics, Genetics
from evo_cpg.evolution.strategy import Evaluation

SIZE, GENES = 200, 3000
_QUICK_GENES = 300
_FEWEST, _MOST = 3, 10_000
_PEER, _MODULE = "evosax, SimpleGA", "evosax"

Breeder = Callable[[int], object]


def measure(plan: Plan) -> list[Row]:
    """Return the rows of our two algorithms, each compared with SimpleGA."""
    genes = _QUICK_GENES if plan.quick else GENES
    real = experiment_of("iwadate2010_swimmer").strategy
    assert isinstance(real, Genetics)
    breeders: dict[str, Breeder] = {}
    compile_seconds: dict[str, float] = {}
    for part, genetics in (("real-valued", real), ("bits", BitGenetics(population=SIZE))):
        plan.say(f"ga: {part}")
        breeders[part], compile_seconds[part] = _ours(genetics, genes)
    installed = importlib.util.find_spec(_MODULE) is not None
    if installed:
        breeders[_PEER], _ = _evosax(genes)
    rates = race([_contender(name, breed, plan) for name, breed in breeders.items()], plan.repeats)
    return [
        _row(part, genes, rates, compile_seconds[part], installed, plan) for part in compile_seconds
    ]


def _ours(genetics: Genetics, gene_count: int) -> tuple[Breeder, float]:
    """Return a function that breeds a number of generations, and its compile time, s."""
    fitness = _fitness()
    first = jax.random.bernoulli(jax.random.key(0), 0.5, (gene_count, SIZE)).astype(jnp.float32)

    def generation(key: jax.Array, genes: jax.Array) -> tuple[jax.Array, jax.Array]:
        key, now = jax.random.split(key)
        return key, genetics.tell(now, (), genes, Evaluation(fitness, {}, {}))

    return _compiled(jax.jit(generation), jax.random.key(1), first)


def _evosax(gene_count: int) -> tuple[Breeder, float]:
    """Return SimpleGA's function that breeds a number of generations, and its compile time, s.

    Its methods `ask` and `tell` are compiled together.
    """
    evosax: Any = importlib.import_module("evosax.algorithms")
    strategy = evosax.SimpleGA(population_size=SIZE, solution=jnp.zeros(gene_count))
    settings, fitness = strategy.default_params, -_fitness()
    population = jax.random.normal(jax.random.key(0), (SIZE, gene_count))
    start = strategy.init(jax.random.key(1), population, fitness, settings)

    def generation(key: jax.Array, state: Any) -> tuple[jax.Array, Any]:
        key, ask, tell = jax.random.split(key, 3)
        children, state = strategy.ask(ask, state, settings)
        return key, strategy.tell(tell, children, fitness, state, settings)[0]

    return _compiled(jax.jit(generation), jax.random.key(1), start)


def _fitness() -> jax.Array:
    return jnp.asarray(np.random.default_rng(0).permutation(SIZE), jnp.float32)


def _compiled(generation: Any, key: jax.Array, first: Any) -> tuple[Breeder, float]:
    start = time.perf_counter()
    program = generation.lower(key, first).compile()
    seconds = time.perf_counter() - start

    def breed(generations: int) -> None:
        state = key, first
        for _ in range(generations):
            state = program(*state)
        jax.block_until_ready(state)

    return breed, seconds


def _contender(name: str, breed: Breeder, plan: Plan) -> Contender:
    count = count_lasting(
        lambda count: functools.partial(breed, count), plan.call_seconds, _FEWEST, _MOST
    )
    return Contender(name, count, functools.partial(breed, count))


def _row(
    part: str,
    gene_count: int,
    rates: dict[str, list[float]],
    compile_seconds: float,
    installed: bool,
    plan: Plan,
) -> Row:
    row = Row(
        "ga",
        part,
        SIZE,
        statistics.median(rates[part]),
        "generations/s",
        f"{SIZE} individuals of {gene_count} genes in float32 on one core, median of "
        f"{plan.repeats} rounds in turn. A call of the peer is one `ask` and one `tell`",
        compile_seconds,
        peer=_PEER,
        note=None if installed else "not installed",
    )
    if not installed:
        return row
    low, ratio, high = ratio_quartiles(rates, part, _PEER)
    peer_rate = statistics.median(rates[_PEER])
    return dataclasses.replace(row, peer_rate=peer_rate, ratio=ratio, ratio_spread=(low, high))
