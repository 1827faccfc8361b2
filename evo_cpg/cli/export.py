"""`evo-cpg export`: write a creature as a MuJoCo model, or a motion for other programs."""

import os
import sys
from pathlib import Path
from typing import Annotated

import typer

from evo_cpg.cli.completion import complete_config
from evo_cpg.cli.errors import UsageError, require_free
from evo_cpg.cli.options import BEST, Overwrite, Which, find_config_or_folder


def export(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="CONFIG_OR_RUN",
            help="A configuration file, the name of a shipped one, or a run folder.",
            callback=find_config_or_folder,
            autocompletion=complete_config,
        ),
    ],
    output: Annotated[
        Path,
        typer.Argument(
            metavar="OUT",
            help="A .xml file for a MuJoCo model. A run also gives a .glb, .csv or .npz file with "
            "the motion.",
        ),
    ],
    which: Which = BEST,
    overwrite: Overwrite = False,
) -> None:
    """Export a creature to MuJoCo, or a motion as a scene or table."""
    from evo_cpg.view.output import output_path

    require_free(output, overwrite)
    suffix = output_path(output, (".xml", ".glb", ".csv", ".npz")).suffix.lower()
    if suffix == ".xml":
        if which != BEST:
            raise UsageError(f"{output}: has no motion. Leave out --run, --trial and --cell")
        _export_model(source, output)
    elif not os.path.isdir(source):
        raise UsageError(f"{source} is not a run folder: only a run has a motion for {output.name}")
    elif suffix == ".glb":
        _export_scene(source, output, which)
    else:
        from evo_cpg.cli.champions import champion_record

        record = champion_record(source, which)
        record.to_csv(output) if suffix == ".csv" else record.to_npz(output)
    print(output)


def _export_scene(run: Path, output: Path, which: Which) -> None:
    """Write the motion as an animated scene, a .glb file."""
    from evo_cpg.api.display import working
    from evo_cpg.cli.champions import champion_motion
    from evo_cpg.files import write_whole

    opened, recording = champion_motion(run, which)
    experiment = opened.experiment
    with working("writing the scene"):
        from evo_cpg.view.gltf_film import gltf_film
        from evo_cpg.view.scene import panel_of

        scene = gltf_film(panel_of(experiment, recording, experiment.name))
        write_whole(output, lambda file: file.write(scene))


def _export_model(source: Path, output: Path) -> None:
    """Write a MuJoCo model, and print the parts that are left out."""
    from evo_cpg.cli.building import build
    from evo_cpg.cli.champions import open_and_build
    from evo_cpg.files import write_text
    from evo_cpg.io.load import load_config
    from evo_cpg.io.models.mjcf_export import mjcf_model, mjcf_text

    if os.path.isdir(source):
        experiment = open_and_build(source).experiment
    else:
        experiment = build(load_config(source), source)
    simulation = experiment.simulation
    world, situation = simulation.world, simulation.situations[0]
    model = mjcf_model(
        experiment.creature,
        world.gravity,
        world.ground,
        world.water,
        situation.start_position,
        situation.start_heading,
        simulation.step_length,
        world.pair_names,
        situation.start_orientation,
        situation.start_angles,
    )
    write_text(output, mjcf_text(model))
    if world.water is not None:
        carried = world.water.surface is None
        what = "the water, except buoyancy" if carried else "the water, because it has a surface"
        print(f"left out: {what}", file=sys.stderr)
    if world.tree.muscles is not None:
        what = "the stiffness of active muscles, and Hill's law"
        print(f"left out: {what}", file=sys.stderr)
    own = [type(law).__name__ for law in world.forces if not law.of_water]
    if own:
        print(f"left out: force laws of your own, {', '.join(own)}", file=sys.stderr)
