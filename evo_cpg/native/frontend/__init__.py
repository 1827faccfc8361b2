"""Lower JAX programs to graphs of scalars, and define fused programs as JAX primitives."""
