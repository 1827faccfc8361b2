"""Programs for one individual as native code for all: from JAX to machine code."""

# Teaches JAX how to run, differentiate and map what is fused.
import evo_cpg.fusion.native  # noqa: F401
