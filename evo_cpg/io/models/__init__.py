"""Exchange of creatures with other programs: MuJoCo's MJCF."""
