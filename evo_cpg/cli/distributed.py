"""`--distributed`: `train` and `resume` by several processes.

A lost process ends all others, each with one line. `resume` continues the run from its newest
checkpoint.
"""

import contextlib
import json
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from evo_cpg.cli.errors import UsageError
from evo_cpg.cli.exit_codes import ExitCode
from evo_cpg.cli.interrupts import leave_at_once
from evo_cpg.errors import UserError
from evo_cpg.installation import version_of

if TYPE_CHECKING:
    from evo_cpg.training.processes import Team
    from evo_cpg.training.roll_call import Place

JOIN_TIMEOUT = 60.0
"""So long the processes may take to come together, s."""


class Disagreement(UserError):
    """Processes with different configurations; the message says what differs."""


class Distribution(NamedTuple):
    """What the command line says of several processes.

    Attributes:
        wanted: whether there are any.
        hosts: a list of hosts or the name of a file; None to ask the scheduler.
        process: the number of this one; None to find it by the name of the host.
        local: how many to start on this machine; None for none.
        join_timeout: so long they may take to come together, s.
        patience: so much longer than twice its own trials each waits for the others, s; None for
            what suits most.
    """

    wanted: bool = False
    hosts: str | None = None
    process: int | None = None
    local: int | None = None
    join_timeout: float = JOIN_TIMEOUT
    patience: float | None = None

    def checked(self) -> "Distribution":
        """The same, where it makes sense.

        Raises:
            UsageError: it does not.
        """
        given = {"--hosts": self.hosts, "--process": self.process, "--local": self.local}
        named = [option for option, value in given.items() if value is not None]
        if named and not self.wanted:
            raise UsageError(f"{named[0]} goes with --distributed")
        if self.local is not None and self.hosts is not None:
            raise UsageError(
                "--local starts processes on this machine, --hosts names machines on which they "
                "are started: take one of them"
            )
        if self.process is not None and self.hosts is None:
            raise UsageError("--process goes with --hosts: it is a place in that list")
        return self

    def start_local(self, cores: int | None, check: Callable[[], object]) -> None:
        """Have the processes of this machine do it all, where they are asked for.

        Args:
            cores: of all together; None for all of this machine.
            check: raises what all would otherwise complain of, one by one.

        Raises:
            SystemExit: when they are done.
        """
        if self.local is not None:
            from evo_cpg.cli.local import run_local

            raise SystemExit(run_local(self.local, sys.argv[1:], cores, check))

    @property
    def leads(self) -> bool:
        """Whether this process is the lead, or the only one.

        Raises:
            UsageError: what was asked for does not tell.
        """
        return not self.wanted or _place(self).index == 0


@contextlib.contextmanager
def together(asked: Distribution, run: Path) -> Iterator["Team"]:
    """Become one of the processes that were asked for, and part after the block.

    If another process is lost, this one ends at once, also in the middle of a generation.

    Args:
        asked: the options of the command line.
        run: folder of the run, for the line that says how to go on.
    """
    from evo_cpg.training import processes

    def end(message: str) -> None:
        advice = f"go on with `evo-cpg resume {run}`, on any number of processes"
        print(f"evo-cpg: {message}; {advice}", file=sys.stderr, flush=True)
        leave_at_once(ExitCode.LOST)

    place = _place(asked) if asked.wanted else None
    if place is None or place.count == 1:
        yield processes.ALONE
        return
    patience = processes.PATIENCE if asked.patience is None else asked.patience
    team = processes.join(place, _versions(), asked.join_timeout, patience, end)
    try:
        yield team
    except processes.TeamError as error:
        end(str(error))
    except Disagreement:
        # All processes raise it, and none may report that it lost another one.
        team.leave()
        raise
    else:
        team.leave()


def require_same(team: "Team", own: Mapping[str, Mapping[str, str]]) -> None:
    """Make sure that all processes evolve the same.

    Args:
        team: the processes.
        own: `fingerprint` of this one's configuration.

    Raises:
        Disagreement: in all processes, where one evolves something else.
    """
    from evo_cpg.config.fingerprint import changes
    from evo_cpg.training.processes import difference

    text = json.dumps(own, sort_keys=True).encode()
    rows = team.exchange(text, "the others, to compare the configuration")
    unlike = difference(rows)
    if unlike:
        changed = changes(json.loads(rows[0]), own)
        how = f"; process {team.index} differs from process 0 in {', '.join(changed)}"
        raise Disagreement(
            f"the configuration differs between the processes: {unlike}{how if changed else ''}"
        )


def _place(asked: Distribution) -> "Place":
    from evo_cpg.cli.hosts import place_in
    from evo_cpg.fusion.jax_internals import detected_cluster
    from evo_cpg.training.roll_call import Place

    if asked.hosts is not None:
        return place_in(asked.hosts, asked.process)
    found = detected_cluster(asked.join_timeout)
    if found is None:
        raise UsageError(
            "--distributed: no scheduler that JAX knows (SLURM, Open MPI) has started this; say "
            "--local N for N processes on this machine, or --hosts A,B,C for those of a list, and "
            "start the same command on each"
        )
    address, count, index = found
    host, _, port = address.rpartition(":")
    return Place(index, count, host.strip("[]"), int(port))


def _versions() -> dict[str, str]:
    packages = ("evo-cpg", "jax", "jaxlib", "numpy")
    return {f"the version of {name}": version_of(name) for name in packages}
