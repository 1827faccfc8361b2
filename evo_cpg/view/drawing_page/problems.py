"""Messages of `validate` about a document, each with the part that it is about."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

from evo_cpg.creature.creature import CreatureError
from evo_cpg.errors import UserError
from evo_cpg.io.build import build_experiment, require_genes
from evo_cpg.io.errors import Key, KeyProblem
from evo_cpg.io.lint import lint
from evo_cpg.io.load import complete_config
from evo_cpg.simulation.simulation import Simulation
from evo_cpg.view.drawing_page.document import Data


class Problem(NamedTuple):
    """A message about a document.

    Attributes:
        kind: an error, with which it cannot run, or a warning of an unlikely value.
        part: name of the entry of a body that the message is about, or None.
        key: key of the value.
        words: the message.
    """

    kind: Literal["error", "warning"]
    part: str | None
    key: Key
    words: str


Advice = Callable[[Simulation], Sequence[str]]
"""Warnings about a simulation, one sentence or more each."""


def no_advice(simulation: Simulation) -> Sequence[str]:
    """Return no warnings."""
    del simulation
    return ()


def problems(
    data: Data, source: Path, thorough: bool = True, advice: Advice = no_advice
) -> list[Problem]:
    """Return the messages of `validate` about a document.

    Args:
        data: data of the document.
        source: file of the document, to whose folder other files are relative.
        thorough: whether to build the whole experiment, which takes longer.
        advice: further warnings about the experiment.
    """
    try:
        config = complete_config(data, source)
        found = [
            Problem("warning", _part(data, each.key), each.key, each.problem)
            for each in lint(config, source)
        ]
        if thorough:
            experiment = build_experiment(config, source)
            require_genes(experiment, source)
            lines = advice(experiment.simulation)
            found += [Problem("warning", None, ("controller",), line) for line in lines]
        return found
    except KeyProblem as error:
        return [Problem("error", _part(data, error.key), error.key, error.problem)]
    except CreatureError as error:
        return [Problem("error", None, ("creature",), str(error))]
    except UserError as error:
        return [Problem("error", None, (), str(error))]


def _part(data: Data, key: Key) -> str | None:
    """Return the name of the entry that a key is about."""
    match tuple(key):
        case ("creature", "bodies", int() as i, *_):
            name = _at(data, "creature", "bodies", i, "name")
        case ("creature", str() as kind, int() as i, *_) if kind.endswith("sensors"):
            name = _at(data, "creature", kind, i, "body")
        case _:
            return None
    return name if isinstance(name, str) else None


def _at(data: Any, *key: str | int) -> Any:
    for part in key:
        try:
            data = data[part]
        except (LookupError, TypeError):
            return None
    return data
