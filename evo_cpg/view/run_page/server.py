"""A server of one page, which only this page of the user's browser can use.

- It listens on 127.0.0.1, so no other machine reaches it.
- Every request needs the random token of the printed address. Other programs and pages lack it.
- ``Host`` and ``Origin`` must be this server, so a page with a name that leads here is refused.
- Bodies of requests are limited, and a connection that sends nothing is closed.
- The page may load and call nothing else (``Content-Security-Policy``).
"""

import http.server
import json
import math
import os
import secrets
import socketserver
import sys
import webbrowser
from collections.abc import Callable, Mapping
from http import HTTPStatus
from typing import Any
from urllib.parse import parse_qs, urlsplit

from evo_cpg.files import OutputError
from evo_cpg.io.trust import LARGEST
from evo_cpg.view.run_page.html import Page

HOST = "127.0.0.1"
# Time without data after which a connection is closed, s.
_PATIENCE = 60.0
# Largest request other than a file, bytes.
MOST_BYTES = 2**20
_JSON = "application/json"


class PageServer(socketserver.ThreadingMixIn, http.server.HTTPServer):
    """Server of one page.

    Args:
        page: the page.
        get: answer to a GET request as JSON, from its path and query, or None if there is none.
        post: answer to a POST request, from its path and its JSON object, if the page takes data.
        upload: answer to a file, from its name and content, which the page posts to ``/upload``.
        port: port, or 0 for a free one.

    Attributes:
        token: secret of the address.

    Raises:
        OutputError: the port cannot be used.
    """

    daemon_threads = True
    allow_reuse_address = False

    def __init__(
        self,
        page: Page,
        get: Callable[[str, Mapping[str, str]], Any],
        post: Callable[[str, dict[str, Any]], Any] | None = None,
        upload: Callable[[str, bytes], Any] | None = None,
        port: int = 0,
    ):
        self.page, self.token = page, secrets.token_urlsafe(24)
        self.get, self.post, self.upload = get, post, upload
        try:
            super().__init__((HOST, port), _PageHandler)
        except OSError as error:
            raise OutputError(f"port {port} cannot be used ({error.strerror or error})") from None

    @property
    def origin(self) -> str:
        """Scheme, host and port."""
        return f"http://{HOST}:{self.server_address[1]}"

    @property
    def address(self) -> str:
        """Address of the page, with the token."""
        return f"{self.origin}/?token={self.token}"

    @property
    def reach(self) -> str:
        """Advice on how to reach the page from another machine."""
        port = self.server_address[1]
        return (
            f"To open it on another machine, run `ssh -L {port}:{HOST}:{port} USER@THIS-MACHINE` "
            "there, and open the printed address there"
        )

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore connections that the browser drops. Print a fault of this program."""
        if not isinstance(sys.exception(), (ConnectionError, TimeoutError)):
            super().handle_error(request, client_address)


class _PageHandler(http.server.BaseHTTPRequestHandler):
    """Answers the requests of a page."""

    protocol_version = "HTTP/1.1"
    server_version, sys_version = "evo-cpg", ""
    timeout = _PATIENCE
    server: PageServer

    def do_GET(self) -> None:
        """Send the page, or an answer to it."""
        place = self.place()
        if place is None:
            return
        path, query = place
        if not self.is_allowed(query.get("token", "") if path == "/" else None):
            return
        if path == "/":
            self._send(HTTPStatus.OK, "text/html; charset=utf-8", self.server.page.text.encode())
            return
        answer = self.server.get(path, query)
        if answer is None:
            self.refuse(HTTPStatus.NOT_FOUND, "there is no such page")
        else:
            self.send_json(answer)

    def do_POST(self) -> None:
        """Answer a request of the page, or take a file."""
        post, upload = self.server.post, self.server.upload
        if post is None:
            self.refuse(HTTPStatus.NOT_IMPLEMENTED, "the page takes no data")
            return
        place = self.place() if self.is_allowed() else None
        if place is None:
            return
        path, query = place
        take = upload if path == "/upload" else None
        most = LARGEST if take else MOST_BYTES
        length = self.headers.get("Content-Length", "")
        if not (length.isascii() and length.isdigit()):
            self.refuse(HTTPStatus.LENGTH_REQUIRED, "the request has no length")
            return
        if len(length) > len(str(most)) or int(length) > most:
            self.refuse(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"more than {most // 2**20} MiB")
            return
        body = self.rfile.read(int(length))
        if len(body) < int(length):
            self.refuse(HTTPStatus.BAD_REQUEST, "the request is cut off")
            return
        if take:
            self.send_json(take(query.get("name", ""), body))
            return
        try:
            given = json.loads(body or b"{}")
        except (ValueError, RecursionError):
            given = None
        if isinstance(given, dict):
            self.send_json(post(path, given))
        else:
            self.refuse(HTTPStatus.BAD_REQUEST, "the request is not a JSON object")

    def log_message(self, format: str, *args: Any) -> None:
        """Print nothing."""

    def place(self) -> tuple[str, dict[str, str]] | None:
        """Return the path and the query of a request, or refuse a malformed address."""
        try:
            place = urlsplit(self.path)
        except ValueError:
            self.refuse(HTTPStatus.BAD_REQUEST, "the address is malformed")
            return None
        return place.path, {name: values[0] for name, values in parse_qs(place.query).items()}

    def is_allowed(self, token: str | None = None) -> bool:
        """Return whether a request comes from the page, and refuse it if not.

        Without a token of the address, the token of the header counts.
        """
        origin, host = self.server.origin, self.headers.get("Host", "")
        given = token if token is not None else self.headers.get("X-Token", "")
        own = self.headers.get("Sec-Fetch-Site", "none") in ("none", "same-origin")
        if f"http://{host}" != origin:
            words = f"the page answers only at {origin}, with this port. {self.server.reach}"
            self.refuse(HTTPStatus.FORBIDDEN, words)
        elif self.headers.get("Origin", origin) != origin or not own:
            self.refuse(HTTPStatus.FORBIDDEN, "wrong origin")
        elif not secrets.compare_digest(given.encode(), self.server.token.encode()):
            self.refuse(HTTPStatus.FORBIDDEN, "wrong token: open the printed address")
        else:
            return True
        return False

    def send_json(self, answer: Any) -> None:
        """Send an answer as JSON. Numbers that are not finite become null."""
        self._send(HTTPStatus.OK, _JSON, json.dumps(_finite(answer), allow_nan=False).encode())

    def refuse(self, status: HTTPStatus, words: str) -> None:
        """Send an error, and close the connection, because the request may not be read."""
        self.close_connection = True
        self._send(status, _JSON, json.dumps({"error": words}).encode())

    def _send(self, status: HTTPStatus, kind: str, content: bytes) -> None:
        self.send_response(status)
        for name, value in {
            "Content-Type": kind,
            "Content-Length": str(len(content)),
            "Content-Security-Policy": self.server.page.policy,
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


def opened(address: str) -> bool:
    """Open a page in the browser, if there is one and a display."""
    if sys.platform == "linux" and not ("DISPLAY" in os.environ or "WAYLAND_DISPLAY" in os.environ):
        return False
    return webbrowser.open(address)


def _finite(value: Any) -> Any:
    """Return JSON with null in place of numbers that are not finite."""
    if isinstance(value, dict):
        return {str(key): _finite(each) for key, each in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
