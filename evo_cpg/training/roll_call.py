"""Roll call: the processes of a team connect to their lead.

The lead, process 0, listens at the address of the team. Every other process connects and sends one
line: its number, and all values that must be equal, such as versions. When all are connected, the
lead answers each, and the connections stay open. If a process is missing or does not fit, all
connected processes receive its name and the reason.
"""

import contextlib
import json
import os
import socket
import time
from collections.abc import Container, Mapping, Sequence
from typing import Any, NamedTuple

from evo_cpg.errors import UserError

# Longest line, bytes. Our lines have a few hundred. A longer line comes from another program.
_LONGEST_LINE = 1 << 14

# Time between two attempts to reach the lead, s.
_PAUSE = 0.2

# Time for a connected process to send its line, s. The lead answers no other process meanwhile.
_SILENCE = 2.0

# Additional time to wait for the lead's answer, s, because the lead may have started later.
_LATER = 30.0


class JoinError(UserError):
    """Error of processes that cannot form a team. The message names the reason."""


class Place(NamedTuple):
    """Place of a process in a team.

    Attributes:
        index: number of the process, from 0. Process 0 is the lead.
        count: number of processes.
        host: host of the lead.
        port: port at which the lead listens.
        names: hosts of all processes, or empty if unknown.
    """

    index: int
    count: int
    host: str
    port: int
    names: Sequence[str] = ()

    @property
    def address(self) -> str:
        """Address of the lead."""
        return f"{self.host}:{self.port}"

    def name(self, index: int) -> str:
        """Return the name of a process, with its host if known."""
        return f"process {index}" + (f" ({self.names[index]})" if self.names else "")


def call_roll(place: Place, common: Mapping[str, str], timeout: float) -> dict[int, socket.socket]:
    """Connect the processes.

    Args:
        place: place of this process.
        common: values that must be equal in all processes, by name, such as versions.
        timeout: time that the processes have to connect, s.

    Returns:
        Connections by the number of the other process. The lead has one to each process. Every
        other process has one to the lead.

    Raises:
        JoinError: a process is missing or does not fit. All connected processes raise it.
    """
    if place.index == 0:
        return _lead(place, common, timeout)
    return {0: _follow(place, common, timeout)}


def _lead(place: Place, common: Mapping[str, str], timeout: float) -> dict[int, socket.socket]:
    end = time.monotonic() + timeout
    joined: list[socket.socket] = []
    connections: dict[int, socket.socket] = {}
    hellos: dict[int, dict[str, Any]] = {}
    with contextlib.ExitStack() as open_connections, _listen(place) as server:
        try:
            while len(hellos) < place.count - 1:
                server.settimeout(max(end - time.monotonic(), 0.001))
                try:
                    connection, _ = server.accept()
                except TimeoutError:
                    raise JoinError(_missing(place, hellos, timeout)) from None
                open_connections.enter_context(connection)
                hello = _read(connection, _SILENCE)
                if not _is_hello(hello):
                    connection.close()
                    continue
                joined.append(connection)
                _require_fit(place, common, hellos, hello)
                index = hello["index"]
                connections[index], hellos[index] = connection, hello
        except JoinError as error:
            for connection in joined:
                _send(connection, {"error": str(error)})
            raise
        for connection in joined:
            _send(connection, {"error": None})
        open_connections.pop_all()
    return connections


def _follow(place: Place, common: Mapping[str, str], timeout: float) -> socket.socket:
    host, process = socket.gethostname(), os.getpid()
    hello = {"index": place.index, "host": host, "id": process, "common": _common(place, common)}
    with contextlib.ExitStack() as open_connection:
        connection = open_connection.enter_context(_reach(place, timeout))
        _send(connection, hello)
        answer = _read(connection, timeout + _LATER)
        if answer.get("error"):
            raise JoinError(str(answer["error"]))
        if "error" not in answer:
            raise JoinError(
                f"the program that listens at {place.address} is not process 0, or process 0 "
                "ended while the processes joined. See its output"
            )
        open_connection.pop_all()
    return connection


def _listen(place: Place) -> socket.socket:
    both = socket.has_dualstack_ipv6()
    family = socket.AF_INET6 if both else socket.AF_INET
    try:
        return socket.create_server(
            ("", place.port), family=family, backlog=place.count, dualstack_ipv6=both
        )
    except OSError as error:
        raise JoinError(
            f"port {place.port} of this machine cannot be used ({_reason(error)}). Choose another "
            "port with the first host of --hosts: HOST:PORT"
        ) from None


def _reach(place: Place, timeout: float) -> socket.socket:
    end = time.monotonic() + timeout
    while True:
        try:
            return socket.create_connection((place.host, place.port), timeout=_SILENCE)
        except socket.gaierror:
            raise JoinError(f"the name of the lead's host is not known: {place.host}") from None
        except OSError as error:
            if time.monotonic() > end:
                raise JoinError(
                    f"process 0 did not answer within {timeout:g} s at {place.address} "
                    f"({_reason(error)}). Is it running, and does a firewall allow this port?"
                ) from None
            time.sleep(_PAUSE)


def _common(place: Place, common: Mapping[str, str]) -> dict[str, str]:
    """Return the values that must be equal in all processes."""
    return {**common, "the number of processes": str(place.count)}


def _missing(place: Place, present: Container[int], timeout: float) -> str:
    absent = [i for i in range(1, place.count) if i not in present]
    named = ", ".join(place.name(i) for i in absent[:5])
    more = f" and {len(absent) - 5} more" if len(absent) > 5 else ""
    return (
        f"{len(absent)} of {place.count} processes did not connect to {place.address} within "
        f"{timeout:g} s: {named}{more}. Allow more time with --join-timeout"
    )


def _require_fit(
    place: Place,
    common: Mapping[str, str],
    present: Mapping[int, dict[str, Any]],
    hello: Mapping[str, Any],
) -> None:
    """Check that a connected process fits into the team.

    Raises:
        JoinError: the process does not fit.
    """
    index, sender = hello["index"], f"on host {hello['host']} (process id {hello['id']})"
    for name, value in _common(place, common).items():
        if hello["common"].get(name) != value:
            raise JoinError(
                f"{name} differs between the processes: {value} in process 0, "
                f"{hello['common'].get(name)} in process {index} {sender}"
            )
    if not 0 < index < place.count:
        raise JoinError(
            f"the number of a process must be from 0 to {place.count - 1}, got {index} {sender}"
        )
    if index in present:
        other = present[index]
        raise JoinError(
            f"two processes have the number {index}: one {sender}, and one on host "
            f"{other['host']} (process id {other['id']})"
        )


def _is_hello(message: Mapping[str, Any]) -> bool:
    kinds = {"index": int, "host": str, "id": int, "common": dict}
    return all(isinstance(message.get(name), kind) for name, kind in kinds.items())


def _send(connection: socket.socket, message: Mapping[str, Any]) -> None:
    """Send a line. A process that has ended meanwhile is reported later, by its link."""
    with contextlib.suppress(OSError):
        connection.sendall(json.dumps(message).encode() + b"\n")


def _read(connection: socket.socket, timeout: float) -> dict[str, Any]:
    """Return the received object, or an empty one without a line in time, or if it is not ours.

    No byte after the line is read, as frames may follow.
    """
    connection.settimeout(timeout)
    line = bytearray()
    try:
        while not line.endswith(b"\n") and len(line) < _LONGEST_LINE:
            byte = connection.recv(1)
            if not byte:
                break
            line += byte
        message = json.loads(line)
    except (OSError, ValueError):
        return {}
    return message if isinstance(message, dict) else {}


def _reason(error: OSError) -> str:
    """Return the system's text of an error, without the address that Python may add."""
    return os.strerror(error.errno) if error.errno else str(error)
