"""Test runs against faults: `python -m benchmarks.faults kills|configs|folders|hour OUT`.

kills    small runs of five kinds are killed at random moments, by SIGKILL, SIGTERM and SIGINT in
         turn, and resumed until they finish. Their populations, tables and champions must equal,
         to the last bit, the results of undisturbed runs.
configs  the shipped configurations, with random mistakes in their values or text, are read and
         built. Each must be accepted, or refused with a message for the user, in bounded time and
         memory.
folders  run folders with random damage are plotted and opened. Every eighth is verified and resumed
         instead of opened. Each command must succeed, or refuse with a message for the user. A
         resumed run must end with the original's population, unless its configuration was damaged.
hour     one run trains for an hour. Memory, generations and files are recorded every minute.

A folder in OUT, named after the test, holds summary.json and any failures. All seeds are fixed.
"""

import argparse
import collections
import contextlib
import copy
import hashlib
import io
import json
import math
import multiprocessing
import os
import random
import shutil
import signal
import subprocess
import sys
import time
import traceback
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from evo_cpg.errors import UserError

ROOT = Path(__file__).parents[1]
CONFIGS = ROOT / "configs"

_SMALL = ("simulation.seconds=2", "evolution.generations=40")
_PAIR = (*_SMALL, "creature.bodies.1.repeat=1", "creature.bodies.1.joint.axes=[z]")
_SWIM = (*_PAIR, "evolution.population=16", "evolution.elites=4", "world.water.form_resolution=1")
_LIGHTS = "simulation.trials=[{light: {bearing_deg: 30}}, {light: {bearing_deg: -30}}]"
_NOISE = ("noise.joint_angle_deg=1", "noise.push=0.05")

# Kinds of runs that are killed.
KINDS = {
    "swimmer": ("iwadate2010_swimmer", _SWIM),
    "several lights": ("iwadate2010_swimmer", (*_SWIM, _LIGHTS)),
    "learning": (
        "iwadate2010_swimmer",
        (
            *_SWIM,
            "simulation.seconds=0.5",
            "evolution.learning.every=4",
            "evolution.learning.steps=1",
        ),
    ),
    "noise and trials": ("iwadate2010_swimmer", (*_SWIM, *_NOISE, "simulation.trials=3")),
    "walkers side by side": (
        "fukui2003_model1",
        ("simulation.seconds=1", "runs=3", "evolution.generations=40", "noise.friction=0.2"),
    ),
}

# Longest time until a process is killed, s.
_LONGEST = 14.0

# One of this many damaged folders is verified and resumed, which compiles its programs.
_VERIFIED = 8

# Limits of time and memory for a configuration, s and bytes. A damaged folder has 12 times as long.
_SLOW, _LARGE = 5.0, 2**30

# Columns of metrics.csv that may differ between runs with the same results.
_TIMES = ("seconds", "steps_per_second")

_ODD_VALUES: tuple[Any, ...] = (
    None, True, False, -1, 0, 1, 2, 1e308, -1e308, 1e-308, math.nan, math.inf, -math.inf, 10**30,
    -(10**30), 0.5, "", " ", "x", "x" * 5000, "1", "nan", "\x00", "../x", "/", "é\u202e", [], {},
    [[]], [None], [1, 2, 3], [0, 0, 0], ["x"], {"type": "x"}, {"file": "x"}, {"x": 1}, [1e308] * 3,
    [[1, 2]] * 3, 3.0, 1000, 10_000, 1_000_000, 2**31, 2**63, "head", "all", "box", "real", "bits",
)  # fmt: skip


def command(*words: object) -> list[str]:
    """Return the command line of an `evo-cpg` process."""
    return [sys.executable, "-m", "evo_cpg", *map(str, words)]


def environment(out: Path) -> dict[str, str]:
    """Return the environment of `evo-cpg` processes, which share a cache of compiled code."""
    return os.environ | {
        "PYTHONPATH": str(ROOT),
        "JAX_COMPILATION_CACHE_DIR": str(out / "compiled"),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
    }


# Kills ------------------------------------------------------------------------------------------


def contents(run: Path) -> dict[str, str]:
    """Return a digest of each kind of result of a finished run, without times."""
    from evo_cpg.training.run_folder import RunFolder

    folder = RunFolder(run)
    checkpoint = folder.load()
    champion, recording, _ = folder.load_champion()
    assert checkpoint is not None and recording is not None
    rows = [{k: v for k, v in row.items() if k not in _TIMES} for row in checkpoint.history]
    parts = {
        "genes": checkpoint.genes.tobytes(),
        "history": json.dumps(rows).encode(),
        "scales": json.dumps(checkpoint.scales).encode(),
        "lineage": folder.lineage.read_bytes(),
        "champion": champion.genes.tobytes() + json.dumps(champion[1:]).encode(),
        "motion": b"".join(np.asarray(each).tobytes() for each in recording),
    }
    return {name: hashlib.sha256(part).hexdigest() for name, part in parts.items()}


def finish(out: Path, run: Path, start: list[str]) -> None:
    """Start or resume a run, and wait until it finishes.

    Args:
        out: folder of the test.
        run: run folder.
        start: command line for a run that has no configuration yet.

    Raises:
        RuntimeError: the process failed.
    """
    again = command("resume", run, "--cores", 1) if (run / "config.yaml").exists() else start
    done = subprocess.run(again, env=environment(out), capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"{' '.join(again)}: {done.stderr[-2000:]}")


def kills_of(out: Path, kind: str, count: int) -> dict[str, Any]:
    """Kill runs of one kind, and compare their results with an undisturbed run.

    Args:
        out: folder of the test.
        kind: key of `KINDS`.
        count: number of kills.

    Returns:
        Number of kills, number of finished runs, and the results that differ.
    """
    config, settings = KINDS[kind]
    file, name = CONFIGS / f"{config}.yaml", kind.replace(" ", "_")
    whole = out / f"{name}_whole"
    finish(out, whole, command("train", file, *settings, "--cores", 1, "--out", whole))
    expected = contents(whole)
    chance, killed, finished, differ = random.Random(kind), 0, 0, []
    signals = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
    while killed < count:
        run = out / f"{name}_{finished}"
        start = command("train", file, *settings, "--cores", 1, "--out", run)
        while killed < count:
            started = (run / "config.yaml").exists()
            words = command("resume", run, "--cores", 1) if started else start
            process = subprocess.Popen(
                words, env=environment(out), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
            )
            try:
                process.wait(chance.uniform(0.0, _LONGEST))
                break
            except subprocess.TimeoutExpired:
                process.send_signal(signals[killed % len(signals)])
                process.wait()
                killed += 1
        finish(out, run, start)
        found = contents(run)
        differ += [f"{run}: {part}" for part in expected if found[part] != expected[part]]
        finished += 1
        shutil.rmtree(run)
    return {"killed": killed, "finished": finished, "differ": differ}


def kills(out: Path, count: int) -> dict[str, Any]:
    """Kill runs of all kinds, at least ``count`` times in all, with two kinds at a time."""
    each = -(-count // len(KINDS))
    with ThreadPoolExecutor(2) as pool:
        found = pool.map(lambda kind: kills_of(out, kind, each), KINDS)
        return dict(zip(KINDS, found, strict=True))


# Configurations ---------------------------------------------------------------------------------


def places(data: Any, key: tuple = ()) -> Iterable[tuple]:
    """Yield the path of keys to every value in nested mappings and lists."""
    inner = data.items() if isinstance(data, dict) else enumerate(data)
    for name, value in inner:
        yield (*key, name)
        if isinstance(value, (dict, list)):
            yield from places(value, (*key, name))


def with_odd_values(data: dict[str, Any], chance: random.Random) -> dict[str, Any]:
    """Return a copy of a configuration with some values replaced, scaled, left out or renamed."""
    data = copy.deepcopy(data)
    for _ in range(chance.choice((1, 1, 1, 2, 3))):
        key = chance.choice(list(places(data)))
        inner: Any = data
        for part in key[:-1]:
            inner = inner[part]
        what = chance.random()
        if what < 0.1:
            del inner[key[-1]]
        elif what < 0.2 and isinstance(inner, dict):
            inner[chance.choice(("x", "type", "file", "", 3, None, True))] = inner.pop(key[-1])
        elif what < 0.3 and isinstance(inner[key[-1]], (int, float)):
            inner[key[-1]] *= chance.choice((-1, 1e-6, 1e3, 1e6, 1e12))
        else:
            inner[key[-1]] = copy.deepcopy(chance.choice(_ODD_VALUES))
    return data


def with_odd_text(text: bytes, chance: random.Random) -> bytes:
    """Return a text with bits flipped, or bytes lost, inserted, doubled or cut off."""
    damaged = bytearray(text)
    for _ in range(chance.choice((1, 2, 5))):
        place = chance.randrange(len(damaged))
        what = chance.random()
        if what < 0.4:
            damaged[place] ^= 1 << chance.randrange(8)
        elif what < 0.6:
            del damaged[place : place + chance.choice((1, 10, 100))]
        elif what < 0.8:
            damaged[place:place] = chance.choice((b"[", b"{", b"&a ", b"*a", b"\t", b"- ", b": "))
        elif what < 0.9:
            damaged[place:place] = damaged[place : place + 200]
        else:
            del damaged[place + 1 :]
        if not damaged:
            break
    return bytes(damaged)


def build_odd(folder: Path, number: int) -> str:
    """Read, check and build one configuration with mistakes.

    Args:
        folder: folder of the configurations.
        number: seed of the mistakes.

    Returns:
        ``taken`` or ``refused``.

    Raises:
        ValueError: the message for the user is too long.
        Exception: any error that is not a message for the user.
    """
    from evo_cpg.io.build import build_experiment
    from evo_cpg.io.lint import lint
    from evo_cpg.io.load import load_config

    chance = random.Random(number)
    original = chance.choice(sorted(folder.glob("*.yaml")))
    path = original.with_name(f"odd_{number}.yml")
    if chance.random() < 0.7:
        data = yaml.safe_load(original.read_text())
        creature = data["creature"]
        if chance.random() < 0.6 and isinstance(creature, str):
            data["creature"] = yaml.safe_load((folder / creature).read_text())
        path.write_text(yaml.safe_dump(with_odd_values(data, chance), allow_unicode=True))
    else:
        path.write_bytes(with_odd_text(original.read_bytes(), chance))
    try:
        config = load_config(path)
        list(lint(config, path))
        build_experiment(config, path)
    except Exception as error:
        if not isinstance(error, UserError):
            raise
        if len(str(error)) > 1000:
            words = f"the message for the user has {len(str(error))} characters, more than 1000"
            raise ValueError(words) from error
        path.unlink()
        return "refused"
    path.unlink()
    return "taken"


# Run folders ------------------------------------------------------------------------------------


def damage(run: Path, chance: random.Random) -> list[str]:
    """Break some files of a run folder, and return their paths in it."""
    files = sorted(path for path in run.rglob("*") if path.is_file())
    broken = []
    for path in chance.sample(files, chance.choice((1, 1, 2, 3))):
        broken.append(str(path.relative_to(run)))
        size = path.stat().st_size
        what = chance.randrange(8)
        if what == 0:
            os.truncate(path, chance.randrange(size + 1))
        elif what == 1:
            contents = bytearray(path.read_bytes())
            for _ in range(chance.choice((1, 8, 64))):
                contents[chance.randrange(len(contents))] ^= 1 << chance.randrange(8)
            path.write_bytes(contents)
        elif what == 2:
            path.unlink()
        elif what == 3:
            path.unlink()
            path.mkdir()
        elif what == 4:
            other = chance.choice(files)
            path.write_bytes(other.read_bytes())
        elif what == 5:
            path.write_bytes(b"")
        elif what == 6:
            path.unlink()
            path.symlink_to(path.name)
        else:
            path.write_bytes(chance.randbytes(size))
        files = [each for each in files if each.is_file()]
    return broken


def open_damaged(folder: Path, number: int) -> str:
    """Damage a copy of a run folder, and use the copy as its user would.

    Args:
        folder: folder of the undamaged runs.
        number: seed of the damage.

    Returns:
        Outcomes of all commands, such as ``plot done, open refused``.

    Raises:
        RuntimeError: a command failed without a message for the user, or resuming changed the
            population.
    """
    import evo_cpg as evo
    from evo_cpg.api.runs import open_champion
    from evo_cpg.cli.draw import plot
    from evo_cpg.training import devices
    from evo_cpg.training.run_folder import RunFolder

    chance = random.Random(number)
    original = chance.choice(sorted(path for path in folder.iterdir() if path.is_dir()))
    run = folder.parent / "odd" / f"{original.name}_{number}"
    shutil.copytree(original, run)
    broken = damage(run, chance)
    outcomes = []
    commands: dict[str, Callable[[], object]] = {
        "plot": lambda: plot(run),
        "verify": lambda: evo.verify(run, 1),
        "resume": lambda: evo.resume(run, cores=1),
    }
    if number % _VERIFIED:
        commands = {"plot": commands["plot"], "open": lambda: open_champion(run)}
    # JAX already has its devices in this process. A damaged file must not change their number.
    devices.use_cores = lambda cores: 1
    for name, call in commands.items():
        try:
            with (
                contextlib.redirect_stdout(io.StringIO()),
                contextlib.redirect_stderr(io.StringIO()),
            ):
                call()
            outcomes.append(f"{name} done")
        except SystemExit as error:
            outcomes.append(f"{name} ends with {error.code}")
        except Exception as error:
            if not isinstance(error, UserError):
                raise RuntimeError(f"{name} failed after damage to {', '.join(broken)}") from error
            outcomes.append(f"{name} refused")
    if outcomes[-1] == "resume done":
        sound, found = RunFolder(original).load(), RunFolder(run).load()
        assert sound is not None and found is not None
        if "config.yaml" not in broken and not np.array_equal(sound.genes, found.genes):
            raise RuntimeError(f"damage to {', '.join(broken)} changed the resumed run's genes")
    shutil.rmtree(run)
    return ", ".join(outcomes)


# In worker processes ----------------------------------------------------------------------------


def _work(call: Callable[[Path, int], str], folder: Path, tasks: Any, results: Any) -> None:
    """Call a function with numbers from a queue, and queue each outcome, its time and memory."""
    from evo_cpg.training.devices import use_cores

    use_cores(1)
    os.chdir(folder)
    parent = multiprocessing.parent_process()
    for number in iter(tasks.get, None):
        if parent is not None and not parent.is_alive():
            return
        before = _memory()
        # Writing 5 resets the peak memory that Linux reports for this process.
        with contextlib.suppress(OSError):
            Path("/proc/self/clear_refs").write_text("5")
        start = time.perf_counter()
        try:
            outcomes, problem = call(folder, number), ""
        except BaseException:
            outcomes, problem = "FAILED", traceback.format_exc()
        seconds = time.perf_counter() - start
        results.put((number, outcomes, problem, seconds, _memory("VmHWM") - before))


def _memory(kind: str = "VmRSS") -> int:
    """Return the resident memory (VmRSS) of this process or its peak (VmHWM), bytes."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(kind):
            return int(line.split()[1]) * 1024
    return 0


def fuzz(
    call: Callable[[Path, int], str], folder: Path, count: int, out: Path, slow: float
) -> dict[str, Any]:
    """Call a function with all numbers below a count, in two processes. Stop if a process hangs.

    Args:
        call: function of a folder and a number, which returns an outcome.
        folder: first argument of the function.
        count: number of calls.
        out: folder for the failures.
        slow: longest time of a call, s.

    Returns:
        Number of calls, outcomes with their counts, number of failures, longest time (s), and
        largest growth of memory (MiB).
    """
    context = multiprocessing.get_context("spawn")
    tasks, results = context.Queue(), context.Queue()
    for number in range(count):
        tasks.put(number)
    workers = []

    def hire() -> None:
        worker = context.Process(target=_work, args=(call, folder, tasks, results), daemon=True)
        worker.start()
        workers.append(worker)

    for _ in range(2):
        hire()
    outcomes, wrong, times, sizes = collections.Counter(), [], [], []
    seen, patience = 0, max(60.0, 12 * slow)
    while seen < count:
        try:
            number, what, problem, seconds, grown = results.get(timeout=patience)
        except Exception:
            # A process that is still at work hangs, or died without a message.
            wrong.append("a process hung or died. Its number is missing from the outcomes")
            break
        seen += 1
        outcomes[what] += 1
        times.append(seconds)
        sizes.append(grown)
        if problem or seconds > slow or grown > _LARGE:
            wrong.append(f"{number}: {what}, {seconds:.1f} s, {grown / 2**20:.0f} MiB\n{problem}")
            (out / "wrong.txt").write_text("\n".join(wrong))
        if seen % 250 == 0:
            print(f"{seen} of {count}: {len(wrong)} wrong", flush=True)
    for worker in workers:
        worker.terminate()
    return {
        "count": seen,
        "outcomes": dict(outcomes),
        "wrong": len(wrong),
        "longest_s": max(times, default=0.0),
        "largest_MiB": max(sizes, default=0) / 2**20,
    }


def configs(out: Path, count: int) -> dict[str, Any]:
    """Read and build the shipped configurations, with mistakes, this many times."""
    folder = out / "configs"
    shutil.copytree(CONFIGS, folder, dirs_exist_ok=True)
    return fuzz(build_odd, folder, count, out, _SLOW)


def folders(out: Path, count: int) -> dict[str, Any]:
    """Train two runs, then use damaged copies of their folders this many times."""
    whole = out / "whole"
    for kind in ("swimmer", "walkers side by side"):
        config, settings = KINDS[kind]
        run = whole / kind.replace(" ", "_")
        few = (*settings, "evolution.generations=3")
        start = command("train", CONFIGS / f"{config}.yaml", *few, "--cores", 1, "--out", run)
        finish(out, run, start)
    (out / "odd").mkdir(exist_ok=True)
    os.environ.update(environment(out))
    # A call may run three commands that compile. A user does not wait for all of them in a row.
    return fuzz(open_damaged, whole, count, out, 12 * _SLOW)


# An hour ----------------------------------------------------------------------------------------


def hour(out: Path, minutes: int) -> dict[str, Any]:
    """Train one run, and inspect it once a minute."""
    run = out / "hour"
    words = command(
        "train", CONFIGS / "iwadate2010_swimmer.yaml", "simulation.seconds=3.333",
        "evolution.generations=1000000", "--out", run,
    )  # fmt: skip
    process = subprocess.Popen(
        words, env=environment(out), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    rows = []
    for _ in range(minutes):
        time.sleep(60)
        status = Path(f"/proc/{process.pid}/status").read_text()
        resident = next(line for line in status.splitlines() if line.startswith("VmRSS"))
        files = [path for path in run.rglob("*") if path.is_file()]
        metrics = run / "metrics.csv"
        generations = metrics.read_text().count("\n") - 1 if metrics.exists() else 0
        size = sum(path.stat().st_size for path in files if path.exists())
        rows.append([int(resident.split()[1]) / 1024, generations, len(files), size / 2**20])
        print(rows[-1], flush=True)
    process.send_signal(signal.SIGINT)
    process.wait()
    return {"MiB, generations, files, MiB of them, each minute": rows}


def main() -> None:
    """Run one of the tests, then print and store its summary."""
    parser = argparse.ArgumentParser(description=str(__doc__).split("\n", 1)[0])
    parser.add_argument("what", choices=("kills", "configs", "folders", "hour"), help="the test")
    parser.add_argument("out", type=Path, help="folder for the results")
    defaults = "200 kills, 5000 configs, 1000 folders, 60 minutes"
    parser.add_argument("--count", type=int, help=f"default: {defaults}")
    given = parser.parse_args()
    calls = {"kills": (kills, 200), "configs": (configs, 5000), "folders": (folders, 1000),
             "hour": (hour, 60)}  # fmt: skip
    call, usual = calls[given.what]
    out = given.out.resolve() / given.what
    out.mkdir(parents=True, exist_ok=True)
    found = call(out, given.count or usual)
    (out / "summary.json").write_text(json.dumps(found, indent=1))
    print(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
