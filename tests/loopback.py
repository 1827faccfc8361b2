"""Processes of this machine that act as several hosts."""

import socket


def free_port() -> int:
    """Return a free port. Another process may take it at any time."""
    with socket.create_server(("", 0)) as server:
        return server.getsockname()[1]


def loopback(count: int) -> str:
    """Return a value for `--hosts`."""
    return ",".join([f"localhost:{free_port()}", *["localhost"] * (count - 1)])
