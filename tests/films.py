"""A film of one animal."""

from pathlib import Path
from typing import Any

from evo_cpg.creature.creature import Creature
from evo_cpg.simulation.recording import Recording
from evo_cpg.view.film import side_by_side
from evo_cpg.view.panel import Panel


def film(
    creature: Creature,
    recording: Recording,
    path: Path,
    size: tuple[int, int] = (1280, 720),
    **given: Any,
) -> Path:
    """`side_by_side` of one; what is given are fields of its `Panel`, and settings."""
    shown = {name: given.pop(name) for name in Panel._fields if name in given}
    return side_by_side([Panel(creature, recording, **shown)], path, size=size, **given)
