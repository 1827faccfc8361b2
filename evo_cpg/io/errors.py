"""Errors in the user's input: file, key, value, allowed values, nearest valid key."""

import contextlib
import copyreg
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from evo_cpg.errors import UserError
from evo_cpg.errors import nearest as nearest

Key = Sequence[str | int]


class KeyProblem(UserError):
    """A problem with the value of a key, raised in code that does not know the file.

    Before it leaves `evo_cpg.io`, `located` makes it a `ConfigError`, which names the file.

    Attributes:
        key: key of the value, relative to the section that is being read (`under`).
        problem: description of the problem.
    """

    def __init__(self, key: Key, problem: str):
        self.key, self.problem = tuple(key), problem
        super().__init__(f"{'.'.join(map(str, key))}: {problem}")

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the message and its parts, as a pool of processes requires."""
        return copyreg.__newobj__, (type(self), *self.args), self.__dict__  # type: ignore[attr-defined]


class ConfigError(KeyProblem):
    """An invalid configuration, with a message for the user.

    Attributes:
        source: file, or another origin of the value.
        key: key of the value.
        problem: description of the problem.
        line: line of the value in the file, or None if it is unknown.
    """

    def __init__(self, source: str | Path, key: Key, problem: str, line: int | None = None):
        super().__init__(key, problem)
        self.source, self.line = source, line
        # Text from a stranger may have any length, so clip it.
        where = [_clipped(str(source)), *([] if line is None else [f"line {line}"])]
        where += [_clipped(".".join(map(str, key)))] if key else []
        self.args = (": ".join([*where, _clipped(problem, 700)]),)


@contextlib.contextmanager
def under(*key: str | int) -> Iterator[None]:
    """Add the key of a section before the keys of problems that the ``with`` block raises."""
    try:
        yield
    except ConfigError:
        raise
    except KeyProblem as error:
        raise KeyProblem((*key, *error.key), error.problem) from None


def _clipped(text: str, most: int = 150) -> str:
    """Return a text, shortened to its beginning and end if it is long."""
    if len(text) <= most:
        return text
    return f"{text[: most // 2]}...{text[-(most // 2) :]}"
