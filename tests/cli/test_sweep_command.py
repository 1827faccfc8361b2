"""`evo-cpg sweep`: evolve several settings, interrupt and continue them, and compare them."""

import csv
import json
import shutil

import numpy as np
import pytest

import evo_cpg as evo
from evo_cpg.api import sweep as sweeps
from evo_cpg.api.sweep import new_plan, read_plan
from evo_cpg.cli.evolve import _axis
from evo_cpg.cli.evolve import sweep as run_sweep
from evo_cpg.errors import UsageError
from evo_cpg.io.load import as_overrides
from evo_cpg.io.settings import combine
from evo_cpg.training import devices, train
from evo_cpg.training.run_folder import RunFolder, RunFolderError
from evo_cpg.view import search_plots
from pictures import ink
from tiny_run import CONFIG, PAIR
from trials import untimed

SHORT = (*PAIR, "simulation.seconds=0.3333", "evolution.generations=3", "runs=2")
GRID = ("evolution.mutation_rate=0.02,0.3",)


@pytest.fixture(autouse=True, scope="module")
def two_devices():
    """Use the two devices that JAX already has."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(devices, "use_cores", lambda count=None: 2)
        yield


def sweep(folder, *, grid=GRID, settings=None, given=SHORT, only=()):
    run_sweep(CONFIG, given, grid, settings, folder, only=only)


def table(path):
    with path.open() as file:
        return list(csv.DictReader(file))


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
def test_a_setting_has_the_same_result_alone_and_in_a_sweep(swept, tmp_path):
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


@pytest.mark.slow
def test_settings_with_the_same_trial_share_a_program(swept):
    members = sweeps.members_of(swept, sweeps.read_plan(swept))
    names = [[member.setting.name for member in group] for group in sweeps.groups(members)]
    assert names == [["plain", "random"], ["heavy"]]


@pytest.mark.parametrize(
    ("rule", "groups"),
    [("speed", [["speed=1"], ["speed=2"]]), ("overlap", [["speed=1", "speed=2"]])],
)
def test_rules_with_other_limits_need_another_program(tmp_path, rule, groups):
    """An individual that breaks one of the rules may obey the other."""
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


def test_under_noise_tables_and_figure_show_expected_fitness(swept, tmp_path, monkeypatch):
    """The history holds the best single evaluation instead."""
    load, drawn = RunFolder.load, []

    def with_expected_fitness(folder):
        found = load(folder)
        chosen = tuple(one._replace(lives=16, expected=one.fitness - 5.0) for one in found.records)
        return found._replace(chosen=chosen)

    monkeypatch.setattr(RunFolder, "load", with_expected_fitness)
    figure = search_plots.sweep_figure

    def seen(curves, title):
        drawn.extend(curves)
        return figure(curves, title)

    monkeypatch.setattr(search_plots, "sweep_figure", seen)
    sweeps.summarise(tmp_path, sweeps.members_of(swept, sweeps.read_plan(swept)))
    for curve in drawn:
        listed = [row["fitness"] for row in table(tmp_path / "runs.csv")
                  if row["setting"] == curve.name]  # fmt: skip
        np.testing.assert_array_equal(curve.final, np.array(listed, float))
        np.testing.assert_allclose(curve.final, curve.best[:, -1] - 5.0)
    assert len(drawn) == 3


@pytest.mark.slow
def test_a_continued_sweep_equals_an_uninterrupted_one(tmp_path, monkeypatch):
    """The sweep stops between the checkpoints of two settings, so one setting is ahead."""
    sweep(tmp_path / "whole")
    counted = []

    class Stop(BaseException):
        pass

    class Stopping(train.Running):
        def tell(self, part, began):
            if len(counted) == 3:
                raise Stop
            counted.append(self)
            return super().tell(part, began)

    with monkeypatch.context() as patch, pytest.raises(Stop):
        patch.setattr(train, "Running", Stopping)
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
    # The lost file is written again with all its entries.
    assert {"seed", "devices", "fingerprint", "config"} <= json.loads(lost.read_text()).keys()
    # A third run has nothing left to do.
    before = (tmp_path / "stopped" / "runs.csv").read_text()
    run_sweep(tmp_path / "stopped")
    assert (tmp_path / "stopped" / "runs.csv").read_text() == before


def test_a_run_of_a_sweep_can_be_verified(swept):
    found = evo.verify(swept / "heavy")
    assert found.exact and not found.differences
    meta = json.loads((swept / "random" / "meta.json").read_text())
    assert meta["name"] == "iwadate2010_swimmer random"


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"grid": ()}, "nothing is varied"),
        ({"grid": ("seed",)}, "'seed' is not KEY=VALUE,VALUE"),
        ({"grid": ("seed=[1",)}, "is not a list of values"),
        ({"grid": ("seed=1", "seed=2")}, "seed is given twice"),
        ({"grid": ("seed=1,2",), "given": ("seed=3",)}, "seed is given twice"),
        ({"only": ("there",)}, r"no setting 'there'\. Allowed: mutation_rate=0.02, mutation_rate"),
    ],
)
def test_wrong_options_are_refused(tmp_path, given, words):
    with pytest.raises(UsageError, match=words):
        sweep(tmp_path / "sweep", **given)


@pytest.mark.parametrize("text", ["[1,2],[3,4]", "[[1,2],[3,4]]", " [1, 2] , [3, 4]"])
def test_a_grid_may_hold_vectors(text):
    key, values = _axis(f"simulation.start={text}")
    assert (key, values) == ("simulation.start", [[1, 2], [3, 4]])
    found = combine({key: values}, {})
    assert [setting.name for setting in found] == ["start=1_2", "start=3_4"]


@pytest.mark.parametrize(
    ("grid", "words"),
    [
        ("evolution.mutation_rate=0.5,1.5", r"evolution\.mutation_rate: .*less than or equal"),
        ("seed=!!binary aGVsbG8=", "seed: .*Allowed: numbers, texts, lists"),
    ],
)
def test_a_wrong_setting_is_refused_before_any_run(tmp_path, grid, words):
    with pytest.raises(evo.ConfigError, match=words):
        sweep(tmp_path / "sweep", grid=(grid,))
    assert not (tmp_path / "sweep").exists()


def test_another_sweep_or_a_used_folder_is_refused(swept, tmp_path):
    with pytest.raises(RunFolderError, match="holds a sweep with other `settings`"):
        sweep(swept)
    with pytest.raises(UsageError, match="is a sweep, which can only be continued unchanged"):
        evo.sweep(swept, grid={"seed": [1, 2]})
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(RunFolderError, match="is not empty and holds no sweep"):
        sweep(tmp_path)


@pytest.mark.slow
def test_a_changed_configuration_is_refused(tmp_path):
    own = shutil.copytree(CONFIG.parent, tmp_path / "configs") / CONFIG.name
    run_sweep(own, SHORT, GRID, out=tmp_path / "sweep", only=["mutation_rate=0.02"])
    own.write_text(own.read_text().replace("seed: 0", "seed: 5"))
    with pytest.raises(RunFolderError, match="has changed since the sweep began"):
        run_sweep(tmp_path / "sweep")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"config": 3}, "wrong type"),
        ({"settings": {"a": []}}, "wrong type"),
        *(
            ({"settings": {name: {}}}, "is not allowed as the name of a setting")
            for name in ("../../x", "/tmp/x", "..", "", "a/b", "a\0")
        ),
    ],
)
def test_a_damaged_plan_is_refused(tmp_path, change, words):
    folder = tmp_path / "sweep"
    folder.mkdir()
    plan = new_plan(CONFIG, (), combine({"evolution.mutation_rate": [0.02, 0.3]}, {}))
    (folder / "sweep.json").write_text(json.dumps(plan))
    assert read_plan(folder) == plan
    (folder / "sweep.json").write_text(json.dumps(plan | change))
    with pytest.raises(RunFolderError, match=rf"sweep\.json is damaged \(.*{words}"):
        run_sweep(folder)
    assert list(tmp_path.rglob("*")) == [folder, folder / "sweep.json"]
