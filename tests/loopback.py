"""Processes of this machine that take each other for hosts."""

import socket


def free_port() -> int:
    """A port that nobody uses; somebody may the moment after."""
    with socket.create_server(("", 0)) as server:
        return server.getsockname()[1]


def loopback(count: int) -> str:
    """A list for `--hosts`."""
    return ",".join([f"localhost:{free_port()}", *["localhost"] * (count - 1)])
