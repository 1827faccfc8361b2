"""Constants that suit one kind of machine and may be wrong for another.

The result of a trial does not depend on them: they trade time against memory. "Fitted" constants
are measured on the machine at hand by

    python -m benchmarks.fit_constants

The others are facts, or limits that keep a mistake from taking minutes. Modules read a constant
at each use.
"""

from typing import NamedTuple


class VectorUnit(NamedTuple):
    """The vectors of a processor.

    Attributes:
        bytes: size of a vector, bytes.
        registers: number of vector registers.
        needs: LLVM's names of the processor features that the set requires.
        compresses: whether an instruction moves chosen numbers of a vector into its first lanes.
    """

    bytes: int
    registers: int
    needs: tuple[str, ...]
    compresses: bool = False


INSTRUCTION_SETS = {
    "avx512": VectorUnit(64, 32, ("avx512f", "avx512vl", "avx512dq", "avx512bw", "fma"), True),
    "avx2": VectorUnit(32, 16, ("avx2", "fma")),
    "sse": VectorUnit(16, 16, ("sse2",)),
    "neon": VectorUnit(16, 32, ("neon",)),
}
"""A fact: instruction sets by name. A processor uses the first one that it has."""

LANES = 16
"""A fact: float32 numbers in the widest vector.

The number of individuals on a device is rounded up to a multiple of it.
"""

CACHE_LINE = 64
"""A fact, bytes: size of a cache line. A vector's place in scratch memory begins at a line."""

VALUE_REGISTERS = 0.75
"""Fitted: fraction of the registers that hold values. The other registers hold constants and
temporaries of an operation. On a busy machine, fractions from 1/2 to 7/8 give equal times for steps
of the swimmer and the quadruped, within the scatter. On a quieter machine, 7/8 took 1.0 to 1.3
times as long, because LLVM then spills the other registers."""

LLVM_EFFORT = 2
"""Fitted: optimisation level of LLVM. Levels 1 to 3 make the same code, because its order and its
registers are already chosen. With 0, a step takes 2.3 (quadruped) to 3.3 times (swimmer) as long,
and compiling takes no less time."""

WIDEST_CHUNK = 32
"""Fitted: vectors of individuals that a device computes at a time. Trials of 30 control steps of
2048 swimmers take 1.9 times as long with 1, 1.3 times with 4 and 0.94 times with 128. Larger chunks
need more memory, and progress is reported less often."""

VECTOR_GROUP = 16
"""Fitted: vectors that run together in programs with a loop that ends at a different round for each
individual (`evo_cpg.native.backend.packing`)."""

LARGEST_GROUP = 5 * 2**20
"""Fitted, bytes: memory of the vectors that run together. Fewer vectors run together if their
memory is larger. 16 vectors of the quadruped have 1.4 MB and take 0.91 times as long as groups of
4. For the humanoid of gymnasium, groups of 3 to 16 vectors take equally long."""

LARGEST_RESIDUALS = 256 * 2**20
"""Fitted, bytes: memory on a device for intermediate results of all control steps of a trial, for
its gradient. Results that do not fit are computed again. With 0, gradients of 16 swimmers take 1.4
times as long. Raise it on a machine with more memory."""

LONGEST_FUNCTION = 6000
"""Fitted: approximate number of lines of LLVM IR in one function. At a cut between functions, all
values that are used again go through memory."""

MANY_OPERATIONS = 400_000
"""A limit: operations of a program above which its size is reported, because compiling takes half a
minute. No shipped animal has more."""

MOST_OPERATIONS = 600_000
"""A limit: operations of a program. A larger one would take minutes and much memory to compile."""

SHORTEST_BRANCH = 60
"""Fitted: least number of scalars in a branch that a vector skips if no individual takes it."""

LONGEST_ELIMINATION = 5000
"""Fitted: most products of an elimination in written-out code. Longer ones run in a loop."""

LONGEST_LISTS = 1 << 22
"""A limit: scalars that a loop may stack over its rounds. Each is a row of memory per vector, so
the limit is 256 MiB for the widest vectors."""

LONGEST_SELF_TEST = 120.0
"""A limit, s: time after which the self-test of native code has failed. It takes 2 s."""
