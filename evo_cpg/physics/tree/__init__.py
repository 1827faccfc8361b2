"""The tree: joints, recursions and the torques on its axes."""
