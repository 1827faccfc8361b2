"""The implicit time step of a world."""
