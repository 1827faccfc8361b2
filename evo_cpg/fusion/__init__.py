"""Compile JAX programs for one individual to native code for all individuals."""

# This import teaches JAX how to run, differentiate and map fused programs.
import evo_cpg.fusion.native  # noqa: F401
