"""Contact: gaps, points and forces, with the ground and between limbs."""
