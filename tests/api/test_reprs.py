"""Text that `print` shows for public objects."""

import evo_cpg as evo
from evo_cpg.io.schema.world import WaterConfig, WorldConfig
from tiny_run import CONFIG, PAIR


def test_an_experiment_shows_its_parts():
    shown = repr(evo.load(CONFIG, [*PAIR, "task={type: distance}"]))
    assert shown.startswith("Experiment('iwadate2010_swimmer', creature=Creature('swimmer10'")
    assert "genes=51, task=Distance, trials=1 of 1 s, search=RealGenetics of 8" in shown


def test_settings_show_values_that_differ_from_defaults():
    assert repr(WorldConfig()) == str(WorldConfig()) == "WorldConfig()"
    world = WorldConfig(gravity=1.6, water=WaterConfig(surface=0.0))
    assert repr(world) == "WorldConfig(gravity=1.6, water=WaterConfig(surface=0.0))"
