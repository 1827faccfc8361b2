"""What a film shows of an animal and its world."""

from typing import NamedTuple

import numpy as np

from evo_cpg.creature.creature import Creature
from evo_cpg.physics.footing import Ground
from evo_cpg.simulation.recording import Recording, require_whole
from evo_cpg.training.experiment import Experiment
from evo_cpg.view.look import LOOKS
from evo_cpg.view.signals import Signals


class Panel(NamedTuple):
    """An animal that a film shows.

    Attributes:
        creature: the animal.
        recording: its motion.
        title: caption; the creature's name by default.
        world: where the animal lives, ``water`` or ``land``.
        ground: that carries the animal; None where there is none.
        surface: height of the water's surface, m.
        signals: shown in a strip under it; None for none.
        note: below the title, in small letters.
    """

    creature: Creature
    recording: Recording
    title: str | None = None
    world: str = "water"
    ground: Ground | None = None
    surface: float | None = None
    signals: Signals | None = None
    note: str = ""


def panel_of(
    experiment: Experiment,
    recording: Recording,
    title: str,
    signals: Signals | None = None,
    note: str = "",
) -> Panel:
    """A motion in the world of the experiment that it was recorded in."""
    world = experiment.simulation.world
    return Panel(
        experiment.creature,
        recording,
        title,
        world="land" if world.water is None else "water",
        ground=world.ground,
        surface=None if world.water is None else world.water.surface,
        signals=signals,
        note=note,
    )


def check_panel(panel: Panel) -> None:
    """Check that an animal can be filmed.

    Raises:
        RecordingError: a recording that does not fit its creature, is empty or not finite.
        ValueError: a world that there is not.
    """
    creature, recording, world = panel.creature, panel.recording, panel.world
    if panel.surface is not None and not np.isfinite(panel.surface):
        raise ValueError(
            f"surface is {panel.surface:g}; it must be finite, or None where there is none"
        )
    if world not in LOOKS:
        raise ValueError(f"world is {world!r}; choose {' or '.join(LOOKS)}")
    require_whole(recording, creature)
