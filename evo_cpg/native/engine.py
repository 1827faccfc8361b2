"""Choose the engine that computes fused programs: native code if possible, else JAX.

The engine is chosen when a program is traced, and a compiled program keeps its engine. A self-test
in a separate process precedes the first use of native code with each combination of machine,
Python, JAX and llvmlite. A mistake in native code could end the process without an exception.
"""

import contextlib
import contextvars
import ctypes
import functools
import os
import subprocess
import sys
import warnings
from collections.abc import Iterator
from typing import Any, Literal, NamedTuple

import jax

from evo_cpg.native import machine_constants
from evo_cpg.native.backend import machine
from evo_cpg.native.ir import Unsupported

EngineName = Literal["auto", "native", "jax"]
InstructionSet = Literal["host", "avx512", "avx2", "sse", "neon"]


class Engine(NamedTuple):
    """The engine that computes programs.

    Attributes:
        name: "auto" uses native code if possible, else JAX with a warning. "native" requires
            native code. "jax" never uses native code.
        instructions: instruction set of native code ("host" is the largest of this machine).
        tested: whether native code must pass its self-test first (False only in the self-test).
    """

    name: EngineName = "auto"
    instructions: InstructionSet = "host"
    tested: bool = True


class EngineWarning(UserWarning):
    """Warning that a program runs on plain JAX instead of native code."""


_AUTO = Engine()
_chosen: contextvars.ContextVar[Engine] = contextvars.ContextVar("engine")
# Names of the parts that fell back to JAX while a program is computed in parts.
_fallbacks: contextvars.ContextVar[list[str]] = contextvars.ContextVar("fallbacks")


@contextlib.contextmanager
def using(engine: Engine) -> Iterator[None]:
    """Use the given engine for all programs that are traced within the block."""
    token = _chosen.set(engine)
    try:
        yield
    finally:
        _chosen.reset(token)


def is_native() -> bool:
    """Return whether programs traced now become native code.

    Raises:
        Unsupported: if the engine is "native", and this machine has no native code.
    """
    engine = _chosen.get(_AUTO)
    if engine.name == "jax":
        return False
    try:
        target()
    except Unsupported as error:
        if engine.name == "native":
            raise
        if jax.default_backend() == "cpu":
            warn_once(f"Plain JAX computes everything, slowly. No native code: {error}")
        return False
    return True


def target() -> machine.Target:
    """Return the machine that native code is made for.

    Raises:
        Unsupported: if this machine has no native code, or failed the self-test.
    """
    if jax.default_backend() != "cpu":
        raise Unsupported(f"JAX runs on {jax.default_backend()}, but native code needs a CPU")
    engine = _chosen.get(_AUTO)
    found = machine.host(None if engine.instructions == "host" else engine.instructions)
    if engine.tested and (wrong := _wrong(found)):
        raise Unsupported(wrong)
    return found


def described(engine: Engine) -> dict[str, Any]:
    """Return a description of an engine on this machine, for the records."""
    with using(engine):
        if not is_native():
            return {"engine": "jax"}
        own = target()
        return {
            "engine": "native",
            "instructions": own.name,
            "vector_bytes": own.bytes,
            "llvm": machine.llvm_version(),
        }


def warn_of_fallback(name: str, error: Exception) -> None:
    """Warn once that a program runs on plain JAX."""
    _fallbacks.get([]).append(name)
    kind = "" if isinstance(error, Unsupported) else f"{type(error).__name__}: "
    reason = str(error).strip().split("\n")[0]
    warn_once(f"{name} runs on plain JAX, not as native code: {kind}{reason}")


@contextlib.contextmanager
def smallest_fallback(name: str, error: Exception) -> Iterator[None]:
    """Compute a program in parts, and warn of it unless a part falls back to plain JAX, too."""
    parts: list[str] = []
    token = _fallbacks.set(parts)
    try:
        yield
    finally:
        _fallbacks.reset(token)
    if parts:
        _fallbacks.get([]).extend(parts)
    else:
        warn_of_fallback(name, error)


@functools.cache
def register(name: str, address: int) -> str:
    """Register a handler with XLA and return its registered name."""
    make = ctypes.pythonapi.PyCapsule_New
    make.restype = ctypes.py_object
    make.argtypes = [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p]
    known_as = f"evo_cpg_{name}"
    capsule = make(address, None, None)
    jax.ffi.register_ffi_target(known_as, capsule, platform="cpu", api_version=1)
    return known_as


@functools.cache
def warn_once(message: str) -> None:
    """Warn the user, unless this process has given the same warning already."""
    warnings.warn(message, EngineWarning, stacklevel=3)


@functools.cache
def _wrong(found: machine.Target) -> str:
    """Return the fault of native code on this machine, or "" if it passed its self-test."""
    record = machine.self_test_record(found, jax.__version__)
    # Unlike `Path.exists`, this does not raise for a folder of another user.
    if record is not None and os.path.exists(record):
        return ""
    command = [sys.executable, "-m", "evo_cpg.native.self_test", found.name]
    # The last line of the output must be the error. If JAX filtered the traceback, the last line
    # would be its remark on that.
    own = os.environ | {"JAX_PLATFORMS": "cpu", "JAX_TRACEBACK_FILTERING": "off"}
    try:
        test = subprocess.run(
            command,
            capture_output=True,
            encoding="utf-8",
            errors="replace",
            timeout=machine_constants.LONGEST_SELF_TEST,
            env=own,
        )
    except (OSError, subprocess.SubprocessError) as error:
        return f"the self-test could not run ({error})"
    if test.returncode:
        last = (test.stderr.strip().splitlines() or ["no message"])[-1]
        return f"the self-test failed (exit status {test.returncode}: {last})"
    if record is not None:
        with contextlib.suppress(OSError):
            record.touch()
    return ""
