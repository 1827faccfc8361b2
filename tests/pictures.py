"""Properties of a picture that a command has drawn."""

from pathlib import Path

import numpy as np
from PIL import Image

_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


def ink(path: Path) -> float:
    """Return the fraction of the pixels that stand out from the background."""
    with Image.open(path) as picture:
        grey = np.asarray(picture.convert("L"), float)
    return float((np.abs(grey - grey[0, 0]) > 40).mean())


def contrast(behind: np.ndarray, text: str) -> float:
    """Return the contrast of a colour to a background, for which WCAG requires 4.5."""
    shades = np.array([int(text[i : i + 2], 16) for i in (1, 3, 5)])
    light = []
    for c in (behind.reshape(-1, 3) / 255, shades / 255):
        linear = np.where(c > 0.04045, ((c + 0.055) / 1.055) ** 2.4, c / 12.92)
        light.append(float(np.median(linear @ _LUMINANCE)))
    return (max(light) + 0.05) / (min(light) + 0.05)
