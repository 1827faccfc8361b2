"""Who is there: the processes of a team find each other before JAX starts.

When the time to join is up, JAX ends the process from C++ and cannot say who is missing; a port in
use and a number given twice end likewise (JAX 0.10.2). So the lead, process 0, listens at the
team's address first, and every other process sends it one line: its number, and what all must have
in common. When all are there the lead answers each with where JAX's own service will be.
"""

import contextlib
import json
import os
import socket
import time
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from evo_cpg.errors import UserError

# Lines are a few hundred bytes; what is longer comes from somebody else.
_LONGEST_LINE = 1 << 14

# Between two attempts to reach the lead, s.
_PAUSE = 0.2

# So long may somebody who has connected say nothing, s. Others wait meanwhile.
_SILENCE = 2.0

# The lead may have begun to wait later than the others; so much longer they wait for it, s.
_LATER = 30.0


class JoinError(UserError):
    """Processes that cannot become a team; the message says why."""


class Place(NamedTuple):
    """A process's place in a team.

    Attributes:
        index: its number, from 0; 0 is the lead.
        count: processes in all.
        host: of the lead.
        port: at which the lead listens.
        names: of the hosts of all processes; empty where they are not known.
    """

    index: int
    count: int
    host: str
    port: int
    names: Sequence[str] = ()

    @property
    def address(self) -> str:
        """Of the lead, in words."""
        return f"{self.host}:{self.port}"

    def name(self, index: int) -> str:
        """Of a process, with its host where that is known."""
        return f"process {index}" + (f" ({self.names[index]})" if self.names else "")


class Meeting(NamedTuple):
    """What comes of the roll call.

    Attributes:
        service: host and port of the service that JAX starts in the lead.
        own: address at which the other processes reach this one.
    """

    service: str
    own: str


class _Present(NamedTuple):
    connection: socket.socket
    told: dict[str, Any]


def call_roll(place: Place, common: Mapping[str, str], timeout: float) -> Meeting:
    """Meet the other processes.

    Args:
        place: of this process.
        common: what must be equal in all processes, by name, such as versions.
        timeout: so long they may take to come, s.

    Raises:
        JoinError: in all processes that came, where one did not, or they do not fit together.
    """
    if place.index == 0:
        return _lead(place, common, timeout)
    return _follow(place, common, timeout)


def free_port() -> int:
    """A port of this machine that nobody listens at."""
    with socket.create_server(("", 0)) as server:
        return server.getsockname()[1]


def _lead(place: Place, common: Mapping[str, str], timeout: float) -> Meeting:
    end = time.monotonic() + timeout
    present: dict[int, _Present] = {}
    with contextlib.ExitStack() as open_connections, _listen(place) as server:
        while len(present) < place.count - 1:
            server.settimeout(max(end - time.monotonic(), 0.001))
            try:
                connection, _ = server.accept()
            except TimeoutError:
                _refuse(present, _missing(place, present, timeout))
            open_connections.enter_context(connection)
            told = _read(connection, _SILENCE)
            if not _is_hello(told):
                continue
            new = _Present(connection, told)
            wrong = _misfit(place, common, present, told)
            if wrong:
                _refuse({**present, -1: new}, wrong)
            present[told["index"]] = new
        port = free_port()
        outer = [_plain(one.connection.getsockname()[0]) for one in present.values()]
        # Who came from this machine may have come to an address that other machines cannot reach.
        own = next((address for address in outer if not _is_loopback(address)), outer[0])
        for one in present.values():
            theirs = _plain(one.connection.getpeername()[0])
            _send(one.connection, {"port": port, "own": own if _is_loopback(theirs) else theirs})
    return Meeting(_joined(place.host, port), own)


def _follow(place: Place, common: Mapping[str, str], timeout: float) -> Meeting:
    hello = {
        "index": place.index,
        "count": place.count,
        "host": socket.gethostname(),
        "id": os.getpid(),
        "common": dict(common),
    }
    with _reach(place, timeout) as connection:
        _send(connection, hello)
        answer = _read(connection, timeout + _LATER)
    if "error" in answer:
        raise JoinError(str(answer["error"]))
    if not {"port", "own"} <= answer.keys():
        raise JoinError(
            f"who listens at {place.address} is not process 0, or that ended while the processes "
            "joined: see what it says"
        )
    return Meeting(_joined(place.host, answer["port"]), answer["own"])


def _listen(place: Place) -> socket.socket:
    both = socket.has_dualstack_ipv6()
    family = socket.AF_INET6 if both else socket.AF_INET
    try:
        return socket.create_server(
            ("", place.port), family=family, backlog=place.count, dualstack_ipv6=both
        )
    except OSError as error:
        raise JoinError(
            f"port {place.port} of this machine cannot be used ({_reason(error)}); the first "
            "host of --hosts may name another one: HOST:PORT"
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
                    f"process 0 did not come within {timeout:g} s: nobody answers at "
                    f"{place.address} ({_reason(error)}); is it started, and does a "
                    "firewall let this port through?"
                ) from None
            time.sleep(_PAUSE)


def _missing(place: Place, present: Mapping[int, _Present], timeout: float) -> str:
    absent = [i for i in range(1, place.count) if i not in present]
    named = ", ".join(place.name(i) for i in absent[:5])
    more = f" and {len(absent) - 5} more" if len(absent) > 5 else ""
    return (
        f"of {place.count} processes {len(absent)} did not come to {place.address} within "
        f"{timeout:g} s: {named}{more}; --join-timeout allows them longer"
    )


def _misfit(
    place: Place,
    common: Mapping[str, str],
    present: Mapping[int, _Present],
    told: Mapping[str, Any],
) -> str | None:
    """What is wrong with somebody who came."""
    index, who = told["index"], f"the one of {told['host']} (process id {told['id']})"
    if told["count"] != place.count:
        return (
            f"the processes do not agree on how many they are: {place.count} says process 0, "
            f"{told['count']} says process {index}, {who}"
        )
    if not 0 < index < place.count:
        return f"there is no process {index} among {place.count}, counted from 0: {who}"
    if index in present:
        other = present[index].told
        return (
            f"two processes have the number {index}: {who} and the one of {other['host']} "
            f"(process id {other['id']})"
        )
    for name, value in common.items():
        if told["common"].get(name) != value:
            return (
                f"{name} differs between the processes: {value} in process 0, "
                f"{told['common'].get(name)} in process {index}, {who}"
            )
    return None


def _refuse(present: Mapping[int, _Present], why: str) -> None:
    """Tell everybody who came, and give up."""
    for one in present.values():
        with contextlib.suppress(OSError):
            _send(one.connection, {"error": why})
    raise JoinError(why)


def _is_hello(told: Mapping[str, Any]) -> bool:
    kinds = {"index": int, "count": int, "host": str, "id": int, "common": dict}
    return all(isinstance(told.get(name), kind) for name, kind in kinds.items())


def _send(connection: socket.socket, told: Mapping[str, Any]) -> None:
    connection.sendall(json.dumps(told).encode() + b"\n")


def _read(connection: socket.socket, timeout: float) -> dict[str, Any]:
    """The line that comes; empty where it does not come, or is none of ours."""
    connection.settimeout(timeout)
    try:
        with connection.makefile("rb") as lines:
            told = json.loads(lines.readline(_LONGEST_LINE))
    except (OSError, ValueError):
        return {}
    return told if isinstance(told, dict) else {}


def _reason(error: OSError) -> str:
    """In the system's words; Python adds the address to some."""
    return os.strerror(error.errno) if error.errno else str(error)


def _plain(address: str) -> str:
    """An address of IPv4 that came over IPv6, as it is."""
    return address.removeprefix("::ffff:")


def _is_loopback(address: str) -> bool:
    return address.startswith("127.") or address == "::1"


def _joined(host: str, port: int) -> str:
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
