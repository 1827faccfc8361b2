"""Cost of transport of animals of a mass, and Reynolds number of swimmers, as scaling laws.

Animals' figures are metabolic: the chemical energy of the whole animal. Mechanical work costs four
to five times as much, because muscles have an efficiency of 0.2 to 0.25.

| motion | formula | unit | source |
|---|---|---|---|
| running at speed v | 10.7 M^-0.316 + 6.03 M^-0.303 / v | J/(kg m) | Taylor et al. 1982 |
| running, least | 10.7 M^-0.316 | J/(kg m) | Taylor et al. 1982 |
| swimming, fish | 1.1 M^-0.38 with M in grams | J/(N m) | secondary source |
| swimming, salmon | 2.15 M^-0.25 | J/(kg m) | secondary source |

| swimmers, laminar | Re = 0.03 Sw^1.31 | | Gazzola et al. 2014, secondary source |
| swimmers, turbulent | Re = 0.4 Sw^1.02 | | Gazzola et al. 2014, secondary source |

M is in kg, except where the table says grams. The exponents of running are from secondary sources,
too. Divided by the standard gravity, J/(kg m) becomes the cost of transport without a unit.
"""

import numpy as np

from evo_cpg.analysis.ratio import Values

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
    """Return the metabolic cost of transport of fish, no unit: by two formulas, the lower first.

    Args:
        mass: mass, kg.
    """
    fish = 1.1 * np.power(np.multiply(1000.0, mass), -0.38)
    salmon = 2.15 * np.power(mass, -0.25) / _GRAVITY
    return np.minimum(fish, salmon), np.maximum(fish, salmon)


def reynolds_of_swimmers(swimming_number: Values) -> Values:
    """Return the Reynolds number of swimmers from larvae to whales with a swimming number.

    It is the smaller of the two laws. They meet near Sw = 7500 and Re = 3600.

    Args:
        swimming_number: Sw = w A L / nu, with A from side to side (`swimming.swimming_number`).
    """
    laminar = 0.03 * np.power(swimming_number, 1.31)
    return np.minimum(laminar, 0.4 * np.power(swimming_number, 1.02))
