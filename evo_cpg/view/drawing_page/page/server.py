"""The server of the drawing page: requests of one session (see `evo_cpg.view.run_page.server`)."""

import json
from collections.abc import Mapping
from http import HTTPStatus
from typing import Any
from urllib.parse import parse_qs

from evo_cpg.io.trust import LARGEST
from evo_cpg.view.drawing_page.page.document import page
from evo_cpg.view.drawing_page.session import Session
from evo_cpg.view.run_page.server import PageHandler, PageServer

# Largest request other than a mesh file, bytes.
MOST_BYTES = 2**20


class DrawingServer(PageServer):
    """Server of one session.

    Args:
        session: the session.
        port: port, or 0 for a free one.
    """

    def __init__(self, session: Session, port: int = 0):
        self.session = session
        super().__init__(page(), _Handler, port)


class _Handler(PageHandler):
    server: DrawingServer  # pyright: ignore[reportIncompatibleVariableOverride]

    def answer(self, path: str, query: Mapping[str, list[str]]) -> Any:
        """Return the state of the try and the run."""
        return self.server.session.poll() if path == "/poll" else None

    def do_POST(self) -> None:
        """Answer a request of the session, or take a mesh file."""
        if not self.is_allowed():
            return
        place = self.place()
        if place is None:
            return
        upload = place.path == "/upload"
        body = self.body(LARGEST if upload else MOST_BYTES)
        if body is None:
            return
        if upload:
            name = parse_qs(place.query).get("name", [""])[0]
            self.send_json(self.server.session.upload(name, body))
            return
        try:
            given = json.loads(body or b"{}")
        except (ValueError, RecursionError):
            given = None
        if not isinstance(given, dict):
            self.refuse(HTTPStatus.BAD_REQUEST, "the request is not a JSON object")
            return
        session = self.server.session
        # Requests that change nothing do not wait for the others.
        reading = {"/check": session.check, "/live_page": session.live_page}.get(place.path)
        self.send_json(reading() if reading else session.answer(place.path[1:], given))
