"""Rows of the report card: swimmers."""

from evo_cpg.studies import card_measures as m
from evo_cpg.studies.card import (
    Question,
    Row,
    above,
    below,
    exponent,
    factor,
    third,
    within,
)

# Open loop: the largest drive, and the adaptation gains of the eel's own range.
DRIVE = Question(
    "eel", {"u": (0.2, 0.4, 0.6, 0.8, 1.0), "b": (4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0)}, 10.0
)
THICK = Question(
    "eel",
    {"u": (0.4, 0.6, 0.8), "b": (7.0,), "viscosity": tuple(10 ** (k / 2) for k in range(-2, 9))},
    10.0,
)
_BEST = "at its best efficiency"
_GAZZOLA = "Gazzola, Argentina, Mahadevan 2014, Nat. Phys., secondary source"
_AMPLITUDE = "Sw takes the excursion of the tail from side to side"
_TUNED = "the eel was tuned by hand for this number"
_WAKE = "the power is that of the muscles: our water has no wake"

EFFICIENCY = [
    Row(
        f"efficient swimmers: Strouhal number {_BEST}",
        "0.2 to 0.4",
        "Saadat et al. 2017; Eloy 2012, secondary source",
        within(0.2, 0.4),
        DRIVE,
        m.at_best("strouhal", "froude_efficiency", "b"),
        "7 adaptation gains",
        _TUNED,
    ),
    Row(
        f"efficient swimmers: excursion of the tail {_BEST}, body lengths",
        "0.1 to 0.3",
        "Saadat et al. 2017, secondary source",
        within(0.1, 0.3),
        DRIVE,
        m.at_best("tail_amplitude", "froude_efficiency", "b"),
        "7 adaptation gains",
        f"{_TUNED}. Ours is from side to side. We do not know which amplitude the source takes",
    ),
    Row(
        f"eels and lampreys: Strouhal number {_BEST}",
        "0.45",
        "Borazjani and Sotiropoulos 2009, J. Exp. Biol. 212, 576, secondary source",
        third(0.45),
        DRIVE,
        m.at_best("strouhal", "froude_efficiency", "b"),
        "7 adaptation gains",
        _TUNED,
    ),
    Row(
        "self-propelled models: exponent of the Strouhal number over the Reynolds number",
        "below 0",
        "Borazjani and Sotiropoulos 2009, J. Exp. Biol. 212, 576, secondary source",
        below(0.0),
        THICK,
        m.slope("strouhal", "reynolds", "u"),
        "3 drives",
    ),
    Row(
        "swimmers: exponent of Re over Sw, turbulent",
        "1.02",
        _GAZZOLA,
        exponent(1.02),
        THICK,
        m.turbulent(m.slope, "reynolds", "swimming_number", "u"),
        "3 drives",
        f"Re above 3600. {_AMPLITUDE}",
    ),
    Row(
        "swimmers: Re over Sw^1.02, turbulent",
        "0.4",
        _GAZZOLA,
        factor(0.4),
        THICK,
        m.turbulent(m.prefactor, "reynolds", "swimming_number", "u", 1.02),
        "3 drives",
        _AMPLITUDE,
    ),
    Row(
        "swimmers: exponent of Re over Sw, laminar",
        "1.31",
        _GAZZOLA,
        exponent(1.31),
        THICK,
        m.laminar(m.slope, "reynolds", "swimming_number", "u"),
        "3 drives",
        f"Re of 10 to 3600. {_AMPLITUDE}",
    ),
    Row(
        "swimmers: Re over Sw^1.31, laminar",
        "0.03",
        _GAZZOLA,
        factor(0.03),
        THICK,
        m.laminar(m.prefactor, "reynolds", "swimming_number", "u", 1.31),
        "3 drives",
        _AMPLITUDE,
        3,
    ),
    Row(
        "eel: exponent of power over speed",
        "1.48",
        "Tytell 2004, J. Exp. Biol., secondary source",
        exponent(1.48),
        DRIVE,
        m.slope_at_best("power", "path_speed", "froude_efficiency", "b"),
        "over 7 adaptation gains at their best efficiency",
        _WAKE,
    ),
]

SHAPE = [
    Row(
        f"eel: excursion of the tail from side to side {_BEST}, body lengths",
        "0.15",
        "D'Aout and Aerts 1999, J. Exp. Biol., secondary source",
        third(0.15),
        DRIVE,
        m.at_best("tail_amplitude", "froude_efficiency", "b"),
        "7 adaptation gains",
        _TUNED,
    ),
    Row(
        "eel in water: displacement lags bending, percent of a cycle",
        "10 to 15",
        "Gillis 1998, J. Exp. Biol., secondary source",
        within(10.0, 15.0),
        DRIVE,
        m.at_best("bending_lag", "froude_efficiency", "b", 100.0),
        "7 adaptation gains",
        "",
        1,
    ),
    Row(
        "eel in water: exponent of stride length over speed",
        "0",
        "Gillis 1998, J. Exp. Biol., secondary source",
        exponent(0.0),
        DRIVE,
        m.slope_at_best("stride_length", "path_speed", "froude_efficiency", "b"),
        "over 7 adaptation gains at their best efficiency",
        "feedback sets the frequency, so ours changes its speed by its amplitude",
    ),
    Row(
        "44 species: part of the amplitude's variance along the body that a quadratic explains",
        "near 1",
        "data beside Di Santo et al. 2021, secondary source",
        above(0.9),
        DRIVE,
        m.at_best("envelope_fit", "froude_efficiency", "b"),
        "7 adaptation gains",
        "the source has no figure of the fit. The limit is ours",
        3,
    ),
]
