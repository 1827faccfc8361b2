"""The drawing page in headless Chromium: animals drawn, tried and trained with the mouse."""

import contextlib
import json
import threading
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import pytest
import trimesh

import chromium
from evo_cpg.io.load import load_config
from evo_cpg.view.drawing_page.document import Document
from evo_cpg.view.drawing_page.server import drawing_server
from evo_cpg.view.drawing_page.session import DrawingSession, problems
from evo_cpg.view.run_page.server import PageServer

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(chromium.found() is None, reason="needs Chromium"),
]
CONFIGS = Path(__file__).parents[3] / "configs"
FINISHED = "document.getElementById('run-state').textContent.startsWith('finished')"


class Drawn:
    """The page of a document, used with mouse and fields."""

    def __init__(self, page: chromium.Page, server: PageServer, session: DrawingSession):
        self.page, self.server, self.session = page, server, session
        self.document = session.document

    def wait(self) -> None:
        """Wait until all requests are answered and drawn."""
        self.page.run("new Promise((done) => setTimeout(done, 60))")
        self.page.wait("document.body.dataset.busy === '0'")

    def fill(self, label: str, value: str) -> None:
        """Write into a field of the panel."""
        selector = json.dumps(f'[aria-label="{label}"]')
        self.page.run(
            f"(() => {{ const field = document.querySelector({selector});"
            f" field.value = {json.dumps(value)};"
            " field.dispatchEvent(new Event('change')); })()"
        )
        self.wait()

    def click(self, selector: str) -> None:
        self.page.click(selector)
        self.wait()

    def check(self, label: str) -> None:
        self.click(f"[aria-label='{label}']")

    def part(self, name: str) -> None:
        """Select a part in the tree."""
        self.click(f"[data-part='{name}']")

    def press(self, x: float, y: float) -> None:
        self.page.mouse("mousePressed", [x, y])
        self.page.mouse("mouseReleased", [x, y])
        self.wait()

    def add(self, what: str, view: str, x: float, y: float, on: str) -> None:
        """Click a place of a part's picture, at a fraction of it from its middle to its edge."""
        self.click(f"[data-view={view}]")
        box = self.page.run(
            "(() => { const b = document.getElementById('canvas').getBoundingClientRect();"
            " return [b.left, b.top, b.width, b.height]; })()"
        )
        middle = self.page.run(f"View.screen({on!r})")

        def reach(dx: float, dy: float) -> float:
            """Distance from the middle to the edge of the part along a direction, pixels."""
            far = 0
            while far < box[2]:
                at = middle[0] + dx * (far + 1), middle[1] + dy * (far + 1)
                if self.page.run(f"View.hit({at[0]}, {at[1]})?.name") != on:
                    break
                far += 1
            return far

        right = reach(1 if x >= 0 else -1, 0) if x else 0
        down = reach(0, 1 if y >= 0 else -1) if y else 0
        self.click(f"[data-add={what}]")
        answers = int(self.page.run("document.body.dataset.answers"))
        self.press(middle[0] + x * right, middle[1] + y * down)
        if self.page.run("document.getElementById('dialog').open"):
            self.page.click("#no")  # on this body of a row only
        self.page.wait(f"Number(document.body.dataset.answers) > {answers}")
        self.wait()


@contextlib.contextmanager
def opened(document: Document, profile: Path) -> Iterator[Drawn]:
    """Serve a document and open its page."""
    session = DrawingSession(document)
    with drawing_server(session) as server, chromium.browser(profile) as page:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        page.visit(server.address)
        page.wait("document.querySelectorAll('#tree button').length > 0")
        yield Drawn(page, server, session)
        ours = server.origin
        assert page.complaints == []
        assert all(each.startswith((ours, "data:", "about:")) for each in page.requests)
        session.close()
        server.shutdown()
        thread.join()


@pytest.fixture
def drawn(tmp_path, monkeypatch) -> Iterator[Drawn]:
    for display in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(display, raising=False)
    with opened(Document.new(tmp_path / "animal.yaml"), tmp_path / "profile") as page:
        yield page


def test_the_swimmer_of_the_paper_is_drawn_tried_and_trained(drawn):
    drawn.part("body")
    drawn.fill("name", "head")
    drawn.add("part", "back", 0, 0, "head")
    drawn.part("part")
    drawn.fill("name", "segment")
    drawn.fill("shape", "box")
    for label, value in {
        "size x": "0.2", "size y": "0.1", "size z": "0.1",
        "at x": "-0.11", "at y": "0", "at z": "0",
        "child_at x": "0.11", "child_at y": "0", "child_at z": "0",
        "rotation_deg x": "0", "rotation_deg y": "0", "rotation_deg z": "0",
        "lower limit": "-60", "upper limit": "60", "gain": "100",
    }.items():  # fmt: skip
        drawn.fill(label, value)
    drawn.check("axis x")
    drawn.fill("repeat", "9")
    drawn.add("eye", "front", 0, 0, "head")
    drawn.part("head")
    drawn.click("#save")
    theirs = load_config(CONFIGS / "iwadate2010_swimmer.yaml").creature.model_dump()
    ours = load_config(drawn.document.path).creature.model_dump()
    for name in ("name", "materials"):
        assert ours.pop(name) != theirs.pop(name)
    for mine, paper in zip(ours["bodies"], theirs["bodies"], strict=True):
        assert (mine.pop("material"), paper.pop("material")) == ("flesh", "body")
    assert ours == theirs
    assert problems(drawn.document.data, drawn.document.path) == []
    assert Document.open(drawn.document.path).texts == drawn.document.texts

    drawn.page.click("#try-drive")
    drawn.page.wait("View.playing")
    before = drawn.page.run("View.pose('segment9')")
    frames = drawn.page.run("View.frames")
    drawn.page.wait(f"View.frames > {frames + 5}")
    assert drawn.page.run("View.pose('segment9')") != before
    drawn.click("#close-player")
    assert not drawn.page.run("View.playing")

    drawn.page.click("#train")
    drawn.page.run("document.getElementById('answer').value = '1'")
    drawn.page.click("#yes")
    drawn.page.wait(FINISHED)
    assert (drawn.document.path.parent / "runs/animal/champion.npz").exists()
    drawn.page.click("#champion")
    drawn.page.wait("View.playing")
    drawn.click("#live")
    address = drawn.page.run("document.getElementById('notice').textContent").rpartition(" ")[2]
    with urllib.request.urlopen(address, timeout=300) as answer:
        assert "<h1>animal</h1>" in answer.read().decode()


def test_sections_of_a_loft_are_moved_and_scaled_with_the_mouse(drawn):
    drawn.part("body")
    drawn.fill("shape", "loft")
    drawn.click("[aria-label='add behind section 2']")
    drawn.fill("section 3 height", "0.2")

    def sections():
        return drawn.document.data["creature"]["bodies"][0]["shape"]["sections"]

    assert [each["height"] for each in sections()] == [0.05, 0.1, 0.2, 0.05]
    drawn.click("[data-view=side]")
    drawn.press(*drawn.page.run("View.dot(2)"))
    assert drawn.page.run("View.section") == 2
    _drag(drawn, drawn.page.run("View.gizmo()"), 30)
    assert sections()[2]["at"][0] > -0.049 and sections()[2]["at"][1:] == [0, 0]
    # In the view from the front the y axis of the section is level.
    drawn.click("[data-view=back]")
    drawn.click("[data-mode=scale]")
    width = sections()[2]["width"]
    _drag(drawn, drawn.page.run("View.gizmo('y')"), -30)
    assert sections()[2]["width"] != width and sections()[2]["height"] == 0.2
    drawn.fill("corners", "4")
    assert drawn.document.data["creature"]["bodies"][0]["shape"]["corners"] == 4
    assert problems(drawn.document.data, drawn.document.path, thorough=False) != []


def _drag(drawn: Drawn, place: list[float], by: float) -> None:
    drawn.page.mouse("mouseMoved", place)
    drawn.page.mouse("mousePressed", place)
    for step in range(1, 6):
        drawn.page.mouse("mouseMoved", [place[0] + by / 5 * step, place[1]])
    drawn.page.mouse("mouseReleased", [place[0] + by, place[1]])
    drawn.wait()


def test_every_kind_of_joint_and_motor_has_fields(drawn):
    drawn.add("part", "back", 0, 0, "body")

    def joint():
        return drawn.document.data["creature"]["bodies"][1]["joint"]

    def errors():
        found = problems(drawn.document.data, drawn.document.path, thorough=False)
        return [each for each in found if each.kind == "error"]

    drawn.fill("joint", "ball")
    drawn.fill("largest angle", "30")
    assert joint()["axes"] == "ball" and joint()["limits_deg"] == [0, 30] and not errors()
    drawn.fill("joint", "weld")
    assert joint()["axes"] == [] and not errors()
    drawn.fill("joint", "axes")
    drawn.page.run("document.querySelector('#panel details').open = true")
    drawn.click("#add-axis")
    drawn.fill("axis 1 direction", "other")
    drawn.fill("axis 1 vector x", "1")
    drawn.check("axis 2 no limits")
    drawn.fill("axis 2 upper limit", "0.02")
    drawn.check("limits of each axis")
    drawn.fill("axis 1 lower limit", "-20")
    drawn.check("motor of each axis")
    drawn.fill("axis 1 motor", "muscle")
    drawn.fill("axis 1 area", "0.001")
    drawn.check("damping of each axis")
    drawn.fill("damping of axis 2", "3")
    assert joint()["axes"] == [[1, 0, 1], {"slide": "x", "limits_m": [-0.01, 0.02]}]
    assert joint()["limits_deg"] == [[-20, 30], None]
    assert joint()["damping"] == [0, 3]
    muscle, servo = joint()["actuator"]
    assert (muscle["type"], muscle["area"]) == ("muscle", 0.001) and servo["gain"] > 0
    assert not errors()
    drawn.check("axis 1 own place")
    drawn.fill("axis 1 place z", "0.01")
    assert joint()["axes"][0] == {"turn": [1, 0, 1], "at": [0, 0, 0.01]} and not errors()
    drawn.click("[aria-label='remove axis 1']")
    assert joint()["axes"] == [{"slide": "x", "limits_m": [-0.01, 0.02]}] and not errors()


def test_a_mesh_that_is_not_convex_becomes_its_hull_if_the_user_agrees(drawn, tmp_path):
    (tmp_path / "mine").mkdir()
    ring = trimesh.creation.annulus(0.05, 0.1, 0.1, sections=16)
    ring.export(tmp_path / "mine" / "ring.glb")
    drawn.part("body")
    drawn.page.give_file("[aria-label='mesh file']", tmp_path / "mine" / "ring.glb")
    drawn.page.wait("document.getElementById('dialog').open")
    assert "it is not convex" in drawn.page.run("document.getElementById('question').textContent")
    drawn.page.click("#yes")
    drawn.page.wait("document.querySelector('[aria-label=hull]')?.checked")
    shape = {"type": "mesh", "file": "ring.glb", "hull": True}
    assert drawn.document.data["creature"]["bodies"][0]["shape"] == shape


def test_a_gizmo_moves_a_part_and_its_copies(drawn):
    drawn.add("part", "side", 0, 0, "body")
    drawn.click("#mirror")
    before = drawn.page.run("View.pose('left_part')")
    drawn.click("[data-view=top]")
    # The arrow along x points to the right in the view from above.
    _drag(drawn, drawn.page.run("View.gizmo()"), 40)
    after = drawn.page.run("View.pose('left_part')")
    assert after[0] - before[0] > 0.005
    assert after[1:] == pytest.approx(before[1:], abs=1e-4)
    right = drawn.page.run("View.pose('right_part')")
    assert right[0] == pytest.approx(after[0], abs=1e-6)


def test_edits_of_a_program_that_crashed_are_offered(drawn, tmp_path):
    drawn.part("body")
    drawn.fill("size x", "0.3")
    # The program ends without saving, and starts again.
    with opened(Document.new(drawn.document.path), tmp_path / "another profile") as again:
        text = "document.getElementById('text').textContent"
        assert not again.page.run("document.getElementById('recovered').hidden")
        assert "0.3" in again.page.run(text)
        again.click("#discard")
        assert "0.3" not in again.page.run(text)
        again.click("#undo")
        assert "0.3" in again.page.run(text)


def test_a_further_shape_is_drawn_with_the_mouse(drawn):
    drawn.add("shape", "side", 0.3, 0, "body")
    assert drawn.page.run("View.names") == ["body", "body/2"]
    drawn.fill("shape 1 at z", "0.08")
    drawn.click("#save")
    assert load_config(drawn.document.path).creature.bodies[0].parts[0].at[2] == 0.08


def test_wrong_entries_and_lost_comments_are_told(drawn):
    drawn.add("part", "side", 0, 0, "body")
    drawn.fill("lower limit", "90")
    words = drawn.page.run("document.getElementById('problems').textContent")
    assert "part" in words and "90" in words
    assert drawn.page.run("document.querySelectorAll('#tree .error').length") == 1
    drawn.fill("gain", "strong")
    assert "strong is not a number" in drawn.page.run(
        "document.getElementById('notice').textContent"
    )
    drawn.click("#undo")
    assert drawn.page.run("document.querySelectorAll('#tree .error').length") == 0
