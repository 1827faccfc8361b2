"""Compile JAX programs for one individual to native code for all individuals."""

# This import registers with JAX how to run, differentiate and map (`jax.vmap`) fused programs.
import evo_cpg.native.native  # noqa: F401
