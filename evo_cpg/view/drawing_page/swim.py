"""The drawn animal swims to a light at once, moved by the newborn brain.

One program fits almost any animal in deep water (`evo_cpg.simulation.any_animal`). It is compiled
while the user draws, and kept on disk. Other animals need a program of their own, which takes
longer.
"""

import dataclasses
import functools
import threading
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from evo_cpg.creature.algebra.numerics import as_vector
from evo_cpg.io.build import CommonPlan, build_simulation
from evo_cpg.io.load import complete_config, read_yaml
from evo_cpg.io.plans import with_star
from evo_cpg.io.shipped import shipped
from evo_cpg.simulation.any_animal import AnimalInputs
from evo_cpg.simulation.recording import Recorder
from evo_cpg.simulation.simulation import Simulation
from evo_cpg.training.devices import population_mesh, use_cores
from evo_cpg.training.evaluate import compile_trials

RATE = 30.0
"""Frames per second, 1/s."""

STEPS = {"control_rate_hz": 60, "substeps": 4, "seconds": 20}
"""Section of the simulation of a swim. The brain needs short steps (docs/models/body-brain.md)."""

# Most bodies in the common program, and distance of the farthest light in lengths of the animal.
_BODIES, _FARTHEST = 20, 5.0
_KEPT = "position", "rotation"


class Swim(NamedTuple):
    """Motion of an animal to a light.

    Attributes:
        names: names of the bodies.
        position: centres of the bodies, m.
        rotation: rotations from body to world axes.
        light: place of the light, m.
    """

    names: tuple[str, ...]
    position: Float[np.ndarray, "t b 3"]
    rotation: Float[np.ndarray, "t b 3 3"]
    light: tuple[float, float, float]


_lock = threading.Lock()


def prepare() -> Callable[..., dict[str, np.ndarray]]:
    """Return the common program. The first call compiles it, others wait for it."""
    with _lock:
        return _common_program()


def swim(own: Simulation, length: float) -> Swim:
    """Return the motion of an animal with the newborn brain.

    Args:
        own: simulation of the animal with the controller `body_brain`, `STEPS` and a light.
        length: length of the animal, m. A light is moved to at most five lengths away.
    """
    begin, goal = own.situations[0], own.lights[0]
    assert goal is not None
    start = np.array(begin.start_position)
    away = np.array(goal) - start
    light = as_vector(start + min(1.0, _FARTHEST * length / np.linalg.norm(away)) * away)
    own = dataclasses.replace(own, situations=(begin._replace(light=light),))
    inputs = _common_inputs()
    if found := inputs.values(own):
        values, places = found
        frames = prepare()(_genes(inputs.common), None, None, 1, (values[:, None],))
    else:
        frames, places = _compiled(own)(_genes(own)), slice(None)
    position, rotation = (np.moveaxis(frames[x][..., places, 0], -1, 1) for x in _KEPT)
    return Swim(own.world.tree.names, position, rotation, light)


def star(bodies: int) -> Simulation:
    """Return the simulation of a root with all other bodies on it, with three axes each."""
    source = shipped("follow_the_light").path
    plans = {"type": "plans", "plan": {"bodies": bodies, "joints": ["ball"]}}
    data = read_yaml(source) | {"evolution": plans, "simulation": STEPS}
    config = with_star(complete_config(data, source), bodies)
    return build_simulation(config, CommonPlan("complete"))[1]


@functools.cache
def _common_inputs() -> AnimalInputs:
    return AnimalInputs(star(_BODIES))


@functools.cache
def _common_program() -> Callable[..., dict[str, np.ndarray]]:
    use_cores()
    inputs = _common_inputs()
    # The star is an animal, too. The first animal also compiles the walk over its tree.
    found = inputs.values(star(_BODIES))
    assert found is not None
    return _compiled(inputs.common, inputs, (None, None, 1, (found[0][:, None],)))


def _compiled(simulation: Simulation, inputs: Any = None, given: tuple = ()) -> Callable[..., Any]:
    """Return the compiled program of a simulation."""
    recorder = Recorder(names=_KEPT, every=round(STEPS["control_rate_hz"] / RATE))
    ahead = _genes(simulation), *given
    return compile_trials(simulation, population_mesh(1), 1, inputs, recorder, ahead)


def _genes(simulation: Simulation) -> Float[np.ndarray, "g 1"]:
    """Return genes that leave the brain as it is."""
    return np.full((simulation.controller.gene_count, 1), 0.5, np.float32)
