"""Estimate how long compiling takes, from what it took on this machine before.

The times are kept in the folder of the compiled programs. An animal that was compiled before takes
what it took without LLVM, for its code is kept. Another animal takes as long for each operation
(`evo_cpg.simulation.operations`) as those before it. Where nothing was measured, nothing is said.
"""

import contextlib
import json
import math
import os
import tempfile
from typing import Any

from evo_cpg.fusion.backend import machine
from evo_cpg.fusion.stopwatch import Spent
from evo_cpg.training.compile_cache import compiled_folder

_FILE = "compile-times.json"

# Weight of all earlier animals beside the newest in the time for an operation.
_MEMORY = 0.5

# Animals that are remembered.
_MOST = 500


def expected_seconds(operations: float, animal: str | None = None) -> float | None:
    """Estimate the time to compile an animal's trial, s; None where nothing was measured.

    Args:
        operations: of the trial, about.
        animal: a digest of all that its program depends on; None for code that is not kept.
    """
    times = _read()
    known = times["animals"].get(animal)
    if known is not None:
        return known
    measured, seconds = times["rate"]
    return seconds / measured * operations if measured > 0 else None


def note_seconds(operations: float, animal: str, spent: Spent) -> None:
    """Remember how long an animal took.

    Args:
        operations: of its trial, about.
        animal: a digest of all that its program depends on.
        spent: on its native code.
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
    # Estimates are no reason to fail.
    with contextlib.suppress(OSError):
        handle, path = tempfile.mkstemp(dir=folder, prefix=".times-")
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            json.dump(times, file)
        os.replace(path, folder / _FILE)


def _read() -> dict[str, Any]:
    """Return what was measured: ``rate`` as operations and seconds, ``animals`` in seconds."""
    nothing = {"rate": [0.0, 0.0], "animals": {}}
    # Reading is for commands that compile nothing, too.
    folder = machine.code_folder() or compiled_folder()
    if folder is None:
        return nothing
    try:
        times = json.loads((folder / _FILE).read_text(encoding="utf-8"))
        numbers = [*times["rate"], *times["animals"].values()]
        sound = len(times["rate"]) == 2 and all(math.isfinite(x) and x >= 0 for x in numbers)
    except (OSError, ValueError, TypeError, KeyError, AttributeError):
        return nothing
    return times if sound else nothing
