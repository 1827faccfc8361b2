"""Evolving virtual creatures: rigid bodies in water, Matsuoka CPGs, genetic algorithms, in JAX."""
