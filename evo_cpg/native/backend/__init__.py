"""Compile a graph of scalars to LLVM IR, and LLVM IR to machine code in memory."""
