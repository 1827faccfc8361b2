"""`evo-cpg watch --page`: the page of a run while it evolves, in a process of its own."""

import shutil
import signal
import time
from collections.abc import Callable
from typing import Any

import pytest

import chromium
from tiny_run import CONFIG, LONG, PAIR

browsing = pytest.mark.skipif(chromium.found() is None, reason="needs Chromium")
# Enough for a compilation on a busy machine, s.
PATIENCE = 300.0


def address_of(watcher: Any) -> str:
    """Return the address that the command prints, after lines about the run."""
    for line in iter(watcher.stdout.readline, ""):
        if line.startswith("http://127.0.0.1:"):
            # `communicate` would lose a line that is read ahead.
            assert watcher.stdout.readline() == "Control-C ends the program.\n"
            return line.strip()
    raise AssertionError(watcher.stderr.read())


def until(page: chromium.Page, condition: str) -> None:
    end = time.monotonic() + PATIENCE
    while not page.run(condition):
        assert time.monotonic() < end, (condition, page.run("document.body.innerText"))
        time.sleep(0.2)


def generation(page: chromium.Page) -> int:
    return int(page.run("parseInt(document.querySelector('#numbers b')?.textContent || '0')"))


def changes(picture: Callable[[], bytes]) -> bool:
    """Whether one of some later pictures differs from the first."""
    first = picture()
    return any(picture() != first for _ in range(20))


def test_a_wrong_use_is_one_line(cli, tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    for arguments, words in (
        ((tmp_path, "--page"), "is not a run folder (it has no config.yaml)"),
        ((tmp_path / "run", "--page", "--once"), "--page and --once exclude"),
    ):
        err = cli.refuses("watch", *arguments)
        assert words in err and err.count("\n") == 1


@pytest.mark.slow
@browsing
def test_a_run_moves_and_grows_on_its_page_while_it_trains(start, tmp_path):
    run = tmp_path / "run"
    with (
        start("watch", run, "--page", "--no-browser") as watcher,
        chromium.browser(tmp_path / "profile") as page,
    ):
        address = address_of(watcher)
        page.visit(address)
        until(page, "document.getElementById('status').textContent.includes('no run yet')")
        settings = (*LONG, "evolution.generations=50000")
        with start("train", CONFIG, *settings, "--out", run) as trainer:
            until(page, "document.querySelector('#curves svg') !== null")
            first = generation(page)
            until(page, "document.querySelector('#animal.ready') !== null")
            assert "Champion of generation" in page.run("document.body.innerText")
            assert changes(lambda: page.picture("#animal canvas"))
            places = "document.querySelectorAll('#wall li').length"
            until(
                page, f"{places} > 0 && {places} === document.querySelectorAll('#wall span').length"
            )
            assert page.run(places) == 8
            assert changes(lambda: page.picture("#wall"))
            until(page, f"parseInt(document.querySelector('#numbers b').textContent) > {first}")
            assert trainer.poll() is None
            trainer.send_signal(signal.SIGINT)
            trainer.communicate(timeout=PATIENCE)
        shutil.rmtree(run)
        until(page, "document.getElementById('status').textContent.includes('was deleted')")
        # The page keeps what it shows, and no request left the machine.
        assert changes(lambda: page.picture("#animal canvas"))
        assert page.complaints == []
        origin = address.partition("/?")[0]
        assert all(each.startswith((origin, "data:", "about:")) for each in page.requests)
        watcher.send_signal(signal.SIGINT)
        out, complaint = watcher.communicate(timeout=PATIENCE)
        assert (watcher.returncode, complaint) == (0, "")
        lines = [line.removeprefix(f"{run}: ") for line in out.splitlines()]
        assert len(lines) == 2 and lines[0].startswith("Evolving, about")
        assert lines[1] == "The run folder was deleted. The page keeps what it shows"
        until(page, "document.getElementById('status').dataset.kind === 'lost'")


@pytest.mark.slow
@browsing
def test_a_finished_run_stays_on_its_page_at_every_width(cli, start, tmp_path):
    run = tmp_path / "run"
    cli.passes("train", CONFIG, *PAIR, "--out", run)
    with (
        start("watch", run, "--page", "--no-browser") as watcher,
        chromium.browser(tmp_path / "profile") as page,
    ):
        page.visit(address_of(watcher), (390, 844), dark=True)
        until(page, "document.querySelectorAll('#wall span').length === 8")
        assert page.run("document.getElementById('status').dataset.kind") == "finished"
        for width in (390, 1280):
            page.resize((width, 844))
            assert page.run("document.documentElement.scrollWidth") <= width
        assert page.run("getComputedStyle(document.documentElement).backgroundColor") == (
            "rgb(20, 24, 31)"
        )
        page.click("#pause")
        assert page.run("document.getElementById('pause').textContent") == "Play"
        assert watcher.poll() is None and page.complaints == []
        watcher.send_signal(signal.SIGINT)
        assert watcher.wait(PATIENCE) == 0
