"""A film of one creature."""

import dataclasses
from pathlib import Path
from typing import Any

from evo_cpg.creature.creature import Creature
from evo_cpg.simulation.recording import Recording
from evo_cpg.view.film import Film, side_by_side
from evo_cpg.view.scene import Panel

_SETTINGS = [field.name for field in dataclasses.fields(Film)]


def film(creature: Creature, recording: Recording, path: Path, **given: Any) -> Path:
    """Call `side_by_side` with one panel. Options are fields of `Panel` and `Film`, and others."""
    shown = {name: given.pop(name) for name in Panel._fields if name in given}
    settings = {name: given.pop(name) for name in _SETTINGS if name in given}
    return side_by_side([Panel(creature, recording, **shown)], path, Film(**settings), **given)
