"""Ranges and scaling laws of real animals, to stand beside the measured numbers.

All figures are from secondary sources, because we did not see them in their original papers. Costs
are metabolic: the chemical energy of the whole animal. Mechanical work costs four to five times as
much, because muscles have an efficiency of 0.2 to 0.25.

| motion | formula | unit | source |
|---|---|---|---|
| running at speed v | 10.7 M^-0.316 + 6.03 M^-0.303 / v | J/(kg m) | Taylor et al. 1982 |
| running, least | 10.7 M^-0.316 | J/(kg m) | Taylor et al. 1982 |
| swimming, fish | 1.1 M^-0.38 with M in grams | J/(N m) | secondary source |
| swimming, salmon | 2.15 M^-0.25 | J/(kg m) | secondary source |
| swimmers, laminar | Re = 0.03 Sw^1.31 | | Gazzola et al. 2014 |
| swimmers, turbulent | Re = 0.4 Sw^1.02 | | Gazzola et al. 2014 |

M is in kg, except where the table says grams. Divided by the standard gravity, J/(kg m) becomes the
cost of transport without a unit.
"""

from typing import NamedTuple

import numpy as np

from evo_cpg.analysis.stride import Values


class Animals(NamedTuple):
    """Range of a quantity in animals.

    Attributes:
        key: key of the quantity in `evo_cpg.analysis.gait_numbers`.
        low: lower end.
        high: upper end, or the single figure again.
        animal: the animals.
        source: the paper, empty if it is unknown.
    """

    key: str
    low: float
    high: float
    animal: str
    source: str

    @property
    def range(self) -> str:
        """The range in words, such as ``0.2 to 0.4``, or ``up to 0.5``."""
        if self.low == self.high:
            return f"{self.low:.3g}"
        return f"up to {self.high:.3g}" if self.low == 0 else f"{self.low:.3g} to {self.high:.3g}"

    def __str__(self) -> str:
        source = f"{self.source}, " if self.source else ""
        return f"{self.range} {self.animal} ({source}secondary source)"


_WAVES = "Wave Motion 78, 83 (2018)"
_NEWTS = "computed from data beside Pazzaglia et al. 2025"
_NEWTS_ON_LAND = "Ashley-Ross, Lundin and Johnson 2009"

ANIMALS: tuple[Animals, ...] = (
    Animals("strouhal", 0.2, 0.4, "efficient swimmers", "Eloy 2012; Saadat et al. 2017"),
    Animals("strouhal", 0.45, 0.45, "eels and lampreys", "J. Exp. Biol. 212, 576"),
    Animals("strouhal", 0.46, 1.15, "newts", _NEWTS),
    Animals("wave_slip", 0.5, 0.8, "fish", ""),
    Animals("wave_count", 0.77, 0.84, "newts", _NEWTS),
    Animals("travelling_index", 0.74, 0.9, "eel-like fish", _WAVES),
    Animals("travelling_index", 0.52, 0.78, "carangiform fish", _WAVES),
    Animals("travelling_index", 0.36, 0.64, "tuna-like fish", _WAVES),
    Animals("bending_lag", 0.1, 0.15, "eels in water", "Gillis 1998"),
    Animals("bending_lag", 0.0, 0.0, "eels on land", "Gillis 1998"),
    Animals("tail_amplitude", 0.15, 0.16, "eels", "D'Aout and Aerts 1999; Gillis 1998"),
    Animals("tail_amplitude", 0.21, 0.26, "newts", _NEWTS),
    Animals("froude_efficiency", 0.75, 0.9, "theory at U/V 0.5 to 0.8", "Lighthill 1960"),
    Animals("limb_duty_factor", 0.77, 0.77, "newts on land", _NEWTS_ON_LAND),
    Animals("limb_duty_factor", 0.41, 0.41, "newts under water", _NEWTS_ON_LAND),
    Animals("limb_duty_factor", 0.5, 1.0, "walking animals", "Alexander and Jayes 1983"),
    Animals("froude_number", 0.0, 0.5, "walking animals", "Alexander and Jayes 1983"),
    Animals("recovery", 0.4, 0.7, "walking animals", "Cavagna et al. 1977"),
    Animals("recovery", 0.0, 0.2, "running animals", "Cavagna et al. 1977"),
)


def animals_of(key: str) -> tuple[Animals, ...]:
    """Return the ranges of a quantity, or () without one."""
    return tuple(each for each in ANIMALS if each.key == key)


# Standard gravity, m/s^2. Animals' costs are per weight on the earth.
_GRAVITY = 9.80665


def running_cost(mass: Values, speed: Values | None = None) -> Values:
    """Return a running animal's metabolic cost of transport, no unit.

    Args:
        mass: mass, kg.
        speed: speed, m/s, or None for the least cost, which a fast animal approaches.
    """
    per_metre = 10.7 * np.power(mass, -0.316)
    if speed is not None:
        per_metre = per_metre + 6.03 * np.power(mass, -0.303) / np.asarray(speed)
    return per_metre / _GRAVITY


def swimming_cost(mass: Values) -> tuple[Values, Values]:
    """Return fish's cost of transport for a mass (kg), no unit: two formulas, the lower first."""
    fish = 1.1 * np.power(np.multiply(1000.0, mass), -0.38)
    salmon = 2.15 * np.power(mass, -0.25) / _GRAVITY
    return np.minimum(fish, salmon), np.maximum(fish, salmon)


def reynolds_of_swimmers(swimming_number: Values) -> Values:
    """Return the Reynolds number of swimmers from larvae to whales with a swimming number.

    It is the smaller of the two laws. They meet near Sw = 7500 and Re = 3600.

    Args:
        swimming_number: Sw = w A L / nu, with A from side to side.
    """
    laminar = 0.03 * np.power(swimming_number, 1.31)
    return np.minimum(laminar, 0.4 * np.power(swimming_number, 1.02))
