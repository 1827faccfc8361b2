"""What a configuration file may say: SI units, angles in degrees where ``_deg`` says so."""
