"""`evo-cpg validate`: build configurations, and report their sizes or errors."""

from pathlib import Path
from typing import Annotated

import typer

from evo_cpg.cli.completion import complete_config
from evo_cpg.cli.errors import ExitCode, UsageError, tell, warn
from evo_cpg.cli.options import Strict, name_replaced


def validate(
    configs: Annotated[
        list[str],
        typer.Argument(
            metavar="CONFIG... [KEY=VALUE]...",
            help="YAML configuration files or names of shipped ones, and settings to change in "
            "each of them.",
            autocompletion=complete_config,
        ),
    ],
    strict: Strict = False,
) -> None:
    """Check configuration files without running them."""
    from evo_cpg.api.display import working
    from evo_cpg.cli.advice import about_step, advise, is_light_in_water
    from evo_cpg.cli.building import build, read_config
    from evo_cpg.io.build import require_genes
    from evo_cpg.io.errors import ConfigError
    from evo_cpg.io.shipped import find_config

    overrides = [word for word in configs if "=" in word and not _exists(word)]
    paths = [Path(word) for word in configs if word not in overrides]
    if not paths:
        raise UsageError(f"validate: {overrides[0]} is a setting. Name a configuration file, too")
    name_replaced(overrides)
    wrong = 0
    for given in paths:
        path = given
        try:
            path = find_config(given)
            experiment = build(read_config(path, overrides, strict), path)
            require_genes(experiment, path)
        except (ConfigError, UsageError) as error:
            wrong += 1
            tell(f"evo-cpg: {error}")
        else:
            tree = experiment.simulation.world.tree
            print(
                f"{given}: {tree.body_count} bodies, {tree.dof_count} joint axes, "
                f"{experiment.creature.mass:.3g} kg, "
                f"{experiment.simulation.genome.count} genes"
            )
            advise(given, experiment.simulation)
            if is_light_in_water(experiment.simulation):
                with working("testing the physics step"):
                    problem = about_step(experiment.simulation)
                if problem:
                    warn(f"{given}: {problem}")
    if wrong:
        raise SystemExit(ExitCode.WRONG_INPUT)


def _exists(word: str) -> bool:
    """Return whether a word is the path of an existing file or folder."""
    try:
        return Path(word).exists()
    except (OSError, ValueError):
        return False
