"""Contents of a page: the animal that evolved, and its motion."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from evo_cpg.analysis.gait_numbers import GaitNumbers
from evo_cpg.simulation.recording import Recording
from evo_cpg.view.clip import Clip


class Difference(NamedTuple):
    """A value that is not that of the shipped configuration; None where there is none."""

    key: str
    shipped: Any
    own: Any


class Note(NamedTuple):
    """Comment of a shipped file on one of its values.

    Attributes:
        key: of the value, within its file.
        value: as it is written.
        text: the comment.
        ours: whether it is ours, and not the paper's.
    """

    key: str
    value: str
    text: str
    ours: bool


class PaperDifferences(NamedTuple):
    """Differences of a configuration from the shipped one of the same name.

    Attributes:
        about: the comment at the top of the shipped file.
        differences: what differs from it.
        notes: what the shipped files say of their values.
    """

    about: str
    differences: tuple[Difference, ...]
    notes: tuple[Note, ...]


class Subject(NamedTuple):
    """Subject of a page.

    Attributes:
        name: of the experiment.
        changed: what is to be said of a configuration that the champion did not evolve in; None
            where it is the one.
        folder: name of the run folder.
        sentence: what evolved, where, for what.
        champion: fitness and terms, by name.
        generation: that the champion comes from.
        generations: that are done.
        run: which of several runs; None where there is one.
        trial: which of several trials; None where there is one.
        seed: of the experiment.
        chains: degrees of freedom in rows, as `joint_signals_figure` has them.
        signal: what the controller's signal is, with its unit.
        config: the resolved configuration, as a file.
        meta: contents of meta.json.
        audit: contents of audit.json; None where no audit was made.
        stale: whether that audit was of another champion.
        half_step: fraction of its displacement that it kept at half the physics step when training
            ended; None if unknown.
        differences: from the shipped configuration and the paper; None where there is none of the
            name.
        program: that made the page, with its version.
        made: when.
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
    differences: PaperDifferences | None
    program: str
    made: str


class Motion(NamedTuple):
    """Motion of the animal.

    Attributes:
        recording: the motion.
        clip: the same at the viewer's frames.
        numbers: measured from it.
        scene: for the viewer.
        still: a picture, JPEG.
        history: columns of metrics.csv.
        chain_places: of the joints along the body, m behind the first.
    """

    recording: Recording
    clip: Clip
    numbers: GaitNumbers
    scene: Mapping[str, Any]
    still: bytes
    history: Mapping[str, np.ndarray]
    chain_places: np.ndarray
