"""From a configuration file to an experiment, with what the user should know on the way."""

from collections.abc import Iterable, Sequence
from pathlib import Path

from evo_cpg.cli.errors import UsageError, warn
from evo_cpg.cli.progress import working
from evo_cpg.config.build import build_experiment
from evo_cpg.config.lint import lint
from evo_cpg.config.load import load_config
from evo_cpg.config.schema.experiment import ExperimentConfig
from evo_cpg.training.experiment import Experiment


def read_config(
    path: Path, overrides: Sequence[str] = (), strict: bool = False, warned: bool = True
) -> ExperimentConfig:
    """Return a configuration; warn about values that are hardly meant.

    Args:
        path: the file.
        overrides: ``key=value`` settings.
        strict: refuse such values instead.
        warned: whether this process is the one that warns.

    Raises:
        ConfigError: it is wrong.
        UsageError: a value is hardly meant, and ``strict`` is set.
    """
    config = load_config(path, overrides)
    found = [f"{path}: {warning}" for warning in lint(config, path)]
    if found and strict:
        raise UsageError("\n".join(found))
    for line in found if warned else ():
        warn(line)
    return config


def build(config: ExperimentConfig, source: Path, folders: Iterable[Path] = ()) -> Experiment:
    """`build_experiment`, which says what it does where it takes long.

    Args:
        config: the configuration.
        source: file it came from.
        folders: where else to look for a user's own classes.

    Raises:
        ConfigError: parts that do not fit together.
    """
    what = f"building {config.name}"
    if config.simulation.start_pose == "settled":
        what = f"{what}: letting the creature settle"
    with working(what):
        return build_experiment(config, source, folders)
