"""Lists of hosts for `--hosts`."""

import re
import socket

import pytest

from evo_cpg.cli.errors import UsageError
from evo_cpg.cli.hosts import DEFAULT_PORT, place_in

HERE = socket.gethostname()


def test_a_process_finds_itself_by_name_and_by_address():
    place = place_in(f"nowhere.invalid,{HERE},also-nowhere.invalid")
    assert (place.index, place.count) == (1, 3)
    assert (place.host, place.port) == ("nowhere.invalid", DEFAULT_PORT)
    assert place.address == f"nowhere.invalid:{DEFAULT_PORT}"
    # No machine has this address, which is reserved for documentation.
    assert place_in("192.0.2.7:4000,127.0.0.1").index == 1


def test_a_file_of_hosts_has_one_on_each_line(tmp_path):
    file = tmp_path / "hosts"
    file.write_text("first:5000  # leads\n\n# a comment\nsecond\n third \n")
    place = place_in(str(file), 2)
    assert (place.index, place.host, place.port) == (2, "first", 5000)
    assert list(place.names) == ["first", "second", "third"]
    assert place.name(1) == "process 1 (second)"


@pytest.mark.parametrize(
    ("text", "host", "port"),
    [
        ("[::1]:5000,b", "::1", 5000),
        ("[::1],b", "::1", DEFAULT_PORT),
        ("fe80::1,b", "fe80::1", DEFAULT_PORT),
    ],
)
def test_only_ipv6_addresses_in_brackets_have_a_port(text, host, port):
    assert place_in(text, 0)[2:4] == (host, port)


@pytest.mark.parametrize(
    ("text", "process", "words"),
    [
        ("a,,b", 0, "--hosts a,,b: a name is missing before or after a comma. Write HOST"),
        ("a,b,", 0, "a name is missing before or after a comma"),
        ("a:0,b", 0, "--hosts: a:0: the port must be from 1 to 65535"),
        ("a:65536,b", 0, "the port must be from 1 to 65535"),
        ("a:http,b", 0, "the port must be from 1 to 65535"),
        ("a:,b", 0, "the port must be from 1 to 65535"),
        ("[::1,b", 0, "--hosts: [::1: write an address in brackets as [HOST]:PORT"),
        ("[::1]5,b", 0, "write an address in brackets as [HOST]:PORT"),
        ("a,b:5000", 0, "--hosts: b:5000: only the first host, the lead, may have a port"),
        ("a,b c", 0, "--hosts: host 2 is 'b c', which is not the name of a host"),
        (":5000,b", 0, "--hosts: host 1 is '', which is not the name of a host"),
        ("a,b", 2, "--process 2: --hosts names 2 process(es), counted from 0"),
        ("localhost,127.0.0.1", None, "--hosts: 2 of them are this machine, localhost, 127.0.0.1."),
        (
            "a.invalid,b.invalid",
            None,
            f"--hosts: none of a.invalid, b.invalid is this machine, {HERE}. Give the place of "
            "this process with --process I, counted from 0",
        ),
    ],
)
def test_wrong_lists_are_refused(text, process, words):
    with pytest.raises(UsageError, match=re.escape(words)):
        place_in(text, process)


def test_a_file_without_hosts_is_refused(tmp_path):
    file = tmp_path / "hosts"
    file.write_text("# none\n")
    with pytest.raises(UsageError, match=r"names no host\. Write one on each line"):
        place_in(str(file))
