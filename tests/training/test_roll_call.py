"""Processes that come together, or do not, and what each is told; threads stand for them."""

import json
import socket
import threading
import time

import pytest

from evo_cpg.training.roll_call import JoinError, Place, call_roll
from loopback import free_port

COMMON = {"the version of jax": "1.2"}


def meet(*members: tuple[int, int, dict], port: int, timeout: float = 5.0, names=()) -> list:
    """What comes of each member: the number, the count and what it has; an error as its words."""
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
        # In this order, so that it is known who comes second.
        time.sleep(0.1)
    for thread in threads:
        thread.join()
    return results


def test_the_lead_is_connected_to_all():
    second, lead, first = meet((2, 3, COMMON), (0, 3, COMMON), (1, 3, COMMON), port=free_port())
    assert sorted(lead) == [1, 2] and list(first) == list(second) == [0]
    for index, other in ((1, first), (2, second)):
        # A frame that follows the lead's answer at once is not swallowed.
        lead[index].sendall(bytes([index]))
        other[0].sendall(bytes([10 + index]))
        assert (other[0].recv(9), lead[index].recv(9)) == (bytes([index]), bytes([10 + index]))
    for connection in (*lead.values(), first[0], second[0]):
        connection.close()


def test_who_did_not_come_is_said_by_name():
    names = ("ant", "bee", "cat")
    lead, other = meet((0, 3, COMMON), (1, 3, COMMON), port=free_port(), timeout=0.6, names=names)
    assert "of 3 processes 1 did not come to localhost:" in lead
    assert "within 0.6 s: process 2 (cat); --join-timeout allows them longer" in lead
    assert other == lead


def test_many_who_did_not_come_are_counted():
    (lead,) = meet((0, 9, COMMON), port=free_port(), timeout=0.2)
    assert "process 1, process 2, process 3, process 4, process 5 and 3 more" in lead


def test_a_lead_that_does_not_come():
    (other,) = meet((1, 2, COMMON), port=free_port(), timeout=0.3)
    assert "process 0 did not come within 0.3 s: nobody answers at localhost:" in other


def test_a_host_that_nobody_knows():
    with pytest.raises(
        JoinError, match=r"name of the lead's host is not known: no-such-host\.invalid"
    ):
        call_roll(Place(1, 2, "no-such-host.invalid", 4000), COMMON, 1.0)


def test_a_port_in_use():
    with socket.create_server(("", 0)) as server:
        port = server.getsockname()[1]
        with pytest.raises(
            JoinError, match=rf"port {port} of this machine cannot be used \(Address already in use"
        ):
            call_roll(Place(0, 2, "localhost", port), COMMON, 1.0)


def test_who_listens_is_not_the_lead():
    with socket.create_server(("127.0.0.1", 0)) as server:

        def hang_up() -> None:
            server.accept()[0].close()

        threading.Thread(target=hang_up, daemon=True).start()
        place = Place(1, 2, "127.0.0.1", server.getsockname()[1])
        with pytest.raises(
            JoinError, match="is not process 0, or process 0 ended while the processes"
        ):
            call_roll(place, COMMON, 1.0)


def test_a_number_given_twice():
    lead, first, second = meet((0, 3, COMMON), (1, 3, COMMON), (1, 3, COMMON), port=free_port())
    assert lead == first == second
    assert lead.startswith("two processes have the number 1: the one of ")


def test_a_number_beyond_the_last():
    lead, other = meet((0, 2, COMMON), (2, 2, COMMON), port=free_port())
    assert lead == other
    assert lead.startswith("there is no process 2 among 2, counted from 0: the one of ")


def test_different_counts():
    lead, other = meet((0, 2, COMMON), (1, 3, COMMON), port=free_port())
    assert lead == other
    assert lead.startswith(
        "the number of processes differs between the processes: 2 in process 0, 3 in process 1, "
    )


def test_different_versions():
    lead, other = meet((0, 2, COMMON), (1, 2, {"the version of jax": "1.3"}), port=free_port())
    assert lead == other
    assert lead.startswith(
        "the version of jax differs between the processes: 1.2 in process 0, 1.3 in process 1, "
    )


def test_strangers_are_not_counted():
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
