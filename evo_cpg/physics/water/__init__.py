"""Water: forces on bodies that move in it."""
