"""The commands that make pictures: plot, preview."""

import math
import re
from collections.abc import Sequence
from pathlib import Path

from evo_cpg.analysis.chains import axis_signs, joint_rows
from evo_cpg.cli.building import read_config
from evo_cpg.cli.champions import champion_motion
from evo_cpg.cli.errors import UsageError
from evo_cpg.cli.progress import working
from evo_cpg.config.build import build_creature, build_experiment
from evo_cpg.config.schema.ground import GroundConfig, PlaneConfig
from evo_cpg.simulation.situation import starting_pose
from evo_cpg.system import named
from evo_cpg.training.checkpoint import Champion
from evo_cpg.training.experiment import Experiment
from evo_cpg.training.run_folder import RunFolder


def plot_run(
    run: Path, output: Path | None, number: int | None, trial: int, cell: str | None = None
) -> None:
    """`evo-cpg plot`; see `champion_motion`."""
    experiment, champion, recording, folder = champion_motion(run, number, trial, cell)
    from evo_cpg.view.figure import save_figure
    from evo_cpg.view.plots import fitness_figure, joint_signals_figure, path_figure

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


def _plot_map(experiment: Experiment, champion: Champion, folder: RunFolder, path: Path) -> None:
    """Draw the map of the champion's run, where it has one."""
    from evo_cpg.training.elites import gait_map

    checkpoint = folder.load()
    found = checkpoint and gait_map(experiment, checkpoint, champion.run)
    if found:
        from evo_cpg.view.figure import save_figure
        from evo_cpg.view.map_plot import map_figure

        title = experiment.name + (f", run {champion.run}" if experiment.runs > 1 else "")
        print(save_figure(map_figure(found.axes, found.fitness, title), path))


def preview_config(
    path: Path, overrides: Sequence[str], output: Path | None, size: str, strict: bool = False
) -> None:
    """`evo-cpg preview`."""
    pixels = pixels_of(size)
    config = read_config(path, overrides, strict)
    creature = build_creature(config, path)
    from evo_cpg.view.preview import preview, preview_path

    place = preview_path(output or named(f"{creature.name}.png"), pixels)
    pose, ground, water = None, config.world.ground is not None, config.world.water
    surface = None
    if water is not None:
        surface = math.inf if water.surface is None else water.surface
    on_shore = ground and surface is not None and math.isfinite(surface)
    shaped = on_shore or _has_shape(config.world.ground)
    if config.simulation.start_pose == "settled" or shaped:
        # As it starts, among what stands around.
        names = [body.name for body in creature.bodies]
        with working("finding how it starts"):
            simulation = build_experiment(config, path).simulation
            pose = starting_pose(simulation.situations[0], simulation.world.tree, names)
        footing = simulation.world.footing
        ground = footing.ground if footing is not None else False
    with working("drawing"):
        made = preview(creature, place, pixels, ground=ground, pose=pose, surface=surface)
    print(made)


def _has_shape(ground: GroundConfig | None) -> bool:
    """Whether there is more to see of the ground than that it is level."""
    return ground is not None and (bool(ground.obstacles) or ground.floor != PlaneConfig())


def of_trial(trial: int) -> str:
    """What is added to the name of a picture of another trial than the first."""
    return f"_trial{trial}" if trial else ""


def pixels_of(size: str) -> tuple[int, int]:
    """Width and height that are asked for.

    Raises:
        UsageError: it is no size.
    """
    match = re.fullmatch(r"(\d{1,9})x(\d{1,9})", size)
    if not match:
        raise UsageError(f"--size: {size!r} is not WIDTHxHEIGHT, such as 1280x720")
    return int(match[1]), int(match[2])
