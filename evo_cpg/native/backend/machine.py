"""Compile LLVM IR to machine code in memory, with a cache on disk.

llvmlite contains LLVM, so no compiler and no linker are needed. Code stays in memory until the
process ends, because XLA may call it at any time. Equal code is loaded only once.

LLVM runs in a separate process, so that a crash of the compiler does not end the run. The process
starts with the first program whose machine code is not on disk, and ends with the current process.
If no process can be started, LLVM runs in the current process.
"""

import atexit
import contextlib
import functools
import hashlib
import json
import os
import pickle
import platform
import re
import signal
import subprocess
import sys
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, NamedTuple, cast

from evo_cpg.files import in_one_piece
from evo_cpg.native import machine_constants
from evo_cpg.native.backend import compiler_process
from evo_cpg.native.backend.code import Target
from evo_cpg.native.backend.compiler_process import Request
from evo_cpg.native.ir import Unsupported

if TYPE_CHECKING:
    import llvmlite.binding as llvm

# Prefixes of processor features to switch off, by requested instruction set.
_LARGER = {"avx2": ("avx512",), "sse": ("avx", "fma", "f16c", "xop", "vaes", "vpclmul")}


_folder: Path | None = None


def keep_code_in(folder: Path | None) -> None:
    """Set the folder in which machine code is kept for the next start, or None to keep none."""
    global _folder
    _folder = folder


def llvm_version() -> str:
    """Return the version of the LLVM that compiles the code."""
    return ".".join(map(str, _llvm().llvm_version_info))


def self_test_record(target: Target, version: str) -> Path | None:
    """Return the file that exists if native code passed its self-test with a version of JAX.

    Return None if no code is kept.
    """
    if _folder is None:
        return None
    import llvmlite

    text = "\n".join([version, llvmlite.__version__, sys.version, *map(str, target)])
    return _folder / f"native-tried-{hashlib.sha256(text.encode()).hexdigest()[:16]}"


@functools.cache
def host(requested: str | None = None) -> Target:
    """Return this machine, limited to an instruction set (None for its largest).

    Raises:
        Unsupported: if llvmlite is missing, or the processor lacks the set.
    """
    llvm = _llvm()
    has = {name for name, present in llvm.get_host_cpu_features().items() if present}
    listed = sorted(has)
    if platform.machine().lower() in ("aarch64", "arm64"):
        # Every 64-bit ARM processor has these, whether LLVM lists them or not.
        has |= {"neon", "fma"}
    sets = machine_constants.INSTRUCTION_SETS
    names = [name for name, each in sets.items() if has.issuperset(each.needs)]
    if not names:
        known = ", ".join(sets)
        raise Unsupported(f"{platform.machine()} has none of the instruction sets {known}")
    if requested is not None and requested not in names:
        raise Unsupported(f"this processor has no {requested}. Allowed: {', '.join(names)}")
    name = requested or names[0]
    kept = {each for each in has if not each.startswith(_LARGER.get(name, ()))}
    flags = [f"{'+' if each in kept else '-'}{each}" for each in listed]
    size, registers, _, compresses = sets[name]
    processor = llvm.get_host_cpu_name()
    return Target(name, size, registers, "fma" in kept, compresses, processor, ",".join(flags))


# Entry address and code size (bytes) of each module, and the object that keeps it in memory.
_loaded: dict[str, tuple[int, int, object]] = {}


def code_bytes() -> int:
    """Return the size of all machine code in memory, bytes."""
    return sum(size for _, size, _ in _loaded.values())


def load(text: str, target: Target) -> tuple[str, int]:
    """Compile and load a module. Return a unique name for its ``@handler``, and the address."""
    effort = machine_constants.LLVM_EFFORT
    # Comments are the names of parts, which may differ in equal code.
    text = re.sub("^;.*\n", "", text, flags=re.MULTILINE)
    key = "\n".join([llvm_version(), platform.platform(), *map(str, target), str(effort), text])
    name = hashlib.sha256(key.encode()).hexdigest()[:32]
    if name not in _loaded:
        code = _kept(f"native-{name}")
        if code is None:
            code = object_code(Request(text, target.processor, target.features, effort))
            _keep(f"native-{name}", code)
        _link(name, code, text.startswith("@ticks"))
    return name, _loaded[name][0]


class Known(NamedTuple):
    """Machine code in memory: the name and address of its handler, its scratch and operations."""

    name: str
    address: int
    scratch: int
    operations: int


def recalled(note: str | None) -> Known | None:
    """Return the machine code of a program by its note, or None if it is not on disk."""
    content = note and _kept(f"note-{note}")
    if not content:
        return None
    name, *numbers = json.loads(content)
    if name not in _loaded:
        code = _kept(f"native-{name}")
        if code is None:
            return None
        _link(name, code)
    return Known(name, _loaded[name][0], *numbers)


def keep_note(note: str | None, known: Known) -> None:
    """Keep a note of which machine code a program has."""
    if note:
        _keep(f"note-{note}", json.dumps([known.name, known.scratch, known.operations]).encode())


def _kept(name: str) -> bytes | None:
    """Return the content of a file in the folder, or None if it is missing or damaged."""
    if _folder is not None:
        with contextlib.suppress(OSError):
            content = (_folder / name).read_bytes()
            # The last 32 bytes are a hash.
            if hashlib.sha256(content[:-32]).digest() == content[-32:]:
                return content[:-32]
    return None


def _keep(name: str, content: bytes) -> None:
    if _folder is not None:
        with contextlib.suppress(OSError), in_one_piece(_folder / name) as file:
            file.write_bytes(content + hashlib.sha256(content).digest())


def _link(name: str, code: bytes, timed: bool = False) -> None:
    builder = _llvm().JITLibraryBuilder()
    builder.add_object_img(code).add_current_process().export_symbol("handler")
    if timed:
        builder.export_symbol("ticks")
    tracker = builder.link(_linker(), name)
    _loaded[name] = tracker["handler"], len(code), tracker


def address_of_ticks(name: str) -> int:
    """Return the address of the clock ticks of a loaded module (`llvm.Printer`)."""
    return cast(Any, _loaded[name][2])["ticks"]


@functools.cache
def _linker() -> "llvm.LLJIT":
    llvm = _llvm()
    machine = llvm.Target.from_default_triple().create_target_machine(
        opt=machine_constants.LLVM_EFFORT, jit=True
    )
    return llvm.create_lljit_compiler(machine, use_jit_link=True)


@functools.cache
def _llvm():
    try:
        import llvmlite.binding as llvm
    except ImportError as error:
        raise Unsupported(f"llvmlite cannot be imported ({error})") from None
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    return llvm


# The process is stopped after a text longer than this (characters), because LLVM never frees the
# memory.
_LARGE_TEXT = 4 * 2**20


class CompilerDied(Unsupported):
    """Raised if the process of LLVM ends, as by a crash, while it compiles a program."""


_lock = threading.Lock()
_process: subprocess.Popen | None = None
_owner = 0


def object_code(request: Request) -> bytes:
    """Compile a module of LLVM IR in the compiler's process, which is started if needed.

    Raises:
        CompilerDied: if LLVM ended its process.
        RuntimeError: if the text is not valid IR, or LLVM has no such processor.
    """
    global _process, _owner
    with _lock:
        # After a fork, the pipes belong to the parent process.
        if _process is None or _owner != os.getpid() or _process.poll() is not None:
            command = [sys.executable, "-P", str(Path(compiler_process.__file__))]
            pipe = subprocess.PIPE
            try:
                _process = subprocess.Popen(
                    command, stdin=pipe, stdout=pipe, stderr=subprocess.DEVNULL
                )
            except OSError:
                _process = None
            _owner = os.getpid()
        if _process is None:
            return compiler_process.object_code(request)
        requests, answers = cast(BinaryIO, _process.stdin), cast(BinaryIO, _process.stdout)
        try:
            with contextlib.suppress(BrokenPipeError):
                pickle.dump((*request,), requests)
                requests.flush()
            try:
                answer = pickle.load(answers)
            except (EOFError, pickle.UnpicklingError):
                status = _process.wait()
                cause = f"exit status {status}"
                with contextlib.suppress(ValueError):
                    cause = signal.Signals(-status).name
                raise CompilerDied(f"the compiler ended with {cause}") from None
            if isinstance(answer, str):
                raise RuntimeError(answer)
            return answer
        except BaseException:
            # The pipes may hold an incomplete request or answer.
            _stop()
            raise
        finally:
            if len(request.text) > _LARGE_TEXT:
                _stop()


@atexit.register
def _stop() -> None:
    """End the compiler's process."""
    global _process
    if _process is None or _owner != os.getpid():
        return
    _process.kill()
    for pipe in (_process.stdin, _process.stdout):
        with contextlib.suppress(OSError):
            cast(BinaryIO, pipe).close()
    _process.wait()
    _process = None
