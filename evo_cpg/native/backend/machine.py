"""Compile LLVM IR to machine code in memory, with a cache on disk.

llvmlite contains LLVM, so no compiler and no linker are needed. Code stays in memory until the
process ends, because XLA may call it at any time. Equal code is loaded only once.
"""

import contextlib
import functools
import hashlib
import os
import platform
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from evo_cpg.files import in_one_piece
from evo_cpg.native import machine_constants
from evo_cpg.native.backend import compiler
from evo_cpg.native.backend.code import Target
from evo_cpg.native.backend.compiler_process import Request
from evo_cpg.native.stopwatch import counted
from evo_cpg.native.unsupported import Unsupported

if TYPE_CHECKING:
    import llvmlite.binding as llvm

# Prefixes of processor features to switch off, by requested instruction set.
_LARGER = {"avx2": ("avx512",), "sse": ("avx", "fma", "f16c", "xop", "vaes", "vpclmul")}


_folder: Path | None = None


def keep_code_in(folder: Path | None) -> None:
    """Set the folder in which machine code is kept for the next start, or None to keep none."""
    global _folder
    _folder = folder


def code_folder() -> Path | None:
    """Return the folder in which machine code is kept, or None if it is not kept."""
    return _folder


def llvm_version() -> str:
    """Return the version of the LLVM that compiles the code."""
    return ".".join(map(str, _llvm().llvm_version_info))


def passed_self_test(target: Target, version: str) -> bool:
    """Return whether native code for a machine passed its self-test with a version of JAX."""
    # Unlike `Path.exists`, this does not raise for a folder of another user.
    return _folder is not None and os.path.exists(_folder / _self_test_name(target, version))


def remember_self_test(target: Target, version: str) -> None:
    """Record that native code for a machine has passed its self-test with this version of JAX."""
    if _folder is not None:
        with contextlib.suppress(OSError):
            (_folder / _self_test_name(target, version)).touch()


def _self_test_name(target: Target, version: str) -> str:
    import llvmlite

    text = "\n".join([version, llvmlite.__version__, sys.version, *map(str, target)])
    return f"native-tried-{hashlib.sha256(text.encode()).hexdigest()[:16]}"


@functools.cache
def host(requested: str | None = None) -> Target:
    """Return this machine, limited to an instruction set.

    Args:
        requested: name of the set, or None for the largest set of the processor.

    Raises:
        Unsupported: llvmlite is missing, or the processor lacks the set.
    """
    llvm = _llvm()
    has = {name for name, present in llvm.get_host_cpu_features().items() if present}
    if platform.machine().lower() in ("aarch64", "arm64"):
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
    flags = [f"{'+' if each in kept else '-'}{each}" for each in sorted(has - {"neon", "fma"})]
    if "fma" in has and name not in ("neon",):
        flags.append(f"{'+' if 'fma' in kept else '-'}fma")
    size, registers, _ = sets[name]
    processor = llvm.get_host_cpu_name()
    return Target(name, size, registers, "fma" in kept, processor, ",".join(flags))


def load(text: str, target: Target) -> tuple[str, int]:
    """Compile and load a module. Return a unique name for its ``@handler``, and the address.

    Args:
        text: LLVM IR of a module with a function ``@handler``.
        target: the machine.
    """
    effort = str(machine_constants.LLVM_EFFORT)
    key = "\n".join([llvm_version(), platform.platform(), *map(str, target), effort, text])
    name = hashlib.sha256(key.encode()).hexdigest()[:32]
    return name, _load(name, text, target)


# Entry address and code size (bytes) of each module, and the object that keeps it in memory.
_loaded: dict[str, tuple[int, int, object]] = {}


def code_bytes() -> int:
    """Return the size of all machine code in memory, bytes."""
    return sum(size for _, size, _ in _loaded.values())


def _load(name: str, text: str, target: Target) -> int:
    if name not in _loaded:
        code = _read(name)
        if code is None:
            effort = machine_constants.LLVM_EFFORT
            with counted(compiler=True):
                request = Request(text, target.processor, target.features, effort)
                code = compiler.object_code(request)
            _write(name, code)
        builder = _llvm().JITLibraryBuilder()
        builder.add_object_img(code).add_current_process().export_symbol("handler")
        tracker = builder.link(_linker(), name)
        _loaded[name] = tracker["handler"], len(code), tracker
    return _loaded[name][0]


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


def _read(name: str) -> bytes | None:
    if _folder is None:
        return None
    try:
        content = (_folder / f"native-{name}").read_bytes()
    except OSError:
        return None
    # The last 32 bytes are a hash of the code. A truncated file counts as missing.
    code, digest = content[:-32], content[-32:]
    return code if hashlib.sha256(code).digest() == digest else None


def _write(name: str, code: bytes) -> None:
    if _folder is not None:
        with contextlib.suppress(OSError), in_one_piece(_folder / f"native-{name}") as file:
            file.write_bytes(code + hashlib.sha256(code).digest())
