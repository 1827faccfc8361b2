"""`evo-cpg resume`: continue a run."""

import contextlib
from typing import Annotated

import typer

from evo_cpg.cli.options import (
    Cores,
    Distributed,
    Hosts,
    JoinTimeout,
    Local,
    Patience,
    Process,
    Run,
    Tensorboard,
)


def resume(
    run: Run,
    generations: Annotated[
        int | None, typer.Option(min=1, help="Evolve up to this many generations in all.")
    ] = None,
    cores: Cores = None,
    distributed: Distributed = False,
    hosts: Hosts = None,
    process: Process = None,
    local: Local = None,
    join_timeout: JoinTimeout = 60.0,
    patience: Patience = None,
    tensorboard: Tensorboard = False,
) -> None:
    """Go on with a run from its newest checkpoint."""
    from evo_cpg.cli.distributed import Distribution

    def check() -> None:
        from evo_cpg.training.run_folder import RunFolder

        with RunFolder(run).locked():
            RunFolder(run).require()

    asked = Distribution(distributed, hosts, process, local, join_timeout, patience).checked()
    asked.start_local(cores, check)
    from evo_cpg.cli.champions import use_cores_of
    from evo_cpg.cli.training import goes_on_with_scalars, resume_run
    from evo_cpg.training.devices import use_cores
    from evo_cpg.training.run_folder import RunFolder

    tensorboard = goes_on_with_scalars(run, tensorboard)
    # Several processes need not be on the machine that the run was last on.
    devices = use_cores(cores) if asked.wanted else use_cores_of(run, cores)
    with contextlib.ExitStack() as lock:
        if asked.leads:
            lock.enter_context(RunFolder(run).locked())
            # What was interrupted is put in order here, before the others come to read it.
            RunFolder(run).require()
        resume_run(run, generations, devices, asked, tensorboard)
