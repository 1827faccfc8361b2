"""Command line of the program, `evo-cpg`."""
