"""Exit codes, messages for errors, and checks of a command's options."""

import os
import sys
from enum import IntEnum
from pathlib import Path

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
        words, jax = None, sys.modules.get("jax")
        try:
            if jax is not None:
                jax.devices()
        except Exception:
            # JAX found no device. JAX 0.10 raises RuntimeError or AssertionError.
            names = ("JAX_PLATFORMS", "JAX_PLATFORM_NAME")
            given = [f"{name} is {os.environ[name]!r}" for name in names if os.environ.get(name)]
            words = (
                f"JAX finds no device to compute on ({', '.join(given) or 'of any kind'}). Set "
                "JAX_PLATFORMS to 'cpu', or unset it"
            )
    return words and " ".join(words.split())
