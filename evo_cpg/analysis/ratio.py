"""Ratio of two quantities that may not exist."""

import numpy as np
from jaxtyping import Float

# A number, or an array of numbers.
Values = float | Float[np.ndarray, " *n"]


def ratio(above: Values, below: Values) -> Values:
    """Return the ratio of two quantities, NaN unless the lower one is positive.

    Args:
        above: a number or an array.
        below: a number or an array.
    """
    below = np.asarray(below, float)
    exists = below > 0
    found = np.where(exists, above, np.nan) / np.where(exists, below, 1.0)
    return found if found.ndim else float(found)
