"""`evo-cpg resume`: continue a run."""

from typing import Annotated

import typer

from evo_cpg.cli.options import CoresOfRun, Run


def resume(
    run: Run,
    generations: Annotated[
        int | None, typer.Option(min=1, help="Continue to this total number of generations.")
    ] = None,
    cores: CoresOfRun = None,
) -> None:
    """Continue a run from its newest checkpoint."""
    from evo_cpg.cli.champions import use_cores_of
    from evo_cpg.cli.training import resume_run
    from evo_cpg.training.run_folder import RunFolder

    devices = use_cores_of(run, cores)
    with RunFolder(run).locked():
        RunFolder(run).require()
        resume_run(run, generations, devices)
