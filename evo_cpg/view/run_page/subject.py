"""Contents of a page: the animal that evolved, and its motion."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from evo_cpg.analysis.gait_numbers import GaitNumbers
from evo_cpg.simulation.recording import Recording
from evo_cpg.view.scene import Clip


class PageSubject(NamedTuple):
    """Subject of a page.

    Attributes:
        name: name of the experiment.
        changed: remark on a configuration that changed after training, or None if it did not.
        folder: name of the run folder.
        sentence: summary of the animal, its world and its task.
        champion: fitness and terms, by name.
        generation: generation of the champion.
        generations: number of finished generations.
        run: number of the run among several, or None for a single run.
        trial: number of the trial among several, or None for a single trial.
        seed: seed of the experiment.
        chains: degrees of freedom in rows, as in `joint_signals_figure`.
        signal: name of the controller's signal, with its unit.
        config: text of the resolved configuration.
        meta: contents of meta.json.
        audit: contents of audit.json, or None without an audit.
        stale: whether the audit belongs to another champion.
        half_step: fraction of its displacement that the champion kept at half the physics step when
            training ended, or None if unknown.
        program: program that made the page, with its version.
        made: date and time at which the page was made, as text.
    """

    name: str
    changed: str | None
    folder: str
    sentence: str
    champion: Mapping[str, float]
    generation: int
    generations: int
    run: int | None
    trial: int | None
    seed: int
    chains: Sequence[Sequence[int]]
    signal: str
    config: str
    meta: Mapping[str, Any]
    audit: Mapping[str, Any] | None
    stale: bool
    half_step: float | None
    program: str
    made: str


class RecordedMotion(NamedTuple):
    """Recorded motion of the animal, with its numbers and pictures.

    Attributes:
        recording: the motion.
        clip: motion at the viewer's frames.
        numbers: numbers measured from the motion.
        scene: data of the viewer.
        still: picture of the animal, JPEG.
        history: columns of metrics.csv.
        chain_places: places of the joints along the body, m behind the first.
        root_index: index of the root in ``creature.bodies``.
    """

    recording: Recording
    clip: Clip
    numbers: GaitNumbers
    scene: Mapping[str, Any]
    still: bytes
    history: Mapping[str, np.ndarray]
    chain_places: np.ndarray
    root_index: int
