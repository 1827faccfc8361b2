"""Rigid-body trees in water: kinematics, the linearly implicit step, fluid and joint forces."""
