"""Connections between processes: frames, goodbyes, lost processes, and silence."""

import queue
import socket
import time

import pytest

from evo_cpg.training import link
from evo_cpg.training.link import Link


class End:
    """One end of a pair, with the reported reasons of a loss."""

    def __init__(self, connection: socket.socket, name: str):
        self.connection, self.reasons = connection, queue.SimpleQueue()
        self.link = Link(connection, name, self.reasons.put)


@pytest.fixture
def pair():
    with socket.create_server(("127.0.0.1", 0)) as server:
        first = socket.create_connection(server.getsockname())
        second, _ = server.accept()
    with first, second:
        yield first, second


def test_frames_arrive_in_order_and_complete(pair):
    a, b = (End(each, "the other") for each in pair)
    frames = [b"", b"one", bytes(range(256)) * 20_000]
    for frame in frames:
        a.link.send(frame)
        a.link.beat()
    assert [b.link.receive(10.0) for _ in frames] == frames
    with pytest.raises(queue.Empty):
        b.link.receive(0.01)


def test_a_process_that_leaves_is_not_lost(pair):
    a, b = (End(each, "the other") for each in pair)
    a.link.send(b"last")
    a.link.leave()
    a.connection.close()
    assert b.link.receive(10.0) == b"last"
    assert b.link.receive(10.0) is None
    b.link.send(b"to nobody")
    assert b.reasons.empty() and a.reasons.empty()


def test_a_process_that_ends_is_reported(pair):
    _, b = pair[0], End(pair[1], "process 7")
    pair[0].close()
    assert b.reasons.get(timeout=10.0) == "process 7 is gone"
    assert b.link.receive(10.0) is None


def test_a_reported_reason_arrives(pair):
    a, b = (End(each, "the other") for each in pair)
    a.link.report("process 3 is gone")
    assert b.reasons.get(timeout=10.0) == "process 3 is gone"


def test_a_silent_process_is_reported(pair, monkeypatch):
    monkeypatch.setattr(link, "SILENCE", 0.3)
    b = End(pair[1], "process 7")
    for _ in range(4):
        # Send heartbeats of the other end.
        pair[0].sendall(link._HEAD.pack(link._HEARTBEAT, 0))
        time.sleep(0.15)
    assert b.reasons.empty()
    told = b.reasons.get(timeout=10.0)
    assert told == "process 7 is dead or stopped: no heartbeat for 0.3 s"
