"""Lineage: earlier champions of a run, a genome for every generation that found one.

At most `KEPT` champions of each run are kept, to limit the file. The champions of landmarks
(generation 0, 1, 2, 5, 10, 20, 50, ...) always stay, and so do the first and the newest. Among the
others, the champion whose neighbours are closest together, in ratios of generations, is dropped. So
the resolution stays even. The choice depends only on the generations in which champions were found.
So a resumed run has the lineage of an uninterrupted run.
"""

import itertools
import math
from collections.abc import Iterable, Sequence

from evo_cpg.training.checkpoint import Champion

# Limit for each run. Landmarks take three per factor of ten: 19 for a million generations.
KEPT = 32


def extended(lineage: Sequence[Champion], found: Iterable[Champion]) -> list[Champion]:
    """Return a lineage with new champions, run by run, in the order of generations.

    New champions replace champions of equal run and generation.
    """
    known = {(each.run, each.generation): each for each in lineage}
    known |= {(each.run, each.generation): each for each in found}
    ordered = [known[place] for place in sorted(known)]
    kept: list[Champion] = []
    for _, group in itertools.groupby(ordered, lambda champion: champion.run):
        own = list(group)
        while len(own) > KEPT:
            born = [each.generation for each in own]
            marks = landmarks(born[-1])
            # Each champion lasts until the generation before the next champion's. The first, the
            # newest and all that last over a landmark are kept.
            free = [
                i
                for i in range(1, len(own) - 1)
                if not any(born[i] <= mark < born[i + 1] for mark in marks)
            ]
            del own[min(free, key=lambda i: math.log1p(born[i + 1]) - math.log1p(born[i - 1]))]
        kept += own
    return kept


def champion_at(lineage: Sequence[Champion], generation: int) -> Champion | None:
    """Return the champion of one run after a generation, or None before the first champion."""
    found = [each for each in lineage if each.generation <= generation]
    return found[-1] if found else None


def representatives(lineage: Sequence[Champion], count: int) -> list[Champion]:
    """Return at most ``count`` champions of one run: the first, the last, and others in between.

    They are evenly spaced in ratios of generations.
    """
    if count < 2 or len(lineage) <= count:
        return list(lineage)[-count:]
    # On a logarithmic scale.
    age = [math.log1p(each.generation) for each in lineage]
    chosen = {0, len(lineage) - 1}
    for place in range(1, count - 1):
        target = age[0] + (age[-1] - age[0]) * place / (count - 1)
        rest = [i for i in range(len(lineage)) if i not in chosen]
        chosen.add(min(rest, key=lambda i: abs(age[i] - target)))
    return [lineage[i] for i in sorted(chosen)]


def landmarks(last: int) -> list[int]:
    """Return the generations 0, 1, 2, 5, 10, 20, 50, ... up to a last one."""
    powers = range(len(str(max(last, 1))))
    round_ones = (step * 10**power for power in powers for step in (1, 2, 5))
    return [0, *(each for each in round_ones if each <= last)]
