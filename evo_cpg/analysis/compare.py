"""Statistical comparison of settings with several runs each.

Results of an evolutionary search are random and seldom normally distributed, so ranks are compared.
The test is the two-sided one of Mann and Whitney (exact for few runs), with Holm's correction for
the number of tests. The effect size of Vargha and Delaney (2000) is the chance that a run of one
setting beats a run of the other.
"""

import itertools
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.stats import mannwhitneyu


class Spread(NamedTuple):
    """Distribution of the runs of one setting.

    Attributes:
        name: name of the setting.
        runs: number of runs with a champion.
        median: median of the runs' fitness.
        low: lower quartile of the fitness.
        high: upper quartile of the fitness.
        worst: smallest fitness of a run.
        best: largest fitness of a run.
    """

    name: str
    runs: int
    median: float
    low: float
    high: float
    worst: float
    best: float


class Comparison(NamedTuple):
    """Comparison of two settings.

    Attributes:
        first: name of the first setting.
        second: name of the second setting.
        wins: chance that a run of the first beats a run of the second. Ties count half.
        p_value: p value of the hypothesis that the two do not differ.
        adjusted: p value corrected for the number of tests (Holm 1979).
    """

    first: str
    second: str
    wins: float
    p_value: float
    adjusted: float


def spread(name: str, fitness: Sequence[float]) -> Spread:
    """Return the distribution of a setting's runs; NaN if none has a champion."""
    known = np.asarray(fitness, float)
    known = known[np.isfinite(known)]
    if not known.size:
        return Spread(name, 0, *(np.nan,) * 5)
    low, median, high = np.quantile(known, (0.25, 0.5, 0.75))
    worst, best = known.min(), known.max()
    return Spread(name, known.size, *(float(x) for x in (median, low, high, worst, best)))


def compare(settings: Mapping[str, Sequence[float]]) -> list[Comparison]:
    """Compare all pairs of settings with at least two runs.

    Args:
        settings: fitness of the runs, to be maximised, by name of the setting.
    """
    every = {name: np.asarray(fitness, float) for name, fitness in settings.items()}
    known = {name: values[np.isfinite(values)] for name, values in every.items()}
    names = [name for name, fitness in known.items() if fitness.size > 1]
    pairs = list(itertools.combinations(names, 2))
    tested = [mannwhitneyu(known[a], known[b], alternative="two-sided") for a, b in pairs]
    adjusted = holm(np.array([found.pvalue for found in tested]))
    chances = [
        x.statistic / (known[a].size * known[b].size)
        for x, (a, b) in zip(tested, pairs, strict=True)
    ]
    return [
        Comparison(*pair, float(wins), float(found.pvalue), float(q))
        for pair, wins, found, q in zip(pairs, chances, tested, adjusted, strict=True)
    ]


def holm(p_values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Return corrected p values (Holm 1979): the smallest times n, the next times n - 1, ..."""
    order = np.argsort(p_values, kind="stable")
    scaled = p_values[order] * np.arange(len(p_values), 0, -1)
    adjusted = np.empty_like(p_values)
    adjusted[order] = np.minimum(np.maximum.accumulate(scaled), 1.0) if len(scaled) else scaled
    return adjusted
