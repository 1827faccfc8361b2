"""The server of a live page (see `evo_cpg.view.run_page.server`)."""

from collections.abc import Mapping
from typing import Any

from evo_cpg.view.live_page.following import Following
from evo_cpg.view.live_page.page.document import page
from evo_cpg.view.run_page.server import PageHandler, PageServer

# Numbers of what the page shows already (see `Following.answer`).
_KNOWN = ("chart", "motion", "wall", "tiles")


class LiveServer(PageServer):
    """Server of the page of one run.

    Args:
        run: the run.
        name: name of the run.
        port: port, or 0 for a free one.
    """

    def __init__(self, run: Following, name: str, port: int = 0):
        self.run = run
        super().__init__(page(name), _Handler, port)


class _Handler(PageHandler):
    server: LiveServer  # pyright: ignore[reportIncompatibleVariableOverride]

    def answer(self, path: str, query: Mapping[str, list[str]]) -> Any:
        """Return what is new since the page's last request."""
        if path != "/state":
            return None
        given = (query.get(name, [""])[0] for name in _KNOWN)
        return self.server.run.answer(*(int(each) if each.isdecimal() else 0 for each in given))
