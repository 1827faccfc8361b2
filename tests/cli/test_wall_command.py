"""`evo-cpg render --wall`: a run whose body plans evolve, as a film and as a page."""

import json
import re

import numpy as np
import pytest
import yaml
from PIL import Image

import chromium
from evo_cpg.api.film import wall_panel
from evo_cpg.api.runs import open_champion
from evo_cpg.training.crowd import compile_motions, evaluated_at
from evo_cpg.view.film import Film
from plans import LAND, plan_config

SMALL = "--size", "160x90", "--seconds", "0.2"


@pytest.fixture(scope="module")
def run(cli, tmp_path_factory):
    folder = tmp_path_factory.mktemp("wall")
    config = plan_config(LAND, 3, 0.5)
    config["evolution"] |= {"generations": 2, "population": 6}
    config["audit"] = {"after_training": False}
    (folder / "plans.yaml").write_text(yaml.safe_dump(config))
    cli.passes("train", folder / "plans.yaml", "--out", folder / "run", "--cores", 1)
    return folder / "run"


@pytest.mark.slow
def test_a_wall_is_filmed(cli, run, tmp_path):
    for generation, name in ((0, "a.png"), (2, "b.png")):
        place = tmp_path / name
        code, out, err = cli("render", run, "--wall", generation, *SMALL, "-o", place)
        assert (code, out) == (0, f"{place}\n"), err
        with Image.open(place) as picture:
            assert picture.size == (160, 90)
    cli.passes("render", run, "--wall", 0, *SMALL, "--fps", 5)
    assert (run / "videos" / "wall_0.mp4").is_file()
    assert "has 2 generations" in cli.refuses("render", run, "--wall", 3, *SMALL)


@pytest.mark.slow
def test_a_wall_is_a_page(cli, run, tmp_path):
    place = tmp_path / "wall.html"
    cli.passes("render", run, "--wall", 1, *SMALL, "--title", "A < B", "-o", place)
    data = re.search(r'id="scene">(.*?)</script>', place.read_text(encoding="utf-8"))
    assert data is not None
    herd = json.loads(data[1])["herd"]
    assert 1 <= len(herd) <= 6 and all(2 <= len(one["bodies"]) <= 3 for one in herd)
    if chromium.found():
        with chromium.browser(tmp_path / "profile") as tab:
            tab.open(place)
            tab.wait("document.querySelector('#animal').classList.contains('ready')")
            assert "Point at an animal" in tab.run("document.querySelector('.caption').textContent")
            left, top, width, height = tab.run(
                "(() => { const b = document.querySelector('canvas').getBoundingClientRect();"
                " return [b.x, b.y, b.width, b.height]; })()"
            )
            found = set()
            for i in range(1, 40):
                for j in range(1, 12):
                    tab.mouse("mouseMoved", [left + width * i / 40, top + height * j / 12])
                    found.add(tab.run("document.querySelector('.caption').textContent"))
            # Each visited animal is named.
            assert sum("fitness" in words for words in found) >= len(herd) - 1
            assert not tab.complaints


@pytest.mark.slow
def test_animals_of_a_wall_are_own_creatures(run):
    """Each animal has the motion of its genome, in the layout of its own creature."""
    opened = open_champion(run)
    panel = wall_panel(opened, 1, 0, Film(seconds=0.5, fps=60), 24)
    genes, fitness = evaluated_at(opened.experiment, opened.folder, 1)
    # The newest generations come from the folder's checkpoints.
    kept = opened.folder.load(1)
    assert kept is not None and kept.generation == 1
    np.testing.assert_array_equal(genes, kept.genes)
    record = compile_motions(opened.experiment, 0.5, 60)
    for one in panel.exhibits:
        assert one.fitness == fitness[0, one.number]
        _, found = record(genes[:, [one.number]], 1, 0, np.array([one.number]), 0)
        root = found["position"][:, :, 0, 0]
        np.testing.assert_allclose(one.recording.position[:, 0], root, atol=1e-4)
        # The distance of the last control step is close to the distance after the trial.
        moved = np.linalg.norm((root[-1] - root[0])[:2])
        assert moved == pytest.approx(one.fitness, abs=0.05)
        for body in one.creature.bodies:
            if body.joint is not None:
                own, parent = (one.creature.body_index(x) for x in (body.name, body.joint.parent))
                ends = [
                    one.recording.position[:, i]
                    + one.recording.rotation[:, i] @ np.array(anchor)
                    for i, anchor in ((own, body.joint.child_anchor),
                                      (parent, body.joint.parent_anchor))
                ]  # fmt: skip
                np.testing.assert_allclose(*ends, atol=1e-5)


@pytest.mark.slow
def test_ancestors_are_drawn_and_filmed(cli, run, tmp_path, monkeypatch):
    made, _ = cli.passes("plot", run, "--output", tmp_path)
    assert "family.png" in made and "diversity.png" in made
    assert "needs" in cli.refuses("render", run, "--lineage", "ancestors", *SMALL)
    monkeypatch.setattr("evo_cpg.api.ancestors.NEEDED", 0.5)
    place = tmp_path / "ancestors.png"
    cli.passes("render", run, "--lineage", "ancestors", *SMALL, "--sheet", "2x2", "-o", place)
    with Image.open(place) as picture:
        assert picture.size == (324, 184)
