"""Benchmarks of evo_cpg and its peers, measurements for the docs, inspection of native code."""
