"""`evo-cpg plot`: pictures of a run."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from evo_cpg.cli.options import Cell, Number, Run, Trial, of_trial
from evo_cpg.cli.writing import writes_to_run

if TYPE_CHECKING:
    from evo_cpg.training.checkpoint import Champion
    from evo_cpg.training.experiment import Experiment
    from evo_cpg.training.run_folder import RunFolder


@writes_to_run("output", "--output")
def plot(
    run: Run,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Folder; RUN/plots by default.")
    ] = None,
    number: Number = None,
    trial: Trial = 0,
    cell: Cell = None,
) -> None:
    """Plot the fitness over the generations, the champion's joint signals and path, and the map."""
    from evo_cpg.analysis.chains import axis_signs, joint_rows
    from evo_cpg.cli.champions import champion_motion
    from evo_cpg.view.figure import save_figure
    from evo_cpg.view.plots import fitness_figure, joint_signals_figure, path_figure

    experiment, champion, recording, folder = champion_motion(run, number, trial, cell)
    place = output or folder.path / "plots"
    of_run = "" if number is None else f"_run{number}"
    which = of_run + of_trial(trial) + ("" if cell is None else f"_cell_{cell.replace(',', '_')}")
    history = folder.history()
    history["best_so_far"] = history["champion"]
    print(save_figure(fitness_figure(history), place / "fitness.png"))
    if recording.dof_names:
        simulation = experiment.simulation
        tree = simulation.world.tree
        rows = joint_rows(simulation)
        figure = joint_signals_figure(
            recording,
            chains=rows,
            signs=axis_signs(tree, rows),
            title=experiment.name,
            signal=simulation.controller.signal_label,
        )
        print(save_figure(figure, place / f"joint_signals{which}.png"))
    print(save_figure(path_figure(recording), place / f"path{which}.png"))
    _plot_map(experiment, champion, folder, place / f"map{of_run}.png")


def _plot_map(
    experiment: "Experiment", champion: "Champion", folder: "RunFolder", path: Path
) -> None:
    """Draw the map of the champion's run, where it has one."""
    from evo_cpg.training.elites import gait_map

    checkpoint = folder.load()
    found = checkpoint and gait_map(experiment, checkpoint, champion.run)
    if found:
        from evo_cpg.view.figure import save_figure
        from evo_cpg.view.map_plot import map_figure

        title = experiment.name + (f", run {champion.run}" if experiment.runs > 1 else "")
        print(save_figure(map_figure(found.axes, found.fitness, title), path))
