"""`benchmarks/faults.py` makes real faults, and notices mistakes of the program."""

import random
import shutil

import pytest
import yaml

from benchmarks import faults
from evo_cpg.io.load import load_config
from evo_cpg.training.run_folder import RunFolder
from tiny_run import CONFIG, REPOSITORY, contents


@pytest.mark.parametrize("number", range(20))
def test_mistakes_change_a_configuration(number):
    chance = random.Random(number)
    data = yaml.safe_load(CONFIG.read_text())
    before = yaml.safe_dump(data)
    assert yaml.safe_dump(faults.with_odd_values(data, chance)) != before
    assert yaml.safe_dump(data) == before
    text = CONFIG.read_bytes()
    assert faults.with_odd_text(text, chance) != text


def test_wrong_configurations_are_taken_or_refused(tmp_path):
    folder = tmp_path / "configs"
    folder.mkdir()
    creature = (REPOSITORY / "configs" / "creatures" / "swimmer10.yaml").read_text()
    (folder / "creatures").mkdir()
    (folder / "creatures" / "swimmer10.yaml").write_text(creature)
    (folder / CONFIG.name).write_text(CONFIG.read_text())
    outcomes = {faults.build_odd(folder, number) for number in range(12)}
    assert outcomes <= {"taken", "refused"} and "refused" in outcomes
    assert not list(folder.glob("odd_*"))


def test_errors_of_the_program_are_raised(tmp_path, monkeypatch):
    (tmp_path / CONFIG.name).write_text("name: x\ncreature: {}\n")

    def broken(path):
        raise KeyError("ours")

    monkeypatch.setattr("evo_cpg.io.load.load_config", broken)
    with pytest.raises(KeyError):
        faults.build_odd(tmp_path, 0)


def test_damage_changes_only_the_named_files(tmp_path):
    run = RunFolder(tmp_path / "run")
    run.create("name: x\n", {"devices": 1})
    (run.path / "metrics.csv").write_text("a,b\n1,2\n")
    for number in range(20):
        copy = shutil.copytree(run.path, tmp_path / f"run{number}")
        before = contents(copy)
        broken = faults.damage(copy, random.Random(number))
        after = contents(copy)
        changed = {path for path in before if before[path] != after.get(path)}
        assert broken and {str(path.relative_to(copy)) for path in changed} <= set(broken)


def test_the_kinds_of_run_are_valid():
    for name, settings in faults.KINDS.values():
        path = CONFIG.with_name(f"{name}.yaml")
        assert load_config(path, settings).evolution.generations == 40
