"""Modules next to configurations: each configuration uses its own module, or raises."""

import sys

import pytest

import evo_cpg as evo
from evo_cpg.io.errors import ConfigError
from evo_cpg.simulation.judge import no_terms
from tiny_run import CONFIG, TINY

TASK = """
from evo_cpg.simulation.tasks import Distance

class Mine(Distance):
    where: str = {where!r}
"""


@pytest.fixture
def folders(tmp_path, monkeypatch):
    """Create two folders, each with a module of the same name."""
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.chdir(tmp_path)
    for where in ("a", "b"):
        (tmp_path / where).mkdir()
        (tmp_path / where / "mine_of_this_test.py").write_text(TASK.format(where=where))
        text = CONFIG.read_text().replace("creatures/", f"{CONFIG.parent}/creatures/")
        (tmp_path / where / "x.yaml").write_text(text)
    yield tmp_path
    sys.modules.pop("mine_of_this_test", None)


def load(path, *settings):
    changed = [*TINY, *settings, "task={type: 'mine_of_this_test:Mine'}", "world.ground={}"]
    return evo.load(path, changed, trust=True)


def test_module_of_the_same_name_in_another_folder_is_not_used(folders):
    first = load(folders / "a" / "x.yaml")
    assert first.parts.simulation.task.where == "a"
    with pytest.raises(ConfigError, match=r"would import .*a.mine_of.* instead of .*b"):
        load(folders / "b" / "x.yaml")
    assert load(folders / "a" / "x.yaml").parts.simulation.task.where == "a"


def test_own_task_may_use_measures(folders):
    (folders / "a" / "mine_of_this_test.py").write_text(
        """
from evo_cpg.simulation.tasks import Distance

class Mine(Distance):
    def scales(self, terms):
        return {"speed": terms["speed"].max()}

    def descriptors(self, terms):
        return {"quick": terms["speed"]}

    def fitness(self, terms, scales):
        return terms["speed"] / scales["speed"]
"""
    )
    simulation = load(folders / "a" / "x.yaml", "measures=[speed]").parts.simulation
    assert "speed" in no_terms(simulation)
