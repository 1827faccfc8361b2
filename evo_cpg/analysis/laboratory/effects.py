"""Knobs that would change nothing under a question. They are errors, not silent zeros."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool

from evo_cpg.analysis.laboratory.settings import BODY, NOTHING, LabError
from evo_cpg.analysis.laboratory.surgery import silenced_by
from evo_cpg.control.controller import Controller
from evo_cpg.control.preparation import Preparation

_ADVICE = "Set controller.cpg.feedback in the configuration"


def require_cord(values: Mapping[str, Sequence[Any]], seconds: float | None) -> None:
    """Check that an isolated cord has everything that the knobs change.

    Raises:
        LabError: a knob belongs to the body, the water or the brain.
    """
    others = {*BODY, "silence"}
    absent = [
        name
        for name in values
        if name in others or ("." in name and not name.startswith("controller."))
    ]
    if absent:
        raise LabError(
            f"{', '.join(absent)}: no effect with bend, because an isolated cord has no body, no "
            "water and no brain"
        )
    if seconds is not None:
        raise LabError("seconds: no effect with bend, which lasts 20 cycles. Leave it out")


def require_effects(controller: Controller, values: Mapping[str, Sequence[Any]]) -> None:
    """Check that the nervous system has everything that the knobs change.

    Raises:
        LabError: a knob would have no effect under any setting.
    """
    if not isinstance(controller, Preparation):
        return
    if "behind" in values and set(values.get("cut", ())) <= {NOTHING}:
        raise LabError("behind: needs cut=BODY")
    feels = controller.animal.feedback is not None
    if "feedback" in values and not feels:
        raise LabError(f"feedback: the spinal cord senses nothing. {_ADVICE}")
    for silence in values.get("silence", ()):
        silenced = silenced_by(silence)
        if silenced == {"feedback"} and not feels:
            raise LabError(f"silence={silence}: the spinal cord senses nothing. {_ADVICE}")
        if silenced and not controller.awake and not (feels and "feedback" in silenced):
            raise LabError(
                f"silence={silence}: no effect, because no brain drives the cord. Ask a run "
                "folder, without u, b and turn"
            )


def require_felt(
    controller: Preparation, moved: Bool[np.ndarray, " d"], bend: str, factor: float
) -> None:
    """Check that the spinal cord feels the stretch of a bent joint.

    Args:
        controller: the nervous system.
        moved: whether each joint axis is bent.
        bend: value of the knob, for the message.
        factor: value of the knob ``feedback``. A factor of 0 is a control without feedback.

    Raises:
        LabError: no oscillator feels a bent joint.
    """
    feedback = controller.animal.feedback
    felt = {
        int(oscillator) + offset
        for sense in (feedback.stretch if feedback else ())
        for offset, row in zip(sense.offsets, sense.rows, strict=True)
        for oscillator in np.flatnonzero(row)
    }
    if factor != 0 and not felt & set(np.flatnonzero(moved).tolist()):
        raise LabError(
            f"bend={bend}: the spinal cord does not feel these joints. {_ADVICE}, such as "
            "feedback: {stretch: [{angle_weight: 0.3}]}"
        )
