"""Public Python interface, ``import evo_cpg as evo``. See docs/api.md."""
