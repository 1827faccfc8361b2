"""Parts of the page of a run: escaping, charts, and the scene that its viewer decodes."""

import base64
import json
import re
from importlib import resources

import numpy as np
import pytest
import synthetic
from matplotlib.colors import to_hex, to_rgb
from scipy.spatial.transform import Rotation

from evo_cpg.analysis.feet import Feet, Phases
from evo_cpg.physics.contact.contact_model import Ground
from evo_cpg.physics.contact.terrain import Boulder, Plane
from evo_cpg.view.figure import BLUES
from evo_cpg.view.plots import path_figure
from evo_cpg.view.run_page.charts import chart, footfall_figure
from evo_cpg.view.run_page.html import join, long_table, table, tag
from evo_cpg.view.run_page.viewer_data import RATE, viewer_data
from evo_cpg.view.scene import Panel, sample
from pictures import contrast


def decoded(made: dict, number: int, kind: str) -> np.ndarray:
    """An array, decoded as in the viewer."""
    return np.frombuffer(base64.b64decode(made["arrays"][number]), kind)


def test_text_is_escaped_and_html_is_not():
    evil = '<b a="1">&'
    assert tag("p", evil, title=evil) == (
        '<p title="&lt;b a=&quot;1&quot;&gt;&amp;">&lt;b a=&quot;1&quot;&gt;&amp;</p>'
    )
    assert tag("p", tag("b", "x"), None, 3, class_="a") == '<p class="a"><b>x</b>3</p>'
    assert tag("input", disabled=True, value=None, data_x=1) == '<input disabled data-x="1">'
    assert "<i>" not in join("<i>", table(["<i>"], [["<i>"]]))


def test_a_long_table_is_folded():
    made = long_table(["a"], [[f"row {i}"] for i in range(15)])
    first, _, rest = made.partition("<details>")
    assert first.count("<tr>") == 13 and rest.count("<tr>") == 4 and "3 more" in rest
    assert "<details>" not in long_table(["a"], [["x"]] * 12)


def test_the_scene_holds_the_motion():
    """Positions are exact as floats, and rotations to 1e-4. Equal arrays are stored once."""
    creature, motion = synthetic.swimmer(), synthetic.swim(3.0)
    made = json.loads(json.dumps(viewer_data(Panel(creature, motion))))
    clip = sample(motion, RATE)
    count, bodies = made["count"], len(creature.bodies)
    assert (count, bodies) == clip.position.shape[:2] == (len(clip.time), len(made["bodies"]))
    places = decoded(made, made["position"], "<f4").reshape(count, bodies, 3)
    np.testing.assert_array_equal(places, clip.position.astype(np.float32))
    turns = decoded(made, made["rotation"], "<i2").reshape(-1, 4)
    np.testing.assert_allclose(
        Rotation.from_quat(turns).as_matrix().reshape(clip.rotation.shape), clip.rotation, atol=1e-4
    )
    # Ten equal boxes have one array of points and one of triangles.
    meshes = [body["parts"][0] for body in made["bodies"]]
    assert len({(mesh["points"], mesh["triangles"]) for mesh in meshes}) == 1
    assert len({mesh["color"] for mesh in meshes}) > 3
    light = decoded(made, made["light"], "<f4")
    assert made["water"] and light == pytest.approx(synthetic.GOAL)
    # Eyes are parts of the head.
    assert [len(body["parts"]) for body in made["bodies"]] == [5] + 9 * [1]


def test_uneven_ground_and_stones_are_in_the_scene():
    stone = Boulder((1.0, 0.5, 0.1), 0.3)
    ground = Ground(floor=Plane(height=0.0), obstacles=(stone,))
    panel = Panel(synthetic.walker(), synthetic.walk(2.0), world="land", ground=Ground())
    made = viewer_data(panel._replace(ground=ground))
    (shown,) = made["obstacles"]
    assert shown["place"] == pytest.approx([1.0, 0.5, 0.1])
    corners = decoded(made, shown["points"], "<f4").reshape(-1, 3)
    assert np.linalg.norm(corners, axis=1) == pytest.approx(0.3, rel=0.02)
    land = {name: decoded(made, made["terrain"][name], "<f4") for name in "xyz"}
    assert len(land["z"]) == len(land["x"]) * len(land["y"])
    np.testing.assert_allclose(land["z"], 0.0, atol=1e-6)
    level = viewer_data(panel)
    assert level["terrain"] is None and level["floor"] == 0.0 and not level["water"]


def test_a_chart_has_the_colours_of_the_page_and_its_time_range():
    touched = np.zeros((300, 2), bool)
    touched[30:60, 0] = touched[120:180, 1] = True
    none = np.full(2, np.nan)
    feet = Feet(("<left>", "$right$"), touched, touched, none, Phases(None, none, none), none,
                none, np.nan, 1.0)  # fmt: skip
    made = chart(footfall_figure(feet, 0.01, (0.5, 2.5)), "a < b", timed=True)
    assert "#000000" not in made and "#ffffff" not in made and "currentColor" in made
    assert "&lt;left&gt;" in made and "$right$" in made and "a &lt; b" in made
    # Text stays text.
    assert re.search(r"<text[^>]*>time \(s\)</text>", made)
    attributes = dict(re.findall(r'data-(\w+)="([^"]+)"', made))
    assert (float(attributes["start"]), float(attributes["stop"])) == (0.5, 2.5)
    assert 0.05 < float(attributes["left"]) < 0.3 and 0.9 < float(attributes["right"]) <= 1.0


def test_lines_and_dots_of_charts_are_seen_on_white_and_dark_paper():
    css = resources.files("evo_cpg.view.run_page").joinpath("page.css").read_text(encoding="utf-8")
    papers = set(re.findall(r"--paper: (#\w+)", css))
    assert len(papers) == 2
    made = chart(path_figure(synthetic.swim(3.0), 0), "path")
    colors = set(re.findall(r"(?:fill|stroke): (#[0-9a-f]{6})", made))
    assert len(colors) > 20
    grid = {"#e5e7eb", "#cccccc"}
    for color in [*(colors - grid), *map(to_hex, BLUES(np.linspace(0, 1, 12)))]:
        behind = 255 * np.array(to_rgb(color))
        assert min(contrast(behind, paper) for paper in papers) > 1.9, color
