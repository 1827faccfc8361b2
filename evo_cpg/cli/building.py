"""Read a configuration and build its experiment, with warnings and progress for the user."""

from collections.abc import Iterable, Sequence
from pathlib import Path

from evo_cpg.api.display import working
from evo_cpg.cli.errors import UsageError, warn
from evo_cpg.io.build import build_experiment
from evo_cpg.io.lint import lint
from evo_cpg.io.load import load_config
from evo_cpg.io.schema.experiment import ExperimentConfig
from evo_cpg.training.experiment import ExperimentParts


def read_config(
    path: Path, overrides: Sequence[str] = (), strict: bool = False
) -> ExperimentConfig:
    """Read a configuration, and warn of unlikely values.

    Args:
        path: path of the file.
        overrides: settings to change, ``key=value``.
        strict: refuse unlikely values.

    Raises:
        ConfigError: the configuration is wrong.
        UsageError: a value is unlikely, and ``strict`` is set.
    """
    config = load_config(path, overrides)
    found = [f"{path}: {warning}" for warning in lint(config, path)]
    if found and strict:
        raise UsageError("\n".join(found))
    for line in found:
        warn(line)
    return config


def build(config: ExperimentConfig, source: Path, folders: Iterable[Path] = ()) -> ExperimentParts:
    """Build an experiment, with a progress line if the build takes long.

    Args:
        config: configuration of the experiment.
        source: file that the configuration came from.
        folders: further folders with a user's own classes.

    Raises:
        ConfigError: parts of the configuration do not fit together.
    """
    what = f"building {config.name}"
    if config.simulation.start_pose == "settled":
        what = f"{what}: letting the creature settle"
    with working(what):
        return build_experiment(config, source, folders)
