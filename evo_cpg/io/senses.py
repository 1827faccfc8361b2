"""Imperfections of senses, from the creature's section ``senses``."""

from collections.abc import Iterator

from evo_cpg.control.controller import Controller
from evo_cpg.control.feedback import make_delay
from evo_cpg.creature.creature import Creature
from evo_cpg.creature.tree import Tree
from evo_cpg.io.errors import KeyProblem
from evo_cpg.io.schema.experiment import ExperimentConfig
from evo_cpg.io.schema.sensor import ImperfectionConfig, kind_of
from evo_cpg.simulation.imperfect import Imperfection
from evo_cpg.simulation.sensors import Sensor

# Part of an observation, first reading, and number of readings.
_Place = tuple[str, int, int]
# A control rate is a multiple of a sense's rate if the quotient is whole up to rounding.
_ROUNDING = 1e-4


def build_imperfections(
    config: ExperimentConfig,
    creature: Creature,
    tree: Tree,
    sensors: tuple[Sensor, ...],
    controller: Controller,
) -> tuple[Imperfection, ...]:
    """Build the imperfections of all readings of the senses that have one.

    Raises:
        KeyProblem: the animal has no such sense, or its rate does not fit the control rate.
    """
    places: dict[str, list[_Place]] = {}
    for kind, place in _places(config, creature, tree, sensors, controller):
        places.setdefault(kind, []).append(place)
    found = []
    for kind, given in config.creature.senses:
        if given is None:
            continue
        if kind not in places:
            having = ", ".join(places)
            problem = f"the creature has no such sense. It has: {having}"
            raise KeyProblem(("creature", "senses", kind), problem)
        if given.silent:
            found += [Imperfection(*place, silent=True) for place in places[kind]]
            continue
        rate = config.simulation.control_rate_hz
        period, delay = _period(kind, given, rate), make_delay(given.delay, 1 / rate)
        found += [Imperfection(*place, given.noise, delay, period) for place in places[kind]]
    return tuple(found)


def _places(
    config: ExperimentConfig,
    creature: Creature,
    tree: Tree,
    sensors: tuple[Sensor, ...],
    controller: Controller,
) -> Iterator[tuple[str, _Place]]:
    """Yield each kind of sense that an animal has, and the place of its readings."""
    eyes, bodies = len(creature.light_sensors), len(tree.names)
    for kind, part, count in (
        ("light", "light", eyes),
        ("vertical", "vertical_cosine", eyes),
        ("vertical", "vertical_sine", eyes),
        ("pressure", "pressure", len(creature.pressure_sensors)),
        ("depth", "depth", len(creature.depth_sensors)),
        ("joint_angle", "joint_angle", tree.dof_count),
        ("joint_rate", "joint_rate", tree.dof_count),
        ("load", "load", bodies * controller.uses_load),
    ):
        if count:
            yield kind, (part, 0, count)
    first = 0
    for given, sensor in zip(config.creature.sensors, sensors, strict=True):
        yield kind_of(given), ("custom", first, sensor.count)
        first += sensor.count


def _period(kind: str, given: ImperfectionConfig, control_rate: float) -> int:
    """Return the number of control steps between two samples."""
    if given.rate_hz is None:
        return 1
    steps = control_rate / given.rate_hz
    period = max(1, round(steps))
    if abs(steps - period) > _ROUNDING * steps:
        problem = (
            f"control_rate_hz ({control_rate:g}) must be a multiple of it, got {given.rate_hz:g}. "
            f"Nearest: {control_rate / period:g}"
        )
        raise KeyProblem(("creature", "senses", kind, "rate_hz"), problem)
    return period
