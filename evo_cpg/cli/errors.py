"""Which errors are about the user's input."""

import sys
from pathlib import Path

_ELSEWHERE = (
    ("evo_cpg.view.output", "OutputError"),
    ("evo_cpg.training.memory", "TooLargeError"),
    ("evo_cpg.training.strategy_state", "StrategyError"),
    ("evo_cpg.training.processes", "Disagreement"),
    ("evo_cpg.training.roll_call", "JoinError"),
    ("evo_cpg.view.output", "SettingError"),
    ("evo_cpg.studies.benchmarks", "SuiteError"),
)


class UsageError(Exception):
    """Input that no other part of the program is responsible for."""


def require_free(output: Path, overwrite: bool) -> None:
    """Check that a file of the user's is not replaced without being told.

    Raises:
        UsageError: it is there.
    """
    if output.exists() and not overwrite:
        raise UsageError(f"{output} exists already; --overwrite replaces it")


def is_users_fault(error: Exception) -> bool:
    """Whether an error is about the input, and its message meant for the user as it stands."""
    from evo_cpg.config.errors import ConfigError
    from evo_cpg.exchange.errors import ExchangeError
    from evo_cpg.training.run_folder import RunFolderError

    kinds: tuple[type[Exception], ...] = (ConfigError, ExchangeError, RunFolderError, UsageError)
    # Of modules that are slow to import; what was not imported has raised nothing.
    for module, name in _ELSEWHERE:
        if module in sys.modules:
            kinds += (getattr(sys.modules[module], name),)
    return isinstance(error, kinds)
