"""Schema of a configuration file: SI units; keys that end with ``_deg`` are in degrees."""
