"""`evo-cpg model`: the address of the page, files that it opens, and its end."""

import http.client
import http.server
import os
import signal
import subprocess
import sys
from urllib.parse import urlsplit

import pytest

from evo_cpg.view.drawing_page.document import Document
from evo_cpg.view.run_page import server as page_server
from evo_cpg.view.run_page.server import PageServer
from tiny_run import REPOSITORY


@pytest.mark.slow
def test_a_page_is_served_until_an_interrupt(tmp_path, interruptible):
    path = [sys.executable, "-m", "evo_cpg", "model", "new.yaml"]
    environment = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY")}
    environment["PYTHONPATH"] = str(REPOSITORY)
    with subprocess.Popen(
        path, cwd=tmp_path, env=environment, text=True, stdout=-1, stderr=-1
    ) as process:
        assert process.stdout and process.stderr
        assert process.stdout.readline().startswith("new.yaml: open this address")
        address = urlsplit(process.stdout.readline().strip())
        assert address.hostname == "127.0.0.1"
        link = http.client.HTTPConnection(address.netloc, timeout=20)
        link.request("GET", f"/?{address.query}")
        assert link.getresponse().status == 200
        link.close()
        process.send_signal(signal.SIGINT)
        try:
            assert process.wait(20) == 0
        finally:
            process.kill()
        if sys.platform == "linux":
            assert "No browser was found" in process.stderr.read()
    assert list(tmp_path.iterdir()) == []


@pytest.fixture
def opened(monkeypatch) -> list[Document]:
    """Documents of servers that end at once."""
    found = []

    def serve(self: PageServer) -> None:
        found.append(self.upload.__self__.document)
        raise KeyboardInterrupt

    monkeypatch.setattr(PageServer, "serve_forever", serve)
    monkeypatch.setattr(page_server, "opened", lambda address: True)
    return found


def test_a_shipped_configuration_is_copied(cli, opened, tmp_path):
    code, out, err = cli("model", "fish", folder=tmp_path)
    assert (code, err) == (0, "") and "127.0.0.1" in out
    (document,) = opened
    assert str(document.path) == "fish.yaml" and document.texts.creature is None
    assert document.data["creature"]["name"] == "fish" and list(tmp_path.iterdir()) == []
    assert "not saved" not in out
    (tmp_path / "fish.yaml").write_text("mine")
    assert cli("model", "fish", folder=tmp_path)[0] == 0
    assert str(opened[1].path) == "fish2.yaml"


def test_edits_that_are_not_saved_are_mentioned(cli, opened, monkeypatch, tmp_path):
    def serve(self: PageServer) -> None:
        given = {"key": ["seed"], "value": 3}
        self.upload.__self__.answer("edit", {"command": "set_value", "given": given})
        raise KeyboardInterrupt

    monkeypatch.setattr(PageServer, "serve_forever", serve)
    code, out, _ = cli("model", "new.yaml", folder=tmp_path)
    assert code == 0 and out.endswith("`evo-cpg model` offers them again.\n")
    assert [path.name for path in tmp_path.iterdir()] == [".new.yaml.autosave"]
    assert Document.new(tmp_path / "new.yaml").data["seed"] == 3


def test_without_a_name_a_new_animal_is_begun(cli, opened, tmp_path):
    (tmp_path / "animal.yaml").write_text("")
    assert cli("model", "--no-browser", folder=tmp_path)[0] == 0
    assert str(opened[0].path) == "animal2.yaml"


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ("broken.yaml", "broken.yaml: line 2, column 1: not valid YAML"),
        ("missing/new.yaml", "there is no folder missing"),
        ("nothing", "nothing"),
    ],
)
def test_wrong_files_are_refused_in_words(cli, opened, tmp_path, given, words):
    (tmp_path / "broken.yaml").write_text("name: [ {")
    code, out, err = cli("model", given, folder=tmp_path)
    assert (code, out, opened) == (2, "", []) and words in err and err.count("\n") == 1


def test_a_port_in_use_is_refused(cli, opened, tmp_path):
    with http.server.HTTPServer(("127.0.0.1", 0), None) as other:  # pyright: ignore
        port = str(other.server_address[1])
        code, _, err = cli("model", "--port", port, folder=tmp_path)
    assert code == 2 and f"port {port} cannot be used" in err
