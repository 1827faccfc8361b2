"""The page on which a creature is drawn: one document with its scripts inside, and its server."""

from collections.abc import Mapping
from typing import Any

from evo_cpg.view.drawing_page.session import DrawingSession
from evo_cpg.view.run_page.html import asset, whole_page
from evo_cpg.view.run_page.server import PageServer


def drawing_server(session: DrawingSession, port: int = 0) -> PageServer:
    """Return the server of a session, on a free port if it is 0."""
    body, style, *own = (
        asset(name, "evo_cpg.view.drawing_page")
        for name in ("page.html", "page.css", "view.js", "forms.js", "page.js")
    )
    shared = [asset(name) for name in ("three.min.js", "animal.js")]
    page = whole_page("evo-cpg model", style, body, [*shared, *own], is_served=True)

    def get(path: str, query: Mapping[str, str]) -> Any:
        return session.poll() if path == "/poll" else None

    def post(path: str, given: dict[str, Any]) -> Any:
        # Requests that change nothing do not wait for the others.
        if path == "/check":
            return session.check()
        if path == "/prepare":
            return session.prepare()
        if path == "/live_page":
            return session.live_page()
        return session.answer(path[1:], given)

    return PageServer(page, get, post, session.upload, port)
