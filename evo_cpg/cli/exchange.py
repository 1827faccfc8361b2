"""Commands about configurations and files of other programs.

These are `configs`, `validate`, `export` and `import`.
"""

import os
import sys
from pathlib import Path
from typing import Annotated

import typer

from evo_cpg.cli.errors import ExitCode, require_free
from evo_cpg.cli.options import (
    Cell,
    Number,
    Overwrite,
    Strict,
    Trial,
    complete_config,
    find_config_or_folder,
    name_replaced,
)
from evo_cpg.cli.terminal import show_table, tell, warn
from evo_cpg.errors import UsageError

configs = typer.Typer(
    help="List and copy shipped configurations.", add_completion=False, rich_markup_mode=None
)


@configs.callback(invoke_without_command=True)
def without_command(context: typer.Context) -> None:
    """List and copy shipped configurations."""
    from evo_cpg.io.shipped import shipped, shipped_names

    if context.invoked_subcommand is not None:
        return
    names = shipped_names()
    if not names:
        raise UsageError("configs: the installation has no configurations. Reinstall evo-cpg")
    rows = [(one.name, one.study or "ours", one.summary) for one in map(shipped, names)]
    show_table(("name", "study", "description"), rows, left=3)


@configs.command()
def copy(
    name: Annotated[
        str,
        typer.Argument(
            metavar="NAME", help="Name of a configuration.", autocompletion=complete_config
        ),
    ],
    folder: Annotated[
        Path,
        typer.Argument(metavar="FOLDER", help="Folder to copy to (default: the working folder)."),
    ] = Path("."),
) -> None:
    """Copy a configuration and the files that it names."""
    from evo_cpg.io.shipped import copy_shipped

    print(copy_shipped(name, folder))


@configs.command()
def schema() -> None:
    """Print the JSON Schema of configuration files, for editors."""
    import json

    from evo_cpg.io.file_schema import file_schema

    print(json.dumps(file_schema(), indent=1))


def validate(
    configs: Annotated[
        list[str],
        typer.Argument(
            metavar="CONFIG... [KEY=VALUE]...",
            help="YAML configuration files or names of shipped ones, and settings to change in "
            "each of them.",
            autocompletion=complete_config,
        ),
    ],
    strict: Strict = False,
) -> None:
    """Check configuration files without running them."""
    from evo_cpg.api.advice import about_oscillators, about_step, is_light_in_water
    from evo_cpg.api.progress import working
    from evo_cpg.api.runs import build, read_config
    from evo_cpg.io.build import require_genes
    from evo_cpg.io.errors import ConfigError
    from evo_cpg.io.shipped import find_config

    # Unlike `Path.exists`, this function accepts words that no file can have as its name.
    overrides = [word for word in configs if "=" in word and not os.path.exists(word)]
    paths = [Path(word) for word in configs if word not in overrides]
    if not paths:
        raise UsageError(f"validate: {overrides[0]} is a setting. Name a configuration file, too")
    name_replaced(overrides)
    wrong = 0
    for given in paths:
        path = given
        try:
            path = find_config(given)
            experiment = build(read_config(path, overrides, strict), path)
            require_genes(experiment, path)
        except (ConfigError, UsageError) as error:
            wrong += 1
            tell(f"evo-cpg: {error}")
        else:
            tree = experiment.simulation.world.tree
            print(
                f"{given}: {tree.body_count} bodies, {tree.dof_count} joint axes, "
                f"{experiment.creature.mass:.3g} kg, "
                f"{experiment.simulation.genome.count} genes"
            )
            for line in about_oscillators(experiment.simulation):
                warn(f"{given}: {line}")
            if is_light_in_water(experiment.simulation):
                with working("testing the physics step"):
                    problem = about_step(experiment.simulation)
                if problem:
                    warn(f"{given}: {problem}")
    if wrong:
        raise SystemExit(ExitCode.WRONG_INPUT)


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
            help="A .xml file for a MuJoCo model, or a .yaml file for the configuration. A run "
            "gives these for its champion's body, and a .glb, .csv or .npz file with the motion.",
        ),
    ],
    number: Number = None,
    trial: Trial = 0,
    cell: Cell = None,
    overwrite: Overwrite = False,
) -> None:
    """Export a creature to MuJoCo, or a motion as a scene or table."""
    from evo_cpg.api.progress import working
    from evo_cpg.api.runs import motion_of, open_champion
    from evo_cpg.files import write_whole
    from evo_cpg.view.output import output_path

    require_free(output, overwrite)
    suffix = output_path(output, (".xml", ".yaml", ".glb", ".csv", ".npz")).suffix.lower()
    if suffix in (".xml", ".yaml"):
        if trial:
            raise UsageError(f"{output}: has no motion. Leave out --trial")
        _export_model(source, output, number, cell)
    elif not os.path.isdir(source):
        raise UsageError(f"{source} is not a run folder: only a run has a motion for {output.name}")
    elif suffix == ".glb":
        from evo_cpg.view.gltf_film import gltf_film
        from evo_cpg.view.scene import panel_of

        opened = open_champion(source, number, trial, cell)
        shown = opened.on_course(trial).experiment
        panel = panel_of(shown, motion_of(opened, trial), shown.name)
        with working("writing the scene"):
            scene = gltf_film(panel)
            write_whole(output, lambda file: file.write(scene))
    else:
        from evo_cpg.api.record import as_record

        opened = open_champion(source, number, trial, cell)
        with working("replaying the champion"):
            (replay,) = opened.replay([opened.champion], trial, full=True)
        record = as_record(
            opened.on_course(trial).experiment.simulation, replay.frames, replay.recording
        )
        record.to_csv(output) if suffix == ".csv" else record.to_npz(output)
    print(output)


def _export_model(source: Path, output: Path, number: int | None, cell: str | None) -> None:
    """Write a configuration or a MuJoCo model, and print the parts that are left out."""
    from evo_cpg.api.runs import build, open_and_build, open_champion
    from evo_cpg.files import write_text
    from evo_cpg.io.load import dump_config, load_config
    from evo_cpg.io.models.mjcf_export import mjcf_model, mjcf_text

    chosen = number is not None or cell is not None
    if os.path.isdir(source):
        opened = open_and_build(source)
        if chosen or opened.experiment.simulation.has_own_bodies:
            opened = open_champion(source, number, cell=cell).own
        config, experiment = opened.config, opened.experiment
    elif chosen:
        raise UsageError(f"{source} is not a run folder: only a run has champions")
    else:
        config = load_config(source)
        experiment = build(config, source)
    if output.suffix.lower() == ".yaml":
        write_text(output, dump_config(config))
        return
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


def import_(
    model: Annotated[
        Path, typer.Argument(metavar="MODEL", help="An MJCF or URDF file, read by MuJoCo.")
    ],
    output: Annotated[
        Path | None,
        typer.Argument(
            metavar="OUT.yaml", help="The configuration to write (default: MODEL.yaml, here)."
        ),
    ] = None,
    drop: Annotated[
        bool,
        typer.Option(
            "--drop", help="Import without the parts that a creature cannot have, and list them."
        ),
    ] = False,
    free: Annotated[
        bool, typer.Option("--free", help="Let the first body move freely, as legs of a URDF need.")
    ] = False,
    creature: Annotated[
        bool, typer.Option("--creature", help="Write the creature alone, without an experiment.")
    ] = False,
    motor_gain: Annotated[
        float | None,
        typer.Option(help="Turn torque motors into velocity servos with this gain, N m s/rad."),
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Import a creature and its world from MJCF or URDF."""
    from evo_cpg.files import require_place
    from evo_cpg.io.models.imported_files import write_imported
    from evo_cpg.io.models.mjcf_import import read_model
    from evo_cpg.io.schema.section import LARGEST

    if motor_gain is not None and not motor_gain > 0:
        raise UsageError(f"--motor-gain: must be greater than 0, got {motor_gain:g}")
    if motor_gain is not None and motor_gain > LARGEST:
        raise UsageError(f"--motor-gain: must be at most {LARGEST:g}, got {motor_gain:g}")
    output = Path(f"{model.stem}.yaml") if output is None else output
    require_free(output, overwrite)
    require_place(output)
    imported = read_model(model, motor_gain, drop, free)
    files = write_imported(imported, model, output, creature)
    if imported.left_out:
        tell(f"left out, without harm: {', '.join(imported.left_out)}")
    kinds = (
        ("dropped", imported.dropped),
        ("changed", imported.changed),
        ("note", imported.warnings),
    )
    for kind, sentences in kinds:
        for sentence in sentences:
            tell(f"{kind}: {sentence}")
    for file in files:
        print(file)
