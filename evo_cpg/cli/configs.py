"""Commands about configurations: configs, configs copy, configs schema."""

from pathlib import Path
from typing import Annotated

import typer

from evo_cpg.cli.completion import complete_shipped

configs = typer.Typer(
    help="List and copy shipped configurations.",
    add_completion=False,
    rich_markup_mode=None,
)


@configs.callback(invoke_without_command=True)
def without_command(context: typer.Context) -> None:
    """List and copy shipped configurations."""
    if context.invoked_subcommand is None:
        _list()


@configs.command()
def copy(
    name: Annotated[
        str,
        typer.Argument(
            metavar="NAME", help="Name of a configuration.", autocompletion=complete_shipped
        ),
    ],
    folder: Annotated[
        Path,
        typer.Argument(metavar="FOLDER", help="Folder to copy to (default: the working folder)."),
    ] = Path("."),
) -> None:
    """Copy a configuration and the files that it names."""
    from evo_cpg.io.shipped import copy_shipped

    print(copy_shipped(name, folder))


@configs.command()
def schema() -> None:
    """Print the JSON Schema of configuration files, for editors."""
    import json

    from evo_cpg.io.file_schema import file_schema

    print(json.dumps(file_schema(), indent=1))


def _list() -> None:
    from evo_cpg.cli.errors import UsageError
    from evo_cpg.cli.tables import show_table
    from evo_cpg.io.shipped import shipped, shipped_names

    names = shipped_names()
    if not names:
        raise UsageError("configs: the installation has no configurations. Reinstall evo-cpg")
    found = map(shipped, names)
    rows = [(one.name, one.study or "ours", one.summary) for one in found]
    show_table(("name", "study", "description"), rows, left=3)
