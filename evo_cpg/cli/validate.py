"""`evo-cpg validate`: whether configurations can be built, and what they come to."""

import sys
from collections.abc import Sequence
from pathlib import Path

from evo_cpg.cli.building import build, read_config
from evo_cpg.cli.costs import warn_of_cost
from evo_cpg.cli.errors import UsageError
from evo_cpg.cli.exit_codes import ExitCode
from evo_cpg.cli.oscillators import warn_of_oscillators
from evo_cpg.config.build import require_genes
from evo_cpg.config.errors import ConfigError
from evo_cpg.config.shipped import find_config


def validate_configs(words: Sequence[str], strict: bool = False) -> None:
    """`evo-cpg validate`.

    Args:
        words: files, and settings that hold for all of them.
        strict: refuse what is hardly meant.

    Raises:
        UsageError: there is no file among the words.
        SystemExit: with `ExitCode.WRONG_INPUT`, where a file is wrong.
    """
    overrides = [word for word in words if "=" in word and not _exists(word)]
    paths = [Path(word) for word in words if word not in overrides]
    if not paths:
        raise UsageError(f"validate: {overrides[0]} is a setting; name a configuration file, too")
    wrong = 0
    for given in paths:
        path = given
        try:
            path = find_config(given)
            experiment = build(read_config(path, overrides, strict), path)
            require_genes(experiment, path)
        except (ConfigError, UsageError) as error:
            wrong += 1
            print(f"evo-cpg: {error}", file=sys.stderr)
        else:
            tree = experiment.simulation.world.tree
            print(
                f"{given}: {tree.body_count} bodies, {tree.dof_count} joint axes, "
                f"{experiment.creature.mass:.3g} kg, "
                f"{experiment.simulation.genome.count} genes"
            )
            warn_of_oscillators(given, experiment.simulation)
            warn_of_cost(given, experiment.simulation)
    if wrong:
        raise SystemExit(ExitCode.WRONG_INPUT)


def _exists(word: str) -> bool:
    """Whether a word is a file; one that no file can be called is none."""
    try:
        return Path(word).exists()
    except (OSError, ValueError):
        return False
