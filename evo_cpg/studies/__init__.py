"""Studies that `evo-cpg reproduce` repeats: runs, and their tables and pictures."""
