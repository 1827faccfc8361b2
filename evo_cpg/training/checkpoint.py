"""Champions and checkpoints of a run, as named arrays in .npz files.

Files hold NumPy's own number types directly. They hold the bits of other types, such as bfloat16,
and the raw data of random keys. The type is then part of the name, as in ``best.bfloat16``.

A file from elsewhere may be damaged or malicious. It must neither run code nor fill all memory. So
`read_arrays` refuses pickles, and arrays that claim to be larger than their part of the file.
"""

import hashlib
import json
import math
import os
import struct
import zipfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PyTree

from evo_cpg.errors import UserError

TERM_PREFIX, SCALE_PREFIX = "term.", "scale."
"""Prefixes of the names of arrays with a champion's terms and scales."""

_HISTORY_PREFIX = "history."
_STATE_PREFIX = "state."


class Champion(NamedTuple):
    """An evaluated individual, such as the best of a run.

    Attributes:
        genes: genome of the individual.
        fitness: fitness in training.
        generation: generation in which the individual was found.
        terms: task's terms, by name.
        scales: task's scales, by name.
        run: number of the run.
        index: place in the run's population. Run, generation and index select the random numbers
            of the trials.
        lives: number of re-evaluations with fresh noise (`evo_cpg.training.reevaluation`).
        expected: mean fitness of re-evaluations that did not end early, or None without any.
        ended_early: number of re-evaluations that ended by a broken rule or by divergence.
    """

    genes: np.ndarray
    fitness: float
    generation: int
    terms: dict[str, float]
    scales: dict[str, float]
    run: int = 0
    index: int = 0
    lives: int = 0
    expected: float | None = None
    ended_early: int = 0

    @property
    def worth(self) -> float:
        """Best estimate of the fitness: the mean with fresh noise if re-evaluated.

        -inf if all re-evaluations ended early.
        """
        if self.expected is not None:
            return self.expected
        return -np.inf if self.lives else self.fitness


class Checkpoint(NamedTuple):
    """State from which a run continues exactly.

    Attributes:
        generation: number of finished generations.
        genes: populations of the next generation, run by run.
        records: best individual that each run has evaluated so far.
        history: rows of metrics.csv.
        scales: task's scales in each run, all 1 before the first generation.
        state: strategy's state, from `state_arrays`.
        chosen: best individual of each run with fresh noise. Empty without noise, and before all
            generations are done.
        inherited: genes that the offspring of the next generation inherit, or None if they are
            ``genes``.
    """

    generation: int
    genes: np.ndarray
    records: tuple[Champion | None, ...]
    history: list[dict[str, float]]
    scales: dict[str, tuple[float, ...]]
    state: Mapping[str, np.ndarray] = MappingProxyType({})
    chosen: tuple[Champion | None, ...] = ()
    inherited: np.ndarray | None = None

    @property
    def champions(self) -> tuple[Champion | None, ...]:
        """Best individual of each run so far."""
        return self.chosen or self.records

    @property
    def champion(self) -> Champion | None:
        """Best individual of all runs so far: fewest re-evaluations ended early, then fitness."""
        living = [champion for champion in self.champions if champion is not None]
        return max(living, key=lambda one: (-one.ended_early, one.worth), default=None)


def genes_digest(genes: np.ndarray) -> str:
    """Return the SHA-256 of a genome."""
    return hashlib.sha256(np.ascontiguousarray(genes).tobytes()).hexdigest()


def outcome_digest(champion: Champion) -> str:
    """Return the SHA-256 of a champion's fitness, generation, terms and scales."""
    content = (champion.fitness, champion.generation, champion.terms, champion.scales)
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def history_columns(
    history: list[dict[str, float]], known: Mapping[str, np.ndarray] | None = None
) -> dict[str, np.ndarray]:
    """Return the columns of metrics.csv by name.

    Args:
        history: rows of metrics.csv.
        known: columns of the first rows, to be extended. Converting 28,000 rows again takes 0.1 s,
            as long as a generation.
    """
    if not history:
        return {}
    if not known:
        return {name: np.array([row[name] for row in history]) for name in history[0]}
    more = history[len(next(iter(known.values()))) :]
    return {
        name: np.concatenate([column, np.array([row[name] for row in more])]) if more else column
        for name, column in known.items()
    }


def champion_arrays(champion: Champion) -> dict[str, Any]:
    """Return a champion as named arrays, with the digests that `verify` compares."""
    content = {} if champion.expected is None else {"expected": champion.expected}
    return {
        "genes": champion.genes,
        "genes_sha256": genes_digest(champion.genes),
        "outcome_sha256": outcome_digest(champion),
        "fitness": champion.fitness,
        "generation": champion.generation,
        "run": champion.run,
        "index": champion.index,
        "lives": champion.lives,
        "ended_early": champion.ended_early,
        **content,
        **{TERM_PREFIX + name: value for name, value in champion.terms.items()},
        **{SCALE_PREFIX + name: value for name, value in champion.scales.items()},
    }


def read_champion(arrays: Mapping[str, np.ndarray]) -> Champion:
    """Read a champion from `champion_arrays`. A missing array raises a KeyError.

    Raises:
        ValueError: the arrays hold something else.
    """
    if arrays["genes"].ndim != 1 or not arrays["genes"].size:
        raise ValueError("it holds no genome")
    return Champion(
        arrays["genes"],
        arrays["fitness"].item(),
        arrays["generation"].item(),
        {name: value.item() for name, value in below(arrays, TERM_PREFIX).items()},
        {name: value.item() for name, value in below(arrays, SCALE_PREFIX).items()},
        arrays["run"].item(),
        arrays["index"].item(),
        arrays["lives"].item(),
        arrays["expected"].item() if "expected" in arrays else None,
        arrays["ended_early"].item(),
    )


def checkpoint_arrays(
    checkpoint: Checkpoint, columns: Mapping[str, np.ndarray] | None = None
) -> dict[str, Any]:
    """Return a checkpoint as named arrays, given the `history_columns` if they are known."""
    if columns is None:
        columns = history_columns(checkpoint.history)
    arrays: dict[str, Any] = {
        "generation": checkpoint.generation,
        "genes": checkpoint.genes,
        "runs": len(checkpoint.records),
    }
    arrays |= {_HISTORY_PREFIX + name: column for name, column in columns.items()}
    arrays |= {SCALE_PREFIX + name: values for name, values in checkpoint.scales.items()}
    arrays |= {_STATE_PREFIX + name: values for name, values in checkpoint.state.items()}
    for kind, champions in (("champion", checkpoint.records), ("chosen", checkpoint.chosen)):
        for run, champion in enumerate(champions):
            if champion is not None:
                prefix = f"{kind}{run}."
                content = champion_arrays(champion)
                arrays |= {prefix + name: value for name, value in content.items()}
    if checkpoint.chosen:
        arrays["chose"] = True
    if checkpoint.inherited is not None:
        arrays["inherited"] = checkpoint.inherited
    return arrays


def read_checkpoint(arrays: Mapping[str, np.ndarray]) -> Checkpoint:
    """Read a checkpoint from `checkpoint_arrays`. A missing array raises a KeyError.

    Raises:
        ValueError: the arrays hold something else.
    """
    if arrays["genes"].ndim != 2 or not arrays["genes"].size:
        raise ValueError("it is not a checkpoint")
    columns = below(arrays, _HISTORY_PREFIX)
    rows = len(columns["generation"]) if columns else 0
    if any(column.shape != (rows,) or not rows for column in columns.values()):
        raise ValueError("the columns of its table of generations are empty or differ in length")
    runs = int(arrays["runs"])
    records, chosen = (
        tuple(
            read_champion(own) if (own := below(arrays, f"{kind}{run}.")) else None
            for run in range(runs)
        )
        for kind in ("champion", "chosen")
    )
    if any(one and len(one.genes) != len(arrays["genes"]) for one in (*records, *chosen)):
        raise ValueError("a champion and the population differ in their number of genes")
    return Checkpoint(
        arrays["generation"].item(),
        arrays["genes"],
        records,
        [{name: column[i].item() for name, column in columns.items()} for i in range(rows)],
        {name: tuple(values.tolist()) for name, values in below(arrays, SCALE_PREFIX).items()},
        below(arrays, _STATE_PREFIX),
        chosen if "chose" in arrays else (),
        arrays.get("inherited"),
    )


def below(arrays: Mapping[str, np.ndarray], prefix: str) -> dict[str, np.ndarray]:
    """Return the arrays whose names begin with a prefix, by the rest of their names."""
    return {
        name.removeprefix(prefix): value
        for name, value in arrays.items()
        if name.startswith(prefix)
    }


class StrategyError(UserError):
    """Error of a strategy that breaks its contract. The message is for the user."""


def state_arrays(state: PyTree) -> dict[str, np.ndarray]:
    """Return the arrays of a state as NumPy arrays. Names are paths, such as ``archive.genes``.

    If two arrays have the same path, the later name ends with an apostrophe.
    """
    arrays = {}
    leaves, _ = jax.tree.flatten_with_path(jax.device_get(state))
    for name, leaf in _named(leaves).items():
        stored = _stored_type(leaf)
        if stored is None:
            arrays[name] = np.asarray(jax.random.key_data(leaf))
        else:
            arrays[name] = np.asarray(leaf).view(stored)
    return arrays


def state_from(arrays: Mapping[str, np.ndarray], like: PyTree) -> PyTree:
    """Return the state that `state_arrays` converted to arrays.

    Args:
        arrays: arrays by name.
        like: state of equal structure. Only its shapes and types are used.

    Raises:
        StrategyError: the arrays come from another strategy or from other settings.
    """
    leaves, structure = jax.tree.flatten_with_path(like)
    named, expected, restored = _named(leaves), {}, []
    for name, leaf in named.items():
        stored = _stored_type(leaf)
        if stored is None:
            expected[name] = jax.eval_shape(jax.random.key_data, leaf)
        else:
            expected[name] = jax.ShapeDtypeStruct(leaf.shape, stored)
    shapes, needed = (
        {name: (leaf.shape, np.dtype(leaf.dtype)) for name, leaf in given.items()}
        for given in (arrays, expected)
    )
    if shapes != needed:
        found, described = (
            ", ".join(f"{name} {shape}" for name, (shape, _) in given.items()) or "nothing"
            for given in (shapes, needed)
        )
        raise StrategyError(
            f"the checkpoint holds the state of another strategy ({found}). This strategy needs "
            f"{described}. Was the section `evolution` changed?"
        )
    for name, leaf in named.items():
        if _stored_type(leaf) is None:
            made = []
            jax.eval_shape(lambda key, made=made: made.append(jax.random.key_impl(key)), leaf)
            restored.append(jax.random.wrap_key_data(jnp.asarray(arrays[name]), impl=made[0]))
        else:
            restored.append(arrays[name].view(leaf.dtype))
    return jax.tree.unflatten(structure, restored)


def _stored_type(leaf: Any) -> np.dtype | None:
    """Return the type under which files hold a leaf, or None for random keys.

    Files would lose a type that is not NumPy's own, so they hold its bits as integers.
    """
    if jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key):
        return None
    own = np.dtype(leaf.dtype)
    return np.dtype(f"u{own.itemsize}") if own.isbuiltin == 2 else own


def _named(leaves: Iterable[tuple[tuple, Any]]) -> dict[str, Any]:
    named: dict[str, Any] = {}
    for path, leaf in leaves:
        if not hasattr(leaf, "dtype"):
            leaf = np.asarray(leaf)
        name = jax.tree_util.keystr(path, simple=True, separator=".") or "value"
        stored = _stored_type(leaf)
        if stored is None or stored != leaf.dtype:
            name = f"{name}.{leaf.dtype}"
        while name in named:
            name += "'"
        named[name] = leaf
    return named


DAMAGED = (
    EOFError,
    KeyError,
    NotImplementedError,
    OSError,
    RuntimeError,
    TypeError,
    ValueError,
    struct.error,
    zipfile.BadZipFile,
)
"""Errors that were observed when truncated or overwritten .npz files were read."""

# Last record of a zip archive without a comment: signature, two disk numbers, number of entries (on
# this disk and in all), size and offset of the central directory, length of the comment.
_END = struct.Struct("<4s4H2LH")


def read_arrays(path: Path) -> dict[str, np.ndarray]:
    """Return the arrays of a file by name. Any error of `DAMAGED` means a damaged file.

    The file must be uncompressed and hold all entries and bytes that it lists, because a malicious
    file could otherwise fill all memory.
    """
    # Given a path, np.load would leave a damaged file open.
    with path.open("rb") as file:
        with zipfile.ZipFile(file) as archive:
            # A flipped byte may let one entry swallow later ones. The module zipfile does not
            # notice.
            file.seek(-_END.size, os.SEEK_END)
            mark, *_, entries, _, _, _ = _END.unpack(file.read(_END.size))
            if mark != b"PK\5\6" or entries != len(archive.infolist()):
                raise ValueError("the list of its arrays is incomplete")
            for member in archive.infolist():
                name = member.filename
                # The package writes uncompressed files.
                if member.compress_type != zipfile.ZIP_STORED:
                    raise ValueError(f"{name} is compressed and may need more than the file holds")
                with archive.open(member) as array:
                    if np.lib.format.read_magic(array) == (1, 0):
                        shape, _, kind = np.lib.format.read_array_header_1_0(array)
                    else:
                        shape, _, kind = np.lib.format.read_array_header_2_0(array)
                if math.prod(shape) * kind.itemsize > member.file_size:
                    raise ValueError(f"{name} declares more than the file holds")
        file.seek(0)
        with np.load(file, allow_pickle=False) as arrays:
            return dict(arrays)
