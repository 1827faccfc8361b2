"""CMA-MAE of pyribs (Tjanaka et al. 2023; Fontaine and Nikolaidis 2023) as a strategy.

Like any other search it begins with the random genomes of the controller, on which yardsticks are
measured. From then on several evolution strategies, the *emitters*, each adapt a normal
distribution, first about the mean of the better half of those, and put what they draw into one map.
A cell of it has a threshold, the fitness that has to be exceeded to enter, and with each that
enters it rises a little,

    threshold <- (1 - a) threshold + a fitness,

from ``threshold_min`` on, with the learning rate ``a``. (Where none is given it is the median of
those who live through the emitters' first generation: who is worse is not worth a cell.) An emitter
ranks what it drew by how far that lies above the thresholds: as they rise where it has been, it
moves on to where they are low.
``a = 0`` optimises alone, as CMA-ES does, ``a = 1`` is CMA-ME. The settings are those of Fontaine
and Nikolaidis: the better half of a sample are parents, and an emitter begins anew at an elite of
the map when its sample has converged.

pyribs is installed with the extra ``pyribs``, and imported when a strategy is made. Its objects do
not outlive a call: what they hold is a pytree of arrays, from which they are built again in every
`Ribs.ask` and `Ribs.tell`, on the host, to the same bits as if they had lived on. As pyribs rounds
to float64 in places, those numbers are kept as their bits, two ``uint32`` each.

Its map forgets the fittest of a cell where a threshold allows a worse one, so the map that a run
shows is one of our own, `evo_cpg.evolution.map_elites.Archive`, which everybody enters.

Who diverged, has descriptors that are not finite, or is not whom the emitter asked for (a migrant)
does not enter pyribs' map and ranks below all others of his emitter. As long as nobody is on that
map, for none exceeded ``threshold_min``, there is nothing to begin anew from: then no emitter is
told, and all go on drawing where they began.

Genes are clipped to their bounds after they were drawn (pyribs itself would draw again, at 3000
genes forever); bits are as in `evo_cpg.evolution.latent`. A full covariance matrix (``cma_es``)
takes memory and time with the square and the cube of the number of genes, and is hopeless for a
brain of 3000: that is 72 MB a matrix, of which every emitter holds three.
"""

import functools
import importlib
import itertools
import operator
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, PyTree

from evo_cpg.evolution.latent import Latent
from evo_cpg.evolution.map_elites import Archive, Axis, Beginning, MapStrategy
from evo_cpg.evolution.selection import rank_order
from evo_cpg.evolution.strategy import Evaluation, descriptor_rows

# Arrays by name; of those of emitters the first axis is that of the emitters.
Arrays = dict[str, Array]


class UnknownPyribsError(Exception):
    """The installed pyribs is not one whose objects we can take apart; the message says why."""


class Told(NamedTuple):
    """What is known before a population is drawn.

    Attributes:
        archive: everybody's map.
        cells: pyribs' map.
        emitters: their distributions.
    """

    archive: Archive
    cells: Arrays
    emitters: Arrays


class Asked(NamedTuple):
    """What is known while a population is tried.

    Attributes:
        archive: everybody's map.
        cells: pyribs' map.
        emitters: their distributions.
        drawn: by them: the numbers of each individual, and what they were made of.
    """

    archive: Archive
    cells: Arrays
    emitters: Arrays
    drawn: Arrays


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


class Ribs(MapStrategy):
    """CMA-MAE.

    Attributes:
        population: individuals, shared equally by the emitters.
        gene_count: numbers in a genome.
        axes: of the map.
        binary: whether genes are bits.
        emitters: how many.
        es: the evolution strategy of each, by pyribs' name: one of `ALGORITHMS`.
        sigma: standard deviation of the first sample.
        learning_rate: of thresholds, 0 to 1.
        threshold_min: where they begin; None for the median of their first sample.
        gene_bound: largest magnitude of a gene; None of bits.
        options: of the evolution strategy's constructor, such as ``lr`` of ``openai_es``.

    Raises:
        ImportError: pyribs is not installed.
        UnknownPyribsError: it is of a version that we do not know.
        TypeError: options that the constructor does not take.
        ValueError: settings that do not go together.
    """

    population: int = eqx.field(static=True)
    gene_count: int = eqx.field(static=True)
    axes: tuple[Axis, ...] = eqx.field(static=True)
    binary: bool = eqx.field(static=True, default=False)
    emitters: int = eqx.field(static=True, default=5)
    es: str = eqx.field(static=True, default="sep_cma_es")
    sigma: float = eqx.field(static=True, default=0.5)
    learning_rate: float = eqx.field(static=True, default=0.01)
    threshold_min: float | None = eqx.field(static=True, default=None)
    gene_bound: float | None = eqx.field(static=True, default=8.0)
    options: tuple[tuple[str, float], ...] = eqx.field(static=True, default=())

    def __post_init__(self):
        if self.es not in ALGORITHMS:
            raise ValueError(f"es must be one of {', '.join(ALGORITHMS)}, got {self.es!r}")
        if self.population % self.emitters:
            raise ValueError(
                f"a population of {self.population} cannot be shared equally by {self.emitters} "
                "emitters"
            )
        if self.population < 2 * self.emitters:
            raise ValueError(
                f"each of {self.emitters} emitters needs two individuals or more, and the "
                f"population is {self.population}"
            )
        _shapes(self._plan)

    def archive(self, state: Asked) -> Archive:
        """Everybody's map."""
        return state.archive

    def init(self, key: Array, genes: Float[Array, "g n"]) -> Beginning:
        """See `Strategy.init`."""
        del key
        return Beginning(self.empty(genes), genes)

    def ask(self, key: Array, state: Told | Beginning) -> tuple[Float[Array, "g n"], Asked]:
        """What comes first; then what the emitters draw, with random numbers of their own."""
        del key
        if isinstance(state, Beginning):
            nothing = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), _shapes(self._plan))
            return state.genes, Asked(state.archive, *nothing)
        _, *wanted = _shapes(self._plan)
        asked = functools.partial(_asked, self._plan)
        emitters, drawn = _on_host(asked, tuple(wanted), state.emitters)
        genes = self._latent.genes(self._rows(drawn).T)
        return genes, Asked(state.archive, state.cells, emitters, drawn)

    def tell(
        self, key: Array, state: Asked, genes: Float[Array, "g n"], evaluation: Evaluation
    ) -> Told:
        """What is told; after the first population the emitters begin.

        They do so about the mean of its better half, in numbers.
        """
        found = descriptor_rows(evaluation, self.measured())
        numbers, better = self._latent.numbers(genes), rank_order(evaluation.fitness)
        start = numbers[:, better[: -(-self.population // 2)]].mean(1).astype(jnp.float32)
        seeds = jax.random.bits(key, (1 + self.emitters, _SEED_WORDS), jnp.uint32)
        own = (genes == self._latent.genes(self._rows(state.drawn).T)).all(0)
        counts = own & jnp.isfinite(evaluation.fitness) & jnp.isfinite(found).all(0)
        fitness = jnp.where(counts, evaluation.fitness, 0.0).astype(jnp.float32)
        measures = jnp.where(counts, found, 0.0).astype(jnp.float32).T
        cells, emitters, _ = _shapes(self._plan)
        known = state.cells, state.emitters, state.drawn
        worth = fitness, measures, counts
        told = functools.partial(_told, self._plan)
        first = state.archive.told == 0
        made = _on_host(told, (cells, emitters), first, start, seeds, *known, *worth)
        return Told(self.entered(state.archive, genes, evaluation), *made)

    def around(self, key: Array, genes: Float[Array, "g n"]) -> Float[Array, "g n"]:
        """See `Latent.around`."""
        return self._latent.around(key, genes)

    @property
    def metric_names(self) -> tuple[str, ...]:
        """See `metrics`."""
        return (*super().metric_names, "restarts")

    def metrics(self, state: Asked) -> dict[str, Float[Array, ""]]:
        """Also ``restarts``: how often emitters began anew, all together."""
        restarts = state.emitters["counters"][:, -1].sum().astype(jnp.float32)
        return {**super().metrics(state), "restarts": restarts}

    @property
    def _latent(self) -> Latent:
        return Latent(self.binary, self.sigma, self.gene_bound)

    @property
    def _plan(self) -> Plan:
        return Plan(
            self.axes,
            self.gene_count,
            self.emitters,
            self.population // self.emitters,
            self.es,
            self.sigma,
            self.learning_rate,
            self.threshold_min,
            self.options,
        )

    def _rows(self, drawn: Arrays) -> Float[Array, "n g"]:
        """The numbers of every individual."""
        return drawn["_solutions"].reshape(self.population, self.gene_count)


def _on_host(function: Any, like: PyTree, *given: PyTree) -> Any:
    """A function of NumPy arrays within a program of JAX; under `jax.vmap` one after the other."""
    return jax.pure_callback(function, like, *given, vmap_method="sequential")


def _begun(plan: Plan, start: Array, seeds: Array) -> tuple[PyTree, PyTree]:
    archive, emitters = _built(plan, start=np.asarray(start), seeds=np.asarray(seeds).tolist())
    return _cells(archive), _distributions(plan, emitters)


def _asked(plan: Plan, distributions: Arrays) -> tuple[PyTree, PyTree]:
    # Drawing takes nothing from the map, and the map is large.
    _, emitters = _built(plan)
    for number, emitter in enumerate(emitters):
        _restore_distribution(plan, emitter, _row(distributions, number))
        emitter.ask()
    return _distributions(plan, emitters), _drawn(plan, emitters)


def _told(
    plan: Plan,
    first: Array,
    start: Array,
    seeds: Array,
    cells: Arrays,
    distributions: Arrays,
    drawn: Arrays,
    fitness: Float[Array, " n"],
    measures: Float[Array, "n k"],
    counts: Bool[Array, " n"],
) -> tuple[PyTree, PyTree]:
    if first:
        return _begun(plan, start, seeds)
    rows = np.asarray(drawn["_solutions"]).reshape(-1, plan.gene_count)
    worth = {"solution": rows, "objective": np.asarray(fitness), "measures": np.asarray(measures)}
    who = np.asarray(counts)
    lowest = float(cells["threshold_min"])
    if np.isnan(lowest) and who.any():
        # Below, so that somebody exceeds it though all are alike.
        lowest = float(np.nextafter(np.median(worth["objective"][who]), -np.inf))
    archive, emitters = _built(plan, lowest)
    _restore_cells(archive, {name: np.asarray(value) for name, value in cells.items()})
    for number, emitter in enumerate(emitters):
        _restore_distribution(plan, emitter, _row(distributions, number))
        _restore_drawn(plan, emitter, _row(drawn, number))
    status, value = _entered(archive, worth, who)
    if not archive.empty:
        for number, emitter in enumerate(emitters):
            own = slice(number * plan.batch, (number + 1) * plan.batch)
            info = {"status": status[own], "value": value[own]}
            emitter.tell(**{name: array[own] for name, array in worth.items()}, add_info=info)
    return _cells(archive), _distributions(plan, emitters)


def _entered(
    archive: Any, worth: dict[str, np.ndarray], counts: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """What came of everybody on pyribs' map: whether he entered, and how far above a threshold."""
    status = np.zeros(len(counts), np.int32)
    value = np.zeros(len(counts), worth["objective"].dtype)
    if counts.any():
        info = archive.add(**{name: array[counts] for name, array in worth.items()})
        status[counts], value[counts] = info["status"], info["value"]
        # Below all others, and finite: pyribs computes with it.
        value[~counts] = np.nextafter(value[counts].min(), -np.inf)
    return status, value


def _row(arrays: Arrays, number: int) -> dict[str, np.ndarray]:
    """Those of one emitter, as pyribs would have them: contiguous, and free to be written."""
    return {name: np.array(value[number], order="C") for name, value in arrays.items()}


# From here on, all that goes by how pyribs is made inside (0.12).


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
_SEED_WORDS, _WORD = 4, 32


def _built(
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
def _shapes(plan: Plan) -> tuple[PyTree, PyTree, PyTree]:
    """Of all arrays of the map, of the emitters and of what these draw."""
    # One emitter shows what all are like.
    one = plan._replace(emitters=1)
    archive, emitters = _built(one)
    _require_known(plan, archive, emitters[0])
    drawn = jax.ShapeDtypeStruct((plan.emitters, plan.batch, plan.gene_count), np.float32)
    cells = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape, x.dtype), _cells(archive))
    distributions = jax.tree.map(
        lambda x: jax.ShapeDtypeStruct((plan.emitters, *x.shape[1:]), x.dtype),
        _distributions(one, emitters),
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


def _cells(archive: Any) -> dict[str, np.ndarray]:
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


def _restore_cells(archive: Any, cells: dict[str, np.ndarray]) -> None:
    """The inverse of `_cells`."""
    store, order = archive._store, cells["order"][: int(cells["count"])]
    store.add(order, {name: cells[name][order] for name in store._fields})
    # By this order elites are drawn.
    store._props["occupied_list"][: len(order)] = order
    _restore_generator(archive._rng, cells["randomness"])


def _distributions(plan: Plan, emitters: list[Any]) -> dict[str, np.ndarray]:
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


def _restore_distribution(plan: Plan, emitter: Any, arrays: dict[str, np.ndarray]) -> None:
    """The inverse of `_distributions`, of one emitter."""
    inside, optimiser = _INSIDE[plan.es], emitter._opt
    kinds = [_KINDS[kind] for kind in arrays["kinds"]]
    *counters, emitter._itrs, emitter._restarts = arrays["counters"].tolist()
    for name, kind in zip((*inside.vectors, *inside.scalars), kinds, strict=True):
        value = arrays[name].view(np.float64)
        _put(optimiser, name, value.astype(kind) if name in inside.vectors else kind(value[0]))
    for name, counter in zip(inside.counters, counters, strict=True):
        _put(optimiser, name, counter)
    _restore_generator(optimiser._rng, arrays["randomness"])


def _drawn(plan: Plan, emitters: list[Any]) -> dict[str, np.ndarray]:
    """What the emitters asked for, and what they made it of."""
    return {
        name: np.stack([getattr(emitter._opt, name) for emitter in emitters])
        for name in _INSIDE[plan.es].drawn
    }


def _restore_drawn(plan: Plan, emitter: Any, arrays: dict[str, np.ndarray]) -> None:
    """The inverse of `_drawn`, of one emitter."""
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
