"""Numbers of a walker, from contacts, speeds and energies. The formulas take numbers or arrays.

| word | meaning | source |
|---|---|---|
| Froude number | v^2 / (g h), with the hip height h | Alexander and Jayes 1983 |
| recovery | energy saved by exchange in the centre of mass / energy | Cavagna et al. 1977 |
| tripod strength | time of joint swing / time of any swing in a tripod | Wosnitza et al. 2013 |
| relative slip | slip of the feet / speed of the animal | |

Duty factors and touch-downs are in `evo_cpg.analysis.footfalls`, slip in
`evo_cpg.simulation.measures`, the stride length and the cost of transport in
`evo_cpg.analysis.stride`.
"""

import numpy as np
from jaxtyping import Bool, Float

from evo_cpg.analysis.ratio import Values, ratio

# Number of legs of an animal with tripods.
SIX = 6


def froude_number(speed: Values, gravity: Values, hip_height: Values) -> Values:
    """Return Fr = v^2 / (g h), no unit (Alexander and Jayes 1983).

    Animals walk below about 0.5 and run above. Some papers write v / sqrt(g h), which is the root.

    Args:
        speed: v, m/s.
        gravity: g, m/s^2.
        hip_height: h, mean height of the hips above the ground, m.

    Returns:
        Froude number, NaN without gravity or with hips on the ground.
    """
    return ratio(np.square(speed), np.multiply(gravity, hip_height))


def recovery(
    forward: Float[np.ndarray, "t *n"], vertical: Float[np.ndarray, "t *n"]
) -> Float[np.ndarray, " *n"]:
    """Return the recovery R = 1 - W / (W_f + W_v) (Cavagna, Heglund and Taylor 1977).

    Each W is the sum of the positive steps of an energy of the centre of mass: W_f of ``forward``,
    W_v of ``vertical``, W of their sum. Two equal sinusoids that are shifted by d have
    R = 1 - |cos(d / 2)|: 1 for 180 degrees (a pendulum), 0 for 0 (a bounce).

    Args:
        forward: kinetic energy of the forward motion, J, in whole strides.
        vertical: potential energy plus kinetic energy of the vertical motion, J.

    Returns:
        Recovery from 0 to 1, NaN if neither energy changes.
    """
    total, *apart = (
        np.maximum(np.diff(energy, axis=0), 0.0).sum(0)
        for energy in (forward + vertical, forward, vertical)
    )
    spent = apart[0] + apart[1]
    return np.where(spent > 0, 1.0 - total / np.where(spent > 0, spent, 1.0), np.nan)


def tripod_strength(touched: Bool[np.ndarray, "t 6 *n"]) -> Float[np.ndarray, " *n"]:
    """Return the tripod strength, mean of both tripods: 1 if their legs swing together.

    A tripod is L1, R2, L3 or R1, L2, R3. Its strength is the time in which all three legs swing,
    over the time in which any of them swings. Swings of the length s that follow each other by d
    have (s - 2 d) / (s + 2 d).

    Args:
        touched: whether each leg touches the ground in each sample. The order is L1, L2, L3, R1,
            R2, R3, from front to back.

    Returns:
        Strength from 0 to 1, NaN if a tripod never swings.
    """
    swings = ~touched
    each = []
    for legs in ([0, 4, 2], [3, 1, 5]):
        together = swings[:, legs].all(1).sum(0)
        any_of_them = swings[:, legs].any(1).sum(0)
        each.append(np.where(any_of_them > 0, together / np.maximum(any_of_them, 1), np.nan))
    return np.mean(each, axis=0)


def relative_slip(slip_speed: Values, speed: Values) -> Values:
    """Return the slip of the feet over the animal's speed, no unit.

    Args:
        slip_speed: slip speed of the feet, m/s (`evo_cpg.simulation.measures`).
        speed: speed of the animal, m/s. The result is NaN for 0.
    """
    return ratio(slip_speed, speed)
