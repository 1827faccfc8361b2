"""How the objects of pyribs 0.12 are made, taken apart into arrays and put together again.

All that goes by their private names is here. pyribs rounds to float64 in places, so such numbers
are kept as their bits, two ``uint32`` each.
"""

import functools
import importlib
import itertools
import operator
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import PyTree

from evo_cpg.evolution.map_elites import Axis


class UnknownPyribsError(Exception):
    """The installed pyribs is not one whose objects we can take apart; the message says why."""


class Plan(NamedTuple):
    """What the objects of pyribs are made with.

    Attributes:
        axes: of the map.
        gene_count: numbers in a genome.
        emitters: how many.
        batch: individuals of each.
        es: the evolution strategy of each, by pyribs' name.
        sigma: standard deviation of the first sample.
        learning_rate: of thresholds.
        threshold_min: where they begin; None for the median of their first sample.
        options: of the evolution strategy's constructor.
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


class _Inside(NamedTuple):
    """What an evolution strategy of pyribs holds, by path.

    Attributes:
        vectors: arrays that it adapts.
        scalars: numbers likewise.
        counters: integers.
        drawn: arrays of what it asked for, ``(batch, g)``.
        settings: what stays as its constructor left it.
    """

    vectors: tuple[str, ...]
    scalars: tuple[str, ...]
    counters: tuple[str, ...]
    drawn: tuple[str, ...]
    settings: tuple[str, ...]

    @property
    def paths(self) -> set[str]:
        """All of them."""
        return set(itertools.chain(*self, _SETTINGS, ("_rng",)))


_SETTINGS = ("batch_size", "sigma0", "solution_dim", "dtype", "lower_bounds", "upper_bounds")

_INSIDE = {
    "sep_cma_es": _Inside(
        ("mean", "pc", "ps", "cov.cov"),
        ("sigma",),
        ("current_eval", "cov.updated_eval"),
        ("_solutions",),
        ("cov.dtype",),
    ),
    "lm_ma_es": _Inside(
        ("mean", "ps", "m"),
        ("sigma",),
        ("current_gens",),
        ("_solutions", "_solution_z"),
        ("n_vectors", "csigma", "cd", "cc"),
    ),
    "openai_es": _Inside(
        ("adam_opt._theta", "adam_opt._m", "adam_opt._v"),
        ("last_update_ratio",),
        ("adam_opt._t",),
        ("_solutions", "noise"),
        (
            "mirror_sampling",
            *(f"adam_opt._{name}" for name in ("lr", "beta1", "beta2", "epsilon", "l2_coeff")),
        ),
    ),
    "cma_es": _Inside(
        ("mean", "pc", "ps", "cov.cov", "cov.eigenbasis", "cov.eigenvalues", "cov.invsqrt"),
        ("sigma", "cov.condition_number"),
        ("current_eval", "cov.updated_eval"),
        ("_solutions",),
        ("cov.dtype", "lazy_gap_evals"),
    ),
}

# Evolution strategies, by pyribs' names.
ALGORITHMS = tuple(_INSIDE)

# Objects within an evolution strategy.
_PARTS = ("cov", "adam_opt")

_EMITTER = (
    *("_archive", "_solution_dim", "_lower_bounds", "_upper_bounds", "_x0", "_sigma0", "_opt"),
    *("_selection_rule", "_restart_rule", "_restarts", "_itrs", "_ranker", "_batch_size"),
)
# Of these the generator draws, and the store holds everybody; `_best_elite`, `_objective_sum` and
# `_stats` are for whoever looks, and nothing that is computed goes by them.
_ARCHIVE = (
    *("_rng", "_dims", "_solution_dim", "_objective_dim", "_measure_dim", "_store"),
    *("_lower_bounds", "_upper_bounds", "_interval_size", "_boundaries", "_epsilon"),
    *("_learning_rate", "_threshold_min", "_qd_score_offset"),
    *("_best_elite", "_objective_sum", "_stats"),
)
_PROPERTIES = ("capacity", "occupied", "n_occupied", "occupied_list", "updates")
_FIELDS = ("solution", "objective", "measures", "threshold")

# Kinds of numbers: pyribs has several, with which NumPy rounds differently.
_KINDS = (float, np.float32, np.float64)

# Of a seed for NumPy's generators; and of the state of one (PCG64), in 32 bits.
SEED_WORDS, _WORD = 4, 32


def built(
    plan: Plan,
    threshold_min: float | None = None,
    start: np.ndarray | None = None,
    seeds: list[list[int]] | None = None,
) -> tuple[Any, list[Any]]:
    """The map and the emitters as they begin; nobody exceeds a threshold that is NaN."""
    lowest = plan.threshold_min if threshold_min is None else threshold_min
    ribs_archives: Any = importlib.import_module("ribs.archives")
    ribs_emitters: Any = importlib.import_module("ribs.emitters")
    first, *others = seeds or [[0]] * (1 + plan.emitters)
    archive = ribs_archives.GridArchive(
        solution_dim=plan.gene_count,
        dims=[axis.cells for axis in plan.axes],
        ranges=[(axis.low, axis.high) for axis in plan.axes],
        learning_rate=plan.learning_rate,
        threshold_min=np.nan if lowest is None else lowest,
        seed=first,
        dtype=np.float32,
    )
    emitters = [
        ribs_emitters.EvolutionStrategyEmitter(
            archive,
            x0=np.zeros(plan.gene_count, np.float32) if start is None else start,
            # As all that it is multiplied with becomes.
            sigma0=np.float64(plan.sigma),
            ranker="imp",
            es=plan.es,
            es_kwargs=dict(plan.options),
            selection_rule="mu",
            restart_rule="basic",
            batch_size=plan.batch,
            seed=seed,
        )
        for seed in others
    ]
    return archive, emitters


@functools.lru_cache(maxsize=16)
def shapes(plan: Plan) -> tuple[PyTree, PyTree, PyTree]:
    """Of all arrays of the map, of the emitters and of what these draw."""
    # One emitter shows what all are like.
    one = plan._replace(emitters=1)
    archive, emitters = built(one)
    _require_known(plan, archive, emitters[0])
    drawn = jax.ShapeDtypeStruct((plan.emitters, plan.batch, plan.gene_count), np.float32)
    cells = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape, x.dtype), cells_of(archive))
    distributions = jax.tree.map(
        lambda x: jax.ShapeDtypeStruct((plan.emitters, *x.shape[1:]), x.dtype),
        distributions_of(one, emitters),
    )
    return cells, distributions, dict.fromkeys(_INSIDE[plan.es].drawn, drawn)


def _require_known(plan: Plan, archive: Any, emitter: Any) -> None:
    """Check that the installed pyribs holds what we take apart, and nothing else.

    Raises:
        UnknownPyribsError: it does not.
    """
    try:
        store, optimiser = archive._store, emitter._opt
        held = {
            "GridArchive": (set(vars(archive)), set(_ARCHIVE)),
            "ArrayStore": ({*store._props, *store._fields}, {*_PROPERTIES, *_FIELDS}),
            "EvolutionStrategyEmitter": (set(vars(emitter)), set(_EMITTER)),
            plan.es: (_paths(optimiser), _INSIDE[plan.es].paths),
        }
    except AttributeError as error:
        raise _unknown(str(error)) from None
    for name, (found, wanted) in held.items():
        if found != wanted:
            lacks, has = (", ".join(sorted(some)) for some in (wanted - found, found - wanted))
            raise _unknown(f"{name} lacks {lacks or 'nothing'}, and has {has or 'nothing'} besides")
    for generator in (archive._rng, optimiser._rng):
        if generator.bit_generator.state["bit_generator"] != "PCG64":
            raise _unknown("its random numbers are not those of PCG64")


def _unknown(why: str) -> UnknownPyribsError:
    version = getattr(importlib.import_module("ribs"), "__version__", "?")
    return UnknownPyribsError(
        f"pyribs {version} keeps its state in another way than 0.12 ({why}); "
        "`pip install 'ribs~=0.12.0'` helps"
    )


def _paths(optimiser: Any) -> set[str]:
    """Of all that an evolution strategy holds."""
    found = set(vars(optimiser))
    for part in found.intersection(_PARTS):
        found |= {f"{part}.{name}" for name in vars(getattr(optimiser, part))}
    return found.difference(_PARTS)


def cells_of(archive: Any) -> dict[str, np.ndarray]:
    """The map as arrays; zeros where nobody is."""
    store = archive._store
    order = np.asarray(store.occupied_list)
    padded = np.zeros(store.capacity, np.int32)
    padded[: len(order)] = order
    taken: dict[str, np.ndarray] = {
        "order": padded,
        "count": np.array(len(order), np.int32),
        "threshold_min": archive.threshold_min,
        "randomness": _generator_words(archive._rng),
    }
    for name, field in store._fields.items():
        taken[name] = np.zeros_like(field)
        taken[name][order] = field[order]
    return taken


def restore_cells(archive: Any, cells: dict[str, np.ndarray]) -> None:
    """The inverse of `cells_of`."""
    store, order = archive._store, cells["order"][: int(cells["count"])]
    store.add(order, {name: cells[name][order] for name in store._fields})
    # By this order elites are drawn.
    store._props["occupied_list"][: len(order)] = order
    _restore_generator(archive._rng, cells["randomness"])


def distributions_of(plan: Plan, emitters: list[Any]) -> dict[str, np.ndarray]:
    """What the emitters know, as arrays; their restarts are the last of the counters."""
    inside, taken = _INSIDE[plan.es], []
    for emitter in emitters:
        held = {name: operator.attrgetter(name)(emitter._opt) for name in inside.vectors}
        held |= {name: operator.attrgetter(name)(emitter._opt) for name in inside.scalars}
        counters = [operator.attrgetter(name)(emitter._opt) for name in inside.counters]
        arrays = {name: _bits(value) for name, value in held.items()}
        arrays["kinds"] = np.array([_kind(value) for value in held.values()], np.int32)
        arrays["counters"] = np.array([*counters, emitter._itrs, emitter._restarts], np.int32)
        arrays["randomness"] = _generator_words(emitter._opt._rng)
        taken.append(arrays)
    return {name: np.stack([arrays[name] for arrays in taken]) for name in taken[0]}


def restore_distribution(plan: Plan, emitter: Any, arrays: dict[str, np.ndarray]) -> None:
    """The inverse of `distributions_of`, of one emitter."""
    inside, optimiser = _INSIDE[plan.es], emitter._opt
    kinds = [_KINDS[kind] for kind in arrays["kinds"]]
    *counters, emitter._itrs, emitter._restarts = arrays["counters"].tolist()
    for name, kind in zip((*inside.vectors, *inside.scalars), kinds, strict=True):
        value = arrays[name].view(np.float64)
        _put(optimiser, name, value.astype(kind) if name in inside.vectors else kind(value[0]))
    for name, counter in zip(inside.counters, counters, strict=True):
        _put(optimiser, name, counter)
    _restore_generator(optimiser._rng, arrays["randomness"])


def drawn_of(plan: Plan, emitters: list[Any]) -> dict[str, np.ndarray]:
    """What the emitters asked for, and what they made it of."""
    return {
        name: np.stack([getattr(emitter._opt, name) for emitter in emitters])
        for name in _INSIDE[plan.es].drawn
    }


def restore_drawn(plan: Plan, emitter: Any, arrays: dict[str, np.ndarray]) -> None:
    """The inverse of `drawn_of`, of one emitter."""
    for name in _INSIDE[plan.es].drawn:
        setattr(emitter._opt, name, arrays[name])


def _put(optimiser: Any, path: str, value: Any) -> None:
    *part, name = path.split(".")
    setattr(operator.attrgetter(*part)(optimiser) if part else optimiser, name, value)


def _kind(value: Any) -> int:
    kind = value.dtype.type if isinstance(value, np.ndarray | np.generic) else float
    return _KINDS.index(kind)


def _bits(value: Any) -> np.ndarray:
    """Of its numbers as float64: the last axis is twice as long."""
    return np.ascontiguousarray(np.atleast_1d(value), np.float64).view(np.uint32)


def _generator_words(generator: np.random.Generator) -> np.ndarray:
    """The state of a generator: two numbers of 128 bits, and half a number that is left over."""
    state = generator.bit_generator.state
    words = [
        (state["state"][name] >> shift) % 2**_WORD
        for name in ("state", "inc")
        for shift in range(0, 128, _WORD)
    ]
    return np.array([*words, state["has_uint32"], state["uinteger"]], np.uint32)


def _restore_generator(generator: np.random.Generator, words: np.ndarray) -> None:
    """The inverse of `_generator_words`."""
    *both, has_uint32, uinteger = words.tolist()
    state, inc = (
        sum(word << (_WORD * place) for place, word in enumerate(half))
        for half in (both[:4], both[4:])
    )
    generator.bit_generator.state = {
        "bit_generator": "PCG64",
        "state": {"state": state, "inc": inc},
        "has_uint32": has_uint32,
        "uinteger": uinteger,
    }
