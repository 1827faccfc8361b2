"""Typical values of fields, a narrower range than the allowed values.

The range is part of a field's annotation: ``Annotated[NotNegative, TypicalRange(0, 30, ...)]``.
`evo_cpg.io.lint` warns of values outside it.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

# A full turn, degrees. Larger angles were probably converted twice.
TURN = 360.0

# Common angles are multiples of the first number, degrees. In radians they are usually written with
# at least two decimals, so their rounding error is less than the second number.
_COMMON, ROUNDING = 15.0, 0.006


class TypicalRange(NamedTuple):
    """Typical range of a number.

    Attributes:
        low: smallest typical value.
        high: largest typical value.
        unit: unit of both limits.
        units: other likely units, with their factors to ``unit``.
        about: sentence with a value to compare with, reported if no other unit fits.
    """

    low: float
    high: float
    unit: str
    units: Mapping[str, float] = {}
    about: str = ""

    def problem(self, value: float) -> str | None:
        """Return a description of what is wrong with a value, or None if it is plausible."""
        if self.low <= value <= self.high:
            return None
        likely = self.about
        for unit, factor in self.units.items():
            if self.low <= value * factor <= self.high:
                likely = f"If it is in {unit}, write {round(value * factor, 3):g}"
                break
        return f"plausible: {self.low:.3g} to {self.high:g} {self.unit}. {likely}"


class Direction(NamedTuple):
    """Mark of a field that holds directions in degrees. Its check finds values in radians."""

    def problem(self, value: float | tuple[float, ...]) -> str | None:
        """Return a description if all angles look like radians, or one exceeds a full turn."""
        given = np.array([angle for angle in np.ravel(value) if angle])
        if not len(given):
            return None
        meant = np.round(np.rad2deg(given) / _COMMON) * _COMMON
        off = np.abs(given - np.deg2rad(meant))
        crooked = given != np.round(given)
        if (np.abs(given) <= 2 * np.pi + ROUNDING).all() and (
            (off < ROUNDING) & (meant != 0) & crooked
        ).all():
            words = ", ".join(f"{angle:g}" for angle in meant)
            return f"in degrees this is hardly a turn. If it is in radians, write {words}"
        if np.abs(given).max() > TURN:
            return (
                f"plausible: -{TURN:g} to {TURN:g} degrees. Was it converted twice? Write degrees"
            )
        return None


# The ranges cover solids from foam to osmium, and liquids from petrol to the Dead Sea.
_DENSITIES = {"g/cm^3": 1000.0, "g/m^3": 1e-3}
SOLID = TypicalRange(20.0, 23_000.0, "kg/m^3", _DENSITIES, "Water has 1000")
LIQUID = TypicalRange(500.0, 2000.0, "kg/m^3", _DENSITIES, "Water has 1000")

# Water at 20 degrees has 0.001 Pa s, and solutions for worms up to some tenths. The kinematic
# viscosity in m^2/s is a thousand times smaller.
VISCOSITY = TypicalRange(1e-4, 0.5, "Pa s", {"mPa s": 1e-3, "m^2/s": 1000.0}, "water has 0.001")

# The strongest gravity of a planet of the sun is 24.8 m/s^2 (Jupiter).
GRAVITY = TypicalRange(0.0, 30.0, "m/s^2", {"cm/s^2": 0.01}, "Earth has 9.81")

# A narrower field of view is a slit, and is probably given in radians.
VIEW = TypicalRange(
    2 * np.pi + ROUNDING, TURN, "degrees", {"radians": np.rad2deg(1.0)}, "A slit sees no light"
)

# Joints of animals and robots turn at up to 20 rad/s, the fastest servos at 60.
RATE = TypicalRange(
    -60.0, 60.0, "rad/s", {"degrees per second": np.deg2rad(1.0)}, "Fast servos reach 60"
)
