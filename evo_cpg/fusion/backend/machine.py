"""From LLVM IR to machine code in memory, kept on disk so that it is made once.

llvmlite brings LLVM; no compiler and no linker are needed. What was compiled stays in memory as
long as the process lives, for XLA may call it at any time; equal code is there only once.
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
from evo_cpg.fusion import machine_constants
from evo_cpg.fusion.backend import compiler
from evo_cpg.fusion.backend.code import Target
from evo_cpg.fusion.backend.compiler_process import Request
from evo_cpg.fusion.stopwatch import counted
from evo_cpg.fusion.unsupported import Unsupported

if TYPE_CHECKING:
    import llvmlite.binding as llvm

# What is left out where a smaller set is requested.
_LARGER = {"avx2": ("avx512",), "sse": ("avx", "fma", "f16c", "xop", "vaes", "vpclmul")}


_folder: Path | None = None


def keep_code_in(folder: Path | None) -> None:
    """Where machine code is kept for the next start; None keeps nothing."""
    global _folder
    _folder = folder


def code_folder() -> Path | None:
    """Return the folder in which machine code is kept; None where it is not."""
    return _folder


def llvm_version() -> str:
    """Of the LLVM that makes the code."""
    return ".".join(map(str, _llvm().llvm_version_info))


def passed_self_test(target: Target, version: str) -> bool:
    """Whether code for a machine has passed its self-test with a version of JAX."""
    # Unlike a path's own method this does not complain of a folder that is another user's.
    return _folder is not None and os.path.exists(_folder / _self_test_name(target, version))


def remember_self_test(target: Target, version: str) -> None:
    """Note that it has."""
    if _folder is not None:
        with contextlib.suppress(OSError):
            (_folder / _self_test_name(target, version)).touch()


def _self_test_name(target: Target, version: str) -> str:
    import llvmlite

    text = "\n".join([version, llvmlite.__version__, sys.version, *map(str, target)])
    return f"native-tried-{hashlib.sha256(text.encode()).hexdigest()[:16]}"


@functools.cache
def host(requested: str | None = None) -> Target:
    """This machine, or as much of it as a set of instructions has.

    Args:
        requested: name of the set; None for the largest that the processor has.

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
        raise Unsupported(f"it knows no vectors of {platform.machine()}")
    if requested is not None and requested not in names:
        raise Unsupported(f"this processor has no {requested}; it has {', '.join(names)}")
    name = requested or names[0]
    kept = {each for each in has if not each.startswith(_LARGER.get(name, ()))}
    flags = [f"{'+' if each in kept else '-'}{each}" for each in sorted(has - {"neon", "fma"})]
    if "fma" in has and name not in ("neon",):
        flags.append(f"{'+' if 'fma' in kept else '-'}fma")
    size, registers, _, compresses = sets[name]
    processor = llvm.get_host_cpu_name()
    return Target(name, size, registers, "fma" in kept, compresses, processor, ",".join(flags))


def load(text: str, target: Target) -> tuple[str, int]:
    """A name of its own for a module's function ``@handler``, and its address.

    Args:
        text: LLVM IR, which may be any module with that function.
        target: the machine.
    """
    effort = str(machine_constants.LLVM_EFFORT)
    key = "\n".join([llvm_version(), platform.platform(), *map(str, target), effort, text])
    name = hashlib.sha256(key.encode()).hexdigest()[:32]
    return name, _load(name, text, target)


# Of each module its entry, the size of its code, and what keeps it in memory.
_loaded: dict[str, tuple[int, int, object]] = {}


def code_bytes() -> int:
    """Size of all machine code in memory."""
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
    # A file that was cut short is none.
    code, digest = content[:-32], content[-32:]
    return code if hashlib.sha256(code).digest() == digest else None


def _write(name: str, code: bytes) -> None:
    if _folder is not None:
        with contextlib.suppress(OSError), in_one_piece(_folder / f"native-{name}") as file:
            file.write_bytes(code + hashlib.sha256(code).digest())
