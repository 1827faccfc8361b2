"""The part of CMA-MAE that runs on the host: evolution strategies of pyribs, and their map.

No object of pyribs outlives a call. Between calls its numbers are arrays, which a checkpoint holds.
Each call rebuilds the object, bit for bit, by public names:

- The evolution strategies are classes of `ribs.emitters.opt`, with `reset`, `ask`, `tell` and
  `check_stop`. pyribs' own emitter does not expose its strategy. So `adapt` repeats the few steps
  of that emitter: rank by improvement, adapt, restart.
- `vars` lists the attributes of a strategy, as for `copy` and `pickle`. The time at which an
  attribute is set shows its purpose (`Layout`).
- pyribs' random numbers come from generators that are passed to it.
- The map is ours (`enter`), because the thresholds of pyribs' map cannot be set. Its sums and
  thresholds are equal, bit for bit, to those of `ribs.archives.GridArchive`.

NumPy rounds differently with different types of numbers (Python float, float32, float64). So
numbers of a strategy are kept as the bits of a float64 (two ``uint32`` each), together with their
types.
"""

import functools
import importlib
import operator
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, PyTree

from evo_cpg.evolution.archive import Axis

ALGORITHMS = {
    "sep_cma_es": "SeparableCMAEvolutionStrategy",
    "lm_ma_es": "LMMAEvolutionStrategy",
    "openai_es": "OpenAIEvolutionStrategy",
    "cma_es": "CMAEvolutionStrategy",
}
"""Class names of the evolution strategies, by pyribs' short names."""

SAMPLE = "_solutions"
"""Name of the array of drawn individuals, in all strategies of pyribs."""

SEED_WORDS = 4
"""Number of 32-bit words in a seed for NumPy's generators."""

# Types of numbers that a strategy holds. Arrays ``kinds`` store indices into this tuple.
_KINDS = (float, np.float32, np.float64)

# Length of a word in the state of a generator (PCG64), bits.
_WORD = 32

# Added to cells * (descriptor - low) before the division by the range and rounding down, as in
# pyribs.
_EPSILON = np.float32(1e-6)

# Arrays by name. Arrays of emitters have the emitters on the first axis.
Arrays = dict[str, np.ndarray]


class UnknownPyribsError(Exception):
    """Raised if strategies of the installed pyribs cannot become arrays, with the reason."""


class RibsSettings(NamedTuple):
    """Settings of the emitters and of their map.

    Attributes:
        axes: axes of the map.
        gene_count: numbers in a genome.
        emitters: number of emitters.
        batch: individuals of each emitter.
        es: evolution strategy of each emitter, one of `ALGORITHMS`.
        sigma: standard deviation of the first sample.
        learning_rate: learning rate of thresholds.
        threshold_min: initial threshold, or None for the median of the first sample.
        options: options of the evolution strategy's constructor.
    """

    axes: tuple[Axis, ...]
    gene_count: int
    emitters: int
    batch: int
    es: str
    sigma: float
    learning_rate: float
    threshold_min: float | None
    options: tuple[tuple[str, float], ...]


class Layout(NamedTuple):
    """Attributes of an evolution strategy that change, by path.

    Attributes:
        vectors: arrays that `reset` sets.
        scalars: numbers that `reset` sets.
        counters: whole numbers that are 0 after `reset`.
        drawn: arrays ``(batch, g)`` that `ask` sets.
    """

    vectors: tuple[str, ...]
    scalars: tuple[str, ...]
    counters: tuple[str, ...]
    drawn: tuple[str, ...]


def optimiser(settings: RibsSettings, generator: np.random.Generator | None = None) -> Any:
    """Build an evolution strategy of pyribs. Call its `reset` before any other method.

    Raises:
        ImportError: pyribs is not installed.
        TypeError: the constructor does not take an option.
        ValueError: the settings do not go together.
    """
    kind = getattr(importlib.import_module("ribs.emitters.opt"), ALGORITHMS[settings.es])
    return kind(
        # All products with it become float64.
        sigma0=np.float64(settings.sigma),
        solution_dim=settings.gene_count,
        batch_size=settings.batch,
        seed=generator or np.random.default_rng(0),
        dtype=np.float32,
        **dict(settings.options),
    )


@functools.lru_cache(maxsize=16)
def layout(settings: RibsSettings) -> Layout:
    """Return the attributes of a strategy that change.

    Raises:
        UnknownPyribsError: an attribute is not a number, an array or a setting.
    """
    strategy = optimiser(settings)
    before = _held(strategy)
    strategy.reset(np.zeros(settings.gene_count, np.float32))
    held = _held(strategy)
    counters = [name for name, x in held.items() if type(x) is int and x == 0]
    set_now = [
        name
        for name, x in held.items()
        if name not in counters
        and x is not None
        and (before.get(name) is None or not np.array_equal(before[name], x))
    ]
    arrays = [name for name in set_now if isinstance(held[name], np.ndarray)]
    # Checkpoints since 1.0 have this order: Adam's parameters come first.
    vectors = tuple(sorted(arrays, key=lambda name: not name.endswith("_theta")))
    scalars = tuple(name for name in set_now if name not in vectors)
    drawn = tuple(name for name, x in held.items() if x is None)
    return Layout(vectors, scalars, tuple(counters), drawn)


@functools.lru_cache(maxsize=16)
def shapes(settings: RibsSettings) -> tuple[PyTree, PyTree, PyTree]:
    """Return the shapes and types of the arrays of the map, of the emitters, and of their draws."""
    seeds = np.zeros((1 + settings.emitters, SEED_WORDS), np.uint32)
    started = start_emitters(settings, np.zeros(settings.gene_count, np.float32), seeds)
    cells, emitters = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape, x.dtype), started)
    drawn = jax.ShapeDtypeStruct(
        (settings.emitters, settings.batch, settings.gene_count), np.float32
    )
    return cells, emitters, dict.fromkeys(layout(settings).drawn, drawn)


def start_emitters(
    settings: RibsSettings, start: np.ndarray, seeds: np.ndarray
) -> tuple[Arrays, Arrays]:
    """Return an empty map, and emitters whose distributions have one genome as their mean."""
    first, *others = seeds.tolist()
    capacity = int(np.prod([axis.cells for axis in settings.axes]))
    lowest = np.nan if settings.threshold_min is None else settings.threshold_min
    cells = {
        # Occupied cells in the order in which they were filled, and their number.
        "order": np.zeros(capacity, np.int32),
        "count": np.array(0, np.int32),
        "threshold_min": np.array(lowest, np.float32),
        "randomness": _generator_words(np.random.default_rng(first)),
        "solution": np.zeros((capacity, settings.gene_count), np.float32),
        "objective": np.zeros(capacity, np.float32),
        "measures": np.zeros((capacity, len(settings.axes)), np.float32),
        "threshold": np.zeros(capacity, np.float32),
    }
    emitters = []
    for seed in others:
        # As in pyribs' emitter, whose ranker gets the second generator.
        generator = np.random.default_rng(np.random.SeedSequence(seed).spawn(2)[0])
        strategy = optimiser(settings, generator)
        strategy.reset(start)
        emitters.append(_distribution(settings, strategy, generator, 0, 0))
    return cells, _stacked(emitters)


def draw(settings: RibsSettings, emitters: Arrays) -> tuple[Arrays, Arrays]:
    """Draw a population.

    Returns:
        The emitters afterwards, and their draws.
    """
    after, drawn = [], []
    for number in range(settings.emitters):
        strategy, generator, counts = _restored(settings, _row(emitters, number))
        strategy.ask()
        after.append(_distribution(settings, strategy, generator, *counts))
        drawn.append({name: getattr(strategy, name) for name in layout(settings).drawn})
    return _stacked(after), _stacked(drawn)


def adapt(
    settings: RibsSettings,
    cells: Arrays,
    emitters: Arrays,
    drawn: Arrays,
    fitness: Float[np.ndarray, " n"],
    measures: Float[np.ndarray, "n k"],
    counts: Bool[np.ndarray, " n"],
) -> tuple[Arrays, Arrays]:
    """Enter a population into the map, and adapt the emitters.

    Args:
        settings: the settings.
        cells: the map.
        emitters: distributions of the emitters.
        drawn: draws of the emitters.
        fitness: fitness of the population, all finite.
        measures: descriptors of each individual, by axis, all finite.
        counts: True for individuals that may enter the map. The others rank below all others of
            their emitter.
    """
    cells = {name: np.array(array) for name, array in cells.items()}
    if np.isnan(cells["threshold_min"]) and counts.any():
        # Just below the median, so that an individual exceeds it even if all are equal.
        median = np.float32(np.median(fitness[counts]))
        cells["threshold_min"] = np.asarray(np.nextafter(median, np.float32(-np.inf)))
    value = np.zeros(len(counts), np.float32)
    if counts.any():
        solutions = drawn[SAMPLE].reshape(-1, settings.gene_count)
        worth = {"solution": solutions, "objective": fitness, "measures": measures}
        value[counts] = enter(settings, cells, {name: x[counts] for name, x in worth.items()})
        # Rank these individuals last, with a finite value, because the strategies compute with it.
        value[~counts] = np.nextafter(value[counts].min(), -np.inf)
    if cells["count"] == 0:
        return cells, emitters
    of_map, after = _generator(cells["randomness"]), []
    for number, own in enumerate(value.reshape(settings.emitters, -1)):
        strategy, generator, (tells, restarts) = _restored(settings, _row(emitters, number))
        for name, array in _row(drawn, number).items():
            setattr(strategy, name, array)
        best_first = np.flip(np.argsort(own))
        strategy.tell(best_first, own, settings.batch // 2)
        if strategy.check_stop(own[best_first]):
            cell = cells["order"][of_map.choice(int(cells["count"]), size=1)[0]]
            strategy.reset(cells["solution"][cell])
            restarts += 1
        after.append(_distribution(settings, strategy, generator, tells + 1, restarts))
    return cells | {"randomness": _generator_words(of_map)}, _stacked(after)


def enter(settings: RibsSettings, cells: Arrays, worth: Arrays) -> Float[np.ndarray, " n"]:
    """Enter individuals into the map, in place.

    Returns:
        The fitness of each individual minus the threshold of its cell.
    """
    low = np.array([axis.low for axis in settings.axes], np.float32)
    high = np.array([axis.high for axis in settings.axes], np.float32)
    size = np.array([axis.cells for axis in settings.axes], np.int32)
    place = ((size * (worth["measures"] - low) + _EPSILON) / (high - low)).astype(np.int32)
    cell = np.ravel_multi_index(tuple(np.clip(place, 0, size - 1).T), tuple(size))
    count, fitness = int(cells["count"]), worth["objective"]
    occupied = np.zeros(len(cells["order"]), bool)
    occupied[cells["order"][:count]] = True
    threshold = np.where(occupied, cells["threshold"], cells["threshold_min"])[cell]
    enters = fitness > threshold
    value = fitness - threshold
    found = np.asarray(cell)[enters]
    number = np.zeros(len(occupied), int)
    total = np.zeros(len(occupied), np.float32)
    np.add.at(number, found, 1)
    np.add.at(total, found, fitness[enters])
    # The batch rule of Fontaine and Nikolaidis 2023.
    remaining = np.asarray(1 - np.float32(settings.learning_rate)) ** number[found]
    risen = remaining * threshold[enters] + total[found] / number[found] * (1 - remaining)
    best = np.full(len(occupied), -np.inf, np.float32)
    np.maximum.at(best, found, fitness[enters])
    wins = np.flatnonzero(fitness[enters] == best[found])
    # The first among equals.
    taken, first = np.unique(found[wins], return_index=True)
    winners = np.flatnonzero(enters)[wins[first]]
    for name, array in worth.items():
        cells[name][taken] = array[winners]
    cells["threshold"][taken] = risen[wins[first]]
    new = taken[~occupied[taken]]
    cells["order"][count : count + len(new)] = new
    cells["count"] = np.array(count + len(new), np.int32)
    return value


def _held(thing: Any, prefix: str = "") -> dict[str, Any]:
    """Return numbers, arrays and None that an object and its parts hold, by path."""
    found: dict[str, Any] = {}
    for name, value in vars(thing).items():
        path = prefix + name
        if value is None or isinstance(value, np.ndarray | np.floating | float | int):
            found[path] = value
        elif type(value).__module__.startswith("ribs."):
            found |= _held(value, f"{path}.")
        elif not isinstance(value, np.random.Generator | np.dtype | type | str):
            version = getattr(importlib.import_module("ribs"), "__version__", "?")
            raise UnknownPyribsError(
                f"pyribs {version} stores its state differently from pyribs 0.12 ({path} of "
                f"{type(thing).__name__} is a {type(value).__name__}). "
                "Install a known version: `pip install 'ribs~=0.12.0'`"
            )
    return found


def _distribution(
    settings: RibsSettings, strategy: Any, generator: np.random.Generator, tells: int, restarts: int
) -> Arrays:
    """Return a strategy as arrays. The last counter is its number of restarts."""
    inside = layout(settings)
    numbers = {
        name: operator.attrgetter(name)(strategy) for name in (*inside.vectors, *inside.scalars)
    }
    counters = [operator.attrgetter(name)(strategy) for name in inside.counters]
    return {name: _bits(value) for name, value in numbers.items()} | {
        "kinds": np.array([_kind(value) for value in numbers.values()], np.int32),
        "counters": np.array([*counters, tells, restarts], np.int32),
        "randomness": _generator_words(generator),
    }


def _restored(settings: RibsSettings, arrays: Arrays) -> tuple[Any, np.random.Generator, list[int]]:
    """Return a strategy, its generator, and the numbers of its tells and restarts."""
    inside, generator = layout(settings), _generator(arrays["randomness"])
    strategy = optimiser(settings, generator)
    strategy.reset(np.zeros(settings.gene_count, np.float32))
    kinds = [_KINDS[kind] for kind in arrays["kinds"]]
    *counters, tells, restarts = arrays["counters"].tolist()
    for name, kind in zip((*inside.vectors, *inside.scalars), kinds, strict=True):
        value = arrays[name].view(np.float64)
        _put(strategy, name, value.astype(kind) if name in inside.vectors else kind(value[0]))
    for name, counter in zip(inside.counters, counters, strict=True):
        _put(strategy, name, counter)
    return strategy, generator, [tells, restarts]


def _put(strategy: Any, path: str, value: Any) -> None:
    *part, name = path.rsplit(".", 1)
    setattr(operator.attrgetter(*part)(strategy) if part else strategy, name, value)


def _kind(value: Any) -> int:
    return _KINDS.index(value.dtype.type if isinstance(value, np.ndarray | np.generic) else float)


def _bits(value: Any) -> np.ndarray:
    """Return numbers as float64, by their bits: the last axis is twice as long."""
    return np.ascontiguousarray(np.atleast_1d(value), np.float64).view(np.uint32)


def _row(arrays: Arrays, number: int) -> Arrays:
    """Return the arrays of one emitter: contiguous and writable, as pyribs needs them."""
    return {name: np.array(value[number], order="C") for name, value in arrays.items()}


def _stacked(rows: list[Arrays]) -> Arrays:
    return {name: np.stack([row[name] for row in rows]) for name in rows[0]}


def _generator_words(generator: np.random.Generator) -> np.ndarray:
    """Return the state of a generator: two numbers of 128 bits, and 32 bits left from a draw."""
    state = generator.bit_generator.state
    words = [
        (state["state"][name] >> shift) % 2**_WORD
        for name in ("state", "inc")
        for shift in range(0, 128, _WORD)
    ]
    return np.array([*words, state["has_uint32"], state["uinteger"]], np.uint32)


def _generator(words: np.ndarray) -> np.random.Generator:
    """Return the generator of `_generator_words`."""
    *both, has_uint32, uinteger = words.tolist()
    state, inc = (
        sum(word << (_WORD * place) for place, word in enumerate(half))
        for half in (both[:4], both[4:])
    )
    bits = np.random.PCG64()
    bits.state = {
        "bit_generator": "PCG64",
        "state": {"state": state, "inc": inc},
        "has_uint32": has_uint32,
        "uinteger": uinteger,
    }
    return np.random.Generator(bits)
