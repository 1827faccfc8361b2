"""Few large kernels instead of many small ones: array programs as scalars per individual."""

# Teaches JAX how to differentiate and map what is fused.
import evo_cpg.fusion.derivatives  # noqa: F401
