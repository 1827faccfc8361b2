"""Studies that `evo-cpg reproduce` repeats: runs, and the tables and pictures made of them."""
