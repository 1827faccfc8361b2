"""`evo-cpg`: commands, errors and interrupts of the program.

A command is a function with its name. The signature declares the options, and `COMMANDS` names the
file, which is imported when the command is called. JAX and VTK are imported when the command runs,
because `--help` must be quick.
"""

import errno
import functools
import importlib
import os
import sys
from collections import UserDict
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from evo_cpg.cli import interrupts, terminal
from evo_cpg.cli.errors import ExitCode, message_for
from evo_cpg.cli.interrupts import interrupts_delivered, leave_at_once
from evo_cpg.cli.terminal import advice_printed, tell

# Commands of each file, in the order of the help text. `import` is a keyword, so its function is
# `import_`.
_FILES = {
    "evolve": ("train", "resume", "sweep", "refine", "watch"),
    "draw": ("render", "plot", "preview", "model"),
    "ask": ("analyse", "audit", "verify", "probe", "sensitivity", "lab"),
    "cpg": ("cpg",),
    "exchange": ("validate", "configs", "export", "import"),
    "repeat": ("reproduce",),
}
COMMANDS = {name: file for file, names in _FILES.items() for name in names}

# These commands write their results to a folder, so a lost standard output is no failure.
_EVOLVING = frozenset({"train", "resume", "refine", "sweep", "reproduce"})

PLAIN: dict[str, Any] = {"pretty_exceptions_enable": False, "rich_markup_mode": None}


# Missing argument, and the hint.
_MISSING = {
    "CONFIG": "Name a configuration, such as iwadate2010_swimmer. `evo-cpg configs` lists them",
    "RUN": "Name a run folder. `evo-cpg train` makes them, below runs/",
    "ANIMAL": "Name a configuration, such as eel, or a run folder. `evo-cpg configs` lists them",
    "NAME": "`evo-cpg configs` lists the names",
}


class _Imported(UserDict[str, Any]):
    """Commands by name. The data are the names of their files, imported at a look-up."""

    def __getitem__(self, name: str) -> Any:
        module = importlib.import_module(f"evo_cpg.cli.{self.data[name]}")
        found = getattr(module, f"{name}_" if name == "import" else name)
        if not isinstance(found, typer.Typer):
            function, found = found, typer.Typer(add_completion=False, **PLAIN)

            @functools.wraps(function)
            def with_all_lines(*values: Any, **options: Any) -> None:
                # Rich, which draws the progress, takes a moment to import.
                from evo_cpg.api.progress import all_lines

                with all_lines():
                    function(*values, **options)

            found.command(name)(with_all_lines)
        command = typer.main.get_command(found)
        command.name = name
        return command


class _Commands(TyperGroup):
    """Group of all commands."""

    def __init__(self, **settings: Any):
        super().__init__(**settings)
        self.commands: Any = _Imported(COMMANDS)

    def invoke(self, ctx: typer.Context) -> Any:
        """Run a command, and add hints to messages about wrong arguments."""
        try:
            return super().invoke(ctx)
        except typer.BadParameter as error:
            # Pydantic's prefix.
            error.message = error.message.removeprefix("Value error, ")
            missing = getattr(error.param, "metavar", None)
            # Only an error about a missing argument has no message of its own.
            if not error.message and missing in _MISSING:
                error.message = _MISSING[missing]
            raise


app = typer.Typer(
    name="evo-cpg",
    cls=_Commands,
    help="Evolve the motion of virtual creatures.",
    no_args_is_help=True,
    **PLAIN,
)


def _show_version(value: bool) -> bool:
    if value:
        from evo_cpg.api.machine import version

        print(version())
        raise typer.Exit
    return value


@app.callback()
def options(
    trust: Annotated[
        bool,
        typer.Option(
            "--trust",
            help="Trust the configuration: it may run code in its folder and name any file.",
        ),
    ] = False,
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_show_version, is_eager=True, help="Show the version and exit."
        ),
    ] = False,
) -> None:
    """Evolve the motion of virtual creatures."""
    if trust:
        # This runs before the command reads its own arguments, which may name a configuration.
        from evo_cpg.io.trust import trust as trust_configurations

        trust_configurations()


def main(commands: typer.Typer = app, name: str = "evo-cpg") -> None:
    """Run the command line, or other commands under another name.

    For an error of the user or the system, print a short message and exit with code 2.
    """
    # For 200 individuals, native code is 20 to 45 times as fast as a GPU (docs/faq.md).
    os.environ.setdefault("JAX_PLATFORMS", "cpu")
    try:
        with interrupts_delivered(), advice_printed():
            commands(prog_name=name)
    except KeyboardInterrupt:
        raise SystemExit(ExitCode.INTERRUPTED) from None
    except Exception as error:
        words = message_for(error)
        if words is None:
            raise
        tell(f"evo-cpg: {words}")
        raise SystemExit(ExitCode.WRONG_INPUT) from None


def program() -> None:
    """Run `main` as a process that does not wait for compilations after an interrupt."""
    terminal.protect()
    try:
        main()
    except SystemExit as stop:
        if stop.code == ExitCode.INTERRUPTED:
            leave_at_once(ExitCode.INTERRUPTED)
        error = terminal.output_error()
        # A reader that stops early, such as `head`, is no error.
        if error is not None and error.errno != errno.EPIPE:
            words = f"cannot write to standard output ({error.strerror or error})"
            tell(f"evo-cpg: {words}")
            command = next((word for word in sys.argv[1:] if not word.startswith("-")), "")
            if not stop.code and command not in _EVOLVING:
                raise SystemExit(ExitCode.WRONG_INPUT) from None
        if not interrupts.waits and isinstance(stop.code, int | None):
            leave_at_once(stop.code or 0)
        raise
