"""`evo-cpg resume`: continue a run."""

import contextlib
from typing import Annotated

import typer

from evo_cpg.cli.distributed import ONE_PROCESS, Distribution
from evo_cpg.cli.options import CoresOfRun, Run, Tensorboard


def resume(
    run: Run,
    generations: Annotated[
        int | None, typer.Option(min=1, help="Continue to this total number of generations.")
    ] = None,
    cores: CoresOfRun = None,
    distribution: Distribution = ONE_PROCESS,
    tensorboard: Tensorboard = False,
) -> None:
    """Continue a run from its newest checkpoint."""
    from evo_cpg.training.run_folder import RunFolder

    def check() -> None:
        with RunFolder(run).locked():
            RunFolder(run).require()

    distribution.begin(cores, check)
    from evo_cpg.cli.champions import use_cores_of
    from evo_cpg.cli.training import goes_on_with_scalars, resume_run
    from evo_cpg.training.devices import use_cores

    tensorboard = goes_on_with_scalars(run, tensorboard)
    # Several processes may run on other machines than before, so ignore the recorded cores.
    devices = use_cores(cores) if distribution.distributed else use_cores_of(run, cores)
    with contextlib.ExitStack() as lock:
        if distribution.leads:
            lock.enter_context(RunFolder(run).locked())
            # Finish interrupted writes here, before the other processes read the run.
            RunFolder(run).require()
        resume_run(run, generations, devices, distribution, tensorboard)
