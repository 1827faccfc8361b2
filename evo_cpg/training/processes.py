"""A team of processes that evolve one population together.

Every process holds the whole population and breeds it, from the same key: that takes milliseconds.
What is shared out is the trials. Of each generation every process tries a part of the individuals,
and then all give each other what these came to, as bytes: nothing is summed, so the bits do not
depend on how many processes there are. A digest of the population goes along.

The lead, process 0, writes the run folder and gives the others the checkpoint. A lone process is
a team of one, whose methods give back what they are given.

JAX's devices never talk to each other within a process (see `evo_cpg.training.experiment`), and
between processes one device of each does.
"""

import contextlib
import hashlib
import io
import itertools
import math
import time
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jaxtyping import Float, UInt8

from evo_cpg.errors import UserError
from evo_cpg.fusion.jax_internals import gather_at
from evo_cpg.fusion.machine_constants import LANES
from evo_cpg.training.checkpoint import Checkpoint, checkpoint_arrays, read_checkpoint
from evo_cpg.training.roll_call import Meeting, Place
from evo_cpg.training.run_folder import RunFolder
from evo_cpg.training.watchdog import finish_within

Tree = TypeVar("Tree")

PATIENCE = 20.0
"""How much longer than twice its own trials a process waits for the others, s."""

COMPILING = 600.0
"""How long it waits at least, s, in a generation in which it has compiled: another one may have to
compile what this one found in its cache."""

HEARTBEAT = 24
"""A process that has sent no heartbeat for so long is dead or stopped, s: JAX then ends all. It is
after `PATIENCE`, and with the second or two that JAX takes to notice it is within 30 s."""

# How long the processes wait for each other in the end, s.
_LEAVING = 60

# To start JAX's service, and to know all devices, takes a second or two, s.
_STARTING = 60

_DIGEST = 8

# Bytes of a checkpoint that are sent at a time.
_PIECE = 1 << 20

_COMPILED = "/jax/core/compile/backend_compile_duration"


class TeamError(Exception):
    """The team is no more; the message says what this process knows of it."""


class Disagreement(UserError):
    """Processes that were started with different things; the message says which."""


class Team:
    """The processes that evolve a population, as one of them sees them.

    Args:
        index: number of this process; 0 leads.
        count: of the processes. More than one have joined `jax.distributed` before.
        patience: see `PATIENCE`.

    Attributes:
        index: number of this process.
        count: of the processes.
        sent: bytes that this process gave the others in the last generation.
        waited: how long it took to exchange them, s.
    """

    def __init__(self, index: int = 0, count: int = 1, patience: float = PATIENCE):
        self.index, self.count = index, count
        self.sent, self.waited = 0, 0.0
        self._patience = patience
        self._since = time.monotonic()
        self._compiled = True
        if count > 1:
            first = {device.process_index: device for device in reversed(jax.devices())}
            mesh = Mesh(np.array([first[i] for i in range(count)]), ("processes",))
            self._apart = NamedSharding(mesh, PartitionSpec("processes"))
            everywhere = NamedSharding(mesh, PartitionSpec())
            self._copy = jax.jit(lambda rows: rows, out_shardings=everywhere)
            # Of whole numbers, of which all but the lead's are 0: nothing is rounded.
            self._sum = jax.jit(
                lambda rows: rows.sum(0, dtype=rows.dtype), out_shardings=everywhere
            )
            jax.monitoring.register_event_duration_secs_listener(self._note)

    @property
    def leads(self) -> bool:
        """Whether this process writes."""
        return self.index == 0

    def share(self, count: int, trials: int = 1) -> slice:
        """The individuals that this process tries.

        Parts differ by a vector of trials at most, and only the last holds less than full vectors.
        Where there are fewer vectors than processes the others try the last individual once more,
        and nobody looks at what that gives.

        Args:
            count: individuals.
            trials: of each.
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
        """What the trials of all individuals came to.

        Args:
            part: of those that are this process's `share`: host arrays, trials on the last axis.
            population: that all processes should have.
            generation: its number.
            trials: of each individual.

        Raises:
            TeamError: a process is gone, or does not come, or has another population.
        """
        if self.count == 1:
            return part
        leaves, structure = jax.tree.flatten(part)
        sizes = [
            (each.stop - each.start) * trials for each in self._parts(population.shape[1], trials)
        ]
        own = [np.asarray(leaf)[..., : sizes[self.index]] for leaf in leaves]
        of_one = sum(leaf.itemsize * math.prod(leaf.shape[:-1]) for leaf in leaves)
        row = np.zeros(_DIGEST + of_one * max(sizes), np.uint8)
        told = _digest(population, generation) + b"".join(leaf.tobytes() for leaf in own)
        row[: len(told)] = np.frombuffer(told, np.uint8)
        rows = self._exchange(row, f"the others' results of generation {generation}")
        self._require_same(rows[:, :_DIGEST], generation)
        parts = [
            _unpacked(one[_DIGEST:], leaves, size) for one, size in zip(rows, sizes, strict=True)
        ]
        whole = [np.concatenate(pieces, axis=-1) for pieces in zip(*parts, strict=True)]
        return jax.tree.unflatten(structure, whole)

    def agree(self, what: str, value: bytes) -> None:
        """Make sure that all processes have the same.

        Args:
            what: it is, in words.
            value: of this process.

        Raises:
            Disagreement: in all processes, where one has another.
        """
        if self.count == 1:
            return
        digest = np.frombuffer(hashlib.sha256(value).digest(), np.uint8)
        groups = _alike(self._exchange(digest, f"the others, to compare {what}"))
        if len(groups) > 1:
            raise Disagreement(f"{what} differs between the processes: {_listed(groups)}")

    def broadcast(self, arrays: Mapping[str, Any] | None) -> dict[str, np.ndarray]:
        """The lead's arrays.

        Args:
            arrays: by name; ignored in all processes but the lead.
        """
        if self.count == 1:
            return {name: np.asarray(array) for name, array in (arrays or {}).items()}
        file = io.BytesIO()
        if self.leads:
            np.savez(file, allow_pickle=False, **(arrays or {}))
        content = np.frombuffer(file.getvalue(), np.uint8)
        what = "the lead's checkpoint"
        length = np.frombuffer(np.int64(content.size).tobytes(), np.uint8)
        size = int(self._exchange(length, what)[0].copy().view(np.int64)[0])
        pieces = []
        for start in range(0, size, _PIECE):
            piece = np.zeros(_PIECE, np.uint8)
            mine = content[start : start + _PIECE]
            piece[: mine.size] = mine
            pieces.append(self._together(self._sum, piece, what))
        with np.load(io.BytesIO(np.concatenate(pieces)[:size].tobytes())) as sent:
            return dict(sent)

    def leave(self) -> None:
        """Part in good order: from here on each process is on its own.

        Raises:
            TeamError: somebody is not there any more.
        """
        if self.count == 1:
            return
        self._exchange(np.zeros(1, np.uint8), "the others, to part")
        try:
            finish_within(_LEAVING, jax.distributed.shutdown)
        except (RuntimeError, TimeoutError) as error:
            raise TeamError(
                f"process {self.index} of {self.count} could not part from the others in good "
                f"order: {_short(error)}"
            ) from None

    def _parts(self, count: int, trials: int) -> list[slice]:
        """Of every process, possibly empty. The lead, which writes, too, has none of the larger."""
        step = LANES // math.gcd(LANES, trials)
        vectors = -(-count // step)
        ends = [min(count, step * (vectors * i // self.count)) for i in range(self.count + 1)]
        return [slice(*pair) for pair in itertools.pairwise(ends)]

    def _exchange(self, row: UInt8[np.ndarray, " n"], what: str) -> UInt8[np.ndarray, "count n"]:
        """The rows of all processes."""
        return self._together(self._copy, row, what)

    def _together(
        self, program: Callable[..., jax.Array], row: UInt8[np.ndarray, " n"], what: str
    ) -> np.ndarray:
        """What a program of all processes gives, and how long that may take.

        Args:
            program: of the rows.
            row: of this process.
            what: is waited for, in words.
        """

        def run() -> np.ndarray:
            shape = (self.count, row.size)
            rows = jax.make_array_from_process_local_data(self._apart, row[None], shape)
            return np.asarray(program(rows))

        start = time.monotonic()
        own = start - self._since
        limit = self._patience + 2 * own
        if self._compiled:
            limit = max(limit, COMPILING)
        try:
            result = finish_within(limit, run)
        except TimeoutError:
            raise TeamError(
                f"process {self.index} of {self.count} has waited {limit:.0f} s for {what}; its "
                f"own took {own:.1f} s: another process hangs, or is much slower"
            ) from None
        except (RuntimeError, ValueError) as error:
            raise TeamError(
                f"process {self.index} of {self.count} lost another one while it waited for "
                f"{what}: {_short(error)}"
            ) from None
        self._since = time.monotonic()
        self._compiled = False
        self.sent, self.waited = row.size, self._since - start
        return result

    def _require_same(self, digests: UInt8[np.ndarray, "count 8"], generation: int) -> None:
        groups = _alike(digests)
        if len(groups) > 1:
            raise TeamError(
                f"the population of generation {generation} differs between the processes: "
                f"{_listed(groups)}; processors of different kinds may round differently, so take "
                "machines of one kind"
            )

    def _note(self, event: str, duration_secs: float, **kwargs: Any) -> None:
        del duration_secs, kwargs
        if event == _COMPILED:
            self._compiled = True


ALONE = Team()
"""A lone process."""


def join(place: Place, meeting: Meeting, patience: float = PATIENCE) -> Team:
    """Become one of several processes. Call it before JAX runs anything.

    Args:
        place: of this process.
        meeting: from `call_roll`: all are there.
        patience: see `PATIENCE`.

    Raises:
        TeamError: somebody left at once.
    """
    # It would keep SIGTERM to itself, with which schedulers and users end a process.
    with contextlib.suppress(AttributeError):
        jax.config.update("jax_enable_preemption_service", False)
    with gather_at(meeting.own):
        jax.distributed.initialize(
            meeting.service,
            place.count,
            place.index,
            cluster_detection_method="deactivate",
            initialization_timeout=_STARTING,
            heartbeat_timeout_seconds=HEARTBEAT,
            shutdown_timeout_seconds=_LEAVING,
        )
        team = Team(place.index, place.count, patience)
    # The first exchange connects the processes, and XLA gives up if one takes 30 s longer than
    # another to come to it. Here they come together; later ones may differ by half an hour.
    team.agree("nothing", b"")
    return team


def load_together(team: Team, folder: RunFolder) -> Checkpoint | None:
    """The newest checkpoint of the lead's folder; None before the first generation is done."""
    if team.count == 1:
        return folder.load()
    checkpoint = folder.load() if team.leads else None
    arrays = team.broadcast(checkpoint_arrays(checkpoint) if checkpoint else None)
    return read_checkpoint(arrays) if arrays else None


def start_together(team: Team, folder: RunFolder) -> Float[np.ndarray, "g all"] | None:
    """The genomes of the lead's folder that the run begins with; None for random ones."""
    if team.count == 1:
        return folder.load_start()
    start = folder.load_start() if team.leads else None
    return team.broadcast(None if start is None else {"genes": start}).get("genes")


def _digest(population: np.ndarray, generation: int) -> bytes:
    # Without a copy: with one it takes several times as long.
    digest = hashlib.sha256(np.int64(generation).tobytes())
    digest.update(np.ascontiguousarray(population).data)
    return digest.digest()[:_DIGEST]


def _unpacked(row: np.ndarray, leaves: list[Any], size: int) -> list[np.ndarray]:
    """What a process has packed into its row: arrays like these, but of so many trials."""
    content, start, found = row.tobytes(), 0, []
    for leaf in leaves:
        shape = (*leaf.shape[:-1], size)
        found.append(np.frombuffer(content, leaf.dtype, math.prod(shape), start).reshape(shape))
        start += leaf.dtype.itemsize * math.prod(shape)
    return found


def _alike(rows: UInt8[np.ndarray, "count n"]) -> list[list[int]]:
    """Numbers of the processes that have equal rows, the lead's first."""
    groups: dict[bytes, list[int]] = {}
    for index, row in enumerate(rows):
        groups.setdefault(row.tobytes(), []).append(index)
    return list(groups.values())


def _listed(groups: list[list[int]]) -> str:
    """Which processes are alike: most of many are."""
    shown = [
        ", ".join(map(str, group[:8])) + (f" and {len(group) - 8} more" if len(group) > 8 else "")
        for group in groups[:4]
    ]
    return "process " + " unlike ".join(shown)


def _short(error: Exception) -> str:
    """The end of what gloo says is what happened."""
    return str(error).strip().splitlines()[0].rpartition("] ")[2][-200:]
