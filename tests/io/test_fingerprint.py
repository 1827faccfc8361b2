"""Changes of a configuration since a run began."""

import pytest

from evo_cpg.io.load import load_config
from evo_cpg.io.run import changes, changes_of_fitness, fingerprint
from tiny_run import CONFIG


def test_equal_and_unknown_configurations_have_no_changes():
    now = fingerprint(load_config(CONFIG))
    assert changes(now, now) == changes(None, now) == []


@pytest.mark.parametrize(
    ("given", "change", "harmful"),
    [
        ("", "world.gravity=1", True),
        ("", "creature.light_sensors=[]", True),
        ("", "simulation.substeps=7", True),
        ("", "simulation.seconds=9", True),
        ("", "noise.push=0.1", True),
        ("", "task={type: distance}", True),
        ("", "controller.cpg.time_scale=2", True),
        ("evolution={type: map_elites, axes: [{name: speed, range: [0, 1], cells: 4}]}",
         "evolution.axes.0.range=[0, 2]", True),
        ("", "audit.disqualify=[speed]", True),
        ("audit.disqualify=[speed]", "audit.speed=0.5", True),
        ("", "audit.speed=0.5", False),
        ("noise.push=0.1", "seed=3", True),
        ("", "seed=3", False),
        ("", "name=other", False),
        ("", "creature.name=other", False),
        ("", "evolution.mutation_rate=0.3", False),
    ],
)  # fmt: skip
def test_changes_of_the_search_leave_the_fitness(given, change, harmful):
    given = [given] if given else []
    before = fingerprint(load_config(CONFIG, given))
    found = load_config(CONFIG, [*given, change])
    assert changes(before, fingerprint(found)) != []
    assert bool(changes_of_fitness(before, found)) is harmful
