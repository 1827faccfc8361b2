"""`evo-cpg train`: start a run."""

import contextlib
from pathlib import Path
from typing import Annotated

import typer

from evo_cpg.cli.options import (
    Config,
    Cores,
    Distributed,
    Hosts,
    JoinTimeout,
    Local,
    Overrides,
    Patience,
    Process,
    Strict,
    Tensorboard,
    What,
)


def train(
    config: Config,
    overrides: Overrides = None,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Run folder; runs/NAME by default.")
    ] = None,
    cores: Cores = None,
    strict: Strict = False,
    earlier: Annotated[
        Path | None,
        typer.Option(
            "--from", metavar="RUN", help="Begin with what evolved in an earlier run (same plan)."
        ),
    ] = None,
    what: Annotated[
        What, typer.Option("--start", help="Of it, the champion or the population.")
    ] = What.CHAMPION,
    distributed: Distributed = False,
    hosts: Hosts = None,
    process: Process = None,
    local: Local = None,
    join_timeout: JoinTimeout = 60.0,
    patience: Patience = None,
    tensorboard: Tensorboard = False,
) -> None:
    """Evolve a population and keep the champion."""
    from evo_cpg.cli.distributed import Distribution

    def check() -> None:
        from evo_cpg.config.load import load_config

        load_config(config, overrides or [])

    asked = Distribution(distributed, hosts, process, local, join_timeout, patience).checked()
    asked.start_local(cores, check)
    from evo_cpg.api.training import begin_run, first_look_asked
    from evo_cpg.api.warm_start import warm_start
    from evo_cpg.cli.building import build, read_config
    from evo_cpg.cli.costs import animal_digest, warn_of_cost
    from evo_cpg.cli.distributed import require_same, together
    from evo_cpg.cli.oscillators import warn_of_oscillators
    from evo_cpg.cli.progress import working
    from evo_cpg.cli.training import evolve_run, require_scalars
    from evo_cpg.config.fingerprint import fingerprint
    from evo_cpg.system import named
    from evo_cpg.training.devices import use_cores
    from evo_cpg.training.run_folder import RunFolder

    if tensorboard:
        require_scalars()
    given = read_config(config, overrides or [], strict, asked.leads)
    folder = RunFolder(out or Path("runs") / named(given.name))
    # Finding a place to stand on uneven ground starts JAX.
    devices = use_cores(cores)
    with together(asked, folder.path) as team, contextlib.ExitStack() as lock:
        experiment = build(given, config)
        require_same(team, fingerprint(given))
        if team.leads:
            lock.enter_context(folder.locked(new=True))
            start = None
            if earlier is not None:
                with working("reading the earlier run"):
                    start = warm_start(experiment, earlier, what.value)
            begin_run(folder, given, experiment, devices, config, start, team.count)
            warn_of_oscillators(config, experiment.simulation)
            warn_of_cost(config, experiment.simulation)
        animal = animal_digest(given)
        evolve_run(experiment, folder, first_look_asked(given), team, tensorboard, animal)
