"""Constants that suit one kind of machine and may be wrong for another.

The result of a trial does not depend on them: they trade time against memory. "Fitted" constants
are measured on the machine at hand by

    python -m benchmarks.fit_constants

The others are facts, or limits that keep a mistake from taking minutes. Modules read a constant
at each use.
"""

from typing import NamedTuple


class InstructionSet(NamedTuple):
    """The vectors of a processor.

    Attributes:
        bytes: size of a vector, bytes.
        registers: number of vector registers.
        needs: LLVM's names of the processor features that the set requires.
        compresses: whether an instruction compresses the chosen numbers of a vector.
    """

    bytes: int
    registers: int
    needs: tuple[str, ...]
    compresses: bool = False


INSTRUCTION_SETS = {
    "avx512": InstructionSet(64, 32, ("avx512f", "avx512vl", "avx512dq", "avx512bw", "fma"), True),
    "avx2": InstructionSet(32, 16, ("avx2", "fma")),
    "sse": InstructionSet(16, 16, ("sse2",)),
    "neon": InstructionSet(16, 32, ("neon",)),
}
"""A fact. By name; the first that a processor has is taken."""

LANES = 16
"""A fact: float32 numbers in the widest vector. Individuals per device are rounded up to it."""

CACHE_LINE = 64
"""A fact, bytes: places in scratch memory begin with a line."""

VALUE_REGISTERS = 0.75
"""Fitted: fraction of the registers that hold values; the others hold constants and what an
operation needs on the way. Hardly sensitive: from 1/2 to 7/8 a step of swimmer and quadruped takes
as long but for the scatter of a busy machine; on a quieter one 7/8 took 1.0 to 1.3 times as long,
for LLVM then spills the others."""

LLVM_EFFORT = 2
"""Fitted: 1 to 3 make the same code, for its order and registers are settled before; with 0 a step
takes 2.3 (quadruped) to 3.3 times (swimmer) as long, and compiling no less."""

WIDEST_CHUNK = 32
"""Fitted: vectors of individuals that a device computes at a time. Trials of 30 control steps of
2048 swimmers take 1.9 times as long with 1, 1.3 times with 4 and 0.94 times with 128. What speaks
against more is that progress shows, and memory stays flat, only from chunk to chunk."""

VECTOR_GROUP = 16
"""Fitted: vectors that run together (`evo_cpg.fusion.backend.packing`) in programs with a loop that
ends at different rounds for each individual."""

LARGEST_RESIDUALS = 256 * 2**20
"""Fitted, bytes: what may be kept of all control steps of a trial on a device, for its gradient;
beyond that parts are computed again: with 0, gradients of 16 swimmers take 1.4 times as long. To be
raised where there is memory."""

LONGEST_FUNCTION = 6000
"""Fitted: lines of LLVM IR in one function, about. Where a function is cut, all that is used again
goes through memory."""

MOST_OPERATIONS = 600_000
"""A limit: more would take minutes to compile, and more memory than code should."""

SHORTEST_BRANCH = 60
"""Fitted: scalars of a branch from which on it is jumped over where no individual takes it."""

LONGEST_ELIMINATION = 5000
"""Fitted: products of an elimination beyond which it is done by a loop."""

LONGEST_LISTS = 1 << 17
"""A limit: scalars that a loop may hand out as lists; each is a row of memory for every vector."""

LONGEST_SELF_TEST = 120.0
"""A limit, s: the self-test of native code takes 2 s, and one that hangs has failed."""
