"""The test suite with the oldest and newest dependencies on every interpreter: `make test-matrix`.

The fast tests run in an environment for each interpreter and age of the dependencies. Then the
swimmer's physics step is timed in turn with the oldest JAX on the oldest interpreter, and with the
newest on the newest. Finally numba, which needs its own range of llvmlite, is installed and used
with the newest dependencies. This program needs only the standard library, and a package index.
"""

import argparse
import json
import os
import shutil
import statistics
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import IO, Any, NamedTuple

ROOT = Path(__file__).parents[1]

# Minor versions of Python 3 that JAX and llvmlite have wheels for.
_MINORS = range(11, 15)

# uv's name for the choice of the oldest or the newest of the allowed versions.
_RESOLUTIONS = {"oldest": "lowest-direct", "newest": "highest"}

# Largest time of a step with the newest JAX, relative to the oldest, and number of rounds.
_SLOWEST = 1.3
_ROUNDS = 21

_NUMBA = """
import numba
from evo_cpg.native.self_test import main

@numba.njit
def total(count):
    result = 0
    for i in range(count):
        result += i
    return result

assert total(10) == 45
main("{instructions}")
assert total(10.0) == 45
"""


class Environment(NamedTuple):
    """A virtual environment: an interpreter with installed dependencies.

    Attributes:
        name: name in the summary.
        python: interpreter of the environment.
    """

    name: str
    python: Path


def main(folder: Path, interpreters: list[str], arguments: list[str]) -> list[str]:
    """Test all environments, time the step, and try numba.

    Args:
        folder: folder of the environments.
        interpreters: commands that start them, or none for all that are found.
        arguments: arguments of pytest.

    Returns:
        A phrase for each failure.
    """
    pythons = _versions(interpreters or _candidates())
    if not pythons:
        return ["no interpreter was found"]
    uv, failures = _uv(folder), []
    made: dict[tuple[str, str], Environment] = {}
    for version, python in pythons.items():
        for age, resolution in _RESOLUTIONS.items():
            name = f"Python {version}, {age} dependencies"
            print(f"== {name}", flush=True)
            place = folder / f"{version}-{age}"
            environment = _make(uv, name, python, place, resolution)
            if environment is None:
                failures.append(f"{name}: the installation failed")
                continue
            made[version, age] = environment
            if _run(environment.python, "-m", "pytest", "-q", *arguments):
                failures.append(f"{name}: the tests failed")
    oldest = next((made[key] for key in made if key[1] == "oldest"), None)
    newest = next((made[key] for key in reversed(made) if key[1] == "newest"), None)
    if oldest and newest:
        failures += _race(oldest, newest)
    if newest:
        failures += _beside_numba(uv, newest)
    return failures


def _candidates() -> Iterable[str]:
    """Return commands that may be interpreters: commands on the path first, then pyenv's."""
    for minor in _MINORS:
        yield f"python3.{minor}"
    root = Path(os.environ.get("PYENV_ROOT") or Path.home() / ".pyenv")
    yield from map(str, sorted(root.glob("versions/3.*/bin/python")))


def _versions(commands: Iterable[str]) -> dict[str, str]:
    """Return the path of an interpreter for each supported version, such as 3.11, oldest first."""
    found: dict[int, str] = {}
    for command in commands:
        line = [command, "-c", "import sys; print(*sys.version_info[:2], sys.executable)"]
        try:
            answer = subprocess.run(line, capture_output=True, text=True, check=True).stdout
        except (OSError, subprocess.CalledProcessError):
            continue
        major, minor, executable = answer.strip().split(" ", 2)
        if int(major) == 3 and int(minor) in _MINORS:
            found.setdefault(int(minor), executable)
    return {f"3.{minor}": found[minor] for minor in sorted(found)}


def _uv(folder: Path) -> str:
    """Return the path of uv, which is installed if necessary.

    pip cannot choose the oldest versions.
    """
    if own := shutil.which("uv"):
        return own
    tools = folder / "tools"
    if not (tools / "bin" / "uv").exists():
        subprocess.run([sys.executable, "-m", "venv", str(tools)], check=True)
        pip = [str(tools / "bin" / "python"), "-m", "pip", "install", "--quiet", "uv"]
        subprocess.run(pip, check=True)
    return str(tools / "bin" / "uv")


def _make(uv: str, name: str, python: str, place: Path, resolution: str) -> Environment | None:
    """Create a new environment. Return None if that fails."""
    environment = Environment(name, place / "bin" / "python")
    steps = (
        ["venv", "--clear", "--python", python, str(place)],
        # Versions without a wheel for this interpreter are left out: users do not build them.
        ["pip", "install", "--python", str(environment.python), "--resolution", resolution,
         "--no-build", "--compile-bytecode", "--editable", f"{ROOT}[test]"],
    )  # fmt: skip
    return None if any(_run(uv, step[0], "--quiet", *step[1:]) for step in steps) else environment


def _race(oldest: Environment, newest: Environment) -> list[str]:
    """Time the swimmer's step in both environments, in turn, and return the failures."""
    print("== the swimmer's step", flush=True)
    workers = [_started(oldest), _started(newest)]
    try:
        seconds: list[list[float]] = [[], []]
        for worker in workers:
            about = _answer(worker)
            print(f"   {about['python']}, JAX {about['jax']}: {about['engine']}", flush=True)
        for _ in range(_ROUNDS):
            for worker, taken in zip(workers, seconds, strict=True):
                _pipe(worker.stdin).write("0\n")
                _pipe(worker.stdin).flush()
                taken.append(_answer(worker)["seconds"])
    except (BrokenPipeError, RuntimeError) as error:
        return [f"the swimmer's step: {error}"]
    finally:
        for worker in workers:
            worker.kill()
            worker.wait()
    for environment, taken in zip((oldest, newest), seconds, strict=True):
        print(f"   {environment.name}: {1e6 * statistics.median(taken):.0f} us")
    ratios = [new / old for old, new in zip(*seconds, strict=True)]
    low, ratio, high = statistics.quantiles(ratios, n=4)
    print(f"   newest / oldest: {ratio:.2f} ({low:.2f} to {high:.2f})", flush=True)
    if ratio > _SLOWEST:
        return [f"the swimmer's step: {ratio:.2f} times as slow on the newest JAX"]
    return []


def _started(environment: Environment) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [str(environment.python), "-m", "benchmarks.matrix_step"],
        cwd=ROOT,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )


def _answer(worker: subprocess.Popen[str]) -> dict[str, Any]:
    answer = json.loads(_pipe(worker.stdout).readline() or '{"error": "the process ended"}')
    if "error" in answer:
        raise RuntimeError(answer["error"])
    return answer


def _pipe(stream: IO[str] | None) -> IO[str]:
    assert stream is not None
    return stream


def _beside_numba(uv: str, environment: Environment) -> list[str]:
    """Install numba, use it and our compiler in one process, and return the failures."""
    print("== together with numba", flush=True)
    at = ["--quiet", "--python", str(environment.python)]
    if _run(uv, "pip", "install", *at, "--no-build", "numba"):
        return ["numba: the installation failed"]
    if _run(uv, "pip", "check", *at):
        return ["numba: its dependencies conflict with ours"]
    find = "from evo_cpg.native.backend.machine import host; print(host().name)"
    found = subprocess.run([environment.python, "-c", find], capture_output=True, text=True)
    program = _NUMBA.format(instructions=found.stdout.strip())
    failed = _run(environment.python, "-c", program)
    return ["numba: it failed in one process with our compiler"] if failed else []


def _run(*command: object) -> int:
    return subprocess.run([str(part) for part in command], cwd=ROOT).returncode


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=str(__doc__).split("\n", 1)[0])
    parser.add_argument("folder", type=Path, help="folder for the environments")
    parser.add_argument(
        "interpreters", nargs="*", help="commands that start Python, default: all found"
    )
    parser.add_argument("--pytest", default="", help="arguments for pytest")
    given = parser.parse_args()
    failed = main(given.folder.resolve(), given.interpreters, given.pytest.split())
    print("\n".join(["== failed", *failed] if failed else ["== all passed"]))
    sys.exit(bool(failed))
