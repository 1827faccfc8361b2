"""Timing side by side: all contenders in turn, several times, medians and pairwise ratios."""

import statistics
import time
from collections.abc import Callable
from typing import NamedTuple

# A call that takes this fraction of the intended time predicts well how long others will take.
_TELLING = 0.2


class Contender(NamedTuple):
    """A call whose time is measured.

    Attributes:
        name: name in the table.
        work: units of work (such as individual physics steps) that one call does.
        call: function that does the work and waits for its end.
    """

    name: str
    work: float
    call: Callable[[], object]


def race(contenders: list[Contender], repeats: int) -> dict[str, list[float]]:
    """Return units of work per second of every contender in every round.

    One uncounted round comes first, so that compilation and first memory accesses are left out.
    The contenders of a round run in turn, so that a change in the machine's speed affects all.
    """
    for contender in contenders:
        contender.call()
    rates: dict[str, list[float]] = {contender.name: [] for contender in contenders}
    for _ in range(repeats):
        for contender in contenders:
            rates[contender.name].append(contender.work / seconds(contender.call))
    return rates


def ratio_quartiles(
    rates: dict[str, list[float]], ours: str, peer: str
) -> tuple[float, float, float]:
    """Return the lower quartile, median and upper quartile of a ratio over the rounds.

    The ratio is our rate over the peer's in the same round.
    """
    ratios = [a / b for a, b in zip(rates[ours], rates[peer], strict=True)]
    if len(ratios) == 1:
        return ratios[0], ratios[0], ratios[0]
    low, middle, high = statistics.quantiles(ratios, n=4, method="inclusive")
    return low, middle, high


def seconds(call: Callable[[], object]) -> float:
    """Return the wall-clock time of one call, s."""
    start = time.perf_counter()
    call()
    return time.perf_counter() - start


def count_lasting(
    prepare: Callable[[int], Callable[[], object]], call_time: float, fewest: int, most: int
) -> int:
    """Return the number of steps (or other units) that take about the intended time.

    Args:
        prepare: function that returns a call of some steps. The preparation is not timed.
        call_time: intended time, s.
        fewest: least number of steps, for the first try.
        most: largest number of steps.
    """
    count = fewest
    prepare(count)()
    while True:
        taken = seconds(prepare(count))
        if count >= most or taken >= _TELLING * call_time:
            return min(max(round(count * call_time / taken), fewest), most)
        count = min(count * 8, most)
