"""Ranges of real animals, to stand beside the measured numbers.

A figure that was not seen in its original paper is marked as a secondary source.
"""

from typing import NamedTuple


class Animals(NamedTuple):
    """Range of a quantity in animals.

    Attributes:
        key: key of the quantity in `evo_cpg.analysis.gait_numbers`.
        low: lower end.
        high: upper end, or the single figure again.
        who: the animals.
        source: the paper.
        secondary: whether the figure comes from a secondary source.
    """

    key: str
    low: float
    high: float
    who: str
    source: str
    secondary: bool = False


ANIMALS: tuple[Animals, ...] = (
    Animals("strouhal", 0.2, 0.4, "efficient swimmers", "Eloy 2012; Saadat et al. 2017", True),
    Animals("strouhal", 0.45, 0.45, "eels and lampreys", "J. Exp. Biol. 212, 576", True),
    Animals("strouhal", 0.46, 1.15, "newts", "computed from two laboratories' kinematics", True),
    Animals("wave_slip", 0.5, 0.8, "fish", "Lighthill 1960; Videler 1993", True),
    Animals("wave_count", 0.77, 0.84, "swimming newts", "two laboratories' kinematics", True),
    Animals("wave_count", 1.7, 1.7, "eels", "Gillis 1998", True),
    Animals("travelling", 0.74, 0.9, "eel-like swimmers", "Cui et al. 2018", True),
    Animals("travelling", 0.52, 0.78, "carangiform fish", "Cui et al. 2018", True),
    Animals("travelling", 0.36, 0.64, "tuna-like swimmers", "Cui et al. 2018", True),
    Animals("bending_lag", 0.1, 0.15, "eels in water", "Gillis 1998", True),
    Animals("bending_lag", 0.0, 0.0, "eels on land", "Gillis 1998", True),
    Animals("tail_amplitude", 0.15, 0.16, "eels", "D'Aout and Aerts 1999; Gillis 1998", True),
    Animals("tail_amplitude", 0.2, 0.26, "newts", "two laboratories' kinematics", True),
    Animals("froude_efficiency", 0.6, 0.9, "fish, elongated-body theory", "Lighthill 1960", True),
    Animals("limb_duty_factor", 0.77, 0.77, "newts on land", "Ashley-Ross et al. 2009", True),
    Animals("limb_duty_factor", 0.41, 0.41, "newts under water", "Ashley-Ross et al. 2009", True),
    Animals("limb_duty_factor", 0.5, 1.0, "walking animals", "Alexander and Jayes 1983", True),
    Animals("froude_number", 0.0, 0.5, "walking animals", "Alexander and Jayes 1983", True),
    Animals("recovery", 0.4, 0.7, "walking animals", "Cavagna et al. 1977", True),
    Animals("recovery", 0.0, 0.2, "running and hopping animals", "Cavagna et al. 1977", True),
    Animals("tripod_strength", 0.5, 1.0, "running insects", "Wosnitza et al. 2013", True),
)


def animals_of(key: str) -> tuple[Animals, ...]:
    """Return the ranges of a quantity, or () without one.

    Args:
        key: key of the quantity.
    """
    return tuple(each for each in ANIMALS if each.key == key)
