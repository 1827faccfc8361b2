"""Rows of the report card: swimmers."""

from evo_cpg.studies import card_measures as m
from evo_cpg.studies.card import (
    Question,
    Row,
    Rule,
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
# From Re 10 to that of whales. The fish beats slowly and widely, like larvae. Its pectoral fins are
# still.
THICK = Question(
    "eel",
    {"u": (0.4, 0.6, 0.8), "b": (7.0,), "viscosity": tuple(10 ** (k / 2) for k in range(-6, 8))},
    10.0,
)
WIDE = Question(
    "fish",
    {
        "u": (0.7, 0.85, 1.0),
        "b": (2.5, 3.0, 4.0),
        "viscosity": tuple(10 ** (k / 2) for k in range(-6, 1))
        + tuple(10 ** (k / 4) for k in range(3, 14)),
        "undriven": ("*_pectoral",),
    },
    8.0,
)
SLOW = Question("eel", {"u": (0.8, 0.9, 1.0), "b": (3.0, 3.25, 3.5), "feedback": (0.25,)}, 10.0)
_BEST = "at its best efficiency"
_GAZZOLA = "Gazzola, Argentina, Mahadevan 2014, Nat. Phys., secondary source"
_AMPLITUDE = "Sw takes the excursion of the tail from side to side"
_TUNED = "the eel was tuned by hand for this number"
_WAKE = "the power is that of the muscles: our water has no wake"


def _gazzola(
    animal: str, question: Question, over: tuple[str, ...], ours: str, missing: str
) -> list[Row]:
    """Return the rows of an animal's Reynolds number over its swimming number."""
    axes = "reynolds", "swimming_number", over

    def row(quantity: str, figure: str, rule: Rule, measure: m.Measure, *about: str) -> Row:
        words = ". ".join((*about, _AMPLITUDE))
        name = f"swimmers: {quantity}. Ours: the {animal}"
        return Row(name, figure, _GAZZOLA, rule, question, measure, ours, words, 3)

    return [
        row("exponent of Re over Sw, turbulent", "1.02", exponent(1.02),
            m.turbulent(m.slope, *axes), "Re above 3600"),
        row("Re over Sw^1.02, turbulent", "0.4", factor(0.4),
            m.turbulent(m.prefactor, *axes, 1.02)),
        row("exponent of Re over Sw, laminar", "1.31", exponent(1.31),
            m.laminar(m.slope, *axes), "Re of 10 to 3600", missing),
        row("Re over Sw^1.31, laminar", "0.03", factor(0.03),
            m.laminar(m.prefactor, *axes, 1.31), missing),
    ]  # fmt: skip


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
        m.slope("strouhal", "reynolds", ("u",)),
        "3 drives",
    ),
    *_gazzola("eel", THICK, ("u",), "3 drives", "Its body is thin, which raises its drag"),
    *_gazzola("fish", WIDE, ("u", "b"), "9 drives", "The drives were chosen for this row"),
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
        "eel in water: displacement lags bending, percent of a cycle. Ours: slow, wide beats",
        "10 to 15",
        "Gillis 1998, J. Exp. Biol., secondary source",
        within(10.0, 15.0),
        SLOW,
        m.each("bending_lag", 100.0),
        "9 drives",
        "the drives were chosen for this row",
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
