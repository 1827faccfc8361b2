"""Measuring evo_cpg beside its peers, and reproducing the papers' studies."""
