"""Earlier champions that race against the final one in a story: those that are clearly apart."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from evo_cpg.api.display import working
from evo_cpg.api.opened import OpenedChampion
from evo_cpg.simulation.recording import Recording
from evo_cpg.training.checkpoint import Champion
from evo_cpg.training.crowd_motion import CrowdMotion
from evo_cpg.training.lineage import representatives
from evo_cpg.training.run_folder import RunFolderError

# Number of earlier champions that are replayed, and largest number of animals in a race.
_REPLAYED, _RACING = 7, 4


def racers_of(
    opened: OpenedChampion, recording: Recording, trial: int, end: float, least: float
) -> list[tuple[int, Recording]]:
    """Return generations and motion of earlier champions, each clearly behind the next one.

    Args:
        opened: the run with its champion.
        recording: motion of the champion.
        trial: number of the trial.
        end: instant at which the race ends, s.
        least: least distance between two animals at that instant, m.

    Returns:
        At most three champions. There are none if none is known or can be replayed.
    """
    try:
        opened.require_configured()
    except RunFolderError:
        return []
    found = representatives(earlier_champions(opened), _REPLAYED)
    if not found:
        return []
    with working("replaying earlier champions"):
        motions = [each.recording for each in opened.replay(found, trial)]
    experiment = opened.experiment
    every = together([*motions, recording])
    shown = max(int((every.time <= end).sum()), 1)
    race = every._replace(time=every.time[:shown], position=every.position[:shown])
    progress = race.advance(experiment.creature.root_index, experiment.simulation.task.heading)
    *chosen, _ = apart(progress, least, _RACING)
    return [(found[i].generation, motions[i]) for i in chosen]


def earlier_champions(opened: OpenedChampion) -> list[Champion]:
    """Return the champions of the run that came before its final one, the first one first."""
    final = opened.champion
    try:
        lineage = opened.folder.load_lineage()
    except RunFolderError:
        return []
    return [one for one in lineage if one.run == final.run and one.generation < final.generation]


def apart(progress: Float[np.ndarray, " n"], least: float, most: int) -> list[int]:
    """Return animals, in order, each of which is clearly ahead of the one before.

    Args:
        progress: distance that each animal has come, m. The last animal is always chosen.
        least: least distance between two chosen animals, m.
        most: largest number of chosen animals. If more are apart, those at even distances stay.
    """
    chosen: list[int] = []
    for number, own in enumerate(progress[:-1]):
        ahead = not chosen or own >= progress[chosen[-1]] + least
        if ahead and own <= progress[-1] - least:
            chosen.append(number)
    chosen.append(len(progress) - 1)
    if len(chosen) <= most:
        return chosen
    places = np.linspace(progress[chosen[0]], progress[chosen[-1]], most)
    return sorted({min(chosen, key=lambda i: abs(progress[i] - place)) for place in places})


def together(motions: Sequence[Recording]) -> CrowdMotion:
    """Return the motion of several animals as a crowd, until the first of them ends."""
    count = min(len(each.time) for each in motions)
    return CrowdMotion(
        motions[0].time[:count],
        np.stack([each.position[:count] for each in motions], 1),
        np.stack([each.rotation[:count] for each in motions], 1),
        motions[0].goal,
    )
