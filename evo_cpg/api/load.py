"""Load an experiment from a file, a run folder or a dictionary."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from evo_cpg.api.experiment import Experiment
from evo_cpg.api.progress import working
from evo_cpg.io.build import build_experiment
from evo_cpg.io.load import as_overrides, complete_config, load_config
from evo_cpg.io.run import class_folders
from evo_cpg.io.shipped import find_config
from evo_cpg.io.trust import trusting
from evo_cpg.training.devices import use_cores
from evo_cpg.training.run_folder import RunFolder

Overrides = Sequence[str] | Mapping[str, Any]

# Source of a configuration that was not read from a file.
_NO_FILE = Path("configuration")


def load(
    config: Path | str | Mapping[str, Any],
    overrides: Overrides = (),
    cores: int | None = None,
    trust: bool = False,
) -> Experiment:
    """Read a configuration and build its experiment.

    Args:
        config: path of a YAML file, or of a run folder with a ``config.yaml``. A name such as
            ``hexapod`` means the shipped configuration, if the working folder has no such file.
            A dictionary holds the contents of a file. Its file names are relative to the working
            folder.
        overrides: settings to change: ``["seed=3", "world.gravity=1.6"]`` as on the command line,
            or ``{"seed": 3, "world.gravity": 1.6}``.
        cores: number of cores that share a population, or None for all cores. If JAX has already
            computed something, its devices are kept.
        trust: whether you trust the configuration. A trusted configuration may name files outside
            its folder, and run code of modules in its folder. Without trust, it may run only
            installed modules and modules in the working folder.

    Raises:
        ConfigError: the configuration is wrong.
    """
    with trusting(trust):
        return _load(config, _as_on_the_command_line(overrides), cores)


def _load(
    config: Path | str | Mapping[str, Any], changed: Sequence[str], cores: int | None
) -> Experiment:
    folders: list[Path] = []
    if isinstance(config, Mapping):
        source = _NO_FILE
        read = complete_config(dict(config), source, changed)
    else:
        source = find_config(config, folders=True)
        if source.is_dir():
            folders = class_folders(RunFolder(source))
            source = source / "config.yaml"
        read = load_config(source, changed)
    use_cores(cores)
    with working(f"building {read.name!r}"):
        return Experiment(build_experiment(read, source, folders), read, source)


def _as_on_the_command_line(overrides: Overrides) -> list[str]:
    if isinstance(overrides, str):
        raise TypeError(f"overrides must be a list of settings, such as [{overrides!r}]")
    if not isinstance(overrides, Mapping):
        return list(overrides)
    return as_overrides(overrides)
