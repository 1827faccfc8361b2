"""A team of processes that evolve one population together.

Every process holds the whole population and breeds it with the same random key, which takes
milliseconds. The trials are divided: in each generation every process runs the trials of some
individuals. Then every process sends one row of bytes: its outcomes, and a digest of the
population. Nothing is summed, so the bits do not depend on the number of processes.

The lead, process 0, writes the run folder and sends the others the checkpoint. Every other process
has a connection to the lead, which passes all rows on to all. A single process is a team of one,
whose methods return their arguments.

The package has its own connections for two reasons. `jax.distributed` (JAX 0.10.2) could do the
exchange, but it ends the other processes from C++ if one is missing, lost or stopped. Then there is
no message, exit code or clean-up. `multiprocessing.connection` has no time limits: `accept` waits
for ever, and so does a receive after its first byte. Three parts fill the gaps of the operating
system:

- The roll call names a process that is missing or does not fit.
- The heartbeat detects a process that is stopped, or whose machine or network is gone.
- The limit of waiting (`PATIENCE`) detects a process that runs, but hangs.
"""

import hashlib
import io
import itertools
import math
import queue
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NoReturn, TypeVar

import jax
import numpy as np
from jaxtyping import Float

from evo_cpg.fusion.machine_constants import LANES
from evo_cpg.training.link import BEAT, Link
from evo_cpg.training.roll_call import Place, call_roll

Tree = TypeVar("Tree")

PATIENCE = 20.0
"""Time that a process waits for the others, s, in addition to twice the time of its own trials."""

COMPILING = 600.0
"""Least time that a process waits, s, in a generation in which it has compiled. Another process may
have to compile a program that this process found in its cache."""

_DIGEST = 8

_COMPILED = "/jax/core/compile/backend_compile_duration"


class TeamError(Exception):
    """Error of a team that cannot continue. The message names the known reason."""


class Team:
    """Team of processes that evolve a population, seen from one of them.

    Args:
        index: number of this process. Process 0 leads.
        count: number of processes.
        patience: time to wait for the others, s, see `PATIENCE`.
        on_lost: called with a message if the team cannot continue, perhaps in another thread and
            during a generation. If the call returns, the next exchange raises `TeamError`.

    Attributes:
        index: number of this process.
        count: number of processes.
    """

    def __init__(
        self,
        index: int = 0,
        count: int = 1,
        patience: float = PATIENCE,
        on_lost: Callable[[str], object] = lambda message: None,
    ):
        self.index, self.count = index, count
        self._patience, self._on_lost = patience, on_lost
        self._links: dict[int, Link] = {}
        self._lost: str | None = None
        self._since = time.monotonic()
        self._compiled = True

    @property
    def leads(self) -> bool:
        """Return whether this process leads and writes files."""
        return self.index == 0

    def connect(self, place: Place, connections: Mapping[int, Any]) -> None:
        """Start links over the connections from `call_roll`."""
        self._links = {
            index: Link(connections[index], place.name(index), self._lose)
            for index in sorted(connections)
        }
        jax.monitoring.register_event_duration_secs_listener(self._note)
        threading.Thread(target=self._beat, name="heartbeat", daemon=True).start()

    def part(self, count: int, trials: int = 1) -> slice:
        """Return the individuals whose trials this process runs.

        Parts consist of full vectors of trials, except the last part. If there are fewer vectors
        than processes, the other processes run the last individual again, and the result is
        ignored.

        Args:
            count: number of individuals.
            trials: number of trials of each individual.
        """
        part = self._parts(count, trials)[self.index]
        return part if part.stop > part.start else slice(count - 1, count)

    def gather(
        self,
        part: Tree,
        population: Float[np.ndarray, "g individuals"],
        generation: int,
        trials: int = 1,
    ) -> Tree:
        """Return the outcome of the trials of all individuals.

        Args:
            part: outcome of this process's `part`: host arrays, trials on the last axis.
            population: the population, which should be equal in all processes.
            generation: number of the generation.
            trials: number of trials of each individual.

        Raises:
            TeamError: a process is lost, does not answer in time, or has another population.
        """
        if self.count == 1:
            return part
        leaves, structure = jax.tree.flatten(part)
        sizes = [
            (each.stop - each.start) * trials for each in self._parts(population.shape[1], trials)
        ]
        own = [np.asarray(leaf)[..., : sizes[self.index]] for leaf in leaves]
        row = _digest(population, generation) + b"".join(leaf.tobytes() for leaf in own)
        rows = self.exchange(row, f"the others' results of generation {generation}")
        self._require_same([row[:_DIGEST] for row in rows], generation)
        parts = [
            _unpacked(one[_DIGEST:], leaves, size) for one, size in zip(rows, sizes, strict=True)
        ]
        joined = [np.concatenate(pieces, axis=-1) for pieces in zip(*parts, strict=True)]
        return jax.tree.unflatten(structure, joined)

    def broadcast(self, arrays: Mapping[str, Any]) -> dict[str, np.ndarray]:
        """Return the lead's arrays.

        Args:
            arrays: arrays by name. Only the lead's arrays are used.
        """
        if self.count == 1:
            return {name: np.asarray(array) for name, array in arrays.items()}
        file = io.BytesIO()
        if self.leads:
            np.savez(file, allow_pickle=False, **arrays)
        # The lead may have to prepare the run first, so wait as long as for a compilation.
        # Heartbeats show whether the lead is alive.
        self._compiled = True
        lead = self.exchange(file.getvalue(), "the lead's checkpoint")[0]
        with np.load(io.BytesIO(lead)) as sent:
            return dict(sent)

    def leave(self) -> None:
        """Send a goodbye to the others. After this, the end of a process counts as no loss."""
        for link in self._links.values():
            link.leave()

    def _parts(self, count: int, trials: int) -> list[slice]:
        """Return the part of each process, possibly empty.

        The lead also writes files, so its part is one of the smaller ones.
        """
        step = LANES // math.gcd(LANES, trials)
        vectors = -(-count // step)
        ends = [min(count, step * (vectors * i // self.count)) for i in range(self.count + 1)]
        return [slice(*pair) for pair in itertools.pairwise(ends)]

    def exchange(self, row: bytes, what: str) -> list[bytes]:
        """Return the rows of all processes.

        Args:
            row: row of this process.
            what: description of the awaited rows.

        Raises:
            TeamError: a process is lost, or does not answer in time.
        """
        start = time.monotonic()
        own = start - self._since
        limit = self._patience + 2 * own
        if self._compiled:
            limit = max(limit, COMPILING)

        def receive(link: Link) -> bytes:
            try:
                content = link.receive(max(start + limit - time.monotonic(), 0.0))
            except queue.Empty:
                self._lose(
                    f"process {self.index} has waited {limit:.0f} s for {what} (its own work "
                    f"took {own:.1f} s). Another process hangs, or is much slower"
                )
                content = None
            if content is None:
                self._fail(self._lost or "another process has left")
            return content

        if self.leads:
            rows = [row, *(receive(link) for link in self._links.values())]
            for link in self._links.values():
                for each in rows:
                    link.send(each)
        else:
            self._links[0].send(row)
            rows = [receive(self._links[0]) for _ in range(self.count)]
        self._since = time.monotonic()
        self._compiled = False
        return rows

    def _require_same(self, digests: list[bytes], generation: int) -> None:
        unlike = difference(digests)
        if unlike:
            # All processes know this reason. So none shall report the end of another one as a loss.
            self.leave()
            self._fail(
                f"the population of generation {generation} differs between the processes: "
                f"{unlike}. Processors of different kinds may round differently, so use "
                "machines of one kind"
            )

    def _lose(self, why: str) -> None:
        """Report to linked processes why the team cannot continue. Only the first reason counts."""
        if self._lost is not None:
            return
        self._lost = why
        for link in self._links.values():
            link.report(why)
        self._on_lost(self._message(why))

    def _fail(self, why: str) -> NoReturn:
        raise TeamError(self._message(why))

    def _message(self, why: str) -> str:
        return f"process {self.index} of {self.count}: {why}"

    def _beat(self) -> None:
        while True:
            for link in self._links.values():
                link.beat()
            time.sleep(BEAT)

    def _note(self, event: str, duration_secs: float, **kwargs: Any) -> None:
        del duration_secs, kwargs
        if event == _COMPILED:
            self._compiled = True


ALONE = Team()
"""The team of a single process."""


def join(
    place: Place,
    common: Mapping[str, str],
    timeout: float,
    patience: float = PATIENCE,
    on_lost: Callable[[str], object] = lambda message: None,
) -> Team:
    """Join a team of several processes.

    Args:
        place: place of this process in the team.
        common: values that must be equal in all processes, by name, such as versions.
        timeout: time that the processes have to connect, s.
        patience: time to wait for the others, s, see `PATIENCE`.
        on_lost: called with a message if the team cannot continue, see `Team`.

    Raises:
        JoinError: a process is missing or does not fit.
    """
    team = Team(place.index, place.count, patience, on_lost)
    team.connect(place, call_roll(place, common, timeout))
    return team


def difference(rows: Sequence[bytes]) -> str:
    """Return a text with the groups of processes that have equal rows, or "" if all are equal.

    The group of the lead comes first.
    """
    groups: dict[bytes, list[int]] = {}
    for index, row in enumerate(rows):
        groups.setdefault(row, []).append(index)
    # Show at most four groups, and eight processes of each. Most of many processes have equal rows.
    shown = [
        ", ".join(map(str, group[:8])) + (f" and {len(group) - 8} more" if len(group) > 8 else "")
        for group in list(groups.values())[:4]
    ]
    return "process " + " unlike ".join(shown) if len(groups) > 1 else ""


def _digest(population: np.ndarray, generation: int) -> bytes:
    # Hash without a copy: a copy takes several times as long.
    digest = hashlib.sha256(np.int64(generation).tobytes())
    digest.update(np.ascontiguousarray(population).data)
    return digest.digest()[:_DIGEST]


def _unpacked(content: bytes, leaves: list[Any], size: int) -> list[np.ndarray]:
    """Return the arrays that a process packed: like ``leaves``, but with ``size`` trials."""
    start, found = 0, []
    for leaf in leaves:
        shape = (*leaf.shape[:-1], size)
        found.append(np.frombuffer(content, leaf.dtype, math.prod(shape), start).reshape(shape))
        start += leaf.dtype.itemsize * math.prod(shape)
    return found
