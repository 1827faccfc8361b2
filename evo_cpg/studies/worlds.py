"""Study of worlds that need a brain: success on held-out courses, beside three controls.

The controls are random search at equal evaluations, animals that evolve blind, and animals without
any sense, whose brains are constant.
"""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from evo_cpg.analysis.laboratory.courses import on_courses
from evo_cpg.creature.creature import length_of
from evo_cpg.simulation.courses import Waypoints
from evo_cpg.studies.parts import pictures_part
from evo_cpg.studies.study import Part, Runs, Study, Table, middle, tabled
from evo_cpg.studies.workshop import Workshop

_COURSES = 200
_EVOLVED, _RANDOM, _BLIND, _CONSTANT = "evolved", "random search", "blind", "constant brain"
_DEAF, _OPEN = "without touch and rays", "from open water"
# Number of runs of each control.
_CONTROLS = {_RANDOM: 3, _BLIND: 2, _CONSTANT: 2, _DEAF: 2, _OPEN: 2}


class _World(NamedTuple):
    """World of the study.

    Attributes:
        title: title of its part.
        generations, population: size of its search, for random search at equal evaluations.
        senses: kinds of senses of its animal, without the eyes.
        runs: number of evolved runs.
        deaf: kinds of senses of a further control, which evolves without them.
        has_obstacles: whether a last control evolves without obstacles, and then meets them.
    """

    title: str
    generations: int
    population: int
    senses: tuple[str, ...] = ("vertical", "joint_angle")
    runs: int = 5
    deaf: tuple[str, ...] = ()
    has_obstacles: bool = False


WORLDS = {
    "waypoints": _World("lights in a row", 60, 100, ("vertical", "joint_angle", "pressure")),
    "moving_light": _World("a light that turns", 60, 200),
    "fleeing_light": _World("a light that flees", 60, 200),
    "cross_current": _World("a current from any side", 60, 200),
    "vortex_street": _World("a vortex street", 60, 200),
    "reef": _World(
        "a reef",
        50,
        100,
        ("vertical", "joint_angle", "pressure", "rays"),
        runs=3,
        deaf=("pressure", "rays"),
        has_obstacles=True,
    ),
    "land_waypoints": _World("lights in a row on land", 40, 100, runs=3),
}


def _silent(*kinds: str) -> tuple[str, ...]:
    return tuple(f"creature.senses.{kind}.silent=true" for kind in kinds)


def _settings(world: _World) -> dict[str, tuple[str, ...]]:
    """Return the changes of each setting."""
    size = f"generations: {world.generations}, population: {world.population}"
    found = {
        _EVOLVED: (),
        _RANDOM: (f"evolution={{type: random, {size}}}",),
        _BLIND: _silent("light"),
        # Joints show the spinal cord's rhythm, so a brain that senses them is not constant.
        _CONSTANT: (*_silent("light", *world.senses), "controller.senses_joints=false"),
    }
    if world.deaf:
        found[_DEAF] = _silent(*world.deaf)
    if world.has_obstacles:
        found[_OPEN] = ("world.ground.obstacles=[]",)
    return found


# The same animals swim straight ahead, because speeds of lights and currents are half of this.
_STRAIGHT = (
    "task={type: distance, heading: forward}",
    "simulation.seconds=20",
    "courses.draw={}",
    "simulation.trials=1",
    "evolution.generations=60",
)
# Flow at the head, for the comparison of its velocity with its gradient. The street is stronger
# than in `vortex_street`, where eyes alone suffice, and has no current.
_STRONG = (
    "world.water.current=[0, 0, 0]",
    "world.water.street.circulation=2.5",
    "world.water.street.speed=0.6",
)
_FLOWS = {
    "eyes alone": _STRONG,
    **{
        f"eyes and {reading} of the flow": (
            *_STRONG,
            f"creature.sensors=[{{type: flow, body: head, reading: {reading}}}]",
        )
        for reading in ("velocity", "gradient")
    },
}
_FLOW_RUNS = 8

RUNS = {
    **{
        f"{name} {setting}": Runs(name, changes, _CONTROLS.get(setting, world.runs))
        for name, world in WORLDS.items()
        for setting, changes in _settings(world).items()
    },
    "straight": Runs("moving_light", _STRAIGHT, 5),
    **{name: Runs("vortex_street", changes, _FLOW_RUNS) for name, changes in _FLOWS.items()},
}


def compared(workshop: Workshop, names: Sequence[str], prefix: str) -> list[Table]:
    """Return a table of success and distance from the goal on held-out courses."""
    rows = []
    for name in names:
        success, far = _held_out(workshop, name)
        rows.append(
            {
                "": name.removeprefix(prefix),
                "champions": str(len(success)),
                "success, % of courses": middle(100 * success, 1),
                "distance from the goal": middle(far, 2),
            }
        )
    return [tabled(rows)]


def _held_out(workshop: Workshop, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the fraction of successes of each champion, and its distance from the goal.

    The distance is the mean from the light, m, or the number of legs that are left. An animal that
    diverges fails, and has no distance. Animals from open water are measured among the obstacles.
    """
    arena = name.replace(_OPEN, _EVOLVED)

    def measure() -> list[list[float]]:
        experiment = workshop.member(arena).experiment
        genes = np.stack([each.genes for each in workshop.champions(name)], axis=1)
        found = on_courses(experiment, genes, _COURSES)
        terms, alive, task = found.terms, np.asarray(found.alive), experiment.simulation.task
        if isinstance(task, Waypoints):
            far = task.lights - 1 - terms["reached"] + terms["left"]
        else:
            far = terms["distance"]
        success = (alive * terms["success"]).mean(1)
        return [success.tolist(), np.nanmean(np.where(alive, far, np.nan), 1).tolist()]

    success, far = workshop.kept(f"held_out_{name}".replace(" ", "_"), [name, arena], measure)
    return np.array(success), np.array(far)


def straight(workshop: Workshop) -> list[Table]:
    """Return a table of the speed of swimmers that evolve to swim straight ahead."""
    member = workshop.member("straight")
    seconds = member.config.simulation.seconds
    speeds = [each.terms["forward"] / seconds for each in workshop.champions("straight")]
    length = length_of(member.config.creature.build())
    row = {
        "champions": str(len(speeds)),
        "speed, m/s": middle(speeds, 2),
        "speed, lengths/s": middle(np.array(speeds) / length, 2),
    }
    return [tabled([row])]


def _part(name: str, world: _World) -> Part:
    names = tuple(f"{name} {setting}" for setting in _settings(world))
    return Part(world.title, names, partial(compared, names=names, prefix=f"{name} "))


STUDY = Study(
    "worlds",
    "Worlds that need a brain",
    RUNS,
    {
        **{name: _part(name, world) for name, world in WORLDS.items()},
        "straight": Part("speed straight ahead", ("straight",), straight),
        "flow": Part(
            "sense of the flow's velocity and of its gradient in a vortex street",
            tuple(_FLOWS),
            partial(compared, names=tuple(_FLOWS), prefix=""),
        ),
        "pictures": pictures_part(
            "moments of the best champions",
            {world.title: f"{name} {_EVOLVED}" for name, world in WORLDS.items()},
        ),
    },
)
