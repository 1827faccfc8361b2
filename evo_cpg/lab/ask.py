"""Ask an animal a question: many settings, one program, one table."""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from evo_cpg.analysis.gait_numbers import GaitNumbers, Quantity, gait_numbers
from evo_cpg.config.schema.experiment import ExperimentConfig
from evo_cpg.lab.bodies import Bodies, build_bodies
from evo_cpg.lab.settings import NERVES, Setting, combinations, require_values
from evo_cpg.lab.surgery import genes_of, prepare
from evo_cpg.lab.tow import held, straight_drag, tow_numbers
from evo_cpg.lab.trials import record_all
from evo_cpg.simulation.noise import Noise
from evo_cpg.simulation.recording import Recording, as_recording
from evo_cpg.simulation.simulation import Simulation


class Subject(NamedTuple):
    """The animal of a question.

    Attributes:
        config: its configuration.
        source: file of the configuration.
        folders: further folders with a user's own classes.
        genes: genes of its champion, or None for an animal without training.
    """

    config: ExperimentConfig
    source: Path
    folders: Sequence[Path] = ()
    genes: Float[np.ndarray, " g"] | None = None


class Answer(NamedTuple):
    """The motion of an animal under each setting.

    Attributes:
        settings: the settings.
        numbers: numbers that describe the motion under each setting, None if it diverged.
        recordings: motion under each setting.
        bodies: the animal of each setting.
    """

    settings: list[Setting]
    numbers: list[GaitNumbers | None]
    recordings: list[Recording]
    bodies: Bodies

    @property
    def rows(self) -> list[dict[str, Any]]:
        """Values of the knobs and all numbers of each setting, by name."""
        names: dict[str, Quantity] = {}
        for each in self.numbers:
            for one in each.quantities if each else ():
                names.setdefault(one.key, one)
        return [
            dict(setting) | {name: each.value(name) if each else np.nan for name in names}
            for setting, each in zip(self.settings, self.numbers, strict=True)
        ]


def ask(
    subject: Subject, values: Mapping[str, Sequence[Any]], seconds: float | None = None
) -> Answer:
    """Simulate an animal under all combinations of values, in one program.

    Args:
        subject: the animal.
        values: values of each knob (`evo_cpg.lab.settings.KNOBS`) or key of the configuration.
        seconds: duration of a trial, s, or None for the duration in the configuration. The second
            half is measured.

    Raises:
        LabError: a knob or a value does not fit the animal.
        ConfigError: a number of the configuration is wrong.
    """
    require_values(values)
    settings = combinations(values)

    def prepared(simulation: Simulation) -> Simulation:
        steps = simulation.steps
        if seconds is not None:
            steps = max(2, round(seconds * simulation.control_rate))
        controller = prepare(simulation.controller, settings, subject.genes is not None)
        world = simulation.world
        if "speed" in values:
            world = held(world)
        return dataclasses.replace(
            simulation,
            world=world,
            controller=controller,
            steps=steps,
            noise=Noise(),
            situations=simulation.situations[:1],
        )

    bodies = build_bodies(subject.config, subject.source, settings, subject.folders, prepared)
    common = bodies.common
    genes = np.stack(
        [
            genes_of(common.controller, common.world.tree, setting, subject.genes)
            for setting in settings
        ],
        axis=-1,
    ).astype(np.float32)
    frames = record_all(bodies.simulation, genes)
    numbers, recordings = [], []
    drags: dict[tuple, float] = {}
    for i in range(len(settings)):
        own = {name: values[..., i : i + 1] for name, values in frames.items()}
        simulation, creature = bodies.of(i), bodies.creatures[i]
        names = [body.name for body in creature.bodies]
        recording = as_recording(simulation, own, names)
        recordings.append(recording)
        finite = np.isfinite(recording.position).all()
        if not finite:
            numbers.append(None)
            continue
        found = gait_numbers(simulation, creature, own, recording)
        if "speed" in values:
            body = tuple(value for name, value in settings[i].items() if name not in NERVES)
            if body not in drags:
                drags[body] = straight_drag(simulation)
            speed = float(settings[i]["speed"])
            towed = tow_numbers(simulation, own, found, speed, drags[body])
            found = found._replace(quantities=(*found.quantities, *towed))
        numbers.append(found)
    return Answer(settings, numbers, recordings, bodies)
