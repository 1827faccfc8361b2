"""Study of the starfish: lag of each arm behind the previous arm of the ring."""

import itertools

import numpy as np

from evo_cpg.analysis.gait import ring_lags
from evo_cpg.control.couplings import ring_members
from evo_cpg.simulation.recording import Recording
from evo_cpg.studies.audits import audit_part
from evo_cpg.studies.stills import pictures_part
from evo_cpg.studies.study import Part, Runs, Study, Table, tabled
from evo_cpg.studies.workshop import Workshop

# Number of windows of the second half of a trial, whose lags are computed separately.
_WINDOWS = 3

RUNS = {name: Runs(name, (), 5) for name in ("starfish", "starfish_land")}


def lags(workshop: Workshop) -> list[Table]:
    """Return mean lags over the second half of the trial, and the extremes over its thirds."""
    rows = []
    for name in RUNS:
        simulation = workshop.experiment(name).simulation
        oscillators, tree = simulation.controller.rhythm_generator, simulation.world.tree
        assert oscillators is not None
        for champion, recording in workshop.recordings(name):
            for number, ring in enumerate(oscillators.settings.rings):
                joints = [tree.dof_names[i] for i in ring_members(tree, ring, number)]
                whole = ring_lags(recording, joints)
                pieces = [ring_lags(part, joints, last=1.0) for part in _parts(recording)]
                low, high = np.min(pieces, 0), np.max(pieces, 0)
                row = {
                    "": f"`{name}`",
                    "seed": str(champion.run),
                    "fitness": f"{champion.worth:.3f}",
                    "distance, m": "{:.2f} to {:.2f}".format(*recording.distance[[0, -1]]),
                }
                for joint, *lag in zip(joints, whole, low, high, strict=True):
                    row[f"`{joint}`, degrees"] = "{:.1f} ({:.1f} to {:.1f})".format(*lag)
                rows.append(row)
    return [tabled(rows)]


def _parts(recording: Recording) -> list[Recording]:
    """Return the second half of a recording, in equal parts."""
    edges = (np.linspace(0.5, 1, _WINDOWS + 1) * len(recording.time)).astype(int)
    return [
        recording._replace(
            time=recording.time[start:stop], joint_angle=recording.joint_angle[start:stop]
        )
        for start, stop in itertools.pairwise(edges)
    ]


STUDY = Study(
    "starfish",
    "The starfish",
    RUNS,
    {
        "lags": Part("lags around the ring of arms", tuple(RUNS), lags),
        "audit": audit_part("audit of the champions", {f"`{name}`": name for name in RUNS}),
        "pictures": pictures_part(
            "moments of the champions", {"in water": "starfish", "on land": "starfish_land"}
        ),
    },
)
