"""Family tree: the genome, the fitness and the origin of every individual of a run.

The file ``family.bin`` has a block for each generation, so that a generation is appended to it and
a kill loses at most the last. A block is its length in bytes (8 bytes, the lowest first), then a
compressed NumPy array ``(runs, population)`` with the fields of `record_of`. Its origins are those
of the *next* generation, because both are known at the same time.
"""

import gzip
import io
import os
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from evo_cpg.evolution.strategy import Births
from evo_cpg.files import cannot_write

FAMILY_FILE = "family.bin"

# Compression beyond this level takes twice as long for a tenth of the size.
_LEVEL = 6
# Bytes of a block's length.
_HEAD = 8


def record_of(genome_bytes: int) -> np.dtype:
    """Return the type of an individual: its fitness and genome, and who is born in its place."""
    origin = [("first", np.int32), ("second", np.int32), ("kind", np.uint8)]
    return np.dtype([("fitness", np.float32), ("genome", np.uint8, (genome_bytes,)), *origin])


def extend_family(folder: Path, fitness: Float[np.ndarray, "runs n"], births: Births) -> None:
    """Append a generation to the family tree of a run folder.

    Raises:
        OutputError: the file cannot be written.
    """
    genome = np.moveaxis(np.asarray(births.genome), 1, -1)
    block = np.zeros(fitness.shape, record_of(genome.shape[-1]))
    block["fitness"], block["genome"] = fitness, genome
    for name in ("first", "second", "kind"):
        block[name] = getattr(births, name)
    packed = io.BytesIO()
    np.save(packed, block)
    path = folder / FAMILY_FILE
    try:
        with path.open("ab") as file:
            member = gzip.compress(packed.getvalue(), _LEVEL, mtime=0)
            file.write(len(member).to_bytes(_HEAD, "little") + member)
    except OSError as error:
        raise cannot_write(path, error) from None


def cut_family(folder: Path, generations: int) -> bool:
    """Keep the first generations of the family tree, and return whether it has all of them.

    A tree that lacks some is emptied, because origins are counted from generation 0.

    Raises:
        OutputError: the file cannot be changed.
    """
    path = folder / FAMILY_FILE
    ends = [end for end, _ in _members(path)]
    whole = len(ends) >= generations
    try:
        if path.is_file():
            os.truncate(path, ends[generations - 1] if generations and whole else 0)
    except OSError as error:
        raise cannot_write(path, error) from None
    return whole


def read_family(folder: Path | str) -> list[np.ndarray]:
    """Return the generations of a family tree, ``(runs, population)`` each. See `record_of`."""
    return [block for _, block in _members(Path(folder) / FAMILY_FILE)]


def _members(path: Path) -> Iterator[tuple[int, Any]]:
    """Yield the end and the array of every complete member of a file."""
    data = path.read_bytes() if path.is_file() else b""
    end = 0
    while end < len(data):
        start = end + _HEAD
        end = start + int.from_bytes(data[end:start], "little")
        try:
            packed = gzip.decompress(data[start:end])
            yield end, np.load(io.BytesIO(packed), allow_pickle=False)
        except (zlib.error, OSError, ValueError, EOFError):
            # A kill interrupted the writing of the last block.
            return


def founders(
    folder: Path | str, generation: int, run: int = 0, least: int = 1
) -> tuple[int, Int[np.ndarray, " n"]] | None:
    """Return the ancestors of every individual of a generation, through first parents.

    The ancestors live in the latest generation in which there are still ``least`` of them, and in
    generation 0 if there are more. Returns that generation, and the ancestor of each individual, or
    None without a family tree of these generations.
    """
    family = read_family(folder)[: max(generation, 1)]
    if len(family) < max(generation, 1):
        return None
    found = np.arange(family[0].shape[1])
    for number in reversed(range(generation)):
        older = family[number]["first"][run, found]
        if len(np.unique(older)) < min(least, len(np.unique(found))):
            return number + 1, found
        found = older
    return 0, found


class Ancestor(NamedTuple):
    """An individual on a line of descent.

    Attributes:
        generation: generation in which the individual was born.
        index: place of the individual in its population.
        kind: 1 for an altered copy, 2 for a cross, 3 for a graft, 0 in generation 0.
        record: fitness and genome, see `record_of`.
        second: place of the second parent in the generation before, or -1.
        other: fitness and genome of the second parent, or None.
    """

    generation: int
    index: int
    kind: int
    record: np.void
    second: int
    other: np.void | None


def line_of(folder: Path | str, generation: int, index: int, run: int = 0) -> list[Ancestor] | None:
    """Return the line of first parents that ends at an individual, the oldest first.

    An individual that survived several generations is there once, in the generation of its birth.
    Returns None without a family tree up to the generation.
    """
    family, line = [block[run] for block in read_family(folder)[: generation + 1]], []
    if len(family) <= generation:
        return None
    for born in reversed(range(1, generation + 1)):
        before, own = family[born - 1], family[born - 1][index]
        if own["kind"]:
            other = before[own["second"]] if own["second"] >= 0 else None
            origin = int(own["kind"]), family[born][index], int(own["second"]), other
            line.append(Ancestor(born, index, *origin))
        index = int(own["first"])
    return [Ancestor(0, index, 0, family[0][index], -1, None), *reversed(line)]
