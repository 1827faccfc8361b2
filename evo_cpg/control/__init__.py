"""The nervous system: brain (ANN) and spinal cord (CPG)."""
