"""What a run must remember, as named arrays: the champion and the checkpoint."""

import hashlib
import json
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

_HISTORY_PREFIX = "history."
_CHAMPION_PREFIX = "champion."
_TERM_PREFIX = "term."
_SCALE_PREFIX = "scale."


class Champion(NamedTuple):
    """The best individual ever evaluated.

    Attributes:
        genes: its genome.
        fitness: as evaluated in training.
        generation: in which it was found.
        terms: the task's terms.
        scales: the task's yardsticks.
    """

    genes: np.ndarray
    fitness: float
    generation: int
    terms: dict[str, float]
    scales: dict[str, float]


class Checkpoint(NamedTuple):
    """All that a run needs to go on exactly.

    Attributes:
        generation: number of generations done.
        genes: the population of the next generation.
        champion: the best individual so far.
        history: rows of metrics.csv.
        scales: the task's yardsticks; empty before the first generation.
    """

    generation: int
    genes: np.ndarray
    champion: Champion | None
    history: list[dict[str, float]]
    scales: dict[str, float]


def genes_digest(genes: np.ndarray) -> str:
    """SHA-256 of a genome."""
    return hashlib.sha256(np.ascontiguousarray(genes).tobytes()).hexdigest()


def outcome_digest(champion: Champion) -> str:
    """SHA-256 of what is recorded about a champion beside its genome."""
    told = (champion.fitness, champion.generation, champion.terms, champion.scales)
    return hashlib.sha256(json.dumps(told, sort_keys=True).encode()).hexdigest()


def history_columns(history: list[dict[str, float]]) -> list[tuple[str, np.ndarray]]:
    """Columns of metrics.csv, by name."""
    if not history:
        return []
    return [(name, np.array([row[name] for row in history])) for name in history[0]]


def champion_arrays(champion: Champion) -> dict[str, Any]:
    """A champion as named arrays, with the digests that `verify` compares."""
    return {
        "genes": champion.genes,
        "genes_sha256": genes_digest(champion.genes),
        "outcome_sha256": outcome_digest(champion),
        "fitness": champion.fitness,
        "generation": champion.generation,
        **{_TERM_PREFIX + name: value for name, value in champion.terms.items()},
        **{_SCALE_PREFIX + name: value for name, value in champion.scales.items()},
    }


def read_champion(arrays: Mapping[str, np.ndarray]) -> Champion:
    """The inverse of `champion_arrays`; a missing array is a KeyError."""
    return Champion(
        arrays["genes"],
        arrays["fitness"].item(),
        arrays["generation"].item(),
        _numbers(arrays, _TERM_PREFIX),
        _numbers(arrays, _SCALE_PREFIX),
    )


def checkpoint_arrays(checkpoint: Checkpoint) -> dict[str, Any]:
    """A checkpoint as named arrays."""
    arrays = {"generation": checkpoint.generation, "genes": checkpoint.genes}
    history = history_columns(checkpoint.history)
    arrays |= {_HISTORY_PREFIX + name: column for name, column in history}
    arrays |= {_SCALE_PREFIX + name: value for name, value in checkpoint.scales.items()}
    if checkpoint.champion is not None:
        champion = champion_arrays(checkpoint.champion)
        arrays |= {_CHAMPION_PREFIX + name: value for name, value in champion.items()}
    return arrays


def read_checkpoint(arrays: Mapping[str, np.ndarray]) -> Checkpoint:
    """The inverse of `checkpoint_arrays`; a missing array is a KeyError."""
    columns = _below(arrays, _HISTORY_PREFIX)
    rows = len(columns["generation"]) if columns else 0
    champion = _below(arrays, _CHAMPION_PREFIX)
    return Checkpoint(
        arrays["generation"].item(),
        arrays["genes"],
        read_champion(champion) if champion else None,
        [{name: column[i].item() for name, column in columns.items()} for i in range(rows)],
        _numbers(arrays, _SCALE_PREFIX),
    )


def _numbers(arrays: Mapping[str, np.ndarray], prefix: str) -> dict[str, float]:
    return {name: value.item() for name, value in _below(arrays, prefix).items()}


def _below(arrays: Mapping[str, np.ndarray], prefix: str) -> dict[str, np.ndarray]:
    return {
        name.removeprefix(prefix): value
        for name, value in arrays.items()
        if name.startswith(prefix)
    }
