"""`evo-cpg plot`: draw pictures of a run."""

from pathlib import Path
from typing import Annotated

import typer

from evo_cpg.cli.options import BEST, Run, Which
from evo_cpg.cli.writing import writes_to_run


@writes_to_run("output", "--output")
def plot(
    run: Run,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Folder (default: RUN/plots).")
    ] = None,
    which: Which = BEST,
) -> None:
    """Plot fitness, joint signals, path and map."""
    from evo_cpg.analysis.chains import axis_signs, joint_rows
    from evo_cpg.cli.champions import champion_motion
    from evo_cpg.files import make_folder
    from evo_cpg.io.run import gait_map
    from evo_cpg.view.figure import save_figure
    from evo_cpg.view.plots import fitness_figure, joint_signals_figure, path_figure
    from evo_cpg.view.search_plots import map_figure

    opened, recording = champion_motion(run, which)
    experiment, place = opened.experiment, output or make_folder(run / "plots")
    name = which.of_trial + which.of_cell
    history = opened.folder.history()
    history["best_so_far"] = history["champion"]
    print(save_figure(fitness_figure(history), place / "fitness.png"))
    if recording.dof_names:
        simulation = experiment.simulation
        tree = simulation.world.tree
        rows = joint_rows(simulation.world.tree)
        figure = joint_signals_figure(
            recording,
            chains=rows,
            signs=axis_signs(tree, rows),
            title=experiment.name,
            signal=simulation.controller.signal_label,
        )
        print(save_figure(figure, place / f"joint_signals{name}.png"))
    print(
        save_figure(
            path_figure(recording, experiment.creature.root_index), place / f"path{name}.png"
        )
    )
    checkpoint, number = opened.folder.load(), opened.champion.run
    found = checkpoint and gait_map(experiment, checkpoint, number)
    if found:
        title = experiment.name + (f", run {number}" if experiment.runs > 1 else "")
        figure = map_figure(found.axes, found.fitness, title)
        print(save_figure(figure, place / f"map{which.of_run}.png"))
