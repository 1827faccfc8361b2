"""Numbers as they stand in MJCF."""

import numpy as np

# Decimal places of coordinates: m and directions.
_PLACES = 15


def number_text(*values: float) -> str:
    """Numbers as short as they can be read back exactly."""
    # Adding 0 leaves no -0.
    return " ".join(np.format_float_positional(float(v) + 0.0, trim="-") for v in values)


def place_text(values: np.ndarray) -> str:
    """Coordinates, without the digits that sines and cosines leave of a zero."""
    return number_text(*np.round(values, _PLACES))
