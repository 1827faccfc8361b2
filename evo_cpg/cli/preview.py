"""`evo-cpg preview`: draw a picture of a creature at rest."""

import math
from pathlib import Path
from typing import Annotated

import typer

from evo_cpg.cli.options import Config, Overrides, Strict, pixels_of


def preview(
    config: Config,
    overrides: Overrides = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="A .png file (default: NAME.png).")
    ] = None,
    size: Annotated[str, typer.Option(help="WIDTHxHEIGHT in pixels.")] = "1280x720",
    strict: Strict = False,
) -> None:
    """Draw the creature of a config at rest."""
    from evo_cpg.api.display import working
    from evo_cpg.cli.building import read_config
    from evo_cpg.io.build import build_creature, build_experiment
    from evo_cpg.io.schema.ground import PlaneConfig
    from evo_cpg.simulation.situation import starting_pose
    from evo_cpg.system import named
    from evo_cpg.view.preview import preview as draw
    from evo_cpg.view.preview import preview_path

    pixels = pixels_of(size)
    given = read_config(config, overrides or [], strict)
    creature = build_creature(given, config)
    place = preview_path(output or named(f"{creature.name}.png"), pixels)
    pose, land, water = None, given.world.ground, given.world.water
    ground = land is not None
    surface = None
    if water is not None:
        surface = math.inf if water.surface is None else water.surface
    on_shore = surface is not None and math.isfinite(surface)
    shaped = land is not None and (on_shore or bool(land.obstacles) or land.floor != PlaneConfig())
    if given.simulation.start_pose == "settled" or shaped:
        # Draw the initial pose, with obstacles and shore.
        names = [body.name for body in creature.bodies]
        with working("computing the initial pose"):
            simulation = build_experiment(given, config).simulation
            pose = starting_pose(simulation.situations[0], simulation.world.tree, names)
        contact_model = simulation.world.contact_model
        ground = contact_model.ground if contact_model is not None else False
    with working("drawing"):
        made = draw(creature, place, pixels, ground=ground, pose=pose, surface=surface)
    print(made)
