"""`evo-cpg sweep --jobs`: run settings that share no program as jobs, by submitit.

    SWEEP/.lock              lock of the processes that work on the sweep (`claimed`)
    SWEEP/.jobs/slurm.json   jobs of SLURM that have not been seen to end
    SWEEP/.jobs/TIME_.../    files of submitit for the jobs of one command, with their output,
                             deleted when all jobs have succeeded

A job evolves a group of settings (`evo_cpg.api.sweep.groups`) as the sweep does without jobs. The
results are the same, and a stopped job can be continued. The checkpoints show the progress of a job
and whether it is done. A job returns no result, and only the job itself reads its pickle. submitit
is installed with the extra ``jobs``, and imported when there are jobs.
"""

import contextlib
import importlib
import json
import shutil
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypedDict

from evo_cpg.api.display import Work, working
from evo_cpg.api.sweep import Member, groups, members_of, read_plan, run_group
from evo_cpg.cli.errors import UsageError
from evo_cpg.config.trust import is_trusted, trusting
from evo_cpg.files import write_text
from evo_cpg.installation import command_for
from evo_cpg.locks import LockedError, joined, locked
from evo_cpg.system import described_by
from evo_cpg.training.devices import available_cores, use_cores
from evo_cpg.training.run_folder import RunFolderError, read_checked

_HIDDEN, _SLURM = ".jobs", "slurm.json"

# Interval between two checks of local jobs, and of jobs of SLURM, s.
_LOOK, _LOOK_AT_SLURM = 0.25, 5.0

# Time that interrupted local jobs have to end, s. submitit kills them after one second.
_GRACE = 10.0

# Time limit of a local job, min: a year. The default of submitit is two minutes.
_LONGEST = 60 * 24 * 365

# Default time limit of a job of SLURM, min, and largest number of times that a job is queued again
# at its time limit. The job then continues from its checkpoints.
_TIMEOUT, _TIMES = 60, 1000

# Number of last lines of a failed job's standard error that are shown.
_LAST_LINES = 5


class _Entry(TypedDict):
    """Entry of the list of SLURM jobs."""

    id: str
    logs: str
    settings: list


# Job of submitit, and its settings.
Running = tuple[Any, list[Member]]


class Jobs(NamedTuple):
    """Jobs that the command line requests.

    Attributes:
        count: number of local processes at a time, or None for SLURM.
        options: options of submitit for SLURM.
    """

    count: int | None
    options: dict[str, Any]


class Job(NamedTuple):
    """Group of settings that submitit evolves in another process.

    Attributes:
        sweep: folder of the sweep.
        settings: names of the settings.
        cores: number of cores to use, or None for all cores of the job.
        trusted: whether configurations are the user's own.
        locks: whether the job shares the lock of the sweep, as local jobs do.
    """

    sweep: str
    settings: tuple[str, ...]
    cores: int | None
    trusted: bool
    locks: bool

    def __call__(self) -> None:
        """Evolve the settings from their checkpoints to their last generations."""
        folder = Path(self.sweep)
        devices = use_cores(self.cores)
        with contextlib.ExitStack() as stack:
            stack.enter_context(trusting(self.trusted))
            if self.locks:
                stack.enter_context(joined(folder))
            plan = read_plan(folder)
            if plan is None:
                raise RunFolderError(f"{folder} is no longer a sweep")
            for group in groups(members_of(folder, plan, self.settings)):
                run_group(group, devices, lambda member, rows: None)

    def checkpoint(self) -> Any:
        """Return this job for submitit to queue again, after a preemption or at the time limit."""
        return importlib.import_module("submitit").helpers.DelayedSubmission(self)


def read_jobs(word: str | None, options: Sequence[str]) -> Jobs | None:
    """Return the jobs of ``--jobs`` and ``--job-option``, or None without ``--jobs``.

    Raises:
        UsageError: a value is wrong, or submitit or SLURM is missing here.
    """
    given = dict(_option(text) for text in options)
    if given and word != "slurm":
        raise UsageError("--job-option: needs --jobs slurm. Add it, or leave --job-option out")
    if word is None:
        return None
    count = None if word == "slurm" else int(word) if word.isdecimal() else 0
    if count == 0:
        raise UsageError(f"--jobs: {word!r} is neither a number of processes nor slurm")
    try:
        importlib.import_module("submitit")
    except ImportError as error:
        raise UsageError(
            f"--jobs: 'submitit' is not installed here ({error}). Install it with "
            f"`{command_for('jobs')}`"
        ) from None
    if count is None and not (shutil.which("sbatch") and shutil.which("srun")):
        raise UsageError(
            "--jobs slurm: this host has no sbatch, which submits jobs to SLURM. Run the command "
            "on a host that has it, or choose --jobs N for N processes on this host"
        )
    return Jobs(count, given)


@contextlib.contextmanager
def claimed(folder: Path, jobs: Jobs | None) -> Iterator[None]:
    """Lock a sweep: two commands would overwrite each other's checkpoints.

    Local jobs share the lock, so it is held until the last job has ended, even if this command ends
    first. Jobs of SLURM do not share the lock. A list, ``slurm.json``, names them.

    Args:
        folder: folder of the sweep.
        jobs: requested jobs. `--jobs slurm` may continue a sweep that has jobs in SLURM.

    Raises:
        LockedError: another command, or a job of another command, works on the sweep.
        OutputError: the folder cannot be written.
        RunFolderError: SLURM has jobs of the sweep, and ``jobs`` are not SLURM jobs.
    """
    with contextlib.ExitStack() as stack:
        try:
            lock = stack.enter_context(locked(folder, make=True))
        except LockedError as error:
            raise LockedError(f"{error}. A job that it has started may be running, too") from None
        if jobs is None or jobs.count is not None:
            running = [entry["id"] for entry in _recorded(folder) if not _of_slurm(entry).done()]
            if running:
                raise RunFolderError(
                    f"{folder}: SLURM has jobs of this sweep ({', '.join(running)}). Follow them "
                    f"with `evo-cpg sweep {folder} --jobs slurm`, or end them with `scancel "
                    f"{' '.join(running)}`. If SLURM has no such jobs, delete "
                    f"{folder / _HIDDEN / _SLURM}"
                )
            (folder / _HIDDEN / _SLURM).unlink(missing_ok=True)
        lock.share()
        yield


def run_jobs(
    folder: Path, found: Sequence[list[Member]], jobs: Jobs, cores: int | None
) -> list[str]:
    """Evolve groups of settings as jobs, until all jobs have ended.

    Args:
        folder: folder of the sweep.
        found: groups of settings.
        jobs: requested jobs.
        cores: cores of all local jobs together, or of each SLURM job. None selects all cores of
            this machine, or SLURM's default.

    Returns:
        Names of settings that did not reach their last generation.

    Raises:
        UsageError: submitit rejects the options, or SLURM rejects a job.
        KeyboardInterrupt: local jobs have ended. Jobs of SLURM continue.
    """
    waiting = [group for group in found if not all(member.finished for member in group)]
    if not waiting:
        return []
    logs = _new_folder(folder)
    places, own = len(waiting), cores
    if jobs.count is None:
        queue = _Slurm(folder, logs, jobs, cores)
    else:
        queue = _Local(folder, logs)
        places = min(jobs.count, places)
        own = max(1, (cores or available_cores()) // places)
    total = sum(member.experiment.generations for group in found for member in group)
    failed: list[str] = []
    running: list[Running] = []
    with working(f"{folder.name}: generations of all settings", counted=True) as work:
        try:
            while waiting or running:
                while waiting and len(running) < places:
                    group = waiting.pop(0)
                    running.append((queue.start(group, own), group))
                    work.say(f"job {running[-1][0].job_id}: {', '.join(_names(group))}")
                time.sleep(queue.look)
                for one in [one for one in running if one[0].done()]:
                    running.remove(one)
                    queue.ended(one[0])
                    failed += _failed(*one, work)
                work.reached(sum(m.folder.newest for group in found for m in group), total)
        except BaseException:
            queue.leave([job for job, _ in running])
            raise
    if not failed:
        shutil.rmtree(logs, ignore_errors=True)
    return failed


class _Local:
    """Queue of processes on this machine.

    Args:
        folder: folder of the sweep.
        logs: folder for the files of the jobs.
    """

    look = _LOOK

    def __init__(self, folder: Path, logs: Path):
        self._folder = folder
        self._executor = importlib.import_module("submitit").LocalExecutor(folder=logs)
        self._executor.update_parameters(timeout_min=_LONGEST)

    def start(self, group: list[Member], cores: int | None) -> Any:
        """Start a process that evolves a group, and return its job."""
        return self._executor.submit(_job(self._folder, group, cores, True))

    def ended(self, job: Any) -> None:
        """Do nothing: a local process leaves nothing behind."""

    def leave(self, running: Sequence[Any]) -> None:
        """End all running jobs."""
        for job in running:
            job.cancel()
        end = time.monotonic() + _GRACE
        while time.monotonic() < end and not all(job.done() for job in running):
            time.sleep(_LOOK)


class _Slurm:
    """Queue of SLURM jobs, including jobs that an earlier command has left there.

    Args:
        folder: folder of the sweep.
        logs: folder for the files of new jobs.
        jobs: requested jobs.
        cores: number of cores of each job, or None for SLURM's default.

    Raises:
        UsageError: submitit rejects the options.
    """

    look = _LOOK_AT_SLURM

    def __init__(self, folder: Path, logs: Path, jobs: Jobs, cores: int | None):
        self._folder, self._logs = folder, logs
        self._entries = _recorded(folder)
        submitit: Any = importlib.import_module("submitit")
        self._refused = importlib.import_module("submitit.core.utils").FailedJobError
        self._executor = submitit.AutoExecutor(
            folder=logs, cluster="slurm", slurm_max_num_timeout=_TIMES
        )
        given = {"name": f"evo-cpg-{folder.name}", "timeout_min": _TIMEOUT}
        given |= {"cpus_per_task": cores} if cores else {}
        try:
            self._executor.update_parameters(**given | jobs.options)
        except (AssertionError, NameError, TypeError, ValueError) as error:
            shutil.rmtree(logs, ignore_errors=True)
            raise UsageError(f"--job-option: {str(error).splitlines()[0]}") from None

    def start(self, group: list[Member], cores: int | None) -> Any:
        """Return the existing job of a group, or submit the group to SLURM."""
        names = _names(group)
        for entry in self._entries:
            shared = set(names) & set(entry["settings"])
            if not shared:
                continue
            job = _of_slurm(entry)
            if job.done(force_check=True):
                self._forget(entry["id"])
            elif entry["settings"] == names:
                return job
            else:
                raise UsageError(
                    f"--jobs slurm: job {entry['id']} already evolves {', '.join(sorted(shared))}, "
                    f"with other settings. Wait for its end, or end it with `scancel "
                    f"{entry['id']}`"
                )
        try:
            job = self._executor.submit(_job(self._folder, group, cores, False))
        except self._refused as error:
            logs = str(self._logs.resolve())
            if not any(entry["logs"] == logs for entry in self._entries):
                shutil.rmtree(logs, ignore_errors=True)
            reason = next(iter(str(error).split("\n")), "") or "no reason given"
            raise UsageError(f"--jobs slurm: sbatch refuses the job: {reason}") from None
        entry = _Entry(id=job.job_id, logs=str(self._logs.resolve()), settings=names)
        self._record([*self._entries, entry])
        return job

    def ended(self, job: Any) -> None:
        """Remove a job from the list."""
        self._forget(job.job_id)

    def leave(self, running: Sequence[Any]) -> None:
        """Let the jobs continue, and print how to follow or end them."""
        if not running:
            return
        ids = [job.job_id for job in running]
        print(
            f"jobs {', '.join(ids)} continue. Follow them with `evo-cpg sweep {self._folder} --jobs"
            f" slurm`, or end them with `scancel {' '.join(ids)}`",
            file=sys.stderr,
        )

    def _forget(self, job: str) -> None:
        self._record([entry for entry in self._entries if entry["id"] != job])

    def _record(self, entries: list[_Entry]) -> None:
        self._entries = entries
        text = json.dumps(entries, indent=2)
        write_text(self._folder / _HIDDEN / _SLURM, text)


def _names(group: Sequence[Member]) -> list[str]:
    return [member.setting.name for member in group]


def _job(folder: Path, group: Sequence[Member], cores: int | None, locks: bool) -> Job:
    return Job(str(folder.resolve()), tuple(_names(group)), cores, is_trusted(), locks)


def _failed(job: Any, group: Sequence[Member], work: Work) -> list[str]:
    """Return unfinished settings of a job that has ended, and print the end of its errors."""
    left = _names([member for member in group if not member.finished])
    if left:
        path = Path(job.paths.stderr)
        last = [line for line in described_by(path).splitlines() if line.strip()][-_LAST_LINES:]
        work.say(f"job {job.job_id} failed ({', '.join(left)}). {path} ends:")
        for line in last or ["(nothing)"]:
            work.say(f"    {line}")
    return left


def _is_list(entries: Any) -> bool:
    return all(
        isinstance(entry[key], kind)
        for entry in entries
        for key, kind in _Entry.__annotations__.items()
    )


def _recorded(folder: Path) -> list[_Entry]:
    """Return jobs of SLURM that have not been seen to end.

    Raises:
        RunFolderError: the list is damaged.
    """
    return read_checked(folder / _HIDDEN / _SLURM, _is_list) or []


def _of_slurm(entry: _Entry) -> Any:
    try:
        submitit: Any = importlib.import_module("submitit")
    except ImportError:
        raise RunFolderError(
            f"job {entry['id']} of this sweep may be running in SLURM, and 'submitit', which can "
            f"check this, is not installed here. Install it with `{command_for('jobs')}`"
        ) from None
    return submitit.SlurmJob(entry["logs"], entry["id"])


def _new_folder(folder: Path) -> Path:
    """Make a folder for one command: submitit would reuse files with the same process number."""
    (folder / _HIDDEN).mkdir(exist_ok=True)
    prefix = time.strftime("%Y%m%d_%H%M%S_")
    return Path(tempfile.mkdtemp(prefix=prefix, dir=folder / _HIDDEN)).resolve()


def _option(text: str) -> tuple[str, Any]:
    """Return a key and its value, read as JSON or else as a word."""
    key, equals, word = text.partition("=")
    if not (key and equals and word):
        raise UsageError(f"--job-option: {text!r} is not KEY=VALUE")
    try:
        return key, json.loads(word)
    except ValueError:
        return key, word
