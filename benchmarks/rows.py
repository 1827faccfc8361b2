"""Measured rows: one row per comparison, stored as JSON."""

import dataclasses
import json
import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

# Increased when a field changes its meaning, so that incompatible files are not compared.
FORMAT = 2
SECONDS = "s"


class RowsError(Exception):
    """Error for a file without valid rows, with a message for the user."""


@dataclasses.dataclass(frozen=True)
class Build:
    """Costs of building a creature and of compiling its program.

    Attributes:
        kind: name of the creatures that differ only in their number of bodies.
        bodies: number of bodies.
        operations: operations in the native code, for one individual, or None without native code.
        building: time from the configuration to the creature and its world, s.
        writing: time from the JAX program to LLVM IR, s.
        llvm: time from LLVM IR to machine code, s.
        code: bytes of machine code.
        scratch: bytes of working memory, of the program that needs most.
        compiler: peak resident memory of the compiler's process, bytes.
        native: whether all code is native.
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
    """One measurement, with one peer or alone.

    Attributes:
        case: name on the command line.
        part: part of the case, such as "physics".
        size: number of individuals.
        rate: our rate in ``unit``, the median over the rounds, or 0 if the process failed.
        unit: a rate such as "steps/s" (more is better), or "s" (less is better).
        how: method of the measurement.
        compile_seconds: time to trace and compile, s, not part of the rate.
        temporary: bytes that XLA sets aside for intermediate results, by its own account.
        memory: peak resident memory of a process that does only this, compiling included, bytes.
        error: our error, by the case's definition (`benchmarks.accuracy`, `benchmarks.nerves`).
        flops: useful floating-point operations per second, 1/s.
        peak_share: ``flops`` over the rate of the machine's float32 matrix product.
        peer: name of the peer.
        peer_rate: rate of the peer in ``unit``, or None if the peer has none.
        peer_error: the error of the peer by the same definition.
        ratio: median over the rounds of our rate over the peer's.
        ratio_spread: lower and upper quartile of the ratio.
        note: reason why the peer or the row has no rate, or why the row runs on plain JAX. It may
            also be the number of the peer's diverged individuals.
        build: costs of making the program, if the creature's size matters.
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
        """Return the key that comparable rows of two runs share."""
        return self.case, self.part, self.size, self.peer or ""


def finite(value: float) -> float | None:
    """Return the value, or None if it is not finite, because JSON cannot hold it."""
    return float(value) if math.isfinite(value) else None


def save(path: Path, machine: dict[str, Any], rows: list[Row]) -> None:
    """Write the machine and the rows so far, with a file that is whole at any moment."""
    record = {"format": FORMAT, "machine": machine, "rows": [dataclasses.asdict(r) for r in rows]}
    partial = path.with_name(f".{path.name}.partial")
    partial.write_text(json.dumps(record, indent=1, allow_nan=False) + "\n")
    os.replace(partial, path)


def load(path: Path) -> tuple[dict[str, Any], list[Row]]:
    """Return the machine and the rows that `save` wrote.

    Raises:
        RowsError: the file cannot be read, or has other contents.
    """
    try:
        record = json.loads(path.read_text())
    except OSError as error:
        raise RowsError(f"{path} cannot be read ({error.strerror})") from None
    except ValueError:
        raise RowsError(f"{path} is no JSON file. Pass a file that `bench --json` wrote") from None
    found = record.get("format") if isinstance(record, dict) else None
    if found != FORMAT:
        raise RowsError(
            f"{path} has the format {found}, not {FORMAT}. Write a new file with `bench --json`"
        )
    try:
        return dict(record["machine"]), [_row(**row) for row in record["rows"]]
    except (KeyError, TypeError, ValueError):
        raise RowsError(f"{path} holds no rows of `bench --json`. Write a new file") from None


def _row(
    ratio_spread: Sequence[float] | None, build: dict[str, Any] | None = None, **fields: Any
) -> Row:
    """Return a row from its fields in JSON, which has no tuples and no classes."""
    spread = None
    if ratio_spread:
        low, high = ratio_spread
        spread = low, high
    return Row(**fields, ratio_spread=spread, build=Build(**build) if build else None)
