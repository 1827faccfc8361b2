"""The champions that a run had on its way: a genome for every generation in which one was found.

At most `KEPT` of each run are kept, so that the file cannot grow without bound. Where there would
be more, one is given up that is no champion of a landmark (generation 0, 1, 2, 5, 10, 20, 50, ...)
and whose neighbours lie closest together, counted in ratios of generations. So the champions of all
landmarks stay exact however long a run lasts, and its beginning stays as fine as its end. The first
and the newest always stay. What is given up depends on nothing but the generations in which
champions were found: a run that is killed and resumed comes to the same lineage.
"""

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from evo_cpg.training.checkpoint import SCALE_PREFIX, TERM_PREFIX, Champion

# Of each run. Landmarks take three in a factor of ten: 19 of a million generations.
KEPT = 32

_OF_ALL = ("fitness", "generation", "run", "index")


def extended(lineage: Sequence[Champion], found: Iterable[Champion]) -> list[Champion]:
    """A lineage with new champions, run by run, each in the order of generations.

    Args:
        lineage: so far.
        found: champions; one of the same run and generation is replaced.
    """
    known = {(each.run, each.generation): each for each in lineage}
    known |= {(each.run, each.generation): each for each in found}
    ordered = [known[place] for place in sorted(known)]
    return [
        each
        for _, own in itertools.groupby(ordered, lambda champion: champion.run)
        for each in _thinned(list(own))
    ]


def until(
    lineage: Sequence[Champion], champions: Sequence[Champion | None], generation: int
) -> list[Champion]:
    """What a lineage was when so many generations were done.

    Args:
        lineage: as it was written, perhaps a generation ahead of the checkpoint, or none at all.
        champions: of the checkpoint, of every run.
        generation: that many are done.
    """
    done = [each for each in lineage if each.generation < generation]
    return extended(done, [each for each in champions if each is not None])


def champion_at(lineage: Sequence[Champion], generation: int) -> Champion | None:
    """Who was champion when a generation was done; None before there was one.

    Args:
        lineage: of one run.
        generation: counted from 0.
    """
    found = [each for each in lineage if each.generation <= generation]
    return found[-1] if found else None


def representatives(lineage: Sequence[Champion], count: int) -> list[Champion]:
    """The first champion, the last, and others in between, evenly in ratios of generations.

    Args:
        lineage: of one run.
        count: how many at most.
    """
    if count < 2 or len(lineage) <= count:
        return list(lineage)[-count:]
    age = [_age(each.generation) for each in lineage]
    chosen = {0, len(lineage) - 1}
    for place in range(1, count - 1):
        target = age[0] + (age[-1] - age[0]) * place / (count - 1)
        rest = [i for i in range(len(lineage)) if i not in chosen]
        chosen.add(min(rest, key=lambda i: abs(age[i] - target)))
    return [lineage[i] for i in sorted(chosen)]


def lineage_arrays(lineage: Sequence[Champion]) -> dict[str, Any]:
    """A lineage, of one champion or more, as named arrays with a row for each."""
    arrays: dict[str, Any] = {"genes": np.stack([each.genes for each in lineage])}
    arrays |= {name: np.array([getattr(each, name) for each in lineage]) for name in _OF_ALL}
    for prefix, rows in (
        (TERM_PREFIX, [each.terms for each in lineage]),
        (SCALE_PREFIX, [each.scales for each in lineage]),
    ):
        # A configuration may have been given other measures on the way.
        names = dict.fromkeys(name for one in rows for name in one)
        arrays |= {
            prefix + name: np.array([one.get(name, math.nan) for one in rows]) for name in names
        }
    return arrays


def read_lineage(arrays: Mapping[str, np.ndarray]) -> list[Champion]:
    """The inverse of `lineage_arrays`.

    Raises:
        KeyError: an array is missing.
        ValueError: they have different numbers of rows, or are none of ours.
    """
    genes = arrays["genes"]
    columns = {name: arrays[name].tolist() for name in _OF_ALL}
    terms, scales = (
        {
            name.removeprefix(prefix): values.tolist()
            for name, values in arrays.items()
            if name.startswith(prefix)
        }
        for prefix in (TERM_PREFIX, SCALE_PREFIX)
    )
    every = [*columns.values(), *terms.values(), *scales.values()]
    rows = genes.ndim == 2 and all(isinstance(x, list) and len(x) == len(genes) for x in every)
    counted = all(arrays[name].dtype.kind in "iu" for name in _OF_ALL[1:])
    if not rows or not counted:
        raise ValueError("its arrays are not those of champions")
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
    """Generations 0, 1, 2, 5, 10, 20, 50, ... up to a last one."""
    powers = range(len(str(max(last, 1))))
    round_ones = (step * 10**power for power in powers for step in (1, 2, 5))
    return [0, *(each for each in round_ones if each <= last)]


def _thinned(own: list[Champion]) -> list[Champion]:
    """At most `KEPT` champions of one run."""
    while len(own) > KEPT:
        least = _least([each.generation for each in own])
        own = own[:least] + own[least + 1 :]
    return own


def _least(found: Sequence[int]) -> int:
    """Which of the champions found in these generations is missed least."""
    marks = landmarks(found[-1])
    # Champion from the generation in which it was found to that before the next one's.
    free = [
        i
        for i in range(1, len(found) - 1)
        if not any(found[i] <= mark < found[i + 1] for mark in marks)
    ]
    return min(free, key=lambda i: _age(found[i + 1]) - _age(found[i - 1]))


def _age(generation: int) -> float:
    """Generations on a scale of ratios."""
    return math.log1p(generation)
