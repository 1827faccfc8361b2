"""The commands about configurations: configs, configs copy, configs schema."""

from pathlib import Path
from typing import Annotated

import typer

from evo_cpg.cli.completion import complete_shipped

app = typer.Typer(
    help="List the configurations that come with the program, copy one, or print their schema.",
    rich_markup_mode=None,
)


@app.callback(invoke_without_command=True)
def configs(context: typer.Context) -> None:
    """List the configurations that come with the program, copy one, or print their schema."""
    if context.invoked_subcommand is None:
        _list()


@app.command()
def copy(
    name: Annotated[
        str,
        typer.Argument(metavar="NAME", help="Of a configuration.", autocompletion=complete_shipped),
    ],
    folder: Annotated[
        Path, typer.Argument(metavar="[FOLDER]", help="Where to; the working folder by default.")
    ] = Path("."),
) -> None:
    """Copy a configuration, with the files that it names, to change it; replaces nothing."""
    from evo_cpg.cli.errors import UsageError
    from evo_cpg.config.copying import copy_shipped

    try:
        print(copy_shipped(name, folder))
    except OSError as error:
        raise UsageError(
            f"configs copy: {error.filename or folder} cannot be written ({error.strerror})"
        ) from None


@app.command()
def schema() -> None:
    """Print the JSON Schema of configuration files, by which editors complete and check keys."""
    import json

    from evo_cpg.config.file_schema import file_schema

    print(json.dumps(file_schema(), indent=1))


def _list() -> None:
    from rich import box
    from rich.console import Console
    from rich.table import Table

    from evo_cpg.cli.errors import UsageError
    from evo_cpg.config.shipped import shipped, shipped_names

    names = shipped_names()
    if not names:
        raise UsageError("configs: there are none beside the program; install it anew")
    table = Table(box=box.SIMPLE_HEAD)
    table.add_column("name", no_wrap=True)
    table.add_column("study", no_wrap=True)
    table.add_column("what it is", overflow="fold")
    for name in names:
        found = shipped(name)
        table.add_row(name, found.study or "ours", found.summary)
    Console(highlight=False, markup=False).print(table)
