"""Settings of a sweep: what each is called, and what is wrong with them."""

import pytest

from evo_cpg.config.errors import ConfigError
from evo_cpg.config.settings import combine, read_settings


def test_every_combination_has_a_name_and_its_values():
    found = combine({"evolution.mutation_rate": [0.02, 0.5], "seed": [1, 2]}, {})
    assert [setting.name for setting in found] == [
        "mutation_rate=0.02,seed=1",
        "mutation_rate=0.02,seed=2",
        "mutation_rate=0.5,seed=1",
        "mutation_rate=0.5,seed=2",
    ]
    assert found[1].values == {"evolution.mutation_rate": 0.02, "seed": 2}
    assert found[1].overrides == ["evolution.mutation_rate=0.02", "seed=2"]


def test_keys_that_end_alike_are_written_out():
    found = combine({"world.water.density": [1], "creature.density": [2]}, {})
    assert found[0].name == "world.water.density=1,creature.density=2"


def test_named_settings_go_with_the_grid():
    named = {"plain": {}, "cma": {"evolution": {"type": "evosax", "algorithm": "Sep_CMA_ES"}}}
    found = combine({"seed": [0, 1]}, named)
    assert [setting.name for setting in found] == [
        "plain,seed=0", "plain,seed=1", "cma,seed=0", "cma,seed=1",
    ]  # fmt: skip
    assert found[2].values == {**named["cma"], "seed": 0}
    assert [setting.name for setting in combine({}, named)] == ["plain", "cma"]


def test_sections_are_called_by_their_types_and_names_are_those_of_folders():
    sections = [{"type": "random"}, {"type": "evosax", "algorithm": "LM_MA_ES"}, "../../etc"]
    names = [setting.name for setting in combine({"evolution": sections}, {})]
    assert names == ["evolution=random", "evolution=LM_MA_ES", "evolution=..-..-etc"]
    assert "/" not in "".join(names)
    assert combine({}, {"../up": {}})[0].name == "up"


def test_what_cannot_be_told_apart_or_run_is_refused():
    with pytest.raises(ValueError, match="two settings would be called 'seed=1'"):
        combine({"seed": [1, 1]}, {})
    with pytest.raises(ValueError, match="at most 1000 settings, this one 10000"):
        combine({"seed": list(range(100)), "world.gravity": list(range(100))}, {})


@pytest.mark.parametrize(
    ("text", "words"),
    [("a: 3", "a: must be settings"), ("a: {1: 2}", "a: must be settings"), ("- a", "mapping")],
)
def test_a_file_of_something_else_is_refused(tmp_path, text, words):
    path = tmp_path / "settings.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=words):
        read_settings(path)


def test_a_file_of_settings(tmp_path):
    path = tmp_path / "settings.yaml"
    path.write_text("a: {}\nb: {seed: 3, evolution: {type: random}}\n")
    assert read_settings(path) == {"a": {}, "b": {"seed": 3, "evolution": {"type": "random"}}}
