"""From a graph of scalars to LLVM IR, and from that to machine code in memory."""
