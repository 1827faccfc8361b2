"""The commands that write for and read from other programs: export, import."""

import sys
from pathlib import Path

from evo_cpg.cli.building import build
from evo_cpg.cli.errors import UsageError
from evo_cpg.cli.training import open_run
from evo_cpg.config.load import dump_creature, load_config
from evo_cpg.exchange.mjcf_export import mjcf_model, mjcf_text
from evo_cpg.exchange.mjcf_import import read_mjcf


def export_model(source: Path, output: Path, overwrite: bool) -> None:
    """`evo-cpg export`."""
    _require_free(output, overwrite)
    if source.is_dir():
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
    )
    _write(output, mjcf_text(model))
    if world.water is not None:
        carried = world.water.surface is None
        what = "all of it but buoyancy" if carried else "all of it, since it has a surface"
        print(f"left out: the water, {what}", file=sys.stderr)
    print(output)


def import_model(path: Path, output: Path, motor_gain: float | None, overwrite: bool) -> None:
    """`evo-cpg import`."""
    if motor_gain is not None and not motor_gain > 0:
        raise UsageError(f"--motor-gain: must be greater than 0, got {motor_gain:g}")
    _require_free(output, overwrite)
    creature, left_out = read_mjcf(path, motor_gain)
    _write(output, dump_creature(creature))
    if left_out:
        print(f"left out: {', '.join(left_out)}", file=sys.stderr)
    print(output)


def _require_free(output: Path, overwrite: bool) -> None:
    if output.exists() and not overwrite:
        raise UsageError(f"{output} exists already; --overwrite replaces it")


def _write(output: Path, text: str) -> None:
    try:
        output.write_text(text, encoding="utf-8")
    except OSError as error:
        raise UsageError(f"{output} cannot be written ({error.strerror})") from None
