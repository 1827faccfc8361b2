"""Lineage: earlier champions of a run, a genome for every generation that found one.

At most `KEPT` champions of each run are kept, to limit the file. The champions of landmarks
(generation 0, 1, 2, 5, 10, 20, 50, ...) always stay, and so do the first and the newest. Among the
others, the champion whose neighbours are closest together, in ratios of generations, is dropped. So
the resolution stays even. The choice depends only on the generations in which champions were found.
So a resumed run has the lineage of an uninterrupted run.
"""

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from evo_cpg.training.checkpoint import SCALE_PREFIX, TERM_PREFIX, Champion, below

# Limit for each run. Landmarks take three per factor of ten: 19 for a million generations.
KEPT = 32

_OF_ALL = ("fitness", "generation", "run", "index")


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


def lineage_arrays(lineage: Sequence[Champion]) -> dict[str, Any]:
    """Return a lineage of at least one champion as named arrays, with a row for each champion."""
    arrays: dict[str, Any] = {"genes": np.stack([each.genes for each in lineage])}
    arrays |= {name: np.array([getattr(each, name) for each in lineage]) for name in _OF_ALL}
    for prefix, rows in (
        (TERM_PREFIX, [each.terms for each in lineage]),
        (SCALE_PREFIX, [each.scales for each in lineage]),
    ):
        # Champions of one run may have different terms: the configuration's measures may have
        # changed.
        names = dict.fromkeys(name for one in rows for name in one)
        arrays |= {
            prefix + name: np.array([one.get(name, math.nan) for one in rows]) for name in names
        }
    return arrays


def read_lineage(arrays: Mapping[str, np.ndarray]) -> list[Champion]:
    """Read a lineage from `lineage_arrays`.

    Raises:
        KeyError: an array is missing.
        ValueError: the arrays have different numbers of rows, or hold something else.
    """
    genes = arrays["genes"]
    columns = {name: arrays[name].tolist() for name in _OF_ALL}
    terms, scales = (
        {name: values.tolist() for name, values in below(arrays, prefix).items()}
        for prefix in (TERM_PREFIX, SCALE_PREFIX)
    )
    every = [*columns.values(), *terms.values(), *scales.values()]
    rows = genes.ndim == 2 and all(isinstance(x, list) and len(x) == len(genes) for x in every)
    counted = all(arrays[name].dtype.kind in "iu" for name in _OF_ALL[1:])
    if not rows or not counted:
        raise ValueError("its arrays do not describe champions")
    return [
        Champion(
            genes[i],
            columns["fitness"][i],
            columns["generation"][i],
            {name: values[i] for name, values in terms.items()},
            {name: values[i] for name, values in scales.items()},
            columns["run"][i],
            columns["index"][i],
        )
        for i in range(len(genes))
    ]


def landmarks(last: int) -> list[int]:
    """Return the generations 0, 1, 2, 5, 10, 20, 50, ... up to a last one."""
    powers = range(len(str(max(last, 1))))
    round_ones = (step * 10**power for power in powers for step in (1, 2, 5))
    return [0, *(each for each in round_ones if each <= last)]
