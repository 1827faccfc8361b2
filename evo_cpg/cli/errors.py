"""Exit codes, messages for errors, and hints for wrong usage of a command."""

import os
import sys
from enum import IntEnum
from pathlib import Path

import typer

from evo_cpg.errors import UsageError, UserError


class ExitCode(IntEnum):
    """Exit codes other than 0. The users' list is in docs/cli.md."""

    FAULT = 1
    """Fault of the program, or failed search for a rhythm."""

    WRONG_INPUT = 2
    """Wrong input. A message names the error."""

    NOT_PASSED = 3
    """Failed audit, verification or comparison."""

    INTERRUPTED = 130
    """Interrupt by the user. Shells use this number, too."""


# Missing argument, and the hint.
_MISSING = {
    "CONFIG": "Name a configuration, such as iwadate2010_swimmer. `evo-cpg configs` lists them",
    "RUN": "Name a run folder. `evo-cpg train` makes them, below runs/",
    "ANIMAL": "Name a configuration, such as eel, or a run folder. `evo-cpg configs` lists them",
    "NAME": "`evo-cpg configs` lists the names",
}


def require_free(output: Path, overwrite: bool) -> None:
    """Check that no file of the user is replaced without `--overwrite`.

    Raises:
        UsageError: the file exists, and ``overwrite`` is not set.
    """
    # Path.exists raises an error for names that no file can have.
    if os.path.exists(output) and not overwrite:
        raise UsageError(f"{output} exists. Choose another name, or replace it with --overwrite")


def require_none(option: str, others: dict[str, object]) -> None:
    """Check that none of the options is given that do not fit another one.

    Raises:
        UsageError: one of them is given.
    """
    if found := next((name for name, given in others.items() if given), None):
        raise UsageError(f"{option} and {found} exclude each other. Leave out one of them")


def message_for(error: Exception) -> str | None:
    """Return the message for the error that ended a command, or None for a fault of the program."""
    if isinstance(error, UserError):
        return str(error)
    if isinstance(error, UnicodeEncodeError):
        words = (
            f"{error.object[:100]!a} cannot be written in {error.encoding}. Choose a locale with "
            "UTF-8, such as LC_ALL=C.UTF-8, or another name"
        )
    elif isinstance(error, OSError):
        reason = error.strerror or str(error) or type(error).__name__
        words = reason if error.filename is None else f"{error.filename}: {reason}"
    else:
        words = _of_platform()
    return words and " ".join(words.split())


def _of_platform() -> str | None:
    """Return the message if JAX finds no device to compute on."""
    jax = sys.modules.get("jax")
    if jax is None:
        return None
    try:
        jax.devices()
    except Exception:
        # JAX 0.10 raises RuntimeError or AssertionError.
        names = ("JAX_PLATFORMS", "JAX_PLATFORM_NAME")
        given = [f"{name} is {os.environ[name]!r}" for name in names if os.environ.get(name)]
        return (
            f"JAX finds no device to compute on ({', '.join(given) or 'of any kind'}). Set "
            "JAX_PLATFORMS to 'cpu', or unset it"
        )
    return None


def add_hint(error: Exception) -> None:
    """Add a hint to an error of Typer about the arguments of a command. Leave others alone."""
    if isinstance(error, typer.BadParameter):
        # Pydantic's prefix.
        error.message = error.message.removeprefix("Value error, ")
        missing = getattr(error.param, "metavar", None)
        # Only an error about a missing argument has no message of its own.
        if not error.message and missing in _MISSING:
            error.message = _MISSING[missing]
