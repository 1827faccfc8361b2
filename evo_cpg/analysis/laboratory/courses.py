"""What an evolved animal needs: its success on held-out courses, without senses and with cuts.

All settings have equal courses, none of which any training uses.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, UInt32

from evo_cpg.analysis.laboratory.settings import (
    NERVES,
    NOTHING,
    LabError,
    Setting,
    combinations,
    require_values,
)
from evo_cpg.analysis.laboratory.surgery import genes_of, prepare, require_effects
from evo_cpg.control.preparation import SENSES
from evo_cpg.simulation.judge import Outcome
from evo_cpg.simulation.simulation import Simulation
from evo_cpg.training.checkpoint import Champion
from evo_cpg.training.devices import population_mesh
from evo_cpg.training.evaluate import compile_trials
from evo_cpg.training.experiment import FIRST_ROUND, ExperimentParts, judge_each, trial_keys

# Number of the generation whose random numbers the courses use, apart from the choice of champions.
_HELD_OUT = FIRST_ROUND + 2**29


def held_out(
    experiment: ExperimentParts,
    kind: str,
    champion: Champion,
    values: Mapping[str, Sequence[Any]],
    count: int,
) -> tuple[list[Setting], list[dict[str, Any]]]:
    """Return the settings, and a row for each: its knobs, and means of all terms and the fitness.

    Args:
        experiment: experiment of the animal.
        kind: type of its controller in the configuration, for messages.
        champion: the animal.
        values: values of the knobs of nerves, or empty for `usual_settings`.
        count: number of courses.

    Raises:
        LabError: a knob or a value does not fit the animal, or its trials are not random.
    """
    simulation = experiment.simulation
    if simulation.silent:
        raise LabError("courses: nothing in a trial is random, so all courses would be equal")
    if others := sorted(values.keys() - NERVES.keys()):
        raise LabError(f"{', '.join(others)}: only knobs of nerves vary on courses")
    require_values(values, None)
    settings = combinations(values) if values else usual_settings(simulation)
    controller = prepare(simulation.controller, settings, True, kind)
    require_effects(controller, values)
    tree = simulation.world.tree
    genes = [genes_of(controller, tree, setting, champion.genes) for setting in settings]
    changed = dataclasses.replace(simulation, controller=controller)
    outcome = on_courses(experiment, np.stack(genes, -1).astype(np.float32), count, changed)
    scales = {name: jnp.float32(value) for name, value in champion.scales.items()}
    fitness = jax.device_get(judge_each(simulation.task, outcome, scales))
    lived = np.asarray(outcome.alive)
    first = {name: outcome.terms[name] for name in ("success",) if name in outcome.terms}
    measured = {**first, "fitness": fitness.T, **outcome.terms}
    rows = []
    for i, setting in enumerate(settings):
        means = {name: _mean(x[i], lived[i]) for name, x in measured.items()}
        if "success" in means:
            # An animal that diverges fails.
            means["success"] *= float(lived[i].mean())
        rows.append(dict(setting) | means | {"diverged": float(1 - lived[i].mean())})
    return settings, rows


def _mean(values: Float[np.ndarray, " n"], chosen: Bool[np.ndarray, " n"]) -> float:
    """Return the mean of some values, or NaN if there are none."""
    return float(values[chosen].mean()) if chosen.any() else float("nan")


def usual_settings(simulation: Simulation) -> list[Setting]:
    """Return the intact animal, one without each of its senses or all, and one with a cut cord."""
    sensors, extra = simulation.sensors, simulation.extra_sensors
    having = {
        "light": len(sensors.eye_bodies),
        "balance": len(sensors.eye_bodies),
        "pressure": len(sensors.pressure_bodies),
        "joints": True,
        "depth": len(sensors.depth_bodies),
        "sensors": len(extra),
        "feedback": getattr(simulation.controller, "feedback", None) is not None,
    }
    senses = [name for name in SENSES if having[name]]
    settings: list[Setting] = [
        {"silence": name, "cut": NOTHING} for name in (NOTHING, *senses, "all")
    ]
    return [*settings, {"silence": NOTHING, "cut": _middle(simulation)}]


def _middle(simulation: Simulation) -> str:
    """Return the body in the middle of the longest chain of joints."""
    tree, chains = simulation.world.tree, list[list[int]]()
    for body in range(tree.body_count):
        chain = [body]
        while tree.parents[chain[-1]] >= 0:
            chain.append(tree.parents[chain[-1]])
        chains.append(chain)
    longest = max(chains, key=len)
    return tree.names[longest[(len(longest) - 1) // 2]]


def on_courses(
    experiment: ExperimentParts,
    genes: Float[np.ndarray, "g n"],
    count: int,
    simulation: Simulation | None = None,
) -> Outcome:
    """Return the outcome of animals on held-out courses, ``(n, courses)``.

    Args:
        experiment: experiment that draws the courses.
        genes: genes of the animals.
        count: number of courses, which are equal for all animals.
        simulation: simulation to take in place of the experiment's.
    """
    simulation = simulation or experiment.simulation
    animals, numbers = genes.shape[1], None
    keys = course_keys(experiment, count)
    if len(simulation.situations) > 1:
        numbers = np.tile(np.arange(count) % len(simulation.situations), animals)
    live = compile_trials(simulation, population_mesh())
    found = live(genes, np.tile(keys, animals), numbers, count)
    return jax.tree.map(lambda x: x.reshape(animals, count), found)


def course_keys(experiment: ExperimentParts, count: int) -> UInt32[np.ndarray, "w count"]:
    """Return the random keys of held-out courses."""
    numbers, none = np.arange(count), np.zeros(count, int)
    return np.asarray(trial_keys(experiment, _HELD_OUT, none, numbers, none))
