"""Dask clusters: workers on this machine, or on the machines of a scheduler that exists.

Each worker holds a `Replica` as a Dask actor, because calls of an actor go straight to its worker.
A generation then costs one message to each worker and one back, and no task of the scheduler.

A thread watches the scheduler's list of workers. New ones become ready while a generation runs. One
that is gone, or has been silent for `PATIENCE`, is lost. Dask alone would wait 5 minutes, and give
up a task after it lost 3 workers.
"""

import contextlib
import dataclasses
import functools
import importlib.util
import json
import logging
import os
import queue
import signal
import tempfile
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from evo_cpg.api.machine import machine_fingerprint, program_commit
from evo_cpg.api.progress import working
from evo_cpg.errors import ClusterError, UsageError, advise
from evo_cpg.io.build import build_experiment
from evo_cpg.io.load import load_config
from evo_cpg.io.run import changes, class_folders, fingerprint
from evo_cpg.io.trust import is_trusted, trusting
from evo_cpg.system import command_for, version_of
from evo_cpg.training.devices import available_cores, population_mesh, use_cores
from evo_cpg.training.replica import Found, Piece, Replica
from evo_cpg.training.run_folder import RunFolder
from evo_cpg.training.team import using

if TYPE_CHECKING:
    from evo_cpg.training.train import Running

# Dask's annotations name both its ways of working, with and without coroutines.
Dask = Any

# A worker without a sign of life for so long is lost, s. Dask's workers give one every 0.5 to 5 s.
PATIENCE = 20.0

# Interval between two looks at the scheduler's list of workers, s.
_LOOK = 0.5

PACKAGES = ("evo-cpg", "jax", "jaxlib", "numpy", "llvmlite")
"""Packages whose versions may change results."""

# Largest number of workers on one machine. Each needs 0.3 GB.
_MOST_LOCAL = 256

# Keys of `machine_fingerprint` that affect rounding and may differ between workers.
_KIND = ("machine", "processor", "instructions", "llvm")


class Job(NamedTuple):
    """What a worker needs to make a `Replica`.

    Attributes:
        configs: text of each configuration.
        fingerprints: `fingerprint` of each configuration, as JSON.
        folders: folders of the user's own classes.
        trusted: whether the user trusts the configurations.
        width: number of trials in a chunk.
        versions: version of each of `PACKAGES`.
        commit: commit of the program's checkout, or "none" without one.
    """

    configs: tuple[str, ...]
    fingerprints: tuple[str, ...]
    folders: tuple[str, ...]
    trusted: bool
    width: int
    versions: tuple[tuple[str, str], ...]
    commit: str


class Evaluator:
    """A worker's end: a `Replica`, if the worker has the same program and configurations.

    Raises:
        ClusterError: it has not. The message names both.
    """

    def __init__(self, job: Job) -> None:
        require_equal({"commit": program_commit() or "none"}, {"commit": job.commit})
        self._replica, self._kind = _replica(job)

    def evaluate(self, pieces: Sequence[Piece]) -> list[Found]:
        """See `Replica.evaluate`."""
        return self._replica.evaluate(pieces)

    def described(self) -> dict[str, str]:
        """Return the kind of processor."""
        return self._kind


# A worker that was taken for lost does not compile again.
@functools.lru_cache(maxsize=2)
def _replica(job: Job) -> tuple[Replica, dict[str, str]]:
    """Build the experiments of a job on a worker."""
    from distributed import get_worker

    use_cores(get_worker().state.nthreads)
    experiments = []
    with trusting(job.trusted), tempfile.TemporaryDirectory() as place:
        for text, expected in zip(job.configs, job.fingerprints, strict=True):
            source = Path(place) / "config.yaml"
            source.write_text(text, encoding="utf-8")
            config = load_config(source)
            experiments.append(build_experiment(config, source, map(Path, job.folders)))
            differing = changes(json.loads(expected), fingerprint(config))
            if differing:
                raise ClusterError(f"its {', '.join(differing)} differs from that of the run")
    found = machine_fingerprint(experiments[0].simulation.engine, 1)
    kind = {name: str(found[name]) for name in _KIND if name in found}
    return Replica(experiments, job.width, population_mesh()), kind


def require_equal(worker: Mapping[str, str | None], run: Mapping[str, str]) -> None:
    """Check that a worker has the same versions as a run.

    Raises:
        ClusterError: it has not.
    """
    for name, expected in run.items():
        if str(worker.get(name)) != expected:
            raise ClusterError(f"it has {name} {worker.get(name)}, but the run has {expected}")


@contextlib.contextmanager
def cluster(where: int | str | Path) -> Iterator["DaskCluster"]:
    """Evaluate all populations on a cluster in the ``with`` block.

    Workers on this machine are processes that end with the block. A program that starts them needs
    the line ``if __name__ == "__main__":``, because each of them imports the program.

    Args:
        where: number of workers to start on this machine, or the address of a scheduler
            (``tls://host:8786``), or a scheduler file.

    Raises:
        ClusterError: the scheduler cannot be reached, or it is lost.
        UsageError: Dask is not installed, or ``where`` is none of these.
    """
    if importlib.util.find_spec("distributed") is None:
        raise UsageError(f"a cluster needs Dask. Install it with `{command_for('cluster')}`")
    text = str(where)
    if text.isdecimal() and not 0 < int(text) <= _MOST_LOCAL:
        raise UsageError(f"cluster: {text} workers. Allowed: 1 to {_MOST_LOCAL}")
    if not (text.isdecimal() or "://" in text or os.path.isfile(text)):
        raise UsageError(
            f"cluster: {text!r} is no file. Allowed: a number of workers, an address such as "
            "tls://host:8786, or a scheduler file"
        )
    import distributed

    # Dask would report every lost worker.
    logging.getLogger(distributed.__name__).setLevel(logging.CRITICAL)
    with contextlib.ExitStack() as stack:
        own = stack.enter_context(_local(int(text))) if text.isdecimal() else None
        found = DaskCluster(stack.enter_context(_joined(own or text)), text)
        stack.callback(found.close)
        with using(found):
            yield found


@contextlib.contextmanager
def _local(count: int) -> Iterator[Dask]:
    """Start a scheduler and workers on this machine, which only they can join.

    The workers share the machine's cores. With more workers than cores, each has one thread.
    """
    from distributed import Nanny, Scheduler, Security, SpecCluster

    cores = available_cores()
    threads = [max(1, cores // count + (i < cores % count)) for i in range(count)]
    security = Security.temporary()
    common = {"security": security, "protocol": "tls://", "host": "127.0.0.1"}
    shown = importlib.util.find_spec("bokeh") is not None
    scheduler = {"dashboard": shown, "dashboard_address": "127.0.0.1:0", "port": 0}
    with tempfile.TemporaryDirectory(prefix="evo-cpg-", ignore_cleanup_errors=True) as place:
        quiet = {"silence_logs": logging.CRITICAL, "local_directory": place, "memory_limit": 0}
        quiet["preload"] = [__name__]
        workers = {
            i: {"cls": Nanny, "options": {**common, **quiet, "nthreads": each}}
            for i, each in enumerate(threads)
        }
        begin: Dask = SpecCluster
        with working(f"starting {count} workers"):
            started = begin(
                workers,
                {"cls": Scheduler, "options": {**common, **scheduler}},
                security=security,
                silence_logs=logging.CRITICAL,
            )
        with started:
            if shown:
                advise(f"dashboard: {started.dashboard_link}")
            yield started


def dask_setup(worker: Dask) -> None:
    """Ignore Control-C in a worker process, because the main process ends it. Dask calls this."""
    del worker
    # A worker in a thread has no signals.
    with contextlib.suppress(ValueError):
        signal.signal(signal.SIGINT, signal.SIG_IGN)


@contextlib.contextmanager
def _joined(where: Dask) -> Iterator[Dask]:
    """Connect to a scheduler.

    Raises:
        ClusterError: it cannot be reached.
    """
    from distributed import Client

    given: dict[str, Any] = {"address": where}
    if isinstance(where, str) and "://" not in where:
        given = {"scheduler_file": where}
    try:
        client: Dask = Client(**given, timeout=10, direct_to_workers=True)
    except Exception as error:
        # Dask raises many kinds of errors, such as AssertionError for a file of other contents.
        words = " ".join(str(error).split()) or type(error).__name__
        raise ClusterError(
            f"cluster {where}: the scheduler cannot be joined ({words}). With tls:// this process "
            "needs the cluster's certificates (docs/cluster.md)"
        ) from None
    with client:
        if not client.scheduler.address.startswith("tls://"):
            advise(
                f"{client.scheduler.address} has no TLS. Whoever reaches this port can run code on "
                "all workers. docs/cluster.md tells how to start a scheduler with certificates"
            )
        yield client


@dataclasses.dataclass(eq=False)
class _Worker:
    """A worker of the scheduler's list.

    Attributes:
        name: its address.
        threads: number of its threads.
        job: what it works on.
        actor: Dask's proxy of its `Evaluator`, when that is ready.
        kind: kind of its processor.
        refused: whether it takes no part.
        busy: whether a result is expected. After a loss, a late result is ignored.
    """

    name: str
    threads: int
    job: Job
    actor: Any = None
    kind: dict[str, str] = dataclasses.field(default_factory=dict)
    refused: bool = False
    busy: bool = False


class DaskCluster:
    """Workers of a Dask scheduler, see `evo_cpg.training.team.Cluster`.

    Attributes:
        devices: number of threads of all workers at the start.
    """

    def __init__(self, client: Dask, name: str) -> None:
        self._client, self._name = client, f"cluster {name}"
        self._job: Job | None = None
        self._workers: dict[str, _Worker] = {}
        # The newest of each name that `workers` has returned.
        self._ready: dict[str, _Worker] = {}
        self._folders: list[RunFolder] = []
        self._kinds: list[dict[str, str]] = []
        # Last sign of life of each worker by the scheduler's clock, and since when it is the last.
        self._signs: dict[str, tuple[float, float]] = {}
        # Words of other threads, for the main thread to say.
        self._notes: list[str] = []
        self._lost: ClusterError | None = None
        self._events: queue.Queue[tuple[_Worker | None, Any]] = queue.Queue()
        self._closed = threading.Event()
        with working(f"waiting for workers of the {self._name}"):
            while not (alive := self._alive()):
                time.sleep(_LOOK)
        self.devices = sum(alive.values())
        threading.Thread(target=self._watch, daemon=True, name="cluster").start()

    def begin(self, running: "Sequence[Running]", width: int) -> None:
        """See `evo_cpg.training.team.Cluster`."""
        folders = [each.folder for each in running]
        configs = [load_config(folder.config) for folder in folders]
        places = [str(place) for folder in folders for place in class_folders(folder)]
        job = Job(
            tuple(folder.config.read_text(encoding="utf-8") for folder in folders),
            tuple(json.dumps(fingerprint(config)) for config in configs),
            tuple(dict.fromkeys(places)),
            is_trusted(),
            width,
            tuple((name, str(version_of(name))) for name in PACKAGES),
            program_commit() or "none",
        )
        self._folders, self._kinds = folders, []
        self._start(job)

    def _start(self, job: Job) -> None:
        """Make an `Evaluator` on every worker, and wait until each is ready or refused."""
        self._job = job
        with working("building the experiment on the workers"):
            while True:
                self._attend()
                known = list(self._workers.values())
                if known and all(each.job is job for each in known):
                    if all(each.refused for each in known):
                        raise ClusterError(f"{self._name}: no worker can take part")
                    if all(each.actor or each.refused for each in known):
                        return
                time.sleep(_LOOK / 10)

    def workers(self) -> dict[str, int]:
        """See `evo_cpg.training.team.Cluster`."""
        self._attend()
        if not (ready := self._able()):
            with working(f"waiting for workers of the {self._name}"):
                while not (ready := self._able()):
                    self._attend()
                    time.sleep(_LOOK / 10)
        self._ready |= {each.name: each for each in ready}
        self._note_kinds([each.kind for each in ready])
        return {each.name: each.threads for each in ready}

    def _able(self) -> list[_Worker]:
        return [each for each in list(self._workers.values()) if each.actor]

    def _note_kinds(self, kinds: Sequence[dict[str, str]]) -> None:
        """Write new kinds of processors into meta.json, where `verify` finds them."""
        new = [kind for kind in kinds if kind not in self._kinds]
        if not new:
            return
        self._kinds += new
        noted = {
            name: " and ".join(sorted({kind.get(name, "none") for kind in self._kinds}))
            for name in _KIND
        }
        for folder in self._folders:
            folder.update_meta(**noted)
        if any(kind != self._kinds[0] for kind in self._kinds):
            advise(f"several kinds of processors take part: {noted['processor']}. Bits may differ")

    def send(self, worker: str, pieces: Sequence[Piece]) -> None:
        """See `evo_cpg.training.team.Cluster`."""
        one = self._ready[worker]
        one.busy = True
        if self._workers.get(worker) is not one:
            # It was lost since `workers`, so nobody would report that.
            self._events.put((one, None))
            return

        async def call() -> None:
            try:
                found = await one.actor.evaluate(pieces)
            except Exception as error:
                # These are Dask's words for a lost worker.
                found = None if "Actor" in str(error) else error
            self._events.put((one, found))

        self._client.loop.add_callback(call)

    def receive(self) -> tuple[str, list[Found] | None]:
        """See `evo_cpg.training.team.Cluster`."""
        while True:
            worker, found = self._events.get()
            self._attend()
            if worker is None or not worker.busy:
                continue
            worker.busy = False
            if isinstance(found, Exception):
                raise ClusterError(f"{worker.name}: {type(found).__name__}: {found}") from found
            if found is None and self._workers.get(worker.name) is worker:
                # Dask noticed before the watch.
                del self._workers[worker.name]
            return worker.name, found

    def close(self) -> None:
        """End the watch."""
        self._closed.set()

    def _attend(self) -> None:
        """Say what other threads noticed, and raise an error if the scheduler is lost."""
        while self._notes:
            advise(self._notes.pop(0))
        if self._lost:
            raise self._lost

    def _watch(self) -> None:
        while not self._closed.wait(_LOOK):
            try:
                alive = self._alive()
            except Exception:
                # Dask raises several kinds of errors. All mean the same.
                self._lost = ClusterError(f"{self._name}: the scheduler does not answer")
                # Wake the main thread.
                self._events.put((None, None))
                return
            for worker in list(self._workers.values()):
                if worker.name not in alive:
                    self._workers.pop(worker.name, None)
                    self._events.put((worker, None))
            for name, threads in alive.items():
                known = self._workers.get(name)
                if self._job and (known is None or known.job is not self._job):
                    self._adopt(_Worker(name, threads, self._job))

    def _alive(self) -> dict[str, int]:
        """Return the number of threads of each worker with a recent sign of life."""
        known = self._client.sync(self._client.scheduler.identity, callback_timeout=PATIENCE)
        now = time.monotonic()
        for name, one in known["workers"].items():
            last, since = self._signs.get(name, (None, now))
            # Measure the silence by this process's clock, because clocks of hosts differ.
            self._signs[name] = one["last_seen"], since if last == one["last_seen"] else now
        return {
            name: one["nthreads"]
            for name, one in known["workers"].items()
            if now - self._signs[name][1] < PATIENCE
        }

    def _adopt(self, worker: _Worker) -> None:
        """Make an `Evaluator` on a worker. It gets work from the next generation on."""
        self._workers[worker.name] = worker
        place = {"workers": [worker.name], "allow_other_workers": False}

        async def finish() -> None:
            try:
                # Ask Dask first, because a worker with an older version lacks this module.
                theirs = self._client.rpc(worker.name).versions(packages=PACKAGES)
                require_equal((await theirs)["packages"], dict(worker.job.versions))
                made = self._client.submit(Evaluator, worker.job, actor=True, pure=False, **place)
                actor = await made
                worker.kind = await actor.described()
                worker.actor = actor
            except Exception as error:
                worker.refused = True
                words = " ".join(str(error).split()) or type(error).__name__
                if worker.name in self._workers:
                    self._notes.append(f"worker {worker.name} takes no part: {words}")

        self._client.loop.add_callback(finish)
