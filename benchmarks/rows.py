"""What was measured: one row per comparison, kept as JSON."""

import dataclasses
import json
import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

# Raised when a field changes its meaning, so that unlike files are not compared.
FORMAT = 2
SECONDS = "s"


class RowsError(Exception):
    """A file that holds no rows; the message is for the user as it stands."""


@dataclasses.dataclass(frozen=True)
class Build:
    """What it took to make the program of one creature.

    Attributes:
        kind: creatures that differ in their number of bodies alone.
        bodies: number of them.
        operations: in the native code, for one individual; None where there is none.
        building: time from the configuration to the creature and its world, s.
        writing: time from the JAX program to LLVM IR, s.
        llvm: time from LLVM IR to machine code, s.
        code: bytes of machine code.
        scratch: bytes of memory that the machine code works in.
        compiler: peak resident memory of the compiler's process, bytes.
        native: whether all of it is native code.
    """

    kind: str
    bodies: int
    operations: int | None = None
    building: float | None = None
    writing: float | None = None
    llvm: float | None = None
    code: int | None = None
    scratch: int | None = None
    compiler: int | None = None
    native: bool = False


@dataclasses.dataclass(frozen=True)
class Row:
    """One thing measured, beside one peer or alone.

    Attributes:
        case: name on the command line.
        part: of the case, such as "physics".
        size: individuals.
        rate: of ours, in ``unit``: the median over the rounds.
        unit: "steps/s" and the like, where more is better, or "s", where less is.
        how: it was measured.
        compile_seconds: tracing and compiling, s; not part of the rate.
        temporary: bytes that XLA sets aside for intermediate results, by its own account.
        memory: peak resident memory of a process that does only this, compiling included, bytes.
        error: of ours; how it is defined depends on the case (see `benchmarks.accuracy`).
        flops: useful floating-point operations per second, 1/s.
        peak_share: of the rate of the machine's float32 matrix product.
        peer: what stands beside.
        peer_rate: in ``unit``; None where the peer gave none.
        peer_error: the error of the peer by the same definition.
        ratio: median over the rounds of our rate over the peer's.
        ratio_spread: lower and upper quartile of it.
        note: why the peer gave no rate, or why the row has none or runs on plain JAX.
        build: of a creature whose size matters.
    """

    case: str
    part: str
    size: int
    rate: float
    unit: str
    how: str
    compile_seconds: float | None = None
    temporary: int | None = None
    memory: int | None = None
    error: float | None = None
    flops: float | None = None
    peak_share: float | None = None
    peer: str | None = None
    peer_rate: float | None = None
    peer_error: float | None = None
    ratio: float | None = None
    ratio_spread: tuple[float, float] | None = None
    note: str | None = None
    build: Build | None = None

    @property
    def key(self) -> tuple[str, str, int, str]:
        """What a row of another run must share to be compared with this one."""
        return self.case, self.part, self.size, self.peer or ""


def finite(value: float) -> float | None:
    """The value, or None in place of what JSON cannot hold."""
    return float(value) if math.isfinite(value) else None


def save(path: Path, machine: dict[str, Any], rows: list[Row]) -> None:
    """Write what was measured so far, and where and when; the file is whole at any moment."""
    record = {"format": FORMAT, "machine": machine, "rows": [dataclasses.asdict(r) for r in rows]}
    partial = path.with_name(f".{path.name}.partial")
    partial.write_text(json.dumps(record, indent=1, allow_nan=False) + "\n")
    os.replace(partial, path)


def load(path: Path) -> tuple[dict[str, Any], list[Row]]:
    """What `save` wrote: the machine and the rows.

    Raises:
        RowsError: the file cannot be read, or holds something else.
    """
    try:
        record = json.loads(path.read_text())
    except OSError as error:
        raise RowsError(f"{path} cannot be read ({error.strerror})") from None
    except ValueError:
        raise RowsError(f"{path} is no JSON file; give one that `bench --json` wrote") from None
    found = record.get("format") if isinstance(record, dict) else None
    if found != FORMAT:
        raise RowsError(
            f"{path} is no benchmark of this program: its format is {found}, not {FORMAT}"
        )
    try:
        return dict(record["machine"]), [_row(**row) for row in record["rows"]]
    except (KeyError, TypeError, ValueError):
        raise RowsError(f"{path}: its rows are not those that `bench --json` writes") from None


def _row(
    ratio_spread: Sequence[float] | None, build: dict[str, Any] | None = None, **fields: Any
) -> Row:
    """Return a row from its fields in JSON, which has no tuples and no classes."""
    spread = None
    if ratio_spread:
        low, high = ratio_spread
        spread = low, high
    return Row(**fields, ratio_spread=spread, build=Build(**build) if build else None)
