"""Compile LLVM IR to object code in a process that `machine` starts from this file.

This file imports nothing of the package, so that the process starts in 0.2 s.

Messages are pickled. A request is a tuple of the fields of `Request`. An answer is the object code,
or the message of an error as text.
"""

import contextlib
import functools
import pickle
import signal
import sys
from typing import TYPE_CHECKING, BinaryIO, NamedTuple

if TYPE_CHECKING:
    import llvmlite.binding as llvm


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
    """Compile a module of LLVM IR.

    LLVM walks through a function recursively. Functions are cut (`LONGEST_FUNCTION`), so 512 KiB of
    stack suffice even for a walker with 41 bodies.

    Raises:
        RuntimeError: if the text is not valid IR, or LLVM has no such processor.
    """
    import llvmlite.binding as llvm

    machine = _machine(request.processor, request.features, request.effort)
    module = llvm.parse_assembly(request.text)
    # The order of instructions and the use of registers are fixed (`storage`). A search for a
    # better order takes longer than the rest of compilation. The option is global, so it is set
    # back afterwards.
    llvm.set_option("", "-enable-misched=false")
    try:
        if request.assembly:
            return machine.emit_assembly(module).encode()
        return machine.emit_object(module)
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


def serve(requests: BinaryIO, answers: BinaryIO) -> None:
    """Answer requests until the input ends."""
    with contextlib.suppress(EOFError):
        while True:
            request = Request(*pickle.load(requests))
            try:
                answer = object_code(request)
            except Exception as error:
                answer = f"{error}"
            pickle.dump(answer, answers)
            answers.flush()


if __name__ == "__main__":
    # The parent process handles interrupts and then stops this process.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    serve(sys.stdin.buffer, sys.stdout.buffer)
