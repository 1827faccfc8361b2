"""Benchmarks of evo_cpg beside its peers, measurements for the docs, and long tests."""
