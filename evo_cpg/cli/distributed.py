"""`--distributed`: `train` and `resume` by several processes.

If a process is lost, every other process prints one line and ends. `resume` continues the run from
its newest checkpoint.
"""

import contextlib
import json
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from evo_cpg.cli.errors import ExitCode, UsageError
from evo_cpg.cli.interrupts import leave_at_once
from evo_cpg.errors import UserError
from evo_cpg.installation import version_of

if TYPE_CHECKING:
    from evo_cpg.training.processes import Team
    from evo_cpg.training.roll_call import Place


class Disagreement(UserError):
    """Processes have different configurations. The message names the differences."""


class Distribution(NamedTuple):
    """Options: the processes that evolve a run together.

    Attributes:
        distributed: evolve with several processes.
        hosts: list of hosts, or the name of a file with hosts, or None to use the scheduler's list.
        process: index of this process, or None to find the index by the name of the host.
        local: number of processes to start on this machine, if any.
        join_timeout: longest time until all processes have joined, s.
        patience: time that each process waits for the others, beyond twice the duration of its own
            trials, s, or None for the default.
    """

    distributed: Annotated[
        bool,
        typer.Option(
            "--distributed",
            help="Evolve with other processes, from SLURM, Open MPI, --hosts or --local.",
        ),
    ] = False
    hosts: Annotated[
        str | None,
        typer.Option(
            metavar="HOST[:PORT],HOST,...",
            help="Hosts of the processes, or a file with one host on each line. The first leads.",
        ),
    ] = None
    process: Annotated[
        int | None,
        typer.Option(
            min=0,
            help="Place of this process in --hosts, from 0 (default: the place of its host).",
        ),
    ] = None
    local: Annotated[
        int | None, typer.Option(min=1, help="Start this many processes on this machine.")
    ] = None
    join_timeout: Annotated[
        float, typer.Option(min=0.1, help="Longest time until all processes have joined, s.")
    ] = 60.0
    patience: Annotated[
        float | None,
        typer.Option(
            min=0,
            help="Extra time to wait for slower processes, s, added to twice the time of the own "
            "trials (default: 20).",
        ),
    ] = None

    def begin(self, cores: int | None, check: Callable[[], object]) -> None:
        """Check the options. With `--local`, start the processes and exit when they are done.

        Args:
            cores: cores of all processes of `--local` together, or None for all of this machine.
            check: function that raises an error once, before every local process would raise it.

        Raises:
            UsageError: the options contradict each other.
            SystemExit: the local processes are done.
        """
        given = {"--hosts": self.hosts, "--process": self.process, "--local": self.local}
        named = [option for option, value in given.items() if value is not None]
        if named and not self.distributed:
            raise UsageError(f"{named[0]} needs --distributed. Add it")
        if self.local is not None and self.hosts is not None:
            raise UsageError(
                "--local and --hosts exclude each other. Give --local to start all processes on "
                "this machine, or --hosts to start one yourself on each host"
            )
        if self.process is not None and self.hosts is None:
            raise UsageError("--process needs --hosts, because it is a place in that list")
        if self.local is not None:
            from evo_cpg.cli.local import run_local

            check()
            raise SystemExit(run_local(self.local, sys.argv[1:], cores))

    @property
    def leads(self) -> bool:
        """Return whether this process is the lead, or the only process.

        Raises:
            UsageError: the options do not determine the index of this process.
        """
        return not self.distributed or _place(self).index == 0


ONE_PROCESS = Distribution()


@contextlib.contextmanager
def together(distribution: Distribution, run: Path) -> Iterator["Team"]:
    """Join the team of processes, and leave the team after the block.

    If another process is lost, this process ends at once, also in the middle of a generation.

    Args:
        distribution: options of the command line.
        run: folder of the run, for the message about how to continue.
    """
    from evo_cpg.training import processes

    def end(message: str) -> None:
        advice = f"Continue with `evo-cpg resume {run}`, on any number of processes"
        print(f"evo-cpg: {message}. {advice}", file=sys.stderr, flush=True)
        leave_at_once(ExitCode.LOST)

    place = _place(distribution) if distribution.distributed else None
    if place is None or place.count == 1:
        yield processes.ALONE
        return
    patience = processes.PATIENCE if distribution.patience is None else distribution.patience
    team = processes.join(place, _versions(), distribution.join_timeout, patience, end)
    try:
        yield team
    except processes.TeamError as error:
        end(str(error))
    except Disagreement:
        # All processes raise this error. So none shall report the end of another one as a loss.
        team.leave()
        raise
    else:
        team.leave()


def require_same(team: "Team", own: Mapping[str, Mapping[str, str]]) -> None:
    """Check that all processes evolve the same configuration.

    Args:
        team: processes of the run.
        own: `fingerprint` of the configuration of this process.

    Raises:
        Disagreement: the configuration of any process differs. All processes raise this error.
    """
    from evo_cpg.config.fingerprint import changes
    from evo_cpg.training.processes import difference

    text = json.dumps(own, sort_keys=True).encode()
    rows = team.exchange(text, "the other processes, to compare the configuration")
    unlike = difference(rows)
    if unlike:
        changed = changes(json.loads(rows[0]), own)
        how = f". Process {team.index} differs from process 0 in {', '.join(changed)}"
        raise Disagreement(
            f"the configuration differs between the processes: {unlike}{how if changed else ''}"
        )


def _place(distribution: Distribution) -> "Place":
    from evo_cpg.cli.hosts import place_in
    from evo_cpg.fusion.jax_internals import detected_cluster
    from evo_cpg.training.roll_call import Place

    if distribution.hosts is not None:
        return place_in(distribution.hosts, distribution.process)
    found = detected_cluster(distribution.join_timeout)
    if found is None:
        raise UsageError(
            "--distributed: no scheduler that JAX knows (SLURM, Open MPI) has started this process."
            " Add --local N to start N processes on this machine. Or add --hosts A,B,C, and start "
            "the same command on each host"
        )
    address, count, index = found
    host, _, port = address.rpartition(":")
    return Place(index, count, host.strip("[]"), int(port))


def _versions() -> dict[str, str]:
    packages = ("evo-cpg", "jax", "jaxlib", "numpy")
    return {f"the version of {name}": version_of(name) for name in packages}
