"""Compile LLVM IR to object code in a process that `machine` starts from this file.

This file imports nothing of the package, so that the process starts in 0.2 s.

A request is one line of JSON and a text of LLVM IR. An answer is one line of JSON and the object
code.

| line | keys |
|---|---|
| request | ``processor``, ``features``, ``effort``, ``assembly``, ``size`` of the text in bytes |
| answer | ``size`` of the object code in bytes, or ``error`` |
"""

import functools
import json
import signal
import sys
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, BinaryIO, NamedTuple

if TYPE_CHECKING:
    import llvmlite.binding as llvm

# Stack of the thread that compiles, bytes. LLVM walks through a function recursively. In version
# 1.0.0 a spider's single function of 250,000 lines needed more than 8 MiB. Since then long
# functions are cut, and need 256 KiB even for a walker with 41 bodies. Unused stack takes no
# memory.
_STACK = 256 * 2**20


class Request(NamedTuple):
    """A module of LLVM IR to be compiled.

    Attributes:
        text: text of the module.
        processor: LLVM's name of the processor.
        features: LLVM's list of processor features.
        effort: optimisation level, 0 to 3.
        assembly: whether the answer is the text of the instructions instead of object code.
    """

    text: str
    processor: str
    features: str
    effort: int
    assembly: bool = False


def object_code(request: Request) -> bytes:
    """Compile a module of LLVM IR, on a thread with a large stack.

    Raises:
        RuntimeError: if the text is not valid IR, or LLVM has no such processor.
    """
    return _on_large_stack(lambda: _object_code(*request))


def _object_code(text: str, processor: str, features: str, effort: int, assembly: bool) -> bytes:
    import llvmlite.binding as llvm

    machine = _machine(processor, features, effort)
    module = llvm.parse_assembly(text)
    # The order of instructions and the use of registers are fixed (`storage`). A search for a
    # better order takes longer than the rest of compilation. The option is global, so it is set
    # back afterwards.
    llvm.set_option("", "-enable-misched=false")
    try:
        return machine.emit_assembly(module).encode() if assembly else machine.emit_object(module)
    finally:
        llvm.set_option("", "-enable-misched=true")


@functools.cache
def _machine(processor: str, features: str, effort: int) -> "llvm.TargetMachine":
    import llvmlite.binding as llvm

    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    return llvm.Target.from_default_triple().create_target_machine(
        cpu=processor, features=features, opt=effort, reloc="pic", codemodel="small"
    )


def _on_large_stack(compute: Callable[[], bytes]) -> bytes:
    """Run a function on a separate thread with a large stack and return its result."""
    found: list[bytes] = []
    errors: list[BaseException] = []

    def run() -> None:
        try:
            found.append(compute())
        except BaseException as error:
            errors.append(error)

    thread = before = None
    try:
        before = threading.stack_size(_STACK)
        thread = threading.Thread(target=run, name="LLVM")
        thread.start()
    except (ValueError, RuntimeError):
        # The system refuses a large stack or another thread.
        thread = None
    finally:
        if before is not None:
            threading.stack_size(before)
    if thread is None:
        return compute()
    thread.join()
    if errors:
        raise errors[0]
    return found[0]


def serve(requests: BinaryIO, answers: BinaryIO) -> None:
    """Answer requests until the input ends."""
    while line := requests.readline():
        request = json.loads(line)
        text = requests.read(request.pop("size")).decode()
        try:
            code, reply = object_code(Request(text, **request)), {}
        except Exception as error:
            code, reply = b"", {"error": f"{error}"}
        answers.write(json.dumps({**reply, "size": len(code)}).encode() + b"\n" + code)
        answers.flush()


if __name__ == "__main__":
    # The parent process handles interrupts and then stops this process.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    serve(sys.stdin.buffer, sys.stdout.buffer)
