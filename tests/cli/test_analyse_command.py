"""`evo-cpg analyse`: the numbers on its page, errors, and the page in a browser."""

import html
import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import chromium
import evo_cpg as evo
from evo_cpg.io.load import dump_config, load_config
from evo_cpg.training.run_folder import RunFolder
from tiny_run import CONFIG, REPOSITORY, TINY

CHANGED = "config.yaml has changed since the champion evolved"
WALKER = REPOSITORY / "configs" / "fukui2003_model2.yaml"
MEASURES = ("speed", "power", "cost_of_transport", "duty_factor", "airborne")
SMALL_WALK = (
    "simulation.seconds=2",
    "runs=1",
    "evolution.population=4",
    "evolution.elites=2",
    "evolution.rank_probabilities=[0.4,0.3,0.2,0.1]",
    "evolution.generations=2",
    "audit.after_training=false",
    f"measures=[{','.join(MEASURES)}]",
)
browsing = pytest.mark.skipif(
    chromium.found() is None, reason="there is no Chromium here to open the page in"
)


@pytest.fixture(scope="module")
def swimmer(cli, tmp_path_factory) -> Path:
    """Make a run of three bodies that swim for two seconds, with its page."""
    run = tmp_path_factory.mktemp("swimmer") / "run"
    planar = "creature.bodies.1.joint.axes=[z]"
    settings = (*TINY, planar, "simulation.seconds=4", "evolution.generations=2")
    cli.passes("train", CONFIG, *settings, "--out", run)
    out, _ = cli.passes("analyse", run)
    lines = out.splitlines()
    assert lines[-2:] == [str(run / "analysis.json"), str(run / "analysis.html")]
    assert max(map(len, lines[:-2])) <= 80
    return run


@pytest.fixture(scope="module")
def walker(cli, tmp_path_factory) -> Path:
    """Make a run of a torso with one leg and the posture controller, with its page."""
    folder = tmp_path_factory.mktemp("walker")
    config = load_config(WALKER, SMALL_WALK)
    creature = config.creature.model_copy(update={"bodies": config.creature.bodies[:3]})
    (folder / "one_leg.yaml").write_text(
        dump_config(config.model_copy(update={"creature": creature}))
    )
    run = folder / "run"
    cli.passes("train", folder / "one_leg.yaml", "--out", run)
    cli.passes("analyse", run)
    return run


@pytest.mark.slow
def test_python_and_the_command_write_the_same_page(swimmer, tmp_path):
    run = tmp_path / "run"
    shutil.copytree(swimmer, run)
    first = page_of(run)
    (run / "analysis.html").unlink()
    assert evo.analyse(run).page == run / "analysis.html"
    # Charts have names drawn at random.
    parts = r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d[+-]\d{4}|<svg.*?</svg>"
    kept, again = (re.sub(parts, "", page, flags=re.DOTALL) for page in (first, page_of(run)))
    assert again == kept and "cost of transport" in kept
    assert CHANGED not in again


def page_of(run: Path) -> str:
    return (run / "analysis.html").read_text()


def rows_of(page: str, section: str) -> dict[str, list[str]]:
    """Return the cells of the tables of a section, by the first cell of each row."""
    part = page.split(f'id="{section}"')[1].split("</section>")[0]
    rows = [re.findall(r"<td[^>]*>(.*?)</td>", row) for row in re.findall(r"<tr>(.*?)</tr>", part)]
    return {row[0]: row[1:] for row in rows if row}


@pytest.mark.slow
def test_numbers_on_the_page_equal_the_measured_terms(walker):
    """The page uses the frames of a replay. The terms come from the trial in training."""
    terms = RunFolder(walker).load_champion()[0].terms
    shown = rows_of(page_of(walker), "numbers")
    names = {
        "speed": "speed",
        "power": "mean power",
        "duty_factor": "duty factor",
        "cost_of_transport": "cost of transport",
    }
    for key, name in names.items():
        # Positions are from the beginning of each control step, so the path is one step shorter.
        assert float(shown[name][0]) == pytest.approx(terms[key], rel=0.03), key
    # The term is a fraction of physics steps. The page counts control steps without any contact. In
    # each other control step, all physics steps but one may be in the air.
    whole, substeps = float(shown["airborne fraction"][0]), load_config(WALKER).simulation.substeps
    most = whole + (1 - whole) * (substeps - 1) / substeps
    assert 0.1 < whole <= terms["airborne"] + 1e-3 and terms["airborne"] <= most


@pytest.mark.slow
@pytest.mark.parametrize("animal", ["swimmer", "walker"])
def test_the_page_is_small_and_requests_nothing_from_the_network(animal, request):
    page = page_of(request.getfixturevalue(animal))
    assert len(page) < 5e6
    # Names of XML namespaces are addresses that a browser does not fetch.
    addresses = set(re.findall(r"(?:src|href|url\()=?[\"']?(?!#|data:)[^\s\"'>)]+", page))
    assert not {a for a in addresses if "://" in a and "www.w3.org" not in a}
    assert "default-src 'none'" in html.unescape(page)


@pytest.mark.slow
def test_html_of_a_run_is_escaped_in_a_named_page(cli, swimmer, tmp_path):
    """The HTML is in the name, the notes of the run, an audit and the configuration.

    The page replaces the file that `--out` names.
    """
    run = tmp_path / "run"
    shutil.copytree(swimmer, run)
    evil = "</script><script>window.broken=1</script><img src=x onerror=window.broken=1>"
    config = (run / "config.yaml").read_text()
    config = re.sub(r"(?m)^name: .*$", f"name: {json.dumps('x' + evil)}", config)
    (run / "config.yaml").write_text(f"# {evil}\n{config}")
    meta = json.loads((run / "meta.json").read_text())
    meta |= {"versions": {evil: evil}, "started": evil, "system": evil, "command": [evil]}
    (run / "meta.json").write_text(json.dumps(meta))
    check = {"question": evil, "measured": 1.0, "limit": None, "unit": evil, "passed": True}
    audit = {"passed": True, "reasons": [evil], "checks": [check], "made": evil, "fitness": evil}
    (run / "audit.json").write_text(json.dumps(audit))
    out = tmp_path / "there.html"
    out.write_text("mine")
    command = "analyse", run, "--out", "there.html", "--overwrite"
    code, told, complaint = cli(*command, folder=tmp_path)
    if code == 2:
        # Such a name is refused before the page is written.
        assert "name" in complaint
        (run / "config.yaml").write_text(f"# {evil}\n" + (swimmer / "config.yaml").read_text())
        code, told, complaint = cli(*command, folder=tmp_path)
    assert code == 0, complaint
    assert told.splitlines()[-2:] == ["there.json", "there.html"]
    page = out.read_text()
    assert "<canvas" in page
    # The file of the configuration has another digest.
    assert complaint == f"evo-cpg: warning: {run}: {CHANGED}\n" and CHANGED in page
    assert "window.broken" in page
    assert evil not in page and "<img src=x" not in page
    # Three scripts that run, and one with the data.
    assert len(re.findall("<script", page)) == 4
    assert "belongs to another champion" in page
    if chromium.found():
        with chromium.browser(tmp_path / "profile") as tab:
            tab.open(out)
            assert tab.run("window.broken === undefined")
            assert not tab.complaints


@pytest.mark.slow
def test_a_page_replaces_nothing(cli, swimmer, tmp_path):
    (tmp_path / "folder.html").mkdir()
    (tmp_path / "there.html").write_text("mine")
    for name, words in (("folder.html", "is a folder"), ("there.html", "there.html exists")):
        assert words in cli.refuses("analyse", swimmer, "--out", name, folder=tmp_path)
    assert (tmp_path / "there.html").read_text() == "mine"


@pytest.mark.slow
def test_numbers_in_json_python_and_terminal_agree(swimmer):
    """A number that does not exist is null and has a reason."""
    written = json.loads((swimmer / "analysis.json").read_text())
    found = evo.gait_numbers(swimmer)
    for each in found.quantities:
        row = written["quantities"][each.key]
        assert (row["value"] is None) == (not each.exists) == bool(row["missing"])
        if each.exists:
            assert row["value"] == pytest.approx(each.value, rel=1e-6), each.key


@pytest.mark.slow
@browsing
@pytest.mark.parametrize("animal", ["swimmer", "walker"])
def test_the_page_plays_and_scrubs_in_a_browser_without_a_network(request, tmp_path, animal):
    run = request.getfixturevalue(animal)
    with chromium.browser(tmp_path / "profile") as tab:
        tab.open(run / "analysis.html")
        tab.wait("document.querySelector('#animal.ready, #animal.still-only') !== null")
        assert tab.run("document.querySelector('#animal.ready') !== null"), "no WebGL"
        start = seen(tab, tmp_path)
        # The canvas shows more than one colour: an animal on a floor.
        assert len(np.unique(start.reshape(-1, 3), axis=0)) > 100

        scrub = (
            "(share => { const s = document.querySelector('#animal input[type=range]');"
            " s.value = share * s.max; s.dispatchEvent(new Event('input'));"
            " return [+s.value, +s.max]; })"
        )
        value, most = tab.run(f"{scrub}(0.5)")
        assert value == pytest.approx(0.5 * most, abs=0.02)
        middle = seen(tab, tmp_path)
        assert differs(start, middle)
        # The first instant has the same picture as before.
        tab.run(f"{scrub}(0)")
        assert not differs(start, seen(tab, tmp_path))

        tab.click("#animal .play")
        assert tab.run("document.querySelector('.play').textContent") == "Pause"
        tab.wait("+document.querySelector('#animal input[type=range]').value > 0.1")
        tab.click("#animal .play")
        instant = tab.run("+document.querySelector('#animal input[type=range]').value")
        played = seen(tab, tmp_path)
        assert differs(start, played)
        assert tab.run("+document.querySelector('#animal input[type=range]').value") == instant

        # Another camera, another picture.
        tab.click("[data-view=top]")
        assert differs(played, seen(tab, tmp_path))

        # A click into a chart over time moves the animal there.
        drawing = "document.querySelector('#effort .timed')"
        tab.run(f"{drawing}.scrollIntoView({{block: 'center'}})")
        box = tab.run(
            f"(() => {{ const b = {drawing}.getBoundingClientRect(), d = {drawing}.dataset;"
            " return [b.x + b.width * (0.25 * d.left + 0.75 * d.right), b.y + b.height / 2,"
            " +d.stop]; })()"
        )
        tab.mouse("mousePressed", box[:2])
        tab.mouse("mouseReleased", box[:2])
        now = tab.run("+document.querySelector('#animal input[type=range]').value")
        assert now == pytest.approx(0.75 * box[2], abs=0.1)

        for width in (1280, 390):
            tab.resize((width, 900))
            assert tab.cut() == []

        assert not tab.complaints
        requested = [address for address in tab.requests if not address.startswith("data:")]
        assert requested == [(run / "analysis.html").resolve().as_uri()]
        assert tab.paper().startswith(b"%PDF")


def seen(tab: chromium.Page, folder: Path) -> np.ndarray:
    """Return the pixels of the animal on the screen."""
    place = folder / "seen.png"
    place.write_bytes(tab.picture("#animal canvas"))
    with Image.open(place) as picture:
        # Cut off the caption below, which always changes.
        return np.array(picture.convert("RGB")).astype(int)[: int(picture.height * 0.88)]


def differs(one: np.ndarray, other: np.ndarray) -> bool:
    """Return whether more than a thousandth of the pixels differ."""
    return float((np.abs(one - other).max(-1) > 12).mean()) > 1e-3
