"""Connection to another process of a team: frames of bytes, and heartbeats between them.

The operating system reports a process that has ended. It does not report a process that is
stopped, or a machine or network that is gone. So each end sends a heartbeat every `BEAT` seconds,
and an end that receives nothing for `SILENCE` seconds reports that the other process is lost.
"""

import contextlib
import queue
import socket
import struct
import threading
from collections.abc import Callable

BEAT = 2.0
"""Time between two heartbeats, s."""

SILENCE = 18.0
"""Time without any byte after which the other process counts as dead or stopped, s. It is shorter
than the patience of a team, so that the report names the process."""

# Header of a frame: its kind, and the length of its content, bytes.
_HEAD = struct.Struct("<BQ")
_DATA, _HEARTBEAT, _LOST, _GOODBYE = range(4)

# Number of bytes that are sent at a time. Sending one such piece may take up to `SILENCE` seconds.
_PIECE = 1 << 20


class Link:
    """One end of a connection.

    Args:
        connection: connection to the other process.
        name: name of the other process.
        on_lost: called with the reason, in a thread of the link, if the other process is lost.
    """

    def __init__(self, connection: socket.socket, name: str, on_lost: Callable[[str], object]):
        connection.settimeout(SILENCE)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._connection, self._name, self._on_lost = connection, name, on_lost
        self._incoming = connection.makefile("rb")
        self._sending = threading.Lock()
        self._frames: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
        self._left = False
        threading.Thread(target=self._read, name=f"link to {name}", daemon=True).start()

    def send(self, content: bytes) -> None:
        """Send a frame. No error is raised: the link reports a lost process by `on_lost`."""
        self._send(_DATA, content)

    def receive(self, timeout: float) -> bytes | None:
        """Return the next frame, or None if the other process has left or is lost.

        Raises:
            queue.Empty: no frame arrives in time.
        """
        return self._frames.get(timeout=timeout)

    def beat(self) -> None:
        """Send a heartbeat."""
        self._send(_HEARTBEAT)

    def report(self, why: str) -> None:
        """Send the reason why the team cannot continue."""
        self._send(_LOST, why.encode())

    def leave(self) -> None:
        """Send a goodbye. After this, an end of the other process is not reported as a loss."""
        self._left = True
        self._send(_GOODBYE)

    def _send(self, kind: int, content: bytes = b"") -> None:
        frame = memoryview(_HEAD.pack(kind, len(content)) + content)
        with self._sending, contextlib.suppress(OSError):
            for start in range(0, len(frame), _PIECE):
                self._connection.sendall(frame[start : start + _PIECE])

    def _read(self) -> None:
        why = self._listen()
        if why is not None and not self._left:
            self._on_lost(why)
        self._frames.put(None)

    def _listen(self) -> str | None:
        """Receive frames until the connection ends. Return the reason, or None after a goodbye."""
        try:
            while True:
                kind, length = _HEAD.unpack(self._take(_HEAD.size))
                content = self._take(length)
                if kind == _DATA:
                    self._frames.put(content)
                elif kind == _LOST:
                    return content.decode(errors="replace")
                elif kind == _GOODBYE:
                    return None
        except TimeoutError:
            return f"{self._name} is dead or stopped: no heartbeat for {SILENCE:g} s"
        except (EOFError, OSError):
            return f"{self._name} is gone"

    def _take(self, count: int) -> bytes:
        content = self._incoming.read(count)
        if len(content) < count:
            raise EOFError
        return content
