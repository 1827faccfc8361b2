"""Estimates of compile times, from earlier compile times on this machine.

The times are kept in the folder of the compiled programs. For an animal that was compiled before,
the estimate is its earlier time without LLVM, because its native code is kept. For another animal,
the estimate is its number of operations (`evo_cpg.simulation.operations`) times the measured time
per operation. There is no estimate before the first measurement.
"""

import contextlib
import json
from typing import Annotated

from pydantic import Field, FiniteFloat
from typing_extensions import TypedDict  # pydantic takes no other before Python 3.12

from evo_cpg.files import read_json, write_text
from evo_cpg.fusion.backend import machine
from evo_cpg.fusion.stopwatch import Spent
from evo_cpg.training.compile_cache import compiled_folder

_FILE = "compile-times.json"

# Weight of all earlier animals, relative to the newest, in the time per operation.
_MEMORY = 0.5

# Number of animals whose times are kept.
_MOST = 500

_Number = Annotated[FiniteFloat, Field(ge=0)]


class _Times(TypedDict):
    """Measured times.

    Attributes:
        rate: weighted sums over animals of operations, and of the seconds to compile them.
        animals: seconds without LLVM, by digest of the animal.
    """

    rate: Annotated[list[_Number], Field(min_length=2, max_length=2)]
    animals: dict[str, _Number]


def expected_seconds(operations: float, animal: str | None = None) -> float | None:
    """Estimate the time to compile an animal's trial, s, or None without a measurement.

    Args:
        operations: approximate number of operations of the trial.
        animal: digest of all that the program depends on, or None for code that is not kept.
    """
    times = _read()
    known = times["animals"].get(animal or "")
    if known is not None:
        return known
    measured, seconds = times["rate"]
    return seconds / measured * operations if measured > 0 else None


def note_seconds(operations: float, animal: str, spent: Spent) -> None:
    """Record the compile time of an animal.

    Args:
        operations: approximate number of operations of the trial.
        animal: digest of all that the program depends on.
        spent: time spent on the animal's native code.
    """
    folder = machine.code_folder()
    if folder is None or not spent.seconds > 0:
        return
    times = _read()
    animals = {name: seconds for name, seconds in times["animals"].items() if name != animal}
    animals[animal] = spent.seconds - spent.compiler
    if spent.compiler > 0:
        measured, seconds = (_MEMORY * x for x in times["rate"])
        times["rate"] = [measured + operations, seconds + spent.seconds]
    times["animals"] = dict(list(animals.items())[-_MOST:])
    # A failure to store estimates must not stop the run.
    with contextlib.suppress(OSError):
        write_text(folder / _FILE, json.dumps(times))


def _read() -> _Times:
    # Commands that compile nothing have no code folder but read the file, too.
    folder = machine.code_folder() or compiled_folder()
    with contextlib.suppress(OSError, ValueError):
        if folder is not None:
            return read_json(folder / _FILE, _Times)
    return {"rate": [0.0, 0.0], "animals": {}}
