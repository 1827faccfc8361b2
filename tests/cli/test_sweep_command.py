"""`evo-cpg sweep`: settings side by side, in turn, stopped and gone on with."""

import csv
import json
import shutil

import numpy as np
import pytest

import evo_cpg as evo
from evo_cpg.api import sweep as sweeps
from evo_cpg.api.sweep import new_plan, read_plan
from evo_cpg.cli import champions
from evo_cpg.cli.errors import UsageError
from evo_cpg.cli.sweep import sweep as run_sweep
from evo_cpg.cli.verify import verify
from evo_cpg.config.load import as_overrides
from evo_cpg.config.settings import combine
from evo_cpg.training import devices, loop
from evo_cpg.training.loop import TIMING_COLUMNS
from evo_cpg.training.run_folder import RunFolder, RunFolderError
from evo_cpg.view import search_plots
from pictures import ink
from tiny_run import CONFIG, PAIR

SHORT = (*PAIR, "simulation.steps=20", "evolution.generations=3", "runs=2")
GRID = ("evolution.mutation_rate=0.02,0.3",)


@pytest.fixture(autouse=True, scope="module")
def two_devices():
    """JAX has them already."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(devices, "use_cores", lambda count=None: 2)
        patch.setattr(champions, "use_cores", lambda count=None: 2)
        yield


def sweep(folder, *, grid=GRID, settings=None, given=SHORT, only=()):
    run_sweep(CONFIG, given, grid, settings, folder, only=only)


def table(path):
    with path.open() as file:
        return list(csv.DictReader(file))


def untimed(rows):
    return [{k: v for k, v in row.items() if k not in TIMING_COLUMNS} for row in rows]


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    folder = tmp_path_factory.mktemp("swept") / "sweep"
    settings = folder.parent / "settings.yaml"
    settings.write_text(
        "plain: {}\n"
        "random: {evolution: {type: random, generations: 2, population: 6}}\n"
        "heavy: {world.water.density: 1200}\n"
    )
    sweep(folder, grid=(), settings=settings)
    return folder


@pytest.mark.slow
def test_each_setting_comes_to_what_it_comes_to_alone(swept, tmp_path):
    for name, changes in (
        ("plain", {}),
        ("random", {"evolution": {"type": "random", "generations": 2, "population": 6}}),
        ("heavy", {"world.water.density": 1200}),
    ):
        alone = evo.train(evo.load(CONFIG, [*SHORT, *as_overrides(changes)]), tmp_path / name)
        together = RunFolder(swept / name).load()
        assert together is not None and together.champion is not None
        assert untimed(together.history) == untimed(alone.history)
        np.testing.assert_array_equal(together.champion.genes, alone.genome)


def test_what_shares_a_trial_shares_a_program(swept):
    members = sweeps.members_of(swept, sweeps.read_plan(swept))
    names = [[member.setting.name for member in group] for group in sweeps.groups(members)]
    assert names == [["plain", "random"], ["heavy"]]


@pytest.mark.parametrize(
    ("rule", "groups"),
    [("speed", [["speed=1"], ["speed=2"]]), ("overlap", [["speed=1", "speed=2"]])],
)
def test_rules_with_other_limits_take_a_program_of_their_own(tmp_path, rule, groups):
    """Who is out for one of them may live for the other."""
    given = (*SHORT, f"audit.disqualify=[{rule}]")
    plan = new_plan(CONFIG, given, combine({"audit.speed": [1.0, 2.0]}, {}))
    found = sweeps.groups(sweeps.members_of(tmp_path, plan))
    assert [[member.setting.name for member in group] for group in found] == groups


def test_tables_and_figure(swept):
    runs = table(swept / "runs.csv")
    assert [(row["setting"], row["run"]) for row in runs] == [
        (name, run) for name in ("plain", "random", "heavy") for run in "01"
    ]
    assert {row["evaluations"] for row in runs} == {"24", "12"}
    assert runs[-1]["world.water.density"] == "1200" and runs[0]["world.water.density"] == ""
    for row in runs:
        champion = RunFolder(swept / row["setting"]).load().champions[int(row["run"])]
        assert float(row["fitness"]) == champion.fitness
        assert float(row["best_distance"]) == champion.terms["distance"]
    spreads = {row["name"]: row for row in table(swept / "settings.csv")}
    own = [float(row["fitness"]) for row in runs if row["setting"] == "plain"]
    assert float(spreads["plain"]["median"]) == pytest.approx(np.median(own))
    assert len(table(swept / "tests.csv")) == 3
    assert 0.01 < ink(swept / "sweep.png") < 0.5


def test_under_noise_figure_and_tables_show_what_champions_are_worth(swept, tmp_path, monkeypatch):
    """And not the luckiest score, of which the history tells."""
    load, drawn = RunFolder.load, []

    def chosen_in_fresh_draws(folder):
        found = load(folder)
        chosen = tuple(one._replace(lives=16, expected=one.fitness - 5.0) for one in found.records)
        return found._replace(chosen=chosen)

    monkeypatch.setattr(RunFolder, "load", chosen_in_fresh_draws)
    figure = search_plots.sweep_figure

    def seen(curves, title):
        drawn.extend(curves)
        return figure(curves, title)

    monkeypatch.setattr(search_plots, "sweep_figure", seen)
    sweeps.summarise(tmp_path, sweeps.members_of(swept, sweeps.read_plan(swept)))
    for curve in drawn:
        told = [row["fitness"] for row in table(tmp_path / "runs.csv")
                if row["setting"] == curve.name]  # fmt: skip
        np.testing.assert_array_equal(curve.final, np.array(told, float))
        np.testing.assert_allclose(curve.final, curve.best[:, -1] - 5.0)
    assert len(drawn) == 3


def test_a_stopped_sweep_goes_on_to_the_same_bits(tmp_path, monkeypatch):
    """Killed between the checkpoints of two settings, so that one is ahead."""
    sweep(tmp_path / "whole")
    counted = []

    class Stop(BaseException):
        pass

    class Stopping(loop.Running):
        def tell(self, part, began):
            if len(counted) == 3:
                raise Stop
            counted.append(self)
            return super().tell(part, began)

    with monkeypatch.context() as patch, pytest.raises(Stop):
        patch.setattr(loop, "Running", Stopping)
        sweep(tmp_path / "stopped")
    stopped = [
        RunFolder(tmp_path / "stopped" / name).load().generation
        for name in ("mutation_rate=0.02", "mutation_rate=0.3")
    ]
    assert stopped == [2, 1]
    lost = tmp_path / "stopped" / "mutation_rate=0.3" / "meta.json"
    lost.unlink()
    run_sweep(tmp_path / "stopped")
    for name in ("mutation_rate=0.02", "mutation_rate=0.3"):
        whole, again = (RunFolder(tmp_path / which / name).load() for which in ("whole", "stopped"))
        np.testing.assert_array_equal(whole.genes, again.genes)
        assert untimed(whole.history) == untimed(again.history)
    # Of what was never written as of what was.
    assert {"seed", "devices", "fingerprint", "config"} <= json.loads(lost.read_text()).keys()
    # Once more there is nothing left to do.
    before = (tmp_path / "stopped" / "runs.csv").read_text()
    run_sweep(tmp_path / "stopped")
    assert (tmp_path / "stopped" / "runs.csv").read_text() == before


def test_the_runs_are_run_folders_like_others(swept, capsys):
    verify(swept / "heavy")
    assert "(exactly)" in capsys.readouterr().out
    meta = json.loads((swept / "random" / "meta.json").read_text())
    assert meta["name"] == "iwadate2010_swimmer random"


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"grid": ()}, "nothing is varied; name keys and values"),
        ({"grid": ("seed",)}, "'seed' is not KEY=VALUE,VALUE"),
        ({"grid": ("seed=[1",)}, "is not a list of values"),
        ({"grid": ("name=!!int x",)}, "'!!int x' is not a list of values"),
        ({"grid": ("seed=1,1",)}, "two settings would be called 'seed=1'"),
        ({"only": ("there",)}, "no setting 'there'; there are mutation_rate=0.02, mutation_rate"),
    ],
)
def test_what_cannot_be_swept_is_said(tmp_path, given, words):
    with pytest.raises(UsageError, match=words):
        sweep(tmp_path / "sweep", **given)


def test_a_wrong_setting_is_said_before_anything_runs(tmp_path):
    with pytest.raises(evo.ConfigError, match=r"evolution\.mutation_rate: .*less than or equal"):
        sweep(tmp_path / "sweep", grid=("evolution.mutation_rate=0.5,1.5",))
    assert not (tmp_path / "sweep").exists()


def test_values_that_are_no_settings_are_refused(tmp_path):
    with pytest.raises(evo.ConfigError, match=r"seed: .*Allowed: numbers, texts, lists"):
        sweep(tmp_path / "sweep", grid=("seed=!!binary aGVsbG8=",))
    assert not (tmp_path / "sweep").exists()


def test_another_sweep_or_a_used_folder_is_refused(swept, tmp_path):
    with pytest.raises(RunFolderError, match="holds a sweep with other `settings`"):
        sweep(swept)
    with pytest.raises(UsageError, match="is a sweep, which is gone on with as it is"):
        run_sweep(swept, grid=GRID)
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(RunFolderError, match="is not empty and holds no sweep"):
        sweep(tmp_path)


def test_a_changed_configuration_is_said(tmp_path):
    own = shutil.copytree(CONFIG.parent, tmp_path / "configs") / CONFIG.name
    run_sweep(own, SHORT, GRID, out=tmp_path / "sweep", only=["mutation_rate=0.02"])
    own.write_text(own.read_text().replace("seed: 0", "seed: 5"))
    with pytest.raises(RunFolderError, match="has changed since the sweep began"):
        run_sweep(tmp_path / "sweep")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"config": 3}, "wrong type"),
        ({"overrides": [3]}, "wrong type"),
        ({"settings": {"a": []}}, "wrong type"),
        *(
            ({"settings": {name: {}}}, "is not allowed as the name of a setting")
            for name in ("../../x", "/tmp/x", "..", "", "a/b", "a\0")
        ),
    ],
)
def test_a_damaged_plan_is_said(tmp_path, change, words):
    folder = tmp_path / "sweep"
    folder.mkdir()
    plan = new_plan(CONFIG, (), combine({"evolution.mutation_rate": [0.02, 0.3]}, {}))
    (folder / "sweep.json").write_text(json.dumps(plan))
    assert read_plan(folder) == plan
    (folder / "sweep.json").write_text(json.dumps(plan | change))
    with pytest.raises(RunFolderError, match=rf"sweep\.json is damaged \(.*{words}"):
        run_sweep(folder)
    assert list(tmp_path.rglob("*")) == [folder, folder / "sweep.json"]
