"""Processes that connect, or do not, and the errors of each. Threads play the processes."""

import json
import socket
import threading
import time

import pytest

from evo_cpg.training.roll_call import JoinError, Place, call_roll
from loopback import free_port

COMMON = {"the version of jax": "1.2"}


def meet(*members: tuple[int, int, dict], port: int, timeout: float = 5.0, names=()) -> list:
    """Return the connections or the error text of each member: number, count, common values."""
    results: list = [None] * len(members)

    def one(place: int, index: int, count: int, common: dict) -> None:
        try:
            results[place] = call_roll(
                Place(index, count, "localhost", port, names), common, timeout
            )
        except JoinError as error:
            results[place] = str(error)

    threads = [
        threading.Thread(target=one, args=(place, *member)) for place, member in enumerate(members)
    ]
    for thread in threads:
        thread.start()
        # The pause fixes the order in which they connect.
        time.sleep(0.1)
    for thread in threads:
        thread.join()
    return results


def test_the_lead_is_connected_to_all():
    second, lead, first = meet((2, 3, COMMON), (0, 3, COMMON), (1, 3, COMMON), port=free_port())
    assert sorted(lead) == [1, 2] and list(first) == list(second) == [0]
    for index, other in ((1, first), (2, second)):
        # A frame that follows the lead's answer at once is not lost.
        lead[index].sendall(bytes([index]))
        other[0].sendall(bytes([10 + index]))
        assert (other[0].recv(9), lead[index].recv(9)) == (bytes([index]), bytes([10 + index]))
    for connection in (*lead.values(), first[0], second[0]):
        connection.close()


def test_a_missing_process_is_named():
    names = ("ant", "bee", "cat")
    lead, other = meet((0, 3, COMMON), (1, 3, COMMON), port=free_port(), timeout=0.6, names=names)
    assert "1 of 3 processes did not connect to localhost:" in lead
    assert "within 0.6 s: process 2 (cat). Allow more time with --join-timeout" in lead
    assert other == lead


def test_many_missing_processes_are_counted():
    (lead,) = meet((0, 9, COMMON), port=free_port(), timeout=0.2)
    assert "process 1, process 2, process 3, process 4, process 5 and 3 more" in lead


def test_a_missing_lead_is_named():
    (other,) = meet((1, 2, COMMON), port=free_port(), timeout=0.3)
    assert "process 0 did not answer within 0.3 s at localhost:" in other


def test_an_unknown_host_is_named():
    with pytest.raises(
        JoinError, match=r"name of the lead's host is not known: no-such-host\.invalid"
    ):
        call_roll(Place(1, 2, "no-such-host.invalid", 4000), COMMON, 1.0)


def test_a_port_in_use_is_named():
    with socket.create_server(("", 0)) as server:
        port = server.getsockname()[1]
        with pytest.raises(
            JoinError, match=rf"port {port} of this machine cannot be used \(Address already in use"
        ):
            call_roll(Place(0, 2, "localhost", port), COMMON, 1.0)


def test_a_listener_that_is_not_the_lead_is_named():
    with socket.create_server(("127.0.0.1", 0)) as server:

        def hang_up() -> None:
            server.accept()[0].close()

        threading.Thread(target=hang_up, daemon=True).start()
        place = Place(1, 2, "127.0.0.1", server.getsockname()[1])
        with pytest.raises(
            JoinError, match="is not process 0, or process 0 ended while the processes"
        ):
            call_roll(place, COMMON, 1.0)


def test_a_duplicate_number_is_refused():
    lead, first, second = meet((0, 3, COMMON), (1, 3, COMMON), (1, 3, COMMON), port=free_port())
    assert lead == first == second
    assert lead.startswith("two processes have the number 1: one on host ")


def test_a_number_beyond_the_last_is_refused():
    lead, other = meet((0, 2, COMMON), (2, 2, COMMON), port=free_port())
    assert lead == other
    assert lead.startswith("the number of a process must be from 0 to 1, got 2 on host ")


def test_different_counts_are_refused():
    lead, other = meet((0, 2, COMMON), (1, 3, COMMON), port=free_port())
    assert lead == other
    assert lead.startswith(
        "the number of processes differs between the processes: 2 in process 0, 3 in process 1 "
    )


def test_different_versions_are_refused():
    lead, other = meet((0, 2, COMMON), (1, 2, {"the version of jax": "1.3"}), port=free_port())
    assert lead == other
    assert lead.startswith(
        "the version of jax differs between the processes: 1.2 in process 0, 1.3 in process 1 "
    )


def test_other_programs_are_not_counted():
    port = free_port()

    def disturb() -> None:
        end = time.monotonic() + 5
        for line in (b"GET / HTTP/1.1\r\n", json.dumps({"index": "1"}).encode() + b"\n", b""):
            while time.monotonic() < end:
                try:
                    with socket.create_connection(("localhost", port), timeout=1) as stranger:
                        stranger.sendall(line)
                    break
                except OSError:
                    time.sleep(0.02)

    stranger = threading.Thread(target=disturb)
    stranger.start()
    lead, other = meet((0, 2, COMMON), (1, 2, COMMON), port=port)
    stranger.join()
    assert list(lead) == [1] and list(other) == [0]
    lead[1].close()
    other[0].close()
