"""`evo-cpg import`: read a creature from a MuJoCo model."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from evo_cpg.cli.errors import UsageError, require_free
from evo_cpg.cli.options import Overwrite


def import_(
    model: Annotated[
        Path, typer.Argument(metavar="MODEL.xml", help="An MJCF file, read by MuJoCo.")
    ],
    output: Annotated[Path, typer.Argument(metavar="OUT.yaml", help="The creature to write.")],
    motor_gain: Annotated[
        float | None,
        typer.Option(help="Turn torque motors into velocity servos with this gain, N m s/rad."),
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Import a creature from a MuJoCo model."""
    from evo_cpg.config.load import dump_creature
    from evo_cpg.config.schema.section import LARGEST
    from evo_cpg.exchange.mjcf_import import read_mjcf
    from evo_cpg.files import require_place, write_text

    if motor_gain is not None and not motor_gain > 0:
        raise UsageError(f"--motor-gain: must be greater than 0, got {motor_gain:g}")
    if motor_gain is not None and motor_gain > LARGEST:
        raise UsageError(f"--motor-gain: must be at most {LARGEST:g}, got {motor_gain:g}")
    require_free(output, overwrite)
    require_place(output)
    creature, left_out = read_mjcf(model, motor_gain)
    write_text(output, dump_creature(creature))
    if left_out:
        print(f"not part of a creature, so not read: {', '.join(left_out)}", file=sys.stderr)
    print(output)
