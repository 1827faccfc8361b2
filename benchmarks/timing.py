"""Timing side by side: every contender in turn, several times, medians and pairwise ratios."""

import statistics
import time
from collections.abc import Callable
from typing import NamedTuple


class Contender(NamedTuple):
    """Something to time.

    Attributes:
        name: for the table.
        work: units of work (such as individual physics steps) that one call does.
        call: does it and waits until it is done.
    """

    name: str
    work: float
    call: Callable[[], object]


def race(contenders: list[Contender], repeats: int) -> dict[str, list[float]]:
    """Units of work per second of every contender in every round.

    One uncounted round comes first, so that compiling and first touches are left out. Within a
    round the contenders run one after the other, so that a change in the machine's speed meets
    all of them.
    """
    for contender in contenders:
        contender.call()
    rates: dict[str, list[float]] = {contender.name: [] for contender in contenders}
    for _ in range(repeats):
        for contender in contenders:
            start = time.perf_counter()
            contender.call()
            rates[contender.name].append(contender.work / (time.perf_counter() - start))
    return rates


def median_ratio(rates: dict[str, list[float]], ours: str, peer: str) -> float:
    """Median over the rounds of our rate over the peer's in the same round."""
    return statistics.median(a / b for a, b in zip(rates[ours], rates[peer], strict=True))
