"""`evo-cpg import`: read an experiment from a MuJoCo model."""

from pathlib import Path
from typing import Annotated

import typer

from evo_cpg.cli.errors import UsageError, require_free, tell
from evo_cpg.cli.options import Overwrite


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
    for sentence in imported.dropped:
        tell(f"dropped: {sentence}")
    for sentence in imported.changed:
        tell(f"changed: {sentence}")
    for warning in imported.warnings:
        tell(f"note: {warning}")
    for file in files:
        print(file)
