"""Hints for wrong usage of a command, added to the messages of Typer."""

import sys
from typing import Any

import typer

# Missing argument, and the hint.
_MISSING = {
    "CONFIG": "Name a configuration, such as iwadate2010_swimmer. `evo-cpg configs` lists them",
    "RUN": "Name a run folder. `evo-cpg train` makes them, below runs/",
    "ANIMAL": "Name a configuration, such as eel, or a run folder. `evo-cpg configs` lists them",
    "NAME": "`evo-cpg configs` lists the names",
}


def add_hint(error: Exception) -> None:
    """Add a hint to an error of Typer about the arguments of a command.

    Args:
        error: error whose message is extended, or another error, which is left alone.
    """
    if isinstance(error, typer.BadParameter):
        # Pydantic's prefix.
        error.message = error.message.removeprefix("Value error, ")
        missing = getattr(error.param, "metavar", None)
        # Only an error about a missing argument has no message of its own.
        if not error.message and missing in _MISSING:
            error.message = _MISSING[missing]
    elif hasattr(error, "possibilities"):
        _add_setting(error)


def _add_setting(error: Any) -> None:
    """Add the setting that an unknown option resembles, if the command takes settings."""
    command = error.ctx and error.ctx.command
    if not any(parameter.name == "overrides" for parameter in getattr(command, "params", ())):
        return
    from evo_cpg.io.schema.experiment import ExperimentConfig
    from evo_cpg.io.wording import Allowed

    name = error.option_name.lstrip("-").replace("-", "_")
    allowed = Allowed(ExperimentConfig, {})
    sections = allowed.keys(())
    keys = [name] * (name in sections)
    keys += [f"{section}.{name}" for section in sections if name in allowed.keys((section,))]
    if keys:
        # An unknown option of one letter, such as -g, is not a key.
        written = " or ".join(f"{key}={_given(error.option_name)}" for key in keys)
        error.message += f". It is a setting, which has no dashes: {written}"
        error.possibilities = []


def _given(option: str) -> str:
    """Return the value that the command line gives to an unknown option, or ``VALUE``."""
    words = sys.argv[1:]
    for i, word in enumerate(words):
        if word.startswith(f"{option}="):
            return word.partition("=")[2]
        if word == option and i + 1 < len(words) and not words[i + 1].startswith("-"):
            return words[i + 1]
    return "VALUE"
