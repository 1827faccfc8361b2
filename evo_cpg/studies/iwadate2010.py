"""Study of the swimmer of Iwadate 2010: distance to the light, and wave along the body."""

import jax
import numpy as np

from evo_cpg.analysis.chains import axis_signs, joint_rows
from evo_cpg.analysis.gait import JointGait, gait
from evo_cpg.simulation.recording import Recorder, Recording, as_recording
from evo_cpg.simulation.rollout import rollout
from evo_cpg.simulation.simulation import Simulation
from evo_cpg.studies.parts import audit_table, audited, light_tables, pictures_part
from evo_cpg.studies.study import Part, Runs, Study, Table, percent, tabled
from evo_cpg.studies.workshop import Workshop
from evo_cpg.training.experiment import begin

_UNTRAINED = 96  # animals with random brains
_CONFIG = "iwadate2010_swimmer"

RUNS = {
    "shared": Runs(_CONFIG, (), 5),
    "random": Runs(_CONFIG, ("evolution={type: random, generations: 50, population: 200}",), 5),
    "per_joint": Runs(_CONFIG, ("controller.drive=per_joint",), 3),
    "per_dof": Runs(_CONFIG, ("controller.drive=per_dof",), 3),
}


def swim(workshop: Workshop) -> list[Table]:
    """Compare champions with random search of equal evaluations, and with an undriven animal."""
    from evo_cpg.training.checkpoint import history_columns
    from evo_cpg.view.plots import fitness_figure, path_figure

    history = history_columns(workshop.checkpoint("shared").history)
    history["best_so_far"] = history["champion"]
    workshop.draw(fitness_figure(history), "fitness")
    best = workshop.checkpoint("shared").champion
    for champion, recording in workshop.recordings("shared"):
        if best is not None and champion.run == best.run:
            root = workshop.member("shared").experiment.creature.root_index
            workshop.draw(path_figure(recording, root), "path")
    return light_tables(workshop, "shared", "random")


def lags(workshop: Workshop) -> list[Table]:
    """Return the phase lags of joint angles (Figure 3), and count untrained animals with a wave."""
    from evo_cpg.view.plots import joint_signals_figure

    best, rows = workshop.checkpoint("shared").champion, []
    experiment = workshop.member("shared").experiment
    simulation = experiment.simulation

    def measure() -> dict[str, int]:
        """Count animals with random brains, and those with a wave along the body."""
        genes = begin(experiment)[0][:, :_UNTRAINED]
        count = genes.shape[1]
        recorder = Recorder(count)
        frames = jax.jit(lambda genes: rollout(simulation, genes, observers=recorder))(genes)
        names = [body.name for body in experiment.creature.bodies]
        recordings = (as_recording(simulation, frames, names, i) for i in range(count))
        waves = sum(_gait(simulation, recording).has_wave() for recording in recordings)
        return {"animals": count, "waves": int(waves)}

    for champion, recording in workshop.recordings("shared"):
        found = _gait(simulation, recording)
        middle = float(np.median(found.frequency))
        spread = np.abs(found.frequency - middle).max()
        size = np.rad2deg(found.amplitude)
        rows.append(
            {
                "seed": str(experiment.seed + champion.run),
                "axis": found.axis,
                "frequency (Hz)": f"{middle:.2f}",
                "spread": percent(float(spread) / middle) if middle else "",
                "lags from head to tail (degrees)": " ".join(f"{each:.0f}" for each in found.lag),
                "amplitude (degrees)": f"{size.min():.0f} to {size.max():.0f}",
                "orderly wave": "yes" if found.has_wave() else "no",
            }
        )
        if best is not None and champion.run == best.run:
            workshop.draw(joint_signals_figure(recording))
    waves = workshop.kept("untrained", ["shared"], measure)
    words = f"{waves['waves']} of {waves['animals']}"
    return [tabled([*rows, {"seed": "untrained", "orderly wave": words}])]


def drives(workshop: Workshop) -> list[Table]:
    """Compare other interpretations of the quantities that the brain sets."""
    rows = []
    for name in ("per_joint", "per_dof"):
        experiment = workshop.member(name).experiment
        for champion, recording in workshop.recordings(name):
            found = _gait(experiment.simulation, recording)
            low, high = found.frequency.min(), found.frequency.max()
            rows.append(
                {
                    "drive": f"`{name}`",
                    "genes": str(experiment.simulation.genome.count),
                    "seed": str(experiment.seed + champion.run),
                    "fitness": f"{champion.worth:.3f}",
                    "distance left": percent(champion.terms["distance"]),
                    "frequency (Hz)": f"{low:.2f} to {high:.2f}",
                    "lags (degrees)": " ".join(f"{each:.0f}" for each in found.lag),
                    "orderly wave": "yes" if found.has_wave() else "no",
                }
            )
    return [tabled(rows)]


def audit(workshop: Workshop) -> list[Table]:
    """Return tables of the audited champions, and of the load of their motors."""
    found = audited(workshop, "shared")
    columns = {
        "peak torque, N m": "peak_torque",
        "mean power, W/kg": "mean_power",
        "peak power, W/kg": "power",
        "highest joint rate, rad/s": "joint_rate",
    }
    rows = [
        {"seed": str(row["seed"])}
        | {head: f"{row['measured'][key] or 0:.3g}" for head, key in columns.items()}
        for row in found
    ]
    return [audit_table("", {"swimmer": found}), tabled(rows, "Load of the motors:")]


def _gait(simulation: Simulation, recording: Recording) -> JointGait:
    signs = axis_signs(simulation.world.tree, joint_rows(simulation.world.tree))
    return gait(recording, signs=signs)


STUDY = Study(
    "iwadate2010",
    "Iwadate et al. 2010: the swimmer",
    RUNS,
    {
        "swim": Part("five champions, compared with random search", ("shared", "random"), swim),
        "lags": Part("phase lag along the body (Fig. 3)", ("shared",), lags),
        "drives": Part(
            "other interpretations of the brain's outputs", ("per_joint", "per_dof"), drives
        ),
        "audit": Part("audit of the champions", ("shared",), audit),
        "pictures": pictures_part("moments of the best champion", {"swimmer": "shared"}),
    },
)
