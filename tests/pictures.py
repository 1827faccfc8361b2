"""Properties of a picture that a command has drawn."""

from pathlib import Path

import numpy as np
from PIL import Image


def ink(path: Path) -> float:
    """Return the fraction of the pixels that stand out from the background."""
    with Image.open(path) as picture:
        grey = np.asarray(picture.convert("L"), float)
    return float((np.abs(grey - grey[0, 0]) > 40).mean())
