"""Errors about what the user wrote: file, key, value, what is allowed, the nearest valid key."""

import contextlib
import copyreg
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from evo_cpg.errors import UserError
from evo_cpg.errors import nearest as nearest

Key = Sequence[str | int]


class KeyProblem(UserError):
    """A problem with the value of a key, raised where the file is not known.

    Outside of this package it is a `ConfigError`, which has the file (`evo_cpg.config.lines`).

    Attributes:
        key: of the value; within a section it begins there (`under`).
        problem: what is wrong with it.
    """

    def __init__(self, key: Key, problem: str):
        self.key, self.problem = tuple(key), problem
        super().__init__(f"{'.'.join(map(str, key))}: {problem}")

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the message and what it is made of, as a pool of processes does."""
        return copyreg.__newobj__, (type(self), *self.args), self.__dict__  # type: ignore[attr-defined]


class ConfigError(KeyProblem):
    """A configuration that cannot be used; the message is for the user as it stands.

    Attributes:
        source: file, or what else the value came from.
        key: of the value.
        problem: what is wrong with it.
        line: of the file in which the value stands; None if that is unknown.
    """

    def __init__(self, source: str | Path, key: Key, problem: str, line: int | None = None):
        super().__init__(key, problem)
        self.source, self.line = source, line
        # What a stranger wrote may be of any length.
        where = [_clipped(str(source)), *([] if line is None else [f"line {line}"])]
        where += [_clipped(".".join(map(str, key)))] if key else []
        self.args = (": ".join([*where, _clipped(problem, 700)]),)


@contextlib.contextmanager
def under(*key: str | int) -> Iterator[None]:
    """Put the key of a section before the keys of problems that are raised within."""
    try:
        yield
    except ConfigError:
        raise
    except KeyProblem as error:
        raise KeyProblem((*key, *error.key), error.problem) from None


def _clipped(text: str, most: int = 150) -> str:
    """The beginning and the end of a long text."""
    if len(text) <= most:
        return text
    return f"{text[: most // 2]}...{text[-(most // 2) :]}"
