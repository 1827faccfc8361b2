"""Rotations, cross products and small matrices, components first."""
