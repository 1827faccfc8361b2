"""`evo-cpg lab` on tiny animals: its table, its files, and its errors."""

import csv

import pytest
import yaml

from evo_cpg.cli.ask import short_heads
from evo_cpg.io.load import load_config
from pictures import ink
from tiny_run import CONFIG, PAIR

TINY = ("u=0.4,0.8", "b=2", "--seconds", "1")


@pytest.fixture(scope="module")
def animal(tmp_path_factory):
    """Configuration of a tiny swimmer."""
    path = tmp_path_factory.mktemp("lab") / "tiny.yaml"
    path.write_text(yaml.safe_dump(load_config(CONFIG, PAIR).model_dump(mode="json")))
    return path


def test_lab_prints_a_table_and_its_files(animal, cli, tmp_path):
    out, _ = cli.passes("lab", animal, *TINY, "--out", tmp_path)
    *table, file, picture = out.splitlines()
    assert (file, picture) == (str(tmp_path / "lab.csv"), str(tmp_path / "lab.png"))
    assert max(map(len, table)) <= 80
    with (tmp_path / "lab.csv").open() as opened:
        found = list(csv.DictReader(opened))
    assert [row["u"] for row in found] == ["0.4", "0.8"]
    assert all(float(row["power"]) > 0 for row in found)
    assert 0.01 < ink(tmp_path / "lab.png") < 0.5


def test_answers_are_kept(animal, cli, tmp_path, monkeypatch):
    """The default folder is a free one, and --out replaces an answer only with --overwrite."""
    monkeypatch.chdir(tmp_path)
    name = yaml.safe_load(animal.read_text())["name"]
    (tmp_path / "lab" / name).mkdir(parents=True)
    (tmp_path / "lab" / name / "lab.csv").touch()
    out, _ = cli.passes("lab", animal, *TINY)
    assert out.splitlines()[-1] == f"lab/{name}_2/lab.png"
    err = cli.refuses("lab", animal, *TINY, "--out", f"lab/{name}")
    assert f"lab/{name}/lab.csv exists. Choose another name, or replace it with" in err
    cli.passes("lab", animal, *TINY, "--out", f"lab/{name}", "--overwrite")


def test_heads_of_a_table_are_the_last_parts_of_keys():
    assert short_heads(["u", "world.water.density"]) == ["u", "density"]
    assert short_heads(["a.b.0", "a.c.0", "x.c.0"]) == ["b.0", "a.c.0", "x.c.0"]
    assert short_heads(["gravity", "world.gravity"]) == ["gravity", "world.gravity"]


@pytest.mark.slow
def test_champion_of_a_run_keeps_its_brain(finished_run, cli, tmp_path):
    out, _ = cli.passes("lab", finished_run, "silence=none,light", "--out", tmp_path)
    assert "light" in out
