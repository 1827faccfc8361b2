"""Systems that lack something: a home, a UTF-8 locale, a permission, or an output stream.

Most tests change this process. Tests that need a new process use quick commands.
"""

import contextlib
import errno
import io
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from evo_cpg import system
from evo_cpg.api.machine import version
from evo_cpg.cli import terminal
from evo_cpg.cli.errors import message_for
from evo_cpg.cli.main import program
from evo_cpg.training.devices import available_cores
from evo_cpg.training.run_folder import RunFolder
from tiny_run import CONFIG, PAIR, REPOSITORY, environment

FULL = Path("/dev/full")
needs_full = pytest.mark.skipif(not FULL.exists(), reason="no /dev/full on this system")
posix = pytest.mark.skipif(sys.platform == "win32", reason="of POSIX systems")

SMALL = (*PAIR, "evolution.generations=2")

# Another user, without an entry in the files of the system. This user may read everything, because
# the interpreter may lie in a folder of root. It may write only where every user may.
STRANGER = (
    *("setpriv", "--reuid=54321", "--regid=54321", "--clear-groups"),
    *("--inh-caps=-all,+dac_read_search", "--ambient-caps=+dac_read_search"),
)


@pytest.fixture(scope="module")
def stranger():
    """Return the start of a command line that another user runs."""
    if not hasattr(os, "geteuid") or os.geteuid() != 0:
        pytest.skip("only root can become another user")
    if shutil.which("setpriv") is None:
        pytest.skip("there is no setpriv")
    if subprocess.run([*STRANGER, "true"], capture_output=True).returncode:
        pytest.skip("this root may not become another user")
    return STRANGER


@contextlib.contextmanager
def deleted_working_folder():
    before, folder = Path.cwd(), Path(tempfile.mkdtemp())
    os.chdir(folder)
    folder.rmdir()
    try:
        yield
    finally:
        os.chdir(before)


def run(*arguments, prefix=(), compiled=None, without=(), **changed):
    """Run `evo-cpg` as a process, and return exit code, standard output and standard error."""
    own = (environment(compiled) if compiled else os.environ) | {"PYTHONPATH": str(REPOSITORY)}
    own = {name: value for name, value in (own | changed).items() if name not in without}
    command = [*prefix, sys.executable, "-m", "evo_cpg", *map(str, arguments)]
    done = subprocess.run(command, env=own, capture_output=True)
    return done.returncode, done.stdout.decode("utf-8", "replace"), done.stderr.decode()


# No home


@pytest.fixture
def homeless(monkeypatch):
    monkeypatch.delenv("HOME", raising=False)
    monkeypatch.delenv("MPLCONFIGDIR", raising=False)

    def unknown(number):
        raise KeyError(f"getpwuid(): uid not found: {number}")

    monkeypatch.setattr("pwd.getpwuid", unknown)


@posix
def test_without_a_home_matplotlib_gets_a_folder(homeless):
    assert system.home_folder() is None
    system.lend_matplotlib_a_folder()
    assert system.is_writable(Path(os.environ["MPLCONFIGDIR"]))


def test_with_a_home_matplotlib_keeps_its_folder(monkeypatch, tmp_path):
    monkeypatch.delenv("MPLCONFIGDIR", raising=False)
    for name in ("HOME", "USERPROFILE"):
        monkeypatch.setenv(name, str(tmp_path))
    system.lend_matplotlib_a_folder()
    assert "MPLCONFIGDIR" not in os.environ


@pytest.mark.slow
def test_another_user_without_a_home_trains(stranger, compiled):
    missing = ("HOME", "XDG_CACHE_HOME", "JAX_COMPILATION_CACHE_DIR")
    with tempfile.TemporaryDirectory() as place:
        os.chmod(place, 0o777)
        folder = Path(place) / "run"
        for words in (("train", CONFIG, *SMALL, "--out", folder), ("plot", folder)):
            code, _, err = run(*words, prefix=stranger, compiled=compiled, without=missing)
            assert code == 0 and "Traceback" not in err, err


# No permission


@pytest.mark.slow
def test_a_missing_permission_is_one_line(stranger, finished_run):
    with tempfile.TemporaryDirectory() as place:
        # Every user may read the folder.
        os.chmod(place, 0o755)
        folder = shutil.copytree(finished_run, Path(place) / "run")
        code, out, err = run("resume", folder, prefix=stranger)
        assert (code, out) == (2, "")
        assert err == f"evo-cpg: cannot write {folder} (Permission denied)\n"
        code, out, err = run("train", CONFIG, *PAIR, "--out", f"{place}/new", prefix=stranger)
        assert (code, out) == (2, "")
        assert err.endswith(f"evo-cpg: cannot write {place}/new (Permission denied)\n")


def test_without_temporary_files_the_scratch_file_is_empty(monkeypatch):
    def none(*args, **options):
        raise FileNotFoundError(errno.ENOENT, "No usable temporary directory found in ['/tmp']")

    monkeypatch.setattr(tempfile, "TemporaryFile", none)
    with system.scratch_file() as file:
        file.write(b"lost")
        file.seek(0)
        assert file.read() == b""


def test_cores_are_counted_if_the_affinity_is_hidden(monkeypatch):
    def refused(number):
        raise PermissionError(errno.EPERM, "Operation not permitted")

    monkeypatch.setattr(os, "sched_getaffinity", refused, raising=False)
    assert available_cores() == os.cpu_count()


# No working folder


@pytest.mark.slow
@posix
def test_without_a_working_folder_full_paths_work(cli, finished_run, tmp_path):
    folder = tmp_path / "run"
    with deleted_working_folder():
        assert system.working_folder() is None
        assert system.resolved(Path("x")) == Path("x")
        code, out, err = cli("validate", CONFIG, "starfish")
        assert code == 0 and out.count(" genes\n") == 2, err
        assert cli("configs")[0] == 0
        code, out, err = cli("train", CONFIG, *SMALL, "--out", folder)
        assert (code, out) == (0, f"{folder}\n"), err
        assert cli("resume", folder, "--generations", 3)[0] == 0
        assert cli("watch", folder, "--once")[0] == 0
        assert cli("export", folder, tmp_path / "model.xml")[0] == 0


@posix
@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("validate", "x.yaml"), "x.yaml: no such file"),
        (("train", CONFIG, *SMALL), "cannot write runs/iwadate2010_swimmer (No such file"),
        (("resume", "run"), "run: there is no such folder"),
        (("configs", "copy", "starfish"), "cannot write creatures (No such file"),
    ],
)
def test_without_a_working_folder_other_paths_are_refused(cli, words, expected):
    with deleted_working_folder():
        code, out, err = cli(*words)
    last = err.splitlines()[-1]
    assert (code, out) == (2, "")
    assert last.startswith("evo-cpg: ") and expected in last


# No UTF-8


def test_a_setting_that_is_not_utf8_is_refused(cli):
    err = cli.refuses("validate", CONFIG, "name=\udcff")
    assert err == "evo-cpg: command line: name: '\\udcff' is not UTF-8 text\n"


# Nowhere to print


@pytest.mark.slow
@needs_full
@pytest.mark.parametrize("which", ["out", "err", "both"])
def test_training_finishes_if_output_is_lost(which, tmp_path, finished_run):
    folder = tmp_path / "run"
    with open(FULL, "wb", buffering=0) as full, pytest.MonkeyPatch.context() as patch:
        # This process already has its devices.
        patch.setattr("evo_cpg.training.devices.use_cores", lambda count=None: 2)
        patch.setattr(terminal, "protect", lambda: None)
        patch.setattr(sys, "argv", ["evo-cpg", "train", str(CONFIG), *SMALL, "--out", str(folder)])
        lost, kept = terminal.opened(full.fileno(), None), io.StringIO()
        patch.setattr(sys, "stdout", kept if which == "err" else lost)
        patch.setattr(sys, "stderr", kept if which == "out" else lost)
        with pytest.raises(SystemExit) as stop:
            program()
    assert stop.value.code == 0
    assert RunFolder(folder).newest == 2 and RunFolder(folder).load_champion()[1] is not None
    if which == "out":
        words = "evo-cpg: cannot write to standard output (No space left on device)\n"
        assert kept.getvalue().endswith(words)


@needs_full
def test_only_a_command_whose_output_is_lost_fails():
    """A closed pipe is no error, because its reader has seen enough."""
    reading, writing = os.pipe()
    os.close(reading)
    for descriptor, expected in (
        (os.open(FULL, os.O_WRONLY), (2, b"output (No space left on device)\n")),
        (writing, (0, b"")),
    ):
        words = [sys.executable, "-m", "evo_cpg", "configs"]
        done = subprocess.run(words, stdout=descriptor, stderr=subprocess.PIPE, check=False)
        os.close(descriptor)
        assert done.returncode == expected[0] and done.stderr.endswith(expected[1])


@posix
def test_a_closed_pipe_is_detected_at_the_next_line():
    reading, writing = os.pipe()
    stream = terminal.opened(writing, None)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "stdout", stream)
        print("line")
        assert terminal.is_read()
        os.close(reading)
        print("line")
        assert not terminal.is_read()
    os.close(writing)


@posix
def test_no_file_gets_the_number_of_a_closed_stream(tmp_path):
    code = f"""
import os, sys
for number in (0, 1, 2):
    os.close(number)
from evo_cpg.cli import terminal
terminal.protect()
with open({str(tmp_path / "file")!r}, "w") as file:
    assert file.fileno() > 2
    print("lost")
    os.write(1, b"lost, too")
    file.write(str([os.get_inheritable(number) for number in (0, 1, 2)]))
"""
    own = os.environ | {"PYTHONPATH": str(REPOSITORY)}
    subprocess.run([sys.executable, "-c", code], env=own, capture_output=True, check=True)
    assert (tmp_path / "file").read_text() == "[True, True, True]"


@posix
def test_a_stream_escapes_characters_outside_its_encoding():
    reading, writing = os.pipe()
    like = io.TextIOWrapper(io.BytesIO(), encoding="ascii", line_buffering=True)
    with terminal.opened(writing, like) as stream:
        print("größe·鮫", file=stream)
        assert os.read(reading, 100) == b"gr\\xf6\\xdfe\\xb7\\u9bab\n"
    os.close(reading)
    os.close(writing)


# No device


def test_version_is_printed_without_a_device(monkeypatch):
    def none(engine):
        raise AssertionError

    monkeypatch.setattr("evo_cpg.api.machine.described", none)
    monkeypatch.setenv("JAX_PLATFORMS", "tpu")
    assert version().endswith("engine: none: JAX finds no device for JAX_PLATFORMS=tpu")


@pytest.mark.slow
def test_training_without_a_device_writes_nothing(tmp_path):
    folder = tmp_path / "run"
    code, out, err = run("train", CONFIG, *SMALL, "--out", folder, JAX_PLATFORMS="nonsense")
    assert (code, out) == (2, "") and "Traceback" not in err
    assert "(JAX_PLATFORMS is 'nonsense'). Set JAX_PLATFORMS to 'cpu'" in err.splitlines()[-1]
    assert not folder.exists()


# Messages for errors


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (PermissionError(errno.EACCES, "Permission denied", "a/b"), "a/b: Permission denied"),
        (FileNotFoundError(errno.ENOENT, "No usable\nplace"), "No usable place"),
        (OSError("no words"), "no words"),
        (TimeoutError(), "TimeoutError"),
        (ValueError("a fault"), None),
    ],
)
def test_only_errors_of_the_user_or_system_have_a_message(error, words):
    assert message_for(error) == words
