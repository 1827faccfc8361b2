"""A run that a live page follows: its states, what is new, and who may ask."""

import http.client
import json
import shutil
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from evo_cpg.io.load import dump_config, load_config
from evo_cpg.training.checkpoint import Champion, Checkpoint
from evo_cpg.training.run_folder import RunFolder, RunFolderError
from evo_cpg.view.live_page import replaying
from evo_cpg.view.live_page.following import Following
from evo_cpg.view.live_page.server import live_server
from evo_cpg.view.run_page.server import PageServer
from tiny_run import CONFIG, PAIR

NOTHING = {"chart": 0, "motion": 0, "wall": 0, "tiles": 0}


def begin(path: Path, generations: int = 3) -> RunFolder:
    """Make a run folder that a trainer has just begun."""
    folder = RunFolder(path)
    config = load_config(CONFIG, [*PAIR, f"evolution.generations={generations}"])
    folder.create(dump_config(config), {})
    return folder


def save(folder: RunFolder, done: int) -> None:
    """Write a checkpoint after some generations, each of which took 2 s."""
    genes = np.zeros((3, 8), np.float32)
    champion = Champion(genes[:, 0], 1.5, done - 1, {"speed": 0.25}, {})
    rows = [
        {"generation": i, "best": 1.0, "mean": 0.5, "diverged": 0, "champion": 1.5, "seconds": 2.0}
        for i in range(done)
    ]
    folder.save(Checkpoint(done, genes, (champion,), rows, {}))


def test_a_run_is_followed_from_before_its_start_to_after_its_end(tmp_path):
    said: list[str] = []
    path = tmp_path / "run"
    followed = Following(RunFolder(path), said.append)

    def state(**known: int) -> dict[str, Any]:
        followed.look()
        return followed.answer(**(NOTHING | known))

    assert state()["status"]["words"] == "There is no run yet. The page waits for it"
    folder = begin(path)
    assert state()["status"] == {"kind": "waiting", "words": "No generation is finished yet"}
    save(folder, 1)
    first = state()
    assert first["status"] == {"kind": "running", "words": "Evolving, about 4 s to go"}
    assert first["numbers"][:3] == [
        ("1 of 3", "generations"), ("1.5", "champion's fitness"), ("0.25 m/s", "speed"),
    ]  # fmt: skip
    assert "<svg" in first["chart"]["html"]
    # The curves are sent again only after another generation.
    number = first["chart"]["number"]
    assert state(chart=number)["chart"] is None
    save(folder, 3)
    last = state(chart=number)
    assert last["status"]["kind"] == "finished" and last["chart"]["number"] == number + 1
    # `resume` first writes the new number of generations, then checkpoints.
    folder.reopen(folder.config.read_text().replace("generations: 3", "generations: 5"))
    save(folder, 4)
    assert state()["numbers"][0] == ("4 of 5", "generations")
    shutil.rmtree(path)
    assert "was deleted" in state()["status"]["words"]
    save(begin(path, 4), 1)
    assert state()["numbers"][0] == ("1 of 4", "generations")
    assert [line.removeprefix(f"{path}: ").split(".")[0] for line in said] == [
        "There is no run yet", "Evolving, about 4 s to go", "All generations are done",
        "Evolving, about 2 s to go", "The run folder was deleted", "Evolving, about 6 s to go",
    ]  # fmt: skip


def test_animals_that_cannot_be_replayed_are_one_line(tmp_path, monkeypatch):
    tried: list[RunFolder] = []

    def fail(folder: RunFolder) -> None:
        tried.append(folder)
        raise RunFolderError("it began in Python")

    monkeypatch.setattr(replaying, "Replays", fail)
    folder = begin(tmp_path / "run")
    save(folder, 1)
    followed = Following(folder)
    followed.replay()
    words = followed.answer(**NOTHING)["motion"]["words"]
    assert words == "The animals cannot be replayed: it began in Python"
    # Only another champion is a reason to try again.
    followed.replay()
    assert len(tried) == 1
    save(folder, 2)
    followed.look()
    followed.replay()
    assert len(tried) == 2


def test_a_damaged_checkpoint_is_one_line_on_the_page(tmp_path):
    folder = begin(tmp_path / "run")
    (folder.path / "checkpoints/generation_000001.npz").write_bytes(b"no archive")
    status = Following(folder).answer(**NOTHING)["status"]
    assert status["kind"] == "wrong" and "no checkpoint can be read" in status["words"]


@pytest.fixture
def server(tmp_path) -> Iterator[PageServer]:
    followed = Following(RunFolder(tmp_path / "run"))
    with live_server(followed, "<b>run") as made:
        thread = threading.Thread(target=made.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        yield made
        made.shutdown()
        thread.join()


def ask(server: PageServer, path: str, method: str = "GET", **headers: str) -> tuple[int, str]:
    link = http.client.HTTPConnection("127.0.0.1", server.server_address[1], timeout=20)
    sent = {"X-Token": server.token} | {k.replace("_", "-"): v for k, v in headers.items()}
    link.request(method, path, headers=sent)
    answer = link.getresponse()
    content = answer.read().decode()
    link.close()
    return answer.status, content


def test_only_the_page_gets_answers(server):
    status, page = ask(server, f"/?token={server.token}", X_Token="")
    assert status == 200 and "&lt;b&gt;run" in page and "<b>run" not in page
    status, answer = ask(server, "/state?chart=-1&motion=x&wall=&tiles=9999")
    assert status == 200 and json.loads(answer)["status"]["kind"] == "waiting"
    assert ask(server, "/state", X_Token="")[0] == 403
    assert ask(server, "/other")[0] == 404
    # The page reads, and changes nothing.
    assert ask(server, "/state", "POST")[0] == 501
