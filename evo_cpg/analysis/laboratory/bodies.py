"""The bodies and the water of each setting: other sizes, viscosity, gravity, currents, joints."""

import dataclasses
import fnmatch
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from evo_cpg.analysis.laboratory.settings import NOTHING, LabError, Setting
from evo_cpg.creature.axis_kinds import kind_named
from evo_cpg.creature.creature import Creature
from evo_cpg.creature.tree import Tree
from evo_cpg.errors import nearest
from evo_cpg.io.batched import batch_of_configs
from evo_cpg.io.build import build_creature, build_experiment
from evo_cpg.io.load import check_config
from evo_cpg.io.numbers import number_at, with_numbers
from evo_cpg.io.schema.experiment import ExperimentConfig
from evo_cpg.simulation.batched import BatchedSimulation
from evo_cpg.simulation.simulation import Simulation

# Powers of the size with which numbers of a creature grow. Torques of motors and springs grow with
# the moment of inertia of a body of the same density. So a motor follows its command equally well
# in all sizes. Muscles keep their stress, so their torque grows with the third power.
_LENGTH, _AREA, _VOLUME, _INERTIA = 1, 2, 3, 5
_POWERS = {
    "shape": _LENGTH,
    "at": _LENGTH,
    "child_at": _LENGTH,
    "position": _LENGTH,
    "distance": _LENGTH,
    "limits_m": _LENGTH,
    "rest_m": _LENGTH,
    "centre_of_mass": _LENGTH,
    "mass": _VOLUME,
    "inertia": _INERTIA,
    "full_scale": _LENGTH,
    "fibre_length": _LENGTH,
    "arm": _LENGTH,
    "area": _AREA,
    "gain": _INERTIA,
    "gear": _INERTIA,
    "friction_loss": _INERTIA,
    "torque_limit": _INERTIA,
    "stiffness": _INERTIA,
    "damping": _INERTIA,
    "armature": _INERTIA,
}

# The same for slides and for tendons whose length is in m. A slide that keeps its rates per length
# of the animal needs masses for inertias, and a length more for forces.
_FORCE = 4
_SLIDING_POWERS = {
    "gain": _VOLUME,
    "stiffness": _VOLUME,
    "damping": _VOLUME,
    "armature": _VOLUME,
    "gear": _FORCE,
    "friction_loss": _FORCE,
    "torque_limit": _FORCE,
    "rest": _LENGTH,
    "limits": _LENGTH,
}


class Variants(NamedTuple):
    """The animal of each setting.

    Attributes:
        simulation: trial of all settings, or one trial for each setting.
        creatures: the creature of each setting.
        common: the trial of the configuration.
    """

    simulation: Simulation | BatchedSimulation
    creatures: Sequence[Creature]
    common: Simulation

    def of(self, number: int) -> Simulation:
        """Return the trial of one setting."""
        whole = isinstance(self.simulation, BatchedSimulation)
        return self.simulation[number] if whole else self.simulation  # pyright: ignore


def build_bodies(
    config: ExperimentConfig,
    source: Path,
    settings: Sequence[Setting],
    folders: Sequence[Path],
    prepared: Callable[[Simulation], Simulation],
) -> Variants:
    """Build the animals of all settings.

    Args:
        config: configuration of the animal.
        source: file of the configuration.
        settings: the settings.
        folders: further folders with a user's own classes.
        prepared: function that changes every simulation in the same way.

    Raises:
        LabError: a setting does not fit the animal, or names no body with a joint.
        ConfigError: a number is wrong.
    """
    # This also makes a user's own classes importable.
    first = build_experiment(config, source, folders)
    configs = [config_of(config, source, setting) for setting in settings]

    def edit(simulation: Simulation, individual: int) -> Simulation:
        if individual >= 0:
            setting = settings[individual]
            world = simulation.world
            tree = world.tree
            passive = setting.get("passive", NOTHING)
            if passive != NOTHING:
                idle = np.isin(tree.dof_bodies, list(joints_of(tree, "passive", passive)))
                tree = tree.without_motors(idle)
            added = setting.get("stiffness", 0.0)
            tree = dataclasses.replace(tree, stiffness=tree.stiffness + float(added))
            simulation = dataclasses.replace(
                simulation, world=dataclasses.replace(world, tree=tree)
            )
        return prepared(simulation)

    common = edit(first.simulation, -1)
    joints = any(
        setting.get("passive", NOTHING) != NOTHING or setting.get("stiffness", 0.0) != 0
        for setting in settings
    )
    if not joints and all(each == config for each in configs):
        return Variants(common, [first.creature] * len(settings), common)
    if not joints and all(each == configs[0] for each in configs):
        same = build_experiment(configs[0], source)
        simulation = edit(same.simulation, 0)
        return Variants(simulation, [same.creature] * len(settings), simulation)
    batched = batch_of_configs(config, configs, source, edit)
    creatures = [build_creature(each, source) for each in configs]
    return Variants(batched, creatures, batched.common)


def config_of(config: ExperimentConfig, source: Path, setting: Setting) -> ExperimentConfig:
    """Return the configuration of a setting.

    Raises:
        LabError: the animal has no such number.
        ConfigError: a number is wrong.
    """
    size = setting.get("size", 1.0)
    if size != 1:
        data = config.model_dump(mode="json")
        data["creature"] = _scaled_creature(config, float(size))
        # The animal sees a light from as many of its lengths as before.
        trials = data["simulation"]["trials"]
        for place in (data["task"], *(trials if isinstance(trials, list) else ())):
            if place.get("light"):
                place["light"] = _scaled(place["light"], float(size))
        config = check_config(data, source)
    numbers = {key: float(value) for key, value in setting.items() if "." in key}
    water = config.world.water
    wet = [name for name in ("viscosity", "current", "tow") if name in setting]
    if water is None and wet:
        raise LabError(f"{', '.join(wet)}: there is no water")
    if water is not None and "viscosity" in setting:
        if water.viscosity is None:
            raise LabError("viscosity: the water has none. Set world.water.viscosity")
        key = "world.water.viscosity"
        numbers[key] = numbers.get(key, water.viscosity) * setting["viscosity"]
    if "gravity" in setting:
        key = "world.gravity"
        numbers[key] = numbers.get(key, config.world.gravity) * setting["gravity"]
    # A body that is towed in still water feels what a held body feels in a current.
    current = -setting.get("current", 0.0) - setting.get("tow", 0.0)
    if current and water is not None:
        heading = math.radians(config.simulation.start_heading_deg)
        along = current * math.cos(heading), current * math.sin(heading)
        for axis, value in enumerate(along):
            key = f"world.water.current.{axis}"
            numbers[key] = numbers.get(key, water.current[axis]) + value
    for key in numbers:
        number_at(config, key, source)
    return with_numbers(config, numbers, source) if numbers else config


def _scaled_creature(config: ExperimentConfig, size: float) -> dict[str, Any]:
    """Return the creature's section at another size."""
    given = config.creature.model_dump(mode="json")
    scaled = _scaled(given, size)
    for body, made in zip(given["bodies"], scaled["bodies"], strict=True):
        joint = body["joint"]
        axes = joint["axes"] if joint else ()
        slides = [isinstance(axis, dict) and "slide" in axis for axis in axes]
        if not any(slides):
            continue
        # A joint with slides has a value for each axis.
        powers = [_POWERS | _SLIDING_POWERS if slide else _POWERS for slide in slides]
        for name in ("stiffness", "damping", "armature", "friction_loss", "actuator"):
            if name in joint:
                every = joint[name] if isinstance(joint[name], list) else [joint[name]] * len(axes)
                made["joint"][name] = [
                    _scaled(value, size, own.get(name, 0), own)
                    for value, own in zip(every, powers, strict=True)
                ]
    for tendon, made in zip(given.get("tendons", ()), scaled.get("tendons", ()), strict=True):
        sliding = {name for name in tendon["joints"] if kind_named(name).unit == "m"}
        if sliding:
            made |= _scaled(tendon, size, powers=_POWERS | _SLIDING_POWERS)
            # Coefficients of turning axes are lever arms beside a slide.
            made["joints"] = {
                name: value if name in sliding else value * size
                for name, value in tendon["joints"].items()
            }
    return scaled


def _scaled(place: Any, size: float, power: int = 0, powers: Mapping[str, int] = _POWERS) -> Any:
    """Return a section of a creature at another size, whose values grow with powers of it."""
    if isinstance(place, dict):
        return {
            name: _scaled(x, size, powers.get(name, power), powers) for name, x in place.items()
        }
    if isinstance(place, list):
        return [_scaled(each, size, power, powers) for each in place]
    return place * size**power if isinstance(place, float) else place


def joints_of(tree: Tree, knob: str, names: str) -> set[int]:
    """Return the bodies of some names or patterns that have a joint.

    Args:
        tree: the creature.
        knob: name of the knob, for messages.
        names: names or patterns, separated by ``+``.

    Raises:
        LabError: no body with a joint has such a name.
    """
    movable = [tree.names[body] for body in sorted(set(tree.dof_bodies))]
    found: set[int] = set()
    for name in names.split("+"):
        matching = fnmatch.filter(movable, name)
        if not matching:
            hint = nearest(name, movable)
            raise LabError(f"{knob}={names}: {name!r} names no body with a joint ({hint})")
        found.update(map(tree.names.index, matching))
    return found
