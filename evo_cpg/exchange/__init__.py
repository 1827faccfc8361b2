"""Creatures from and for other programs: MuJoCo's MJCF."""
