"""Small functions that many programs are made of, traced once for all arrays of a kind."""

import functools

import jax

inlined = functools.partial(jax.jit, inline=True)
"""Decorator of a function of arrays alone: JAX traces it once for arguments of each shape and type.

A program has the operations in its own text all the same, as if they had been written there, and so
do derivatives; outside of programs the function is compiled as one. A step of the quadruped is
traced in four fifths of the time.
"""
