"""Several settings, several runs of each: who is better, and how sure is that?

Runs of an evolutionary search differ by luck, seldom normally, so settings are compared by ranks:
the two-sided test of Mann and Whitney (exact for few runs), Holm's correction for as many tests as
are made, and the effect size of Vargha and Delaney (2000), the chance that a run of one setting
beats a run of the other.
"""

import itertools
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.stats import mannwhitneyu


class Spread(NamedTuple):
    """The runs of one setting.

    Attributes:
        name: of the setting.
        runs: that have a champion.
        median: of their fitness.
        low: quartile below it.
        high: quartile above it.
        worst: of all.
        best: of all.
    """

    name: str
    runs: int
    median: float
    low: float
    high: float
    worst: float
    best: float


class Comparison(NamedTuple):
    """Two settings beside each other.

    Attributes:
        first: name of one.
        second: name of the other.
        wins: chance that a run of the first beats one of the second; ties count half.
        p_value: of the test that the two do not differ.
        adjusted: the same for as many tests as were made (Holm 1979).
    """

    first: str
    second: str
    wins: float
    p_value: float
    adjusted: float


def spread(name: str, fitness: Sequence[float]) -> Spread:
    """What the runs of a setting came to; NaN where none has a champion."""
    known = np.asarray(fitness, float)
    known = known[np.isfinite(known)]
    if not known.size:
        return Spread(name, 0, *(np.nan,) * 5)
    low, median, high = np.quantile(known, (0.25, 0.5, 0.75))
    worst, best = known.min(), known.max()
    return Spread(name, known.size, *(float(x) for x in (median, low, high, worst, best)))


def compare(settings: Mapping[str, Sequence[float]]) -> list[Comparison]:
    """Every setting beside every other; those with fewer than two runs are left out.

    Args:
        settings: the fitness of their runs, to be maximised, by name.
    """
    known = {name: _finite(fitness) for name, fitness in settings.items()}
    names = [name for name, fitness in known.items() if fitness.size > 1]
    pairs = list(itertools.combinations(names, 2))
    tested = [_test(known[first], known[second]) for first, second in pairs]
    adjusted = holm(np.array([p for _, p in tested]))
    return [
        Comparison(*pair, wins, p, float(q))
        for pair, (wins, p), q in zip(pairs, tested, adjusted, strict=True)
    ]


def holm(p_values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """P values for that many tests (Holm 1979): the smallest times n, the next times n - 1, ..."""
    order = np.argsort(p_values, kind="stable")
    scaled = p_values[order] * np.arange(len(p_values), 0, -1)
    adjusted = np.empty_like(p_values)
    adjusted[order] = np.minimum(np.maximum.accumulate(scaled), 1.0) if len(scaled) else scaled
    return adjusted


def _test(first: np.ndarray, second: np.ndarray) -> tuple[float, float]:
    """The chance that the first wins, and the p value."""
    found = mannwhitneyu(first, second, alternative="two-sided")
    return float(found.statistic / (first.size * second.size)), float(found.pvalue)


def _finite(values: Sequence[float]) -> np.ndarray:
    known = np.asarray(values, float)
    return known[np.isfinite(known)]
