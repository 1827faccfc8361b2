"""Schema of a configuration file: SI units, and degrees for keys that end with ``_deg``."""
