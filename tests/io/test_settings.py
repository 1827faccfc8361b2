"""Settings of a sweep: their names, their values and their errors."""

import pytest

from evo_cpg.io.errors import ConfigError
from evo_cpg.io.load import as_overrides
from evo_cpg.io.settings import combine, read_settings


def test_every_combination_has_a_name_and_its_values():
    found = combine({"evolution.mutation_rate": [0.02, 0.5], "seed": [1, 2]}, {})
    assert [setting.name for setting in found] == [
        "mutation_rate=0.02,seed=1",
        "mutation_rate=0.02,seed=2",
        "mutation_rate=0.5,seed=1",
        "mutation_rate=0.5,seed=2",
    ]
    assert found[1].values == {"evolution.mutation_rate": 0.02, "seed": 2}
    assert as_overrides(found[1].values) == ["evolution.mutation_rate=0.02", "seed=2"]


def test_keys_with_the_same_last_part_are_named_in_full():
    found = combine({"world.water.density": [1], "creature.density": [2]}, {})
    assert found[0].name == "world.water.density=1,creature.density=2"


def test_named_settings_are_combined_with_the_grid():
    named = {"plain": {}, "cma": {"evolution": {"type": "evosax", "algorithm": "Sep_CMA_ES"}}}
    found = combine({"seed": [0, 1]}, named)
    assert [setting.name for setting in found] == [
        "plain,seed=0", "plain,seed=1", "cma,seed=0", "cma,seed=1",
    ]  # fmt: skip
    assert found[2].values == {**named["cma"], "seed": 0}
    assert [setting.name for setting in combine({}, named)] == ["plain", "cma"]


def test_sections_are_named_by_type_and_names_are_valid_folders():
    sections = [{"type": "random"}, {"type": "evosax", "algorithm": "LM_MA_ES"}, "../../etc"]
    names = [setting.name for setting in combine({"evolution": sections}, {})]
    assert names == ["evolution=random", "evolution=LM_MA_ES", "evolution=..-..-etc"]
    assert "/" not in "".join(names)
    assert combine({}, {"../up": {}})[0].name == "up"


def test_duplicate_names_and_too_many_settings_are_rejected():
    with pytest.raises(ValueError, match="two settings would be called 'seed=1'"):
        combine({"seed": [1, 1]}, {})
    with pytest.raises(ValueError, match="at most 1000 settings, got 10000"):
        combine({"seed": list(range(100)), "world.gravity": list(range(100))}, {})
    with pytest.raises(ValueError, match=r"evolution would replace evolution\.elites of .*'few'"):
        combine({"evolution": [{"type": "random"}]}, {"few": {"evolution.elites": 1}})


@pytest.mark.parametrize(
    ("text", "words"),
    [("a: 3", "a: must be settings"), ("a: {1: 2}", "a: must be settings"), ("- a", "mapping")],
)
def test_file_without_settings_is_rejected(tmp_path, text, words):
    path = tmp_path / "settings.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=words):
        read_settings(path)


def test_settings_are_read_from_a_file(tmp_path):
    path = tmp_path / "settings.yaml"
    path.write_text("a: {}\nb: {seed: 3, evolution: {type: random}}\n")
    assert read_settings(path) == {"a": {}, "b": {"seed": 3, "evolution": {"type": "random"}}}
