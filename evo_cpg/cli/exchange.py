"""The commands that write for and read from other programs: export, import."""

import os
import sys
from pathlib import Path

from evo_cpg.cli.building import build
from evo_cpg.cli.champions import champion_motion, champion_record, open_run
from evo_cpg.cli.errors import UsageError, require_free
from evo_cpg.cli.progress import working
from evo_cpg.config.load import dump_creature, load_config
from evo_cpg.config.schema.section import LARGEST
from evo_cpg.exchange.mjcf_export import mjcf_model, mjcf_text
from evo_cpg.exchange.mjcf_import import read_mjcf
from evo_cpg.files import require_place, write_text, write_whole
from evo_cpg.view.output import output_path


def export(
    source: Path, output: Path, overwrite: bool, number: int | None, trial: int, cell: str | None
) -> None:
    """`evo-cpg export`: the suffix says what."""
    require_free(output, overwrite)
    suffix = output_path(output, (".xml", *MOTIONS)).suffix.lower()
    if suffix == ".xml":
        if number is not None or trial or cell is not None:
            raise UsageError(f"{output}: has no motion; leave out --run, --trial, --cell")
        export_model(source, output)
        return
    if not os.path.isdir(source):
        raise UsageError(f"{source} is no run folder: only a run has a motion for {output.name}")
    MOTIONS[suffix](source, output, number, trial, cell)
    print(output)


def _export_scene(
    run: Path, output: Path, number: int | None, trial: int, cell: str | None
) -> None:
    """An animated scene."""
    experiment, _, recording, _ = champion_motion(run, number, trial, cell)
    with working("writing the scene"):
        from evo_cpg.exchange.gltf_film import gltf_film

        world = experiment.simulation.world
        scene = gltf_film(
            experiment.creature,
            recording,
            title=experiment.name,
            world="land" if world.water is None else "water",
            ground=world.ground,
            surface=None if world.water is None else world.water.surface,
        )
        write_whole(output, lambda file: file.write(scene))


def _export_table(
    run: Path, output: Path, number: int | None, trial: int, cell: str | None
) -> None:
    """The motion as named columns."""
    record = champion_record(run, number, trial, cell)
    record.to_csv(output) if output.suffix.lower() == ".csv" else record.to_npz(output)


MOTIONS = {".glb": _export_scene, ".csv": _export_table, ".npz": _export_table}


def export_model(source: Path, output: Path) -> None:
    """A MuJoCo model."""
    if os.path.isdir(source):
        _, _, experiment = open_run(source)
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
        what = "all of it but buoyancy" if carried else "all of it, since it has a surface"
        print(f"left out: the water, {what}", file=sys.stderr)
    own = [type(law).__name__ for law in world.forces if not law.of_water]
    if own:
        print(f"left out: force laws of your own, {', '.join(own)}", file=sys.stderr)
    print(output)


def import_model(path: Path, output: Path, motor_gain: float | None, overwrite: bool) -> None:
    """`evo-cpg import`."""
    if motor_gain is not None and not motor_gain > 0:
        raise UsageError(f"--motor-gain: must be greater than 0, got {motor_gain:g}")
    if motor_gain is not None and motor_gain > LARGEST:
        raise UsageError(f"--motor-gain: must be at most {LARGEST:g}, got {motor_gain:g}")
    require_free(output, overwrite)
    require_place(output)
    creature, left_out = read_mjcf(path, motor_gain)
    write_text(output, dump_creature(creature))
    if left_out:
        print(f"left out: {', '.join(left_out)}", file=sys.stderr)
    print(output)
