"""The controls of the study of worlds search as long, and lack the senses that they should."""

from collections import Counter

import pytest

from evo_cpg.io.build import build_experiment
from evo_cpg.io.shipped import shipped
from evo_cpg.studies.workshop import configuration
from evo_cpg.studies.worlds import STUDY, WORLDS


@pytest.mark.parametrize("world", WORLDS)
def test_random_search_has_equal_evaluations(world):
    evolved, random = (
        configuration(STUDY, f"{world} {name}") for name in ("evolved", "random search")
    )
    sizes = {
        (each.evolution.generations, each.evolution.population, each.simulation.trials)
        for each in (evolved, random)
    }
    assert random.evolution.type == "random"
    assert len(sizes) == 1


@pytest.mark.parametrize("world", WORLDS)
def test_a_constant_brain_senses_nothing(world):
    config = configuration(STUDY, f"{world} constant brain")
    simulation = build_experiment(config, shipped(world).path).simulation
    sensors, silent = simulation.sensors, Counter[str]()
    for each in simulation.imperfections:
        silent[each.part] += each.count * each.silent
    assert silent["light"] == silent["vertical_sine"] == len(sensors.eye_bodies) > 0
    assert silent["pressure"] == len(sensors.pressure_bodies)
    assert silent["custom"] == sum(each.count for each in simulation.extra_sensors)
    assert not len(sensors.depth_bodies)
    assert not config.controller.senses_joints
