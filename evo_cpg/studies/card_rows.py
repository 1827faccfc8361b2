"""Rows of the report card: swimmers, nerves and muscles, walkers, and figures without an answer."""

from evo_cpg.studies import card_measures as m
from evo_cpg.studies.card import (
    Absent,
    Question,
    Row,
    Rule,
    above,
    below,
    exponent,
    factor,
    points,
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
    Row(f"efficient swimmers: Strouhal number {_BEST}", "0.2 to 0.4",
        "Saadat et al. 2017; Eloy 2012, secondary source", within(0.2, 0.4), DRIVE,
        m.at_best("strouhal", "froude_efficiency", "b"), "7 adaptation gains", _TUNED),
    Row(f"efficient swimmers: excursion of the tail {_BEST}, body lengths",
        "0.1 to 0.3", "Saadat et al. 2017, secondary source", within(0.1, 0.3), DRIVE,
        m.at_best("tail_amplitude", "froude_efficiency", "b"), "7 adaptation gains",
        f"{_TUNED}. Ours is from side to side. We do not know which amplitude the source takes"),
    Row(f"eels and lampreys: Strouhal number {_BEST}", "0.45",
        "Borazjani and Sotiropoulos 2009, J. Exp. Biol. 212, 576, secondary source", third(0.45),
        DRIVE, m.at_best("strouhal", "froude_efficiency", "b"), "7 adaptation gains", _TUNED),
    Row("self-propelled models: exponent of the Strouhal number over the Reynolds number",
        "below 0", "Borazjani and Sotiropoulos 2009, J. Exp. Biol. 212, 576, secondary source",
        below(0.0), THICK, m.slope("strouhal", "reynolds", ("u",)), "3 drives"),
    *_gazzola("eel", THICK, ("u",), "3 drives", "Its body is thin, which raises its drag"),
    *_gazzola("fish", WIDE, ("u", "b"), "9 drives", "The drives were chosen for this row"),
    Row("eel: exponent of power over speed", "1.48",
        "Tytell 2004, J. Exp. Biol., secondary source", exponent(1.48), DRIVE,
        m.slope_at_best("power", "path_speed", "froude_efficiency", "b"),
        "over 7 adaptation gains at their best efficiency", _WAKE),
]  # fmt: skip

SHAPE = [
    Row(f"eel: excursion of the tail from side to side {_BEST}, body lengths",
        "0.15", "D'Aout and Aerts 1999, J. Exp. Biol., secondary source", third(0.15), DRIVE,
        m.at_best("tail_amplitude", "froude_efficiency", "b"), "7 adaptation gains", _TUNED),
    Row("eel in water: displacement lags bending, percent of a cycle",
        "10 to 15", "Gillis 1998, J. Exp. Biol., secondary source", within(10.0, 15.0), DRIVE,
        m.at_best("bending_lag", "froude_efficiency", "b", 100.0), "7 adaptation gains", "", 1),
    Row("eel in water: displacement lags bending, percent of a cycle. Ours: slow, wide beats",
        "10 to 15", "Gillis 1998, J. Exp. Biol., secondary source", within(10.0, 15.0), SLOW,
        m.each("bending_lag", 100.0), "9 drives", "the drives were chosen for this row", 1),
    Row("eel in water: exponent of stride length over speed",
        "0", "Gillis 1998, J. Exp. Biol., secondary source", exponent(0.0), DRIVE,
        m.slope_at_best("stride_length", "path_speed", "froude_efficiency", "b"),
        "over 7 adaptation gains at their best efficiency",
        "feedback sets the frequency, so ours changes its speed by its amplitude"),
    Row("44 species: part of the amplitude's variance along the body that a quadratic explains",
        "near 1", "data beside Di Santo et al. 2021, secondary source", above(0.9), DRIVE,
        m.at_best("envelope_fit", "froude_efficiency", "b"), "7 adaptation gains",
        "the source has no figure of the fit. The limit is ours", 3),
]  # fmt: skip

_U, _B = (0.4, 0.6, 0.8), (7.0,)
_INTACT, _CUT = {"cut": "none"}, {"cut": "middle1"}
SYRUP = Question("eel", {"u": _U, "b": _B, "feedback": (0.0, 1.0), "viscosity": (1.0, 10.0)}, 10.0)
FELT = Question("eel", {"u": _U, "b": _B, "feedback": (0.0, 0.5, 1.0)}, 10.0)
# Neighbours act on each other nearly alike, so the lag of the cord is small. The shipped eel has a
# weight of 0.1.
EVEN = Question(
    "eel",
    {"u": _U, "b": (6.0, 7.0, 8.0), "controller.cpg.child_weight": (0.3,), "feedback": (0.0,)},
    10.0,
)
# The cord behind the cut keeps its own drive, as in the source's model.
PARTED = Question(
    "eel",
    {
        "u": (0.5,),
        "b": (5.0, 6.0, 8.0),
        "behind": (0.5,),
        "feedback": (0.0, 1.0),
        "cut": ("none", "middle1"),
    },
    20.0,
)

_LAMPREY = "2023, J. Exp. Biol. 226, jeb245457"
_PAZZAGLIA = "Pazzaglia et al. 2025, PLoS Comput. Biol."
_YASUI = "Yasui et al. 2025, PNAS; Hamlet et al. 2023"
_LEECH = "2011, J. Exp. Biol. 214, 561"
_MACKEREL = "1995, J. Exp. Biol. 198, 1575"


def _in_viscous_water(quantity: str, key: str, felt: bool, percent: float, animal: str) -> Row:
    return Row(
        f"{animal}, water 10 times as viscous: {quantity}, percent",
        f"{percent:+g}",
        _LAMPREY,
        points(percent),
        SYRUP,
        m.where(m.change(key, "viscosity", 1.0, 10.0), feedback=float(felt)),
        "3 drives",
        "" if felt else "ours without feedback stands beside the source's model",
        0,
    )


VISCOSITY = [
    _in_viscous_water("speed", "path_speed", True, -44, "lamprey"),
    _in_viscous_water("excursion of the tail", "tail_excursion", True, -4, "lamprey"),
    _in_viscous_water("curvature", "curvature", True, 7, "lamprey"),
    _in_viscous_water("speed", "path_speed", False, -52, "model without feedback"),
    _in_viscous_water(
        "excursion of the tail", "tail_excursion", False, -39, "model without feedback"
    ),
    _in_viscous_water("curvature", "curvature", False, 31, "model without feedback"),
]  # fmt: skip

SENSES = [
    Row("model of a salamander: frequency with feedback over without",
        "above 1", _PAZZAGLIA, above(1.0), FELT, m.ratio("stride_frequency", "feedback", 0.0, 1.0),
        "3 drives", "ours is the eel"),
    Row("model of a salamander: lag along the body with feedback over without",
        "below 1", _PAZZAGLIA, below(1.0), FELT, m.ratio("lag", "feedback", 0.0, 1.0), "3 drives",
        "ours is the eel"),
    Row("eel, cord cut at mid-body: speed that is left with feedback, percent",
        "it swims on", _YASUI, above(70.0), PARTED,
        m.where(m.ratio("path_speed", "cut", "none", "middle1", 100.0), feedback=1.0),
        "3 adaptation gains", "the source's figure was not seen. The limit of 70 % is ours", 0),
    Row("eel, cord cut at mid-body: cycles until the lag across the cut returns, with feedback",
        "it returns", _YASUI, below(5.0), PARTED,
        m.where(m.cycles_to_return("middle1.z", _INTACT, _CUT), feedback=1.0),
        "3 adaptation gains", "the cut is made at the start. The limit of 5 cycles is ours", 0),
    Row("model without feedback, cord cut: cycles until the lag returns",
        "never", _YASUI, above(20.0), PARTED,
        m.where(m.cycles_to_return("middle1.z", _INTACT, _CUT), feedback=0.0),
        "3 adaptation gains", "a lag that never returns counts as the whole trial", 0),
]  # fmt: skip

MUSCLES = [
    Row("leech: speed of the wave of muscle activity over that of bending",
        "2 to 3", _LEECH, within(2.0, 3.0), FELT, m.outrunning, "9 settings", "ours is the eel"),
    Row("leech: speed of the wave of muscle activity over that of bending. "
        "Ours: neighbours couple nearly alike",
        "2 to 3", _LEECH, within(2.0, 3.0), EVEN, m.outrunning, "9 settings",
        "the couplings were chosen for this row"),
    Row("mackerel and saithe: speed of the wave of activity, body lengths a cycle",
        "1.5 to 1.6", _MACKEREL, within(1.5, 1.6), FELT, m.activity_speed, "9 settings",
        "ours is the eel, which has a shorter wave"),
    Row("mackerel and saithe: part of the cycle with activity in front, percent",
        "41 to 47", _MACKEREL, within(41.0, 47.0), FELT, m.burst(0.25), "9 settings",
        "ours is activity above 10 % of the largest", 0),
    Row("mackerel and saithe: part of the cycle with activity behind, percent",
        "25 to 27", _MACKEREL, within(25.0, 27.0), FELT, m.burst(0.85), "9 settings",
        "ours is activity above 10 % of the largest", 0),
    Row("salamander: growth of the lead of activity on bending from front to tail, cycles",
        "above 0", "Frolich and Biewener 1992, J. Exp. Biol. 162, 107", above(0.0), FELT,
        m.lead_grows, "9 settings", "ours is the eel", 3),
]  # fmt: skip

# Limbs of the salamander.
_LIMBS = "*_arm+*_hand+*_thigh+*_shin"
WALK = Question("trot", {}, 10.0)
SWIM = Question(
    "salamander_swim", {"u": (0.25, 0.5, 0.75), "b": (2.8, 4.0, 5.5), "undriven": (_LIMBS,)}, 10.0
)
INSECT = Question("tripod", {}, 10.0)
_NEWT = "Ashley-Ross, Lundin, Johnson 2009, J. Exp. Zool. A 311, 240, secondary source"
_SALAMANDER = "Frolich and Biewener 1992, J. Exp. Biol. 162, 107"
_EEL = "Gillis 1998, J. Exp. Biol., secondary source"
_COST = "Taylor, Heglund, Maloiy 1982, J. Exp. Biol., secondary source"
_SEEDS = "3 seeds"

WALKERS = [
    Row("newt on land: speed, lengths from snout to vent a second",
        "0.63", _NEWT, third(0.63), WALK, m.each("speed", 1 / 0.72), _SEEDS,
        "our animal is 1.1 m long"),
    Row("newt on land: duty factor", "0.77", _NEWT, third(0.77), WALK, m.each("limb_duty_factor"),
        _SEEDS),
    Row("salamander in water: travelling index of its wave",
        "travels", _SALAMANDER, above(0.6), SWIM, m.each("travelling_index"), "9 settings",
        "the source has no index. The limit is ours"),
    Row("salamander on land: travelling index of its wave",
        "stands", _SALAMANDER, below(0.3), WALK, m.each("travelling_index"), _SEEDS,
        "the source has no index. The limit is half of the one in water"),
    Row("eel in water: displacement lags bending, percent of a cycle. Ours: the salamander",
        "10 to 15", _EEL, within(10.0, 15.0), SWIM, m.each("bending_lag", 100.0), "9 settings", "",
        1),
    Row("eel on land: displacement lags bending, percent of a cycle, without sign. "
        "Ours: the salamander",
        "0", _EEL, below(3.0), WALK, m.size(m.each("bending_lag", 100.0)), _SEEDS,
        "the trunk of ours sways against its bending, half a cycle apart", 1),
    Row("land animals: metabolic cost over allometry. Ours: the salamander",
        "1", _COST, factor(1.0), WALK, m.cost_over_allometry, _SEEDS,
        "ours is mechanical work over an efficiency of 0.25"),
    Row("land animals: metabolic cost over allometry. Ours: the hexapod",
        "1", _COST, factor(1.0), INSECT, m.cost_over_allometry, _SEEDS,
        "ours is mechanical work over an efficiency of 0.25"),
]  # fmt: skip

ABSENT = [
    Absent("trout behind a cylinder",
           "tail beats at the shedding frequency, body wave 25 % faster than the flow",
           "2013, J. Exp. Biol. 216, 3442", "our water has currents, but no vortices"),
    Absent("eel: impulse of the wake", "twice that of elongated-body and resistive models",
           "Tytell 2004, J. Exp. Biol., secondary source", "our water has no wake"),
    Absent("eel backwards", "steeper frequency over speed, uniform amplitude",
           "D'Aout and Aerts 1999, J. Exp. Biol., secondary source",
           "no animal of ours swims backwards"),
    Absent("newt under water", "1.19 lengths from snout to vent a second, duty factor 0.41",
           "Ashley-Ross, Lundin, Johnson 2009, secondary source",
           "it walks on the bottom. Our salamander swims"),
    Absent("model of a salamander: limbs",
           "oscillators of limbs are slower than those of the body", "Ijspeert et al. 2007",
           "all oscillators of an animal of ours have the same time constants"),
    Absent("zebrafish larva", "up to 100 Hz, displacement 57 to 63 degrees behind curvature",
           "2004, J. Exp. Biol. 207, 853", "our animals are controlled 60 times a second"),
    Absent("robot fish", "speed predicted to 0.019 m/s", "arXiv 2602.23283",
           "its data have no licence, so the program cannot ship them"),
    Absent("Caenorhabditis elegans, crawling", "drag across over drag along: 10",
           "arXiv 1112.1118", "the ratio is that of the agar. Our worm swims, with a ratio of 1.5"),
]  # fmt: skip
