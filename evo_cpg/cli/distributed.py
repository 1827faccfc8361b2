"""`--distributed`: `train` and `resume` by several processes.

A process that is lost ends all of them, each with one line, and the run goes on from its newest
checkpoint with `resume`. Where processes wait for each other in C++ nothing can be tidied up any
more, so they end by `os._exit`.
"""

import contextlib
import json
import sys
import traceback
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from evo_cpg.cli.errors import UsageError, told
from evo_cpg.cli.exit_codes import ExitCode
from evo_cpg.cli.interrupts import leave_at_once
from evo_cpg.installation import version_of

if TYPE_CHECKING:
    from evo_cpg.training.processes import Team
    from evo_cpg.training.roll_call import Place

JOIN_TIMEOUT = 60.0
"""So long the processes may take to come together, s."""


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
    """Become one of the processes that were asked for.

    Args:
        asked: what the command line says.
        run: folder of the run, with which it goes on.

    Yields:
        The team. The block must have it `leave`.
    """
    from evo_cpg.training import processes

    if not asked.wanted:
        yield processes.ALONE
        return
    advice = f"go on with `evo-cpg resume {run}`, on any number of processes"
    team = processes.ALONE
    try:
        team = _join(asked, advice)
        yield team
    except processes.TeamError as error:
        _say(f"evo-cpg: {error}; {advice}")
        leave_at_once(ExitCode.LOST)
    except KeyboardInterrupt:
        if team.count == 1:
            raise
        leave_at_once(ExitCode.INTERRUPTED)
    except Exception as error:
        if team.count == 1:
            raise
        if isinstance(error, processes.Disagreement):
            # All know of it, and none should think that it has lost the others.
            with contextlib.suppress(processes.TeamError):
                team.leave()
        words = told(error)
        if words is not None:
            _say(f"evo-cpg: {words}")
            leave_at_once(ExitCode.WRONG_INPUT)
        traceback.print_exc()
        leave_at_once(ExitCode.FAULT)


def require_same(team: "Team", own: Mapping[str, Mapping[str, str]]) -> None:
    """Make sure that all processes evolve the same.

    Args:
        team: the processes.
        own: `fingerprint` of this one's configuration.

    Raises:
        Disagreement: in all processes, where one evolves something else.
    """
    from evo_cpg.config.fingerprint import changes
    from evo_cpg.training.processes import Disagreement

    text = json.dumps(own, sort_keys=True)
    try:
        team.agree("the configuration", text.encode())
    except Disagreement as error:
        lead = team.broadcast({"text": text})["text"].item()
        changed = changes(json.loads(lead), own)
        if not changed:
            raise
        raise Disagreement(
            f"{error}; process {team.index} differs from process 0 in {', '.join(changed)}"
        ) from None


def _join(asked: Distribution, advice: str) -> "Team":
    from evo_cpg.cli.native_output import keep_apart
    from evo_cpg.fusion.jax_internals import lost_process
    from evo_cpg.training.processes import ALONE, PATIENCE, join
    from evo_cpg.training.roll_call import call_roll

    place = _place(asked)
    if place.count == 1:
        return ALONE

    def explain(logged: str) -> str | None:
        words = lost_process(logged)
        return words and f"evo-cpg: process {place.index} of {place.count}: {words}; {advice}"

    meeting = call_roll(place, _versions(), asked.join_timeout)
    keep_apart(explain, ExitCode.LOST)
    return join(place, meeting, PATIENCE if asked.patience is None else asked.patience)


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


def _say(line: str) -> None:
    print(line, file=sys.stderr, flush=True)
