"""The server of the drawing page: who may use it, what it accepts, and what it answers."""

import http.client
import json
import socket
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest
import trimesh

from evo_cpg.api.advice import about_oscillators
from evo_cpg.io.load import load_config
from evo_cpg.io.trust import trusting
from evo_cpg.view.drawing_page.document import Document
from evo_cpg.view.drawing_page.server import drawing_server
from evo_cpg.view.drawing_page.session import DrawingSession
from evo_cpg.view.run_page.server import MOST_BYTES, PageServer


@pytest.fixture
def server(tmp_path) -> Iterator[PageServer]:
    document = Document.new(tmp_path / "animal.yaml")
    session = DrawingSession(document, advice=about_oscillators)
    with drawing_server(session) as made:
        made.session = session
        thread = threading.Thread(target=made.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        yield made
        made.shutdown()
        thread.join()


def ask(server: PageServer, path: str, body: Any = None, **headers: str) -> tuple[int, Any]:
    """A request of a plain client. The token is sent unless ``X_Token`` is given."""
    link = http.client.HTTPConnection("127.0.0.1", server.server_address[1], timeout=20)
    sent = {"X-Token": server.token} | {k.replace("_", "-"): v for k, v in headers.items()}
    if body is not None and not isinstance(body, bytes):
        body = json.dumps(body).encode()
    link.request("GET" if body is None else "POST", path, body, sent)
    answer = link.getresponse()
    content = answer.read()
    link.close()
    is_json = answer.headers["Content-Type"] == "application/json"
    return answer.status, json.loads(content) if is_json else content.decode()


def edit(server: PageServer, command: str, given: dict, **more: Any) -> Any:
    return ask(server, "/edit", {"command": command, "given": given} | more)[1]


def test_the_page_needs_the_token_of_its_address(server):
    assert server.address.startswith("http://127.0.0.1:")
    status, page = ask(server, f"/?token={server.token}", X_Token="")
    assert status == 200 and "<canvas" in page
    for path in ("/", "/?token=", "/?token=wrong", f"/?token={server.token[:-1]}"):
        assert ask(server, path, X_Token="")[0] == 403
    assert ask(server, "/poll", X_Token="wrong")[0] == 403
    # The header does not open the page, and the address opens nothing else.
    assert ask(server, "/")[0] == 403
    assert ask(server, f"/poll?token={server.token}", X_Token="")[0] == 403
    assert ask(server, "/edit", {}, X_Token="")[0] == 403
    assert ask(server, "/upload?name=a.stl", b"solid", X_Token="")[0] == 403


@pytest.mark.parametrize(
    "headers",
    [
        {"Origin": "http://evil.example"},
        {"Origin": "http://localhost:1"},
        {"Origin": "null"},
        {"Host": "evil.example"},
        {"Sec_Fetch_Site": "cross-site"},
        {"Sec_Fetch_Site": "same-site"},
    ],
)
def test_another_origin_is_refused_even_with_the_token(server, headers):
    assert ask(server, "/open", {}, **headers)[0] == 403
    assert ask(server, f"/?token={server.token}", **headers)[0] == 403
    assert ask(server, "/open", {}, Origin=server.origin, Sec_Fetch_Site="same-origin")[0] == 200


@pytest.mark.parametrize("host", ["localhost:{port}", "127.0.0.1:1", "lab.example:{port}"])
def test_a_forwarded_port_is_answered_with_the_way(server, host):
    port = server.server_address[1]
    status, answer = ask(server, f"/?token={server.token}", Host=host.format(port=port))
    assert status == 403 and f"only at {server.origin}" in answer["error"]
    assert f"ssh -L {port}:127.0.0.1:{port} " in answer["error"]


def test_no_websocket_and_no_other_method_opens(server):
    upgrade = {"Connection": "Upgrade", "Upgrade": "websocket", "Sec_WebSocket_Version": "13"}
    assert ask(server, f"/?token={server.token}", **upgrade)[0] == 200
    link = http.client.HTTPConnection("127.0.0.1", server.server_address[1], timeout=20)
    link.request("OPTIONS", "/edit", headers={"Origin": "http://evil.example"})
    answer = link.getresponse()
    assert answer.status == 501 and "Access-Control-Allow-Origin" not in answer.headers


def test_requests_are_limited_and_checked(server):
    assert ask(server, "/edit", b"x" * 100)[0] == 400
    assert ask(server, "/edit", b"[1]")[0] == 400
    assert ask(server, "/edit", b"[" * 100_000)[0] == 400
    assert ask(server, "/edit", b"{}", Content_Length=str(MOST_BYTES + 1))[0] == 413
    assert ask(server, "/upload?name=a.stl", b"", Content_Length=str(2**40))[0] == 413
    assert ask(server, "/edit", b"", Content_Length="-1")[0] == 411
    assert ask(server, "/nothing")[0] == 404
    assert "no request 'nothing'" in ask(server, "/nothing", {})[1]["error"]
    assert "edit: " in ask(server, "/edit", {"wing": 1})[1]["error"]


def test_an_edit_is_answered_with_the_new_drawing(server):
    first = ask(server, "/open", {})[1]
    assert [body["name"] for body in first["scene"]["bodies"]] == ["body"]
    assert first["scene"]["arrays"] and first["changed"]
    place = {"parent": "body", "place": [-0.1, 0, 0], "normal": [-1, 0, 0], "name": "tail"}
    answer = edit(server, "add_part", place)
    assert answer["new"] == "tail" and answer["undo"] and answer["changed"]
    body = answer["scene"]["bodies"][1]
    assert (body["parent"], body["entry"], body["copies"]) == ("body", "tail", 1)
    assert [axis["lower"] for axis in body["joint"]["axes"]] == [-45, -45]
    # The mesh of the first body is not sent again.
    assert not set(first["scene"]["arrays"]) & set(answer["scene"]["arrays"])
    wrong = edit(server, "remove_part", {"name": "body"})
    assert "is the root" in wrong["error"] and len(wrong["scene"]["bodies"]) == 2
    assert len(ask(server, "/undo", {})[1]["scene"]["bodies"]) == 1
    assert len(ask(server, "/redo", {})[1]["scene"]["bodies"]) == 2
    key = ["creature", "bodies", 1, "joint", "axes"]
    broken = edit(server, "set_value", {"key": key, "value": ["q"]})
    assert broken["scene"] is None and "axes" in broken["undrawn"]
    assert [each["part"] for each in broken["problems"]] == ["tail"]
    ask(server, "/undo", {})
    assert ask(server, "/save", {})[1]["saved"].endswith("animal.yaml")
    assert len(load_config(server.session.document.path).creature.bodies) == 2


def test_the_experiment_is_checked_after_the_edits(server):
    first = ask(server, "/open", {})[1]
    assert [each["kind"] for each in first["problems"]] == ["warning"]
    found = ask(server, "/check", {})[1]
    assert found["revision"] == first["revision"]
    assert [each["kind"] for each in found["problems"]] == ["error"]
    assert "at least one joint" in found["problems"][0]["words"]
    place = {"parent": "body", "place": [-0.1, 0, 0], "normal": [-1, 0, 0], "name": "tail"}
    edit(server, "add_part", place)
    edit(server, "add_eye", {"part": "body", "place": [0.1, 0, 0], "axis": [1, 0, 0]})
    edit(server, "set_joint", {"name": "tail", "key": "axes", "value": ["z"]})
    (found,) = ask(server, "/check", {})[1]["problems"]
    assert found["key"] == ["controller"] and "at rest under a constant drive" in found["words"]


def test_meshes_are_checked_before_they_are_kept(server, tmp_path):
    def upload(name: str, content: bytes) -> dict:
        return ask(server, f"/upload?name={name}", content)[1]

    good = bytes(trimesh.creation.box((0.2, 0.1, 0.1)).export(file_type="stl"))
    assert upload("..%2F..%2Fmy%20part.stl", good) == {"file": "my_part.stl"}
    assert upload("my_part.stl", good) == {"file": "my_part.stl"}
    assert "other content" in upload("my_part.stl", good + b" ")["error"]
    assert "a mesh is a file" in upload("a.exe", good)["error"]
    for name, content in (("b.stl", b"no mesh"), ("c.stl", good[:-60]), ("d.obj", b"")):
        assert "error" in upload(name, content)
        assert not (tmp_path / name).exists()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["my_part.stl"]
    assert upload("%E5%BD%A2.stl", good) == {"file": "形.stl"}
    # A ring is a body only as its convex hull, about which the page asks.
    ring = bytes(trimesh.creation.annulus(0.05, 0.1, 0.1, sections=16).export(file_type="glb"))
    answer = upload("ring.glb", ring)
    assert answer["file"] == "ring.glb" and "it is not convex" in answer["problem"]
    assert "no binary glTF" in upload("e.glb", ring[4:])["error"]
    shape = {"type": "mesh", "file": "my_part.stl"}
    answer = edit(server, "set_value", {"key": ["creature", "bodies", 0, "shape"], "value": shape})
    assert "error" not in answer and len(answer["scene"]["bodies"]) == 1


def test_a_malformed_or_unfinished_request_is_refused_and_writes_nothing(server, tmp_path):
    mesh = str(trimesh.creation.box((0.2, 0.1, 0.1)).export(file_type="obj"))
    head = (
        f"POST /upload?name=a.obj HTTP/1.1\r\nHost: 127.0.0.1:{server.server_address[1]}\r\n"
        f"X-Token: {server.token}\r\nContent-Length: {len(mesh) + 1}\r\n\r\n"
    )
    for sent, word in ((head + mesh, b"cut off"), ("GET http://[ HTTP/1.1\r\n\r\n", b"malformed")):
        with socket.create_connection(server.server_address[:2], timeout=20) as link:
            link.sendall(sent.encode())
            link.shutdown(socket.SHUT_WR)
            answer = http.client.HTTPResponse(link)
            answer.begin()
            assert answer.status == 400 and word in answer.read()
    assert list(tmp_path.iterdir()) == []


def test_a_fault_of_the_program_is_printed(server, monkeypatch, capsys):
    monkeypatch.setattr(server.session, "poll", lambda: 1 / 0)
    with pytest.raises(http.client.RemoteDisconnected):
        ask(server, "/poll")
    assert "ZeroDivisionError" in capsys.readouterr().err


def test_edits_do_not_wait_for_the_start_of_a_live_page(server, monkeypatch):
    started, go_on = threading.Event(), threading.Event()

    class Run:
        def watch(self) -> None:
            started.set()

        def live_page(self) -> str:
            assert go_on.wait(60)
            return "http://127.0.0.1:1/"

    monkeypatch.setattr(server.session, "_run", Run())
    monkeypatch.setattr(server.session, "close", lambda: None)
    assert "error" not in ask(server, "/watch", {})[1] and started.is_set()
    with ThreadPoolExecutor(1) as thread:
        waiting = thread.submit(ask, server, "/live_page", {})
        assert "error" not in ask(server, "/undo", {})[1] and not waiting.done()
        go_on.set()
        assert waiting.result()[1] == {"address": "http://127.0.0.1:1/"}


@pytest.mark.parametrize("trusted", [False, True])
def test_trust_reaches_the_threads_of_requests(tmp_path, monkeypatch, trusted):
    monkeypatch.delenv("EVO_CPG_TRUST")
    (tmp_path / "here").mkdir()
    trimesh.creation.box((0.2, 0.1, 0.1)).export(tmp_path / "a.stl")
    document = Document.new(tmp_path / "here/animal.yaml")
    with trusting(trusted):
        session = DrawingSession(document)
    shape = {"type": "mesh", "file": "../a.stl"}
    given = {"key": ["creature", "bodies", 0, "shape"], "value": shape}
    with ThreadPoolExecutor(1) as thread:
        edited = {"command": "set_value", "given": given}
        answer = thread.submit(session.answer, "edit", edited).result()
        words = [each["words"] for each in thread.submit(session.check).result()["problems"]]
    assert (answer["undrawn"] is None) == trusted
    assert any("lies outside" in each for each in words) != trusted


def test_a_creature_that_is_missing_can_be_set(tmp_path):
    (tmp_path / "a.yaml").write_text("name: a\ncreature:\n")
    session = DrawingSession(Document.open(tmp_path / "a.yaml"))
    answer = session.answer("edit", {"command": "add_part", "given": {}})
    assert "parent: is missing" in answer["error"]
    given = {"key": ["creature"], "value": Document.new(tmp_path / "b.yaml").data["creature"]}
    answer = session.answer("edit", {"command": "set_value", "given": given})
    assert answer["new"] == "body" and answer["undrawn"] is None


def test_a_session_refuses_in_words(server):
    def error(path: str, **given: Any) -> str:
        return ask(server, path, given)[1]["error"]

    assert "without a folder" in error("/save", name="../x.yaml")
    assert "greater than or equal to 1" in error("/train", generations=0)
    assert "save first" in error("/train")
    assert "there is no run" in error("/watch")
    assert "there is no run" in error("/live_page")
    ask(server, "/save", {})
    assert "at least one joint" in error("/train")
    edit(server, "set_value", {"key": ["seed"], "value": -1})
    ask(server, "/save", {})
    assert "-1" in error("/train")
    assert ask(server, "/poll")[1] == {"try": {"state": "none"}, "run": None}
