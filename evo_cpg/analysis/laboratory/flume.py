"""An animal in a flume: the current against which it holds its place."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from evo_cpg.analysis.cycles import last_cycles
from evo_cpg.analysis.gait_numbers import GaitNumbers, Quantity
from evo_cpg.analysis.laboratory.settings import Setting, worded
from evo_cpg.analysis.laboratory.tow import directions
from evo_cpg.simulation.recording import Recording
from evo_cpg.simulation.simulation import Simulation


def ground_speed(simulation: Simulation, recording: Recording, numbers: GaitNumbers) -> Quantity:
    """Return the speed over ground along the initial heading, over whole cycles."""
    # A mean velocity over k steps needs k + 1 positions.
    count = len(recording.time) - 1
    last = last_cycles(numbers.first, count, numbers.step, numbers.frequency)
    path = recording.position.mean(1) @ directions(simulation)[0]
    speed = (path[last.stop] - path[last.start]) / (numbers.step * (last.stop - last.start))
    definition = "mean velocity of all bodies along the initial heading, over whole cycles"
    return Quantity("ground_speed", "speed over ground", float(speed), "m/s", definition)


def flume_notes(settings: Sequence[Setting], rows: Sequence[Mapping[str, Any]]) -> tuple[str, ...]:
    """Return the current in which an animal stays in place, for each of the other settings.

    The speed over ground is interpolated linearly between two currents.
    """
    groups: dict[str, list[tuple[float, float]]] = {}
    for setting, row in zip(settings, rows, strict=True):
        if "current" not in setting or "tow" in setting:
            continue
        others = worded({name: x for name, x in setting.items() if name != "current"})
        groups.setdefault(others, []).append((setting["current"], row["ground_speed"]))
    notes = []
    for others, points in groups.items():
        if len(points) < 2:
            continue
        current, speed = np.array(sorted(points)).T
        change = np.flatnonzero((speed[:-1] >= 0) != (speed[1:] >= 0))
        place = "in none of these currents"
        if len(change):
            k = change[0]
            share = speed[k] / (speed[k] - speed[k + 1])
            found = current[k] + share * (current[k + 1] - current[k])
            place = f"against a current of {found:.3g} m/s"
        notes.append(f"{others}{': ' if others else ''}holds its place {place}")
    return tuple(notes)
