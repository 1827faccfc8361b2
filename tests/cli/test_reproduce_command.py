"""`evo-cpg reproduce`: make the parts of a study, interrupt them and continue."""

import json
import shutil

import numpy as np
import pytest

from evo_cpg.api import machine, sweep
from evo_cpg.cli import repeat as reproduce
from evo_cpg.cli.repeat import default_folder, make
from evo_cpg.errors import UsageError
from evo_cpg.files import OutputError
from evo_cpg.studies import NAMES, find_study, provenance, workshop
from evo_cpg.studies.study import Part, Runs, Study, Table, beside, in_order, middle, percent
from evo_cpg.studies.workshop import Workshop
from evo_cpg.training.run_folder import RunFolder, RunFolderError
from tiny_run import PAIR

SHORT = (*PAIR, "simulation.seconds=0.5", "evolution.generations=3")
CONFIG = "iwadate2010_swimmer"


def report(shop: Workshop) -> list[Table]:
    """Return a table of the results of the runs, and draw a picture."""
    from evo_cpg.view.search_plots import generations_figure

    best = {name: shop.column(name, "best_distance") for name in ("few", "many")}
    shop.draw(generations_figure(best, "distance", single_runs=True), "best")
    ends = shop.kept("ends", ["few"], lambda: [each.fitness for each in shop.champions("few")])
    return [Table("Ends:", ["", "fitness"], [["few", in_order(ends, 4)]])]


TWIN = Study(
    "twin",
    "a study that a test can afford",
    {
        "few": Runs(CONFIG, SHORT, 2),
        "many": Runs(CONFIG, (*SHORT, "evolution.mutation_rate=0.5"), 2),
    },
    {"ends": Part("results of the runs", ("few", "many"), report)},
)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Make the study `TWIN`, and return its folder."""
    folder = tmp_path_factory.mktemp("twin")
    make(TWIN, ["ends"], folder, False, False, 2)
    return folder


def test_a_part_has_a_table_a_picture_and_its_provenance(made):
    text = (made / "ends.md").read_text()
    assert text.startswith("Ends:\n\n|  | fitness |\n| --- | --- |\n| few | ")
    record = provenance.read(made)["ends"]
    assert set(record["files"]) == {"ends.md", "ends_best.png"}
    assert provenance.problems(made) == []
    assert provenance.caption("twin", "ends", record) in text
    assert "Made by `evo-cpg reproduce twin ends` with evo-cpg " in text
    assert "Quick" not in text
    assert record["quick"] is False and record["devices"] == 2
    runs = record["runs"]
    assert runs["many"]["seeds"] == [0, 1] and runs["many"]["generations"] == 3
    assert runs["few"]["config_sha256"] == RunFolder(made / "runs" / "few").config_digest()
    assert record["run_commits"] == [record["commit"]]


def test_finished_runs_are_not_evolved_again(made, tmp_path, monkeypatch):
    folder = tmp_path / "again"
    shutil.copytree(made, folder)
    before = RunFolder(folder / "runs" / "few").load()
    monkeypatch.setattr(sweep, "run_group", lambda *_: pytest.fail("evolved again"))
    monkeypatch.setattr(workshop, "program_commit", lambda: "0ther")
    make(TWIN, ["ends"], folder, False, False, 2)
    after = RunFolder(folder / "runs" / "few").load()
    assert before is not None and after is not None
    np.testing.assert_array_equal(before.genes, after.genes)
    # The table names the earlier commit that evolved the runs.
    first = provenance.read(made)["ends"]["commit"]
    text = (folder / "ends.md").read_text()
    assert "at commit 0ther on" in text and f", of runs evolved at {first}.*" in text


@pytest.mark.parametrize(("fresh", "words"), [(False, "parts ends\n"), (True, "without --fresh\n")])
def test_an_interrupt_prints_a_command_that_keeps_finished_runs(
    tmp_path, monkeypatch, capsys, fresh, words
):
    def stop(*arguments):
        raise KeyboardInterrupt

    monkeypatch.setattr(sweep, "run_group", stop)
    with pytest.raises(KeyboardInterrupt):
        make(TWIN, ["ends"], tmp_path / "twin", False, fresh, 2)
    assert capsys.readouterr().err.endswith(words)


@pytest.mark.slow
def test_a_continued_study_equals_an_uninterrupted_one(made, tmp_path, monkeypatch, capsys):
    folder, group = tmp_path / "stopped", sweep.run_group

    def stopping(members, tell):
        def stop(member, rows):
            tell(member, rows)
            if member.setting.name == "few" and rows[0]["generation"] == 1:
                raise KeyboardInterrupt

        group(members, stop)

    monkeypatch.setattr(sweep, "run_group", stopping)
    with pytest.raises(KeyboardInterrupt):
        make(TWIN, ["ends"], folder, False, False, 2)
    assert "Continue with the parts ends" in capsys.readouterr().err
    assert not (folder / "ends.md").exists()
    monkeypatch.setattr(sweep, "run_group", group)
    make(TWIN, ["ends"], folder, False, False, 2)
    for name in TWIN.runs:
        one, other = (RunFolder(place / "runs" / name).load() for place in (made, folder))
        assert one is not None and other is not None
        np.testing.assert_array_equal(one.genes, other.genes)
    first, second = ((place / "ends.md").read_text() for place in (made, folder))
    assert first.splitlines()[:5] == second.splitlines()[:5]


def test_runs_of_another_configuration_are_refused(made, tmp_path):
    """A limit of the audit does not affect the evolution, unless it is a rule."""
    folder = tmp_path / "other"
    shutil.copytree(made, folder)

    def changed(*changes: str) -> Study:
        return TWIN._replace(runs={**TWIN.runs, "few": Runs(CONFIG, (*SHORT, *changes), 2)})

    make(changed("audit.overlap=0.02"), ["ends"], folder, False, False, 2)
    for change in ("audit.disqualify=[speed]", "seed=7"):
        with pytest.raises(RunFolderError, match="few was made with another configuration"):
            make(changed(change), ["ends"], folder, False, False, 2)
    make(changed("seed=7"), ["ends"], folder, False, True, 2)
    assert provenance.read(folder)["ends"]["runs"]["few"]["seeds"] == [7, 8]
    assert (folder / "ends.md").read_text() != (made / "ends.md").read_text()


@pytest.mark.slow
def test_quick_results_are_marked_and_kept_apart(made, tmp_path):
    with pytest.raises(RunFolderError, match=r"holds full results of part 'ends'\. Choose another"):
        make(TWIN, ["ends"], made, True, False, 2)
    folder = tmp_path / "quick"
    make(TWIN, ["ends"], folder, True, False, 2)
    assert (
        "**Quick: a small test of the program, not a result.**" in (folder / "ends.md").read_text()
    )
    record = provenance.read(folder)["ends"]
    assert record["quick"] is True
    assert record["runs"]["few"]["generations"] == 2
    with pytest.raises(RunFolderError, match="holds quick results"):
        make(TWIN, ["ends"], folder, False, False, 2)


def test_measurements_are_kept_until_champions_or_the_program_change(made, tmp_path, monkeypatch):
    monkeypatch.setattr(workshop, "program_commit", lambda: "abc")
    folder = tmp_path / "kept"
    shutil.copytree(made, folder)
    shop = Workshop(TWIN, folder, False, 2)
    assert shop.kept("one", ["few"], lambda: (1, 2)) == [1, 2]
    assert shop.kept("one", ["few"], lambda: (3, 4)) == [1, 2]
    assert shop.kept("one", ["many"], lambda: (3, 4)) == [3, 4]
    (folder / "runs" / "one.json").write_text("{")
    assert shop.kept("one", ["many"], lambda: 5) == 5
    assert shop.kept("one", ["many"], lambda: 6) == 5
    monkeypatch.setattr(workshop, "program_commit", lambda: "abd")
    assert shop.kept("one", ["many"], lambda: 6) == 6
    # Uncommitted changes may have changed again, so an earlier measurement is not used again.
    monkeypatch.setattr(workshop, "program_commit", lambda: "abd-dirty")
    assert shop.kept("one", ["many"], lambda: 7) == 7
    assert shop.kept("one", ["many"], lambda: 8) == 8


def test_errors_suggest_the_nearest_study_or_part(tmp_path):
    def call(name, parts=(), listed=False):
        reproduce.reproduce(name, parts, tmp_path, True, listed, False, 2)

    with pytest.raises(UsageError, match=r"there is no study 'fukui': did you mean 'fukui2003'"):
        call("fukui")
    with pytest.raises(UsageError, match="starfish has no part 'lag': did you mean 'lags'"):
        call("starfish", ["lag"])
    with pytest.raises(UsageError, match="name a study: iwadate2010, fukui2003"):
        call(None)
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="cannot write"):
        Workshop(TWIN, tmp_path / "file" / "in", False, 2).claim()
    with pytest.raises(RunFolderError, match="few has no finished generation"):
        Workshop(TWIN, tmp_path, False, 2).checkpoint("few")


def test_files_go_next_to_the_pages_of_a_clone(monkeypatch, tmp_path):
    monkeypatch.setattr(machine, "checkout", lambda: tmp_path)
    assert default_folder("starfish", False) == tmp_path / "docs" / "reproduction" / "starfish"
    assert default_folder("starfish", True).parts == ("reproduction", "starfish_quick")
    monkeypatch.setattr(machine, "checkout", lambda: None)
    assert default_folder("starfish", False).parts == ("reproduction", "starfish")


def test_cells_of_tables():
    assert percent(0.0345) == "3.5 %"
    assert middle([3.0, 1.0, float("nan"), 2.0], 1) == "2.0 (1.0 to 3.0)"
    assert middle([float("nan")]) == "none"
    assert in_order([2, 1], 1) == "1.0, 2.0"
    words = beside({"a": [1, 2, 3, 4], "b": [5, 6, 7, 8], "c": [1, 2, 3, 5]}, "a")
    # Exactly 2 of 70 orders are as extreme. Holm doubles this p value.
    assert words["a"] == "" and words["b"] == "in 100% of pairs, p = 0.057"
    assert words["c"].startswith("in 53% of pairs, p = 1")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "part"), [(name, part) for name in NAMES for part in find_study(name).parts]
)
def test_every_part_of_every_study_runs(name, part, tmp_path_factory):
    # The parts of a study share runs, so they share a folder.
    folder = tmp_path_factory.getbasetemp() / f"quick_{name}"
    make(find_study(name), [part], folder, True, False, 2)
    assert provenance.problems(folder) == []
    assert json.loads((folder / provenance.FILE).read_text())["parts"][part]["quick"] is True
