"""Errors of the command line, messages for other errors, and exit codes."""

import os
import sys
from enum import IntEnum
from pathlib import Path

from evo_cpg.errors import UserError
from evo_cpg.system import folded


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


class UsageError(UserError):
    """Wrong input that the command line itself detects."""


def warn(words: object) -> None:
    """Print a warning to standard error."""
    tell(f"evo-cpg: warning: {words}")


def tell(words: str) -> None:
    """Print words to standard error. On a terminal, no word is broken."""
    print(folded(words, sys.stderr), file=sys.stderr)


def require_free(output: Path, overwrite: bool) -> None:
    """Check that no file of the user is replaced without `--overwrite`.

    Raises:
        UsageError: the file exists, and ``overwrite`` is not set.
    """
    # Path.exists raises an error for names that no file can have.
    if os.path.exists(output) and not overwrite:
        raise UsageError(f"{output} exists. Choose another name, or replace it with --overwrite")


def message_for(error: Exception) -> str | None:
    """Return the message for an error that is not a fault of the program, or None for a fault.

    Args:
        error: error that ended a command.
    """
    if isinstance(error, UserError):
        return str(error)
    words = _of_system(error) or _of_platform()
    return words and " ".join(words.split())


def _of_system(error: Exception) -> str | None:
    """Return the message for a refusal of the operating system."""
    if isinstance(error, UnicodeEncodeError):
        return (
            f"{error.object[:100]!a} cannot be written in {error.encoding}. Choose a locale with "
            "UTF-8, such as LC_ALL=C.UTF-8, or another name"
        )
    if not isinstance(error, OSError):
        return None
    reason = error.strerror or str(error) or type(error).__name__
    return reason if error.filename is None else f"{error.filename}: {reason}"


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
