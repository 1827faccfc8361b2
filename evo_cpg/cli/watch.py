"""`evo-cpg watch`: follow a run while it evolves.

The command reads the files that the trainer writes after every generation, and requests nothing of
the trainer. It writes nothing to the run folder.
"""

import contextlib
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from evo_cpg.cli.completion import complete_folder
from evo_cpg.cli.errors import UsageError, tell
from evo_cpg.cli.interrupts import wait_for_no_thread
from evo_cpg.cli.options import Browser, Port
from evo_cpg.cli.streams import is_read

if TYPE_CHECKING:
    from evo_cpg.view.live_page.standing import Standing

# Interval between two checks of the folder, s.
LOOK = 1.0


def watch(
    run: Annotated[
        Path,
        typer.Argument(
            metavar="RUN",
            help="A run folder made by `train`.",
            autocompletion=complete_folder,
        ),
    ],
    once: Annotated[
        bool, typer.Option("--once", help="Print the present state, then exit.")
    ] = False,
    page: Annotated[
        bool,
        typer.Option(
            "--page",
            help="Show the run on a page in the browser: the champion in 3D, curves, and the "
            "population. RUN may not exist yet.",
        ),
    ] = False,
    port: Port = 0,
    browser: Browser = True,
) -> None:
    """Follow a run while it evolves."""
    if page:
        if once:
            raise UsageError("--once and --page exclude each other. Leave out one of them")
        _on_a_page(run, port, browser)
        return
    _in_lines(run, once)


def _on_a_page(run: Path, port: int, browser: bool) -> None:
    """Serve the live page until Control-C."""
    from evo_cpg.system import resolved
    from evo_cpg.training.run_folder import RunFolder
    from evo_cpg.view.live_page.following import Following
    from evo_cpg.view.live_page.server import live_server
    from evo_cpg.view.run_page.server import opened

    followed = Following(RunFolder(run), lambda words: print(words, flush=True))
    # A thread may compile for long, or wait in JAX.
    wait_for_no_thread()
    with live_server(followed, resolved(run).name, port) as server:
        print(f"{run}: open this address in a browser of this machine")
        print(server.address)
        print("Control-C ends the program.", flush=True)
        if browser and not opened(server.address):
            tell(f"No browser was found. Open the address yourself. {server.reach}.")
        followed.start()
        with contextlib.suppress(KeyboardInterrupt):
            server.serve_forever()
        followed.close()


def _in_lines(run: Path, once: bool) -> None:
    """Print a line for each generation until the run is finished, or only the present lines."""
    from evo_cpg.cli.run_names import find_run
    from evo_cpg.training.run_folder import RunFolder
    from evo_cpg.view.live_page.standing import require_run, standing

    folder = RunFolder(find_run(run))
    require_run(folder)
    seen: Standing | None = None
    printed = 0
    while True:
        now = standing(folder, seen)
        if now is not seen or once:
            history = now.checkpoint.history if now.checkpoint else []
            for row in [row for row in history if row["generation"] >= printed]:
                print(_line(row, now), flush=True)
            if history:
                printed = int(history[-1]["generation"]) + 1
            elif once:
                print(f"{folder.path}: no generation is finished yet", flush=True)
            seen = now
        if once or now.finished or not is_read():
            return
        time.sleep(LOOK)


def _line(row: dict[str, float], now: "Standing") -> str:
    run = f"  run {int(row['run'])}" if "run" in row else ""
    return (
        f"{int(row['generation']) + 1:4d}/{now.generations} generations{run}  "
        f"champion {row['champion']:8.4f}  best {row['best']:8.4f}  mean {row['mean']:8.4f}  "
        f"{row['seconds']:6.2f} s"
    )
