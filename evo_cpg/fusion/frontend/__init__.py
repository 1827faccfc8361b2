"""JAX programs as graphs of scalars, and what fused programs are to JAX."""
