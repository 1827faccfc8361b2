"""The front door: what ``import evo_cpg as evo`` offers; see docs/api.md."""
