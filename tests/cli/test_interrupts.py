"""Control-C at moments at which Python would lose the interrupt or crash."""

import signal
import sys
import threading
import time

import pytest

from evo_cpg.cli import interrupts, main
from evo_cpg.cli.interrupts import interrupts_delivered

pytestmark = pytest.mark.usefixtures("interruptible")

LONG = 20.0  # s. An interrupt takes 0.01 s.


def assert_interrupted_afterwards(key):
    """Check that an interrupt does not come while a key is hashed, but soon after."""
    known = {}
    with interrupts_delivered(), pytest.raises(KeyboardInterrupt):
        known[key] = "there"
        time.sleep(LONG)
    assert list(known.values()) == ["there"]


def test_an_interrupt_waits_until_a_key_is_hashed():
    class Key:
        def __hash__(self):
            signal.raise_signal(signal.SIGINT)
            return deeper()

    def deeper():
        signal.raise_signal(signal.SIGINT)
        return 1

    assert_interrupted_afterwards(Key())


def test_an_interrupt_is_repeated_until_it_is_delivered(monkeypatch):
    """Each try starts before the thread of the earlier try ends, as on a busy machine."""
    tried, kill, end = [], signal.pthread_kill, time.monotonic() + LONG

    def slowly(thread, number):
        tried.append(number)
        kill(thread, number)
        time.sleep(0.1)

    monkeypatch.setattr(signal, "pthread_kill", slowly)

    class Key:
        def __hash__(self):
            signal.raise_signal(signal.SIGINT)
            while len(tried) < 3 and time.monotonic() < end:
                time.sleep(0.001)
            return 1

    assert_interrupted_afterwards(Key())


def test_a_dropped_interrupt_is_sent_again():
    class Dying:
        def __del__(self):
            raise KeyboardInterrupt

    passed = False
    with interrupts_delivered(), pytest.raises(KeyboardInterrupt):
        dying = Dying()
        del dying
        passed = True
        time.sleep(LONG)
    assert passed


def test_other_unraisable_errors_reach_the_earlier_hook(monkeypatch):
    reported = []
    monkeypatch.setattr(sys, "unraisablehook", reported.append)

    class Dying:
        def __del__(self):
            raise ValueError("an error of theirs")

    with interrupts_delivered():
        dying = Dying()
        del dying
    assert [str(each.exc_value) for each in reported] == ["an error of theirs"]


def test_hook_and_handler_are_restored(monkeypatch):
    hook = sys.unraisablehook
    with interrupts_delivered():
        assert sys.unraisablehook is not hook
    assert sys.unraisablehook is hook
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)


def test_ignored_interrupts_stay_ignored():
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with interrupts_delivered():
        signal.raise_signal(signal.SIGINT)
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN


def test_a_thread_installs_no_handler():
    found = []

    def look():
        with interrupts_delivered():
            found.append(signal.getsignal(signal.SIGINT))

    thread = threading.Thread(target=look)
    thread.start()
    thread.join()
    assert found == [signal.default_int_handler]


@pytest.mark.parametrize(("waits", "code"), [(True, None), (False, 0)])
def test_a_process_can_end_without_waiting_for_threads(monkeypatch, waits, code):
    """A skipped compilation does not delay the end of the process."""

    def end():
        raise SystemExit(0)

    left = []
    monkeypatch.setattr(interrupts, "waits", True)
    monkeypatch.setattr(main, "main", end)
    monkeypatch.setattr(main, "leave_at_once", left.append)
    if not waits:
        interrupts.wait_for_no_thread()
    with pytest.raises(SystemExit):
        main.program()
    assert left == ([] if code is None else [code])
