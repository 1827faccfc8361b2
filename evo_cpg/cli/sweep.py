"""`evo-cpg sweep`: compare settings."""

import contextlib
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from evo_cpg.cli.completion import complete_config
from evo_cpg.cli.errors import UsageError, warn
from evo_cpg.cli.options import Cores, Overrides, find_config_or_folder

if TYPE_CHECKING:
    from evo_cpg.api.sweep import Member
    from evo_cpg.io.settings import Setting

# Largest number of rows of a table on a terminal. The file has all rows.
_MOST_ROWS = 30

# Results below this p value are marked.
_SURE = 0.05


def sweep(
    config: Annotated[
        Path,
        typer.Argument(
            metavar="CONFIG",
            help="A YAML configuration file, the name of a shipped one, or a sweep to continue.",
            callback=find_config_or_folder,
            autocompletion=complete_config,
        ),
    ],
    overrides: Overrides = None,
    grid: Annotated[
        list[str] | None,
        typer.Option(
            "--grid",
            metavar="KEY=A,B,...",
            help="Values of a key. Several keys give all combinations.",
        ),
    ] = None,
    settings: Annotated[
        Path | None,
        typer.Option(
            "--settings", metavar="FILE", help="A YAML file, {name: {key: value, ...}, ...}."
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Folder (default: runs/CONFIG_sweep).")
    ] = None,
    only: Annotated[
        list[str] | None, typer.Option("--only", metavar="NAME", help="Evolve only this setting.")
    ] = None,
    cores: Cores = None,
) -> None:
    """Evolve with many settings and compare the results."""
    from evo_cpg.api.display import working
    from evo_cpg.api.sweep import claim, evolve, members_of, new_plan, read_plan
    from evo_cpg.locks import locked
    from evo_cpg.system import as_utf8
    from evo_cpg.training.devices import use_cores

    overrides = [as_utf8(word) for word in overrides or []]
    grid = [as_utf8(word) for word in grid or []]
    folder, plan = config, read_plan(config)
    if plan is None:
        folder = out or Path("runs") / f"{config.stem}_sweep"
        plan = new_plan(config, overrides, _varied(overrides, grid, settings))
    elif overrides or grid or settings or out:
        raise UsageError(
            f"sweep: {config} is a sweep, which can only be continued unchanged. Leave out other "
            "settings"
        )
    devices = use_cores(cores)
    with working("building every setting"):
        members = members_of(folder, plan)
    chosen = _chosen(members, only or [])
    # Several commands with --only may evolve different settings, because each locks its runs.
    with contextlib.nullcontext() if only else locked(folder, make=True):
        claim(folder, plan)
        try:
            evolve(chosen, devices, folder.name, warn=warn)
        except KeyboardInterrupt:
            print(f"interrupted. Continue with `evo-cpg sweep {folder}`", file=sys.stderr)
            raise
        _tell(folder, members)


def _varied(
    overrides: Sequence[str], grid: Sequence[str], settings: Path | None
) -> "list[Setting]":
    from evo_cpg.io.keys import replaces
    from evo_cpg.io.settings import combine, read_settings

    axes: dict[str, list[Any]] = {}
    for word in grid:
        key, values = _axis(word)
        for other in [*(override.partition("=")[0] for override in overrides), *axes]:
            if replaces(key, other):
                twice = "is given twice" if key == other else f"would replace {other}"
                raise UsageError(f"sweep: {key} {twice}. Give all its values in one --grid {key}=")
        axes[key] = values
    if not axes and settings is None:
        raise UsageError(
            "sweep: nothing is varied. Name keys and values, such as "
            "--grid evolution.mutation_rate=0.02,0.05, or a file with --settings"
        )
    named = {} if settings is None else read_settings(settings)
    try:
        return combine(axes, named)
    except ValueError as error:
        raise UsageError(f"sweep: {error}") from None


def _axis(word: str) -> tuple[str, list[Any]]:
    """Return key and values of ``key=a,b,c``, of ``key=[a,b,c]`` or of ``key=[a,b],[c,d]``."""
    import yaml

    from evo_cpg.io.yaml_text import parse_yaml

    key, equals, text = word.partition("=")
    if not (key and equals and text):
        raise UsageError(f"--grid: {word!r} is not KEY=VALUE,VALUE,...")
    try:
        values = parse_yaml(f"[{text}]")
    except yaml.YAMLError:
        values = None
    if isinstance(values, list) and len(values) == 1 and isinstance(values[0], list):
        values = values[0]
    if not isinstance(values, list) or not values:
        raise UsageError(
            f"--grid: {text!r} is not a list of values, such as 1,2,3 or [0,1],[2,3] for vectors"
        )
    return key, values


def _chosen(members: "Sequence[Member]", only: Sequence[str]) -> "list[Member]":
    known = {member.setting.name: member for member in members}
    for name in only:
        if name not in known:
            raise UsageError(f"--only: there is no setting {name!r}. Allowed: {', '.join(known)}")
    return [known[name] for name in dict.fromkeys(only)] or list(members)


def _tell(folder: Path, members: "Sequence[Member]") -> None:
    from evo_cpg.api.display import working
    from evo_cpg.api.sweep import summarise
    from evo_cpg.cli.tables import show_table

    with working("making tables and figure"):
        found = summarise(folder, members)
    spreads = [
        (
            one.name,
            str(one.runs),
            f"{one.median:.4g}",
            f"{one.low:.4g} to {one.high:.4g}",
            f"{one.worst:.4g}",
            f"{one.best:.4g}",
        )
        for one in found.spreads[:_MOST_ROWS]
    ]
    heads = "setting", "runs", "median", "quartiles", "worst", "best"
    show_table(heads, spreads, title="fitness of the champions")
    tests = [
        (
            one.first,
            one.second,
            f"{one.wins:.0%}",
            f"{one.p_value:.3g}",
            f"{one.adjusted:.3g}" + (" *" if one.adjusted < _SURE else ""),
        )
        for one in sorted(found.comparisons, key=lambda one: one.adjusted)[:_MOST_ROWS]
    ]
    if tests:
        heads = "setting", "against", "wins", "p", "p corrected"
        title = "comparisons (Mann-Whitney test, Holm correction)"
        show_table(heads, tests, left=2, title=title)
    print(found.figure)
    print(folder)
