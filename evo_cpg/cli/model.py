"""`evo-cpg model`: draw a creature on a page in the browser."""

import itertools
from pathlib import Path
from typing import Annotated

import typer

from evo_cpg.cli.completion import complete_config
from evo_cpg.cli.errors import tell
from evo_cpg.cli.options import Browser, Port


def model(
    config: Annotated[
        Path | None,
        typer.Argument(
            metavar="CONFIG",
            help="A YAML configuration file, a new one, or the name of one that `evo-cpg configs` "
            "lists, which is copied (default: a new animal.yaml).",
            autocompletion=complete_config,
        ),
    ] = None,
    port: Port = 0,
    browser: Browser = True,
) -> None:
    """Draw a creature on a page in the browser."""
    from evo_cpg.cli.advice import about_oscillators
    from evo_cpg.view.drawing_page.server import drawing_server
    from evo_cpg.view.drawing_page.session import Session
    from evo_cpg.view.run_page.server import opened

    document = _document(config)
    session = Session(document, about_oscillators)
    with drawing_server(session, port) as server:
        print(f"{document.path}: open this address in a browser of this machine")
        print(server.address)
        print("Control-C ends the program.", flush=True)
        if browser and not opened(server.address):
            tell(f"No browser was found. Open the address yourself. {server.reach}.")
        try:
            server.serve_forever()
        except KeyboardInterrupt:
            pass
        finally:
            session.close()
    if document.is_changed and document.can_undo:
        print(f"Edits of {document.path} are not saved. `evo-cpg model` offers them again.")


def _document(config: Path | None):
    """Open, copy or begin a document."""
    from evo_cpg.io.shipped import find_config
    from evo_cpg.view.drawing_page.document import Document

    if config is None:
        return Document.new(_free("animal"))
    if config.exists():
        return Document.open(config)
    if config.suffix in (".yaml", ".yml"):
        from evo_cpg.files import require_place

        return Document.new(require_place(config))
    shipped = find_config(config)
    return Document.copy_of(shipped, _free(shipped.stem))


def _free(stem: str) -> Path:
    """Return a .yaml file that does not exist: of this name, or with a number."""
    names = itertools.chain([stem], (f"{stem}{i}" for i in itertools.count(2)))
    return next(path for name in names if not (path := Path(f"{name}.yaml")).exists())
