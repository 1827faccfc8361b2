"""Champions and checkpoints of a run, as named arrays."""

import hashlib
import json
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

TERM_PREFIX, SCALE_PREFIX = "term.", "scale."
"""Prefixes of the names of arrays with a champion's terms and scales."""

_HISTORY_PREFIX = "history."
_STATE_PREFIX = "state."


class Champion(NamedTuple):
    """Best individual of a run.

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
    """

    generation: int
    genes: np.ndarray
    records: tuple[Champion | None, ...]
    history: list[dict[str, float]]
    scales: dict[str, tuple[float, ...]]
    state: Mapping[str, np.ndarray] = MappingProxyType({})
    chosen: tuple[Champion | None, ...] = ()

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
        _numbers(arrays, TERM_PREFIX),
        _numbers(arrays, SCALE_PREFIX),
        arrays["run"].item(),
        arrays["index"].item(),
        arrays["lives"].item(),
        arrays["expected"].item() if "expected" in arrays else None,
        arrays["ended_early"].item(),
    )


def checkpoint_arrays(
    checkpoint: Checkpoint, columns: Mapping[str, np.ndarray] | None = None
) -> dict[str, Any]:
    """Return a checkpoint as named arrays.

    Args:
        checkpoint: the checkpoint.
        columns: `history_columns` of the history, if known.
    """
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
    return arrays


def read_checkpoint(arrays: Mapping[str, np.ndarray]) -> Checkpoint:
    """Read a checkpoint from `checkpoint_arrays`. A missing array raises a KeyError.

    Raises:
        ValueError: the arrays hold something else.
    """
    if arrays["genes"].ndim != 2 or not arrays["genes"].size:
        raise ValueError("it is not a checkpoint")
    columns = _below(arrays, _HISTORY_PREFIX)
    rows = len(columns["generation"]) if columns else 0
    if any(column.shape != (rows,) or not rows for column in columns.values()):
        raise ValueError("the columns of its table of generations are empty or differ in length")
    runs = int(arrays["runs"])
    records, chosen = (
        tuple(_champion_or_none(_below(arrays, f"{kind}{run}.")) for run in range(runs))
        for kind in ("champion", "chosen")
    )
    if any(one and len(one.genes) != len(arrays["genes"]) for one in (*records, *chosen)):
        raise ValueError("a champion and the population differ in their number of genes")
    return Checkpoint(
        arrays["generation"].item(),
        arrays["genes"],
        records,
        [{name: column[i].item() for name, column in columns.items()} for i in range(rows)],
        {name: tuple(values.tolist()) for name, values in _below(arrays, SCALE_PREFIX).items()},
        _below(arrays, _STATE_PREFIX),
        chosen if "chose" in arrays else (),
    )


def _champion_or_none(arrays: Mapping[str, np.ndarray]) -> Champion | None:
    return read_champion(arrays) if arrays else None


def _numbers(arrays: Mapping[str, np.ndarray], prefix: str) -> dict[str, float]:
    return {name: value.item() for name, value in _below(arrays, prefix).items()}


def _below(arrays: Mapping[str, np.ndarray], prefix: str) -> dict[str, np.ndarray]:
    return {
        name.removeprefix(prefix): value
        for name, value in arrays.items()
        if name.startswith(prefix)
    }
