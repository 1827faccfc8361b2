"""Lists of hosts: read `--hosts`, and find this machine in the list."""

import re
import socket
from collections.abc import Sequence
from pathlib import Path

from evo_cpg.cli.errors import UsageError
from evo_cpg.training.roll_call import Place

# Default port of the lead, from the range of unregistered ports.
DEFAULT_PORT = 61440

_LARGEST_PORT = 65535


def place_in(text: str, process: int | None = None) -> Place:
    """Return the place of this process in a list of hosts.

    Args:
        text: ``HOST[:PORT],HOST,...``, or a file with a host on each line. The first host leads.
        process: number of this process, or None to find the number by the name of the host.

    Raises:
        UsageError: the list is malformed, or does not determine the number of this process.
    """
    words = _words(text)
    host, port = _parted(words[0])
    names = [host, *(_name(word, number) for number, word in enumerate(words[1:], 2))]
    if process is None:
        process = _own(names)
    if not 0 <= process < len(names):
        raise UsageError(
            f"--process {process}: --hosts names {len(names)} process(es), counted from 0"
        )
    return Place(process, len(names), host, port, tuple(names))


def _words(text: str) -> list[str]:
    path = Path(text)
    if path.is_file():
        lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
        words = [line.partition("#")[0].strip() for line in lines]
        words = [word for word in words if word]
        if not words:
            raise UsageError(f"--hosts: {text} names no host. Write one on each line")
        return words
    words = [word.strip() for word in text.split(",")]
    if "" in words:
        raise UsageError(
            f"--hosts {text}: a name is missing before or after a comma. "
            "Write HOST[:PORT],HOST,... or the name of a file"
        )
    return words


def _parted(word: str) -> tuple[str, int]:
    """Return host and port of the lead. An IPv6 address with a port needs brackets."""
    bracketed = word.startswith("[")
    form = r"\[([^]]*)\](?::(.*))?" if bracketed else r"([^:]*)(?::([^:]*))?"
    match = re.fullmatch(form, word)
    if match is None and bracketed:
        raise UsageError(f"--hosts: {word}: write an address in brackets as [HOST]:PORT")
    # Any other word with several colons is an IPv6 address without a port.
    host, port = match.groups() if match else (word, None)
    host = _name(host, 1)
    if port is None:
        return host, DEFAULT_PORT
    if not (port.isascii() and port.isdigit() and 0 < int(port) <= _LARGEST_PORT):
        raise UsageError(f"--hosts: {word}: the port must be from 1 to {_LARGEST_PORT}")
    return host, int(port)


def _name(word: str, number: int) -> str:
    if not word or any(character.isspace() or character in "/@,;=" for character in word):
        raise UsageError(f"--hosts: host {number} is {word!r}, which is not the name of a host")
    if word.count(":") == 1:
        raise UsageError(f"--hosts: {word}: only the first host, the lead, may have a port")
    return word


def _own(names: Sequence[str]) -> int:
    """Return the index of the only host that is this machine."""
    found = [index for index, name in enumerate(names) if _is_here(name)]
    if len(found) == 1:
        return found[0]
    if not found:
        raise UsageError(
            f"--hosts: none of {', '.join(names[:8])} is this machine, {socket.gethostname()}. "
            "Give the place of this process with --process I, counted from 0"
        )
    raise UsageError(
        f"--hosts: {len(found)} of them are this machine, {', '.join(names[i] for i in found[:8])}."
        " Give the place of this process with --process I, counted from 0"
    )


def _is_here(name: str) -> bool:
    """Return whether a host is this machine: a socket can be bound to one of its addresses."""
    if name == socket.gethostname():
        return True
    try:
        known = socket.getaddrinfo(name, 0, type=socket.SOCK_DGRAM)
    except (OSError, UnicodeError):
        return False
    for family, kind, protocol, _, address in known:
        try:
            with socket.socket(family, kind, protocol) as tried:
                tried.bind(address)
        except OSError:
            continue
        return True
    return False
