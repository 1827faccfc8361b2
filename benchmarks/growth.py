"""Growth of costs with the number of bodies: a table of creatures, and exponents of a power law.

The exponent of a cost is the slope of a least-squares line: the logarithm of the cost over the
logarithm of the number of bodies. Exponents leave out creatures without native code.
"""

import statistics
from collections.abc import Callable, Iterable

import numpy as np

from benchmarks.rows import Build, Row
from evo_cpg.studies.study import Table

_MIB = 2**20

_HEAD = (
    "creature",
    "bodies",
    "n",
    "operations",
    "building, s",
    "compile, s",
    "of it IR, s",
    "of it LLVM, s",
    "memory, MiB",
    "compiler, MiB",
    "scratch, MiB",
    "us/step",
    "engine",
)

_COSTS: dict[str, Callable[[Row, Build], float | None]] = {
    "operations": lambda row, build: build.operations,
    "compile": lambda row, build: row.compile_seconds,
    "run": lambda row, build: 1 / row.rate,
}


def tables(rows: Iterable[Row]) -> list[Table]:
    """Return the tables of costs and exponents, or none if no row has a `Build`.

    Args:
        rows: rows of any cases.
    """
    found = [(row, row.build) for row in rows if row.build]
    if not found:
        return []
    cells = [_cells(row, build) for row, build in found]
    costs = Table("Creatures of many bodies:", _HEAD, cells)
    head = ("creatures", "n", "bodies", *_COSTS)
    return [costs, Table("Exponent of the number of bodies:", head, _exponents(found))]


def exponent(sizes: Iterable[float], costs: Iterable[float]) -> float:
    """Return the exponent with which a cost grows with size.

    Args:
        sizes: at least two different sizes.
        costs: positive cost of each size.
    """
    x, y = np.log(list(sizes)), np.log(list(costs))
    return statistics.linear_regression(x, y).slope


def _exponents(found: list[tuple[Row, Build]]) -> list[list[str]]:
    groups: dict[tuple[str, int], list[tuple[Row, Build]]] = {}
    for row, build in found:
        if build.native:
            groups.setdefault((build.kind, row.size), []).append((row, build))
    lines = []
    for (kind, size), members in groups.items():
        bodies = [build.bodies for _, build in members]
        if len(set(bodies)) > 1:
            cells = [_exponent(cost, members) for cost in _COSTS.values()]
            lines.append([kind, str(size), f"{min(bodies)} to {max(bodies)}", *cells])
    return lines


def _exponent(cost: Callable[[Row, Build], float | None], members: list[tuple[Row, Build]]) -> str:
    known = [(build.bodies, cost(row, build)) for row, build in members]
    # A compile time within the scatter of a run is stored as 0, which has no logarithm.
    pairs = [(size, value) for size, value in known if value]
    if len({size for size, _ in pairs}) < 2:
        return ""
    return f"{exponent(*zip(*pairs, strict=True)):.2f}"


def _cells(row: Row, build: Build) -> list[str]:
    return [
        row.part,
        str(build.bodies),
        str(row.size),
        f"{build.operations:,}" if build.operations else "",
        _number(build.building),
        _number(row.compile_seconds),
        _number(build.writing),
        _number(build.llvm),
        _mebibytes(row.memory, 0),
        _mebibytes(build.compiler, 0),
        _mebibytes(build.scratch, 1),
        f"{1e6 / row.rate:.3g}" if row.rate else "",
        "native" if build.native else "plain JAX" if row.rate else "none",
    ]


def _number(value: float | None) -> str:
    return f"{value:.1f}" if value is not None else ""


def _mebibytes(value: int | None, digits: int) -> str:
    return f"{value / _MIB:.{digits}f}" if value is not None else ""
