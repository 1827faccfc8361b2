"""Try an animal for some seconds, without evolution: let it drop or float, or drive its cord."""

import base64
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from evo_cpg.analysis.laboratory.ask import Subject, ask
from evo_cpg.io.load import complete_config
from evo_cpg.simulation.recording import Recording
from evo_cpg.training.devices import use_cores
from evo_cpg.view.drawing_page.document import Data, DrawingError
from evo_cpg.view.scene import quaternions, sample

How = Literal["rest", "rhythm"]

SECONDS = 5.0
# Frames per second of the motion.
RATE = 30.0
_SHORT = 32767
# Knobs of the laboratory: without motors, or with the largest drive of the cord.
_KNOBS: dict[str, dict[str, list[Any]]] = {"rest": {"passive": ["*"]}, "rhythm": {"u": [1.0]}}
# Sections that a try needs. Other sections may not fit its controller, which has a rhythm.
_SECTIONS = ("name", "creature", "world", "simulation", "engine")


def simulate(data: Data, source: Path, how: How) -> dict[str, Any]:
    """Simulate an animal, and return its motion as JSON.

    Args:
        data: data of the document.
        source: file of the document.
        how: ``rest`` without motors, ``rhythm`` with a constant drive of its spinal cord.

    Raises:
        UserError: the animal is wrong, or cannot be driven.
    """
    if how not in _KNOBS:
        raise DrawingError(f"{how!r}: choose rest or rhythm")
    given = {key: data[key] for key in _SECTIONS if key in data}
    controller = data.get("controller")
    if isinstance(controller, dict) and controller.get("type", "brain_cpg") == "brain_cpg":
        given["controller"] = controller
    config = complete_config(given, source)
    if len(config.creature.copies()) < 2:
        raise DrawingError("a body without joints has nothing to try. Add a part first")
    use_cores()
    answer = ask(Subject(config, source), _KNOBS[how], SECONDS)
    (recording,) = answer.recordings
    if not np.isfinite(recording.position).all():
        raise DrawingError("the motion diverged: a motor may be too strong for its body")
    return motion(recording, [body.name for body in config.creature.build().bodies])


def motion(recording: Recording, names: Sequence[str]) -> dict[str, Any]:
    """Return a recording as JSON.

    Args:
        recording: motion of the bodies.
        names: names of the bodies, in its order.
    """
    clip = sample(recording, RATE)
    return {
        "rate": RATE,
        "count": len(clip.time),
        "names": list(names),
        "place": _text(clip.position, "<f4"),
        "turn": _text(quaternions(clip.rotation) * _SHORT, "<i2"),
    }


def _text(values: np.ndarray, kind: str) -> str:
    return base64.b64encode(np.ascontiguousarray(values, kind).tobytes()).decode()
