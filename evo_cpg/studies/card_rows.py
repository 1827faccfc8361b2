"""Rows of the report card: swimmers, nerves and muscles, and walkers."""

from functools import partial

from evo_cpg.studies import card_measures as m
from evo_cpg.studies.card import Question, Row, Rule, rule

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
_AT_BEST = partial(m.at_best, best="froude_efficiency", over="b")
_SLOPE_AT_BEST = partial(m.slope_at_best, best="froude_efficiency", over="b")
_GAZZOLA = "Gazzola, Argentina, Mahadevan 2014, Nat. Phys., secondary source"
_AMPLITUDE = "Sw takes the excursion of the tail from side to side"
_TUNED = "the eel was tuned by hand for this number"
_WAKE = "the power is that of the muscles: our water has no wake"


def _gazzola(
    animal: str, question: Question, over: tuple[str, ...], ours: str, missing: str
) -> list[Row]:
    """Return the rows of an animal's Reynolds number over its swimming number."""
    axes = "reynolds", "swimming_number", over
    laws = [
        ("exponent of Re over Sw, turbulent", "1.02", rule("exponent", 1.02),
         partial(m.slope, *axes, **m.TURBULENT), "Re above 3600. "),
        ("Re over Sw^1.02, turbulent", "0.4", rule("factor", 0.4),
         partial(m.prefactor, *axes, 1.02, **m.TURBULENT), ""),
        ("exponent of Re over Sw, laminar", "1.31", rule("exponent", 1.31),
         partial(m.slope, *axes, **m.LAMINAR), f"Re of 10 to 3600. {missing}. "),
        ("Re over Sw^1.31, laminar", "0.03", rule("factor", 0.03),
         partial(m.prefactor, *axes, 1.31, **m.LAMINAR), f"{missing}. "),
    ]  # fmt: skip
    return [
        Row(f"swimmers: {quantity}. Ours: the {animal}", figure, _GAZZOLA, own, question, measure,
            ours, f"{words}{_AMPLITUDE}", 3)
        for quantity, figure, own, measure, words in laws
    ]  # fmt: skip


EFFICIENCY = [
    Row(f"efficient swimmers: Strouhal number {_BEST}", "0.2 to 0.4",
        "Saadat et al. 2017; Eloy 2012, secondary source", Rule(0.2, 0.4), DRIVE,
        partial(_AT_BEST, "strouhal"), "7 adaptation gains", _TUNED),
    Row(f"efficient swimmers: excursion of the tail {_BEST}, body lengths",
        "0.1 to 0.3", "Saadat et al. 2017, secondary source", Rule(0.1, 0.3), DRIVE,
        partial(_AT_BEST, "tail_amplitude"), "7 adaptation gains",
        f"{_TUNED}. Ours is from side to side. We do not know which amplitude the source takes"),
    Row(f"eels and lampreys: Strouhal number {_BEST}", "0.45",
        "Borazjani and Sotiropoulos 2009, J. Exp. Biol. 212, 576, secondary source",
        rule("third", 0.45), DRIVE, partial(_AT_BEST, "strouhal"), "7 adaptation gains", _TUNED),
    Row("self-propelled models: exponent of the Strouhal number over the Reynolds number",
        "below 0", "Borazjani and Sotiropoulos 2009, J. Exp. Biol. 212, 576, secondary source",
        rule("below", 0.0), THICK, partial(m.slope, "strouhal", "reynolds", ("u",)), "3 drives"),
    *_gazzola("eel", THICK, ("u",), "3 drives", "Its body is thin, which raises its drag"),
    *_gazzola("fish", WIDE, ("u", "b"), "9 drives", "The drives were chosen for this row"),
    Row("eel: exponent of power over speed", "1.48",
        "Tytell 2004, J. Exp. Biol., secondary source", rule("exponent", 1.48), DRIVE,
        partial(_SLOPE_AT_BEST, "power", "path_speed"),
        "over 7 adaptation gains at their best efficiency", _WAKE),
]  # fmt: skip

SHAPE = [
    Row(f"eel: excursion of the tail from side to side {_BEST}, body lengths",
        "0.15", "D'Aout and Aerts 1999, J. Exp. Biol., secondary source", rule("third", 0.15),
        DRIVE, partial(_AT_BEST, "tail_amplitude"), "7 adaptation gains", _TUNED),
    Row("eel in water: displacement lags bending, percent of a cycle",
        "10 to 15", "Gillis 1998, J. Exp. Biol., secondary source", Rule(10.0, 15.0), DRIVE,
        partial(_AT_BEST, "bending_lag", scale=100.0), "7 adaptation gains", "", 1),
    Row("eel in water: displacement lags bending, percent of a cycle. Ours: slow, wide beats",
        "10 to 15", "Gillis 1998, J. Exp. Biol., secondary source", Rule(10.0, 15.0), SLOW,
        partial(m.each, "bending_lag", scale=100.0), "9 drives",
        "the drives were chosen for this row", 1),
    Row("eel in water: exponent of stride length over speed",
        "0", "Gillis 1998, J. Exp. Biol., secondary source", rule("exponent", 0.0), DRIVE,
        partial(_SLOPE_AT_BEST, "stride_length", "path_speed"),
        "over 7 adaptation gains at their best efficiency",
        "feedback sets the frequency, so ours changes its speed by its amplitude"),
    Row("44 species: part of the amplitude's variance along the body that a quadratic explains",
        "near 1", "data beside Di Santo et al. 2021, secondary source", rule("above", 0.9), DRIVE,
        partial(_AT_BEST, "envelope_fit"), "7 adaptation gains",
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

VISCOSITY = [
    Row(f"{animal}, water 10 times as viscous: {quantity}, percent", f"{percent:+g}", _LAMPREY,
        rule("points", percent), SYRUP,
        partial(m.where, partial(m.change, key, "viscosity", 1.0, 10.0), feedback=felt),
        "3 drives", "" if felt else "ours without feedback stands beside the source's model", 0)
    for animal, felt, percents in (
        ("lamprey", 1.0, (-44, -4, 7)),
        ("model without feedback", 0.0, (-52, -39, 31)),
    )
    for quantity, key, percent in zip(
        ("speed", "excursion of the tail", "curvature"),
        ("path_speed", "tail_excursion", "curvature"), percents, strict=True,
    )
]  # fmt: skip

SENSES = [
    Row("model of a salamander: frequency with feedback over without",
        "above 1", _PAZZAGLIA, rule("above", 1.0), FELT,
        partial(m.ratio, "stride_frequency", "feedback", 0.0, 1.0), "3 drives", "ours is the eel"),
    Row("model of a salamander: lag along the body with feedback over without",
        "below 1", _PAZZAGLIA, rule("below", 1.0), FELT,
        partial(m.ratio, "lag", "feedback", 0.0, 1.0), "3 drives", "ours is the eel"),
    Row("eel, cord cut at mid-body: speed that is left with feedback, percent",
        "it swims on", _YASUI, rule("above", 70.0), PARTED,
        partial(m.where, partial(m.ratio, "path_speed", "cut", "none", "middle1", scale=100.0),
                feedback=1.0),
        "3 adaptation gains", "the source's figure was not seen. The limit of 70 % is ours", 0),
    Row("eel, cord cut at mid-body: cycles until the lag across the cut returns, with feedback",
        "it returns", _YASUI, rule("below", 5.0), PARTED,
        partial(m.where, partial(m.cycles_to_return, "middle1.z", _INTACT, _CUT), feedback=1.0),
        "3 adaptation gains", "the cut is made at the start. The limit of 5 cycles is ours", 0),
    Row("model without feedback, cord cut: cycles until the lag returns",
        "never", _YASUI, rule("above", 20.0), PARTED,
        partial(m.where, partial(m.cycles_to_return, "middle1.z", _INTACT, _CUT), feedback=0.0),
        "3 adaptation gains", "a lag that never returns counts as the whole trial", 0),
]  # fmt: skip

MUSCLES = [
    Row("leech: speed of the wave of muscle activity over that of bending",
        "2 to 3", _LEECH, Rule(2.0, 3.0), FELT, m.outrunning, "9 settings", "ours is the eel"),
    Row("leech: speed of the wave of muscle activity over that of bending. "
        "Ours: neighbours couple nearly alike",
        "2 to 3", _LEECH, Rule(2.0, 3.0), EVEN, m.outrunning, "9 settings",
        "the couplings were chosen for this row"),
    Row("mackerel and saithe: speed of the wave of activity, body lengths a cycle",
        "1.5 to 1.6", _MACKEREL, Rule(1.5, 1.6), FELT, m.activity_speed, "9 settings",
        "ours is the eel, which has a shorter wave"),
    Row("mackerel and saithe: part of the cycle with activity in front, percent",
        "41 to 47", _MACKEREL, Rule(41.0, 47.0), FELT, partial(m.burst, 0.25), "9 settings",
        "ours is activity above 10 % of the largest", 0),
    Row("mackerel and saithe: part of the cycle with activity behind, percent",
        "25 to 27", _MACKEREL, Rule(25.0, 27.0), FELT, partial(m.burst, 0.85), "9 settings",
        "ours is activity above 10 % of the largest", 0),
    Row("salamander: growth of the lead of activity on bending from front to tail, cycles",
        "above 0", "Frolich and Biewener 1992, J. Exp. Biol. 162, 107", rule("above", 0.0), FELT,
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
        "0.63", _NEWT, rule("third", 0.63), WALK, partial(m.each, "speed", scale=1 / 0.72), _SEEDS,
        "our animal is 1.1 m long"),
    Row("newt on land: duty factor", "0.77", _NEWT, rule("third", 0.77), WALK,
        partial(m.each, "limb_duty_factor"), _SEEDS),
    Row("salamander in water: travelling index of its wave",
        "travels", _SALAMANDER, rule("above", 0.6), SWIM, partial(m.each, "travelling_index"),
        "9 settings", "the source has no index. The limit is ours"),
    Row("salamander on land: travelling index of its wave",
        "stands", _SALAMANDER, rule("below", 0.3), WALK, partial(m.each, "travelling_index"),
        _SEEDS, "the source has no index. The limit is half of the one in water"),
    Row("eel in water: displacement lags bending, percent of a cycle. Ours: the salamander",
        "10 to 15", _EEL, Rule(10.0, 15.0), SWIM, partial(m.each, "bending_lag", scale=100.0),
        "9 settings", "", 1),
    Row("eel on land: displacement lags bending, percent of a cycle, without sign. "
        "Ours: the salamander",
        "0", _EEL, rule("below", 3.0), WALK,
        partial(m.size, partial(m.each, "bending_lag", scale=100.0)), _SEEDS,
        "the trunk of ours sways against its bending, half a cycle apart", 1),
    Row("land animals: metabolic cost over allometry. Ours: the salamander",
        "1", _COST, rule("factor", 1.0), WALK, m.cost_over_allometry, _SEEDS,
        "ours is mechanical work over an efficiency of 0.25"),
    Row("land animals: metabolic cost over allometry. Ours: the hexapod",
        "1", _COST, rule("factor", 1.0), INSECT, m.cost_over_allometry, _SEEDS,
        "ours is mechanical work over an efficiency of 0.25"),
]  # fmt: skip
