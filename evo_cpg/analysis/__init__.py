"""What an evolved animal does: gaits."""
