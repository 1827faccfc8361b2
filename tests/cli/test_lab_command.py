"""`evo-cpg lab` on tiny animals: its table, its files, and its errors."""

import csv

import pytest
import yaml

from pictures import ink
from tiny_run import PAIR

TINY = ("u=0.4,0.8", "b=2", "--seconds", "1")


@pytest.fixture(scope="module")
def animal(tmp_path_factory):
    """Configuration of a tiny swimmer."""
    from evo_cpg.config.load import load_config
    from tiny_run import CONFIG

    path = tmp_path_factory.mktemp("lab") / "tiny.yaml"
    path.write_text(yaml.safe_dump(load_config(CONFIG, PAIR).model_dump(mode="json")))
    return path


def test_lab_prints_a_table_and_its_files(animal, cli, tmp_path):
    code, out, err = cli("lab", animal, *TINY, "--out", tmp_path)
    assert code == 0, err
    *table, file, picture = out.splitlines()
    assert (file, picture) == (str(tmp_path / "lab.csv"), str(tmp_path / "lab.png"))
    assert max(map(len, table)) <= 80
    with (tmp_path / "lab.csv").open() as opened:
        found = list(csv.DictReader(opened))
    assert [row["u"] for row in found] == ["0.4", "0.8"]
    assert all(float(row["power"]) > 0 for row in found)
    assert 0.01 < ink(tmp_path / "lab.png") < 0.5


@pytest.mark.slow
def test_champion_of_a_run_keeps_its_brain(finished_run, cli, tmp_path):
    code, out, err = cli("lab", finished_run, "silence=none,light", "--out", tmp_path)
    assert code == 0, err
    assert "light" in out


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("u",), "'u' is not KNOB=VALUES, such as u=0.2,0.6 or u=0.2:1:9"),
        (("u=1", "u=2"), "u is given twice"),
        (("u=0:1",), "u=0:1: expected START:STOP:COUNT"),
        (("u=0:1:3:lin",), "u=0:1:3:lin: expected START:STOP:COUNT"),
        (("tow=0.1", "w=3"), "'w' is no knob"),
    ],
)
def test_wrong_words_have_one_clear_line(animal, cli, words, message):
    code, _, err = cli("lab", animal, *words)
    assert code == 2
    assert message in err and len(err.strip().splitlines()) == 1
