"""A process that turns LLVM IR into object code, started as a file by `compiler`.

It imports nothing of the package, so that it starts in a fifth of a second.

A request is one line of JSON and the text; an answer is one line of JSON and the object code.

| line | keys |
|---|---|
| request | ``processor``, ``features``, ``effort``, ``size`` of the text in bytes |
| answer | ``size`` of the object code in bytes, or ``error`` |
"""

import functools
import json
import signal
import sys
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, BinaryIO, NamedTuple

if TYPE_CHECKING:
    import llvmlite.binding as llvm

# Stack of the thread that compiles, bytes. LLVM goes through a function recursively: one of 250,000
# lines, as version 1.0.0 made of a spider, needs more than 8 MiB. Functions that are cut need
# 256 KiB, also those of a walker with 41 bodies. Only what is touched takes up memory.
_STACK = 256 * 2**20


class Request(NamedTuple):
    """A module of LLVM IR to be compiled.

    Attributes:
        text: the module.
        processor: LLVM's name of it.
        features: LLVM's list of what it has.
        effort: of the optimiser, 0 to 3.
    """

    text: str
    processor: str
    features: str
    effort: int


def object_code(request: Request) -> bytes:
    """Compile a module of LLVM IR, on a thread with a large stack.

    Raises:
        RuntimeError: the text is not valid IR, or LLVM has no such processor.
    """
    return _on_large_stack(lambda: _object_code(*request))


def _object_code(text: str, *machine_of: Any) -> bytes:
    import llvmlite.binding as llvm

    machine = _machine(*machine_of)
    module = llvm.parse_assembly(text)
    # The order of instructions and what is in registers is settled (`registers`);
    # looking for a better one takes longer than all the rest. The setting is the whole process's.
    llvm.set_option("", "-enable-misched=false")
    try:
        return machine.emit_object(module)
    finally:
        llvm.set_option("", "-enable-misched=true")


@functools.cache
def _machine(processor: str, features: str, effort: int) -> "llvm.TargetMachine":
    import llvmlite.binding as llvm

    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    return llvm.Target.from_default_triple().create_target_machine(
        cpu=processor,
        features=features,
        opt=effort,
        reloc="pic",
        codemodel="small",
    )


def _on_large_stack(compute: Callable[[], bytes]) -> bytes:
    """Return the result of a function that runs on a thread of its own."""
    found: list[bytes] = []
    errors: list[BaseException] = []

    def run() -> None:
        try:
            found.append(compute())
        except BaseException as error:
            errors.append(error)

    thread = _started(run)
    if thread is None:
        return compute()
    thread.join()
    if errors:
        raise errors[0]
    return found[0]


def _started(run: Callable[[], None]) -> threading.Thread | None:
    """Start a thread with a large stack; return None where the system refuses one."""
    try:
        before = threading.stack_size(_STACK)
    except (ValueError, RuntimeError):
        return None
    try:
        thread = threading.Thread(target=run, name="LLVM")
        thread.start()
    except RuntimeError:
        return None
    finally:
        threading.stack_size(before)
    return thread


def serve(requests: BinaryIO, answers: BinaryIO) -> None:
    """Answer requests until there are no more."""
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
    # An interrupt is for the process that asked, which then closes the pipe.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    serve(sys.stdin.buffer, sys.stdout.buffer)
