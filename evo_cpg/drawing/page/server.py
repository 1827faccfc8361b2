"""The server of the drawing page, which only this page of the user's browser can use.

- It listens on 127.0.0.1, so no other machine reaches it.
- Every request needs the random token of the printed address. Other programs and pages lack it.
- ``Host`` and ``Origin`` must be this server, so a page with a name that leads here is refused.
- Bodies of requests are limited, and a connection that sends nothing is closed.
- The page may load and call nothing else (``Content-Security-Policy``).
"""

import http.server
import json
import math
import secrets
import socketserver
from http import HTTPStatus
from typing import Any
from urllib.parse import parse_qs, urlsplit

from evo_cpg.config.files import LARGEST
from evo_cpg.drawing.page.document import page, policy
from evo_cpg.drawing.session import Session

HOST = "127.0.0.1"
# Largest request other than a mesh file, bytes.
MOST_BYTES = 2**20
# Time without data after which a connection is closed, s.
_PATIENCE = 60.0
_JSON = "application/json"


class PageServer(socketserver.ThreadingMixIn, http.server.HTTPServer):
    """Server of one session.

    Args:
        session: the session.
        port: port, or 0 for a free one.

    Attributes:
        token: secret of the address.
    """

    daemon_threads = True
    allow_reuse_address = False

    def __init__(self, session: Session, port: int = 0):
        self.session, self.token = session, secrets.token_urlsafe(24)
        super().__init__((HOST, port), _Handler)

    @property
    def origin(self) -> str:
        """Scheme, host and port."""
        return f"http://{HOST}:{self.server_address[1]}"

    @property
    def address(self) -> str:
        """Address of the page, with the token."""
        return f"{self.origin}/?token={self.token}"

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore connections that the browser drops."""


class _Handler(http.server.BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    server_version, sys_version = "evo-cpg", ""
    timeout = _PATIENCE
    server: PageServer

    def do_GET(self) -> None:
        """Answer with the page, or the state of the try and the run."""
        place = urlsplit(self.path)
        token = parse_qs(place.query).get("token", [""])[0] if place.path == "/" else None
        if not self._is_allowed(token):
            return
        if place.path == "/":
            self._send(HTTPStatus.OK, "text/html; charset=utf-8", page().encode())
        elif place.path == "/poll":
            self._send_json(self.server.session.poll())
        else:
            self._refuse(HTTPStatus.NOT_FOUND, "there is no such page")

    def do_POST(self) -> None:
        """Answer a request of the session, or take a mesh file."""
        if not self._is_allowed(None):
            return
        place = urlsplit(self.path)
        upload = place.path == "/upload"
        body = self._body(LARGEST if upload else MOST_BYTES)
        if body is None:
            return
        if upload:
            name = parse_qs(place.query).get("name", [""])[0]
            self._send_json(self.server.session.upload(name, body))
            return
        try:
            given = json.loads(body or b"{}")
        except (ValueError, RecursionError):
            given = None
        if not isinstance(given, dict):
            self._refuse(HTTPStatus.BAD_REQUEST, "the request is not a JSON object")
            return
        session = self.server.session
        check = place.path == "/check"
        self._send_json(session.check() if check else session.answer(place.path[1:], given))

    def log_message(self, format: str, *args: Any) -> None:
        """Print nothing."""

    def _is_allowed(self, token: str | None) -> bool:
        """Return whether a request comes from the page, and refuse it if not.

        Args:
            token: token of the address, or None for the header's.
        """
        origin, host = self.server.origin, self.headers.get("Host", "")
        given = token if token is not None else self.headers.get("X-Token", "")
        own = self.headers.get("Sec-Fetch-Site", "none") in ("none", "same-origin")
        if f"http://{host}" != origin:
            self._refuse(HTTPStatus.FORBIDDEN, "wrong host")
        elif self.headers.get("Origin", origin) != origin or not own:
            self._refuse(HTTPStatus.FORBIDDEN, "wrong origin")
        elif not secrets.compare_digest(given.encode(), self.server.token.encode()):
            self._refuse(HTTPStatus.FORBIDDEN, "wrong token: open the printed address")
        else:
            return True
        return False

    def _body(self, most: int) -> bytes | None:
        """Return the body of a request, or refuse it."""
        length = self.headers.get("Content-Length", "")
        if not (length.isascii() and length.isdigit()):
            self._refuse(HTTPStatus.LENGTH_REQUIRED, "the request has no length")
        elif len(length) > len(str(most)) or int(length) > most:
            self._refuse(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"more than {most // 2**20} MiB")
        else:
            body = self.rfile.read(int(length))
            if len(body) == int(length):
                return body
            self._refuse(HTTPStatus.BAD_REQUEST, "the request is cut off")
        return None

    def _send_json(self, answer: Any) -> None:
        self._send(HTTPStatus.OK, _JSON, json.dumps(_finite(answer), allow_nan=False).encode())

    def _refuse(self, status: HTTPStatus, words: str) -> None:
        # The rest of the request was not read.
        self.close_connection = True
        self._send(status, _JSON, json.dumps({"error": words}).encode())

    def _send(self, status: HTTPStatus, kind: str, content: bytes) -> None:
        self.send_response(status)
        for name, value in {
            "Content-Type": kind,
            "Content-Length": str(len(content)),
            "Content-Security-Policy": policy(),
            "Cache-Control": "no-store",
            "Cross-Origin-Resource-Policy": "same-origin",
            "Cross-Origin-Opener-Policy": "same-origin",
            "Referrer-Policy": "no-referrer",
            "X-Content-Type-Options": "nosniff",
            "X-Frame-Options": "DENY",
        }.items():
            self.send_header(name, value)
        if self.close_connection:
            self.send_header("Connection", "close")
        self.end_headers()
        self.wfile.write(content)


def _finite(value: Any) -> Any:
    """Return JSON with null in place of numbers that are not finite."""
    if isinstance(value, dict):
        return {str(key): _finite(each) for key, each in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
