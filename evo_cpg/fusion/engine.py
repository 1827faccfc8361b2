"""What computes fused programs: native code where this machine can, else JAX itself.

The engine is chosen when a program is traced; what was compiled with one keeps it. Before native
code is used for the first time with some versions of JAX and llvmlite, a process of its own tests
it: a mistake there could end the process, and no exception would tell.
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

from evo_cpg.fusion import machine_constants
from evo_cpg.fusion.backend import machine
from evo_cpg.fusion.unsupported import Unsupported

EngineName = Literal["auto", "native", "jax"]
InstructionSet = Literal["host", "avx512", "avx2", "sse", "neon"]


class Engine(NamedTuple):
    """What is to compute programs.

    Attributes:
        name: "auto" takes native code where it can be had, with a warning where it cannot;
            "native" insists on it; "jax" never does.
        instructions: the set of instructions of native code; "host" is the largest there is.
        tested: whether native code has to pass its self-test first. Only the self-test needs none.
    """

    name: EngineName = "auto"
    instructions: InstructionSet = "host"
    tested: bool = True


class EngineWarning(UserWarning):
    """Something runs on plain JAX that was to run as native code."""


_AUTO = Engine()
_chosen: contextvars.ContextVar[Engine] = contextvars.ContextVar("engine")
# Names of the parts that fell back while a program is computed in parts.
_fallbacks: contextvars.ContextVar[list[str]] = contextvars.ContextVar("fallbacks")


@contextlib.contextmanager
def using(engine: Engine) -> Iterator[None]:
    """Trace with the given engine."""
    token = _chosen.set(engine)
    try:
        yield
    finally:
        _chosen.reset(token)


def is_native() -> bool:
    """Whether what is traced now becomes native code.

    Raises:
        Unsupported: it must, and cannot.
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
            _warn_once(f"JAX computes everything, slowly, for there is no native code: {error}")
        return False
    return True


def target() -> machine.Target:
    """The machine that native code is made for.

    Raises:
        Unsupported: there is none.
    """
    if jax.default_backend() != "cpu":
        raise Unsupported(f"JAX computes on {jax.default_backend()}, and native code is for CPUs")
    engine = _chosen.get(_AUTO)
    found = machine.host(None if engine.instructions == "host" else engine.instructions)
    if engine.tested and (wrong := _wrong(found)):
        raise Unsupported(wrong)
    return found


def described(engine: Engine) -> dict[str, Any]:
    """What an engine comes to on this machine, for the records."""
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
    """Warn once that JAX computes a program after all."""
    _fallbacks.get([]).append(name)
    kind = "" if isinstance(error, Unsupported) else f"{type(error).__name__}: "
    reason = str(error).strip().split("\n")[0]
    _warn_once(f"{name} runs on plain JAX, not as native code: {kind}{reason}")


@contextlib.contextmanager
def smallest_fallback(name: str, error: Exception) -> Iterator[None]:
    """Compute a program in parts: warn of it, unless one of the parts falls back as well.

    Args:
        name: of the program.
        error: why it cannot become native code.
    """
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
    """Make a handler known to XLA; under which name."""
    make = ctypes.pythonapi.PyCapsule_New
    make.restype = ctypes.py_object
    make.argtypes = [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p]
    known_as = f"evo_cpg_{name}"
    capsule = make(address, None, None)
    jax.ffi.register_ffi_target(known_as, capsule, platform="cpu", api_version=1)
    return known_as


@functools.cache
def _warn_once(message: str) -> None:
    warnings.warn(message, EngineWarning, stacklevel=3)


@functools.cache
def _wrong(found: machine.Target) -> str:
    """What is wrong with native code here; nothing where it passed its self-test."""
    if machine.passed_self_test(found, jax.__version__):
        return ""
    command = [sys.executable, "-m", "evo_cpg.fusion.self_test", found.name]
    # Else the last line of an error is JAX's remark on how it shortened it.
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
        return f"its self-test could not run ({error})"
    if test.returncode:
        last = (test.stderr.strip().splitlines() or ["no message"])[-1]
        return f"it failed its self-test (exit status {test.returncode}: {last})"
    machine.remember_self_test(found, jax.__version__)
    return ""
