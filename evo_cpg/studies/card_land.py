"""Rows of the report card: the salamander in water and on land, and walkers."""

from evo_cpg.studies import card_measures as m
from evo_cpg.studies.card import Absent, Question, Row, above, below, factor, third, within

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
    Row(
        "newt on land: speed, lengths from snout to vent a second",
        "0.63",
        _NEWT,
        third(0.63),
        WALK,
        m.each("speed", 1 / 0.72),
        _SEEDS,
        "our animal is 1.1 m long",
    ),
    Row(
        "newt on land: duty factor",
        "0.77",
        _NEWT,
        third(0.77),
        WALK,
        m.each("limb_duty_factor"),
        _SEEDS,
    ),
    Row(
        "salamander in water: travelling index of its wave",
        "travels",
        _SALAMANDER,
        above(0.6),
        SWIM,
        m.each("travelling_index"),
        "9 settings",
        "the source has no index. The limit is ours",
    ),
    Row(
        "salamander on land: travelling index of its wave",
        "stands",
        _SALAMANDER,
        below(0.3),
        WALK,
        m.each("travelling_index"),
        _SEEDS,
        "the source has no index. The limit is half of the one in water",
    ),
    Row(
        "eel in water: displacement lags bending, percent of a cycle. Ours: the salamander",
        "10 to 15",
        _EEL,
        within(10.0, 15.0),
        SWIM,
        m.each("bending_lag", 100.0),
        "9 settings",
        "",
        1,
    ),
    Row(
        "eel on land: displacement lags bending, percent of a cycle, without sign. "
        "Ours: the salamander",
        "0",
        _EEL,
        below(3.0),
        WALK,
        m.size(m.each("bending_lag", 100.0)),
        _SEEDS,
        "the trunk of ours sways against its bending, half a cycle apart",
        1,
    ),
    Row(
        "land animals: metabolic cost over allometry. Ours: the salamander",
        "1",
        _COST,
        factor(1.0),
        WALK,
        m.cost_over_allometry,
        _SEEDS,
        "ours is mechanical work over an efficiency of 0.25",
    ),
    Row(
        "land animals: metabolic cost over allometry. Ours: the hexapod",
        "1",
        _COST,
        factor(1.0),
        INSECT,
        m.cost_over_allometry,
        _SEEDS,
        "ours is mechanical work over an efficiency of 0.25",
    ),
]

ABSENT = [
    Absent(
        "trout behind a cylinder",
        "tail beats at the shedding frequency, body wave 25 % faster than the flow",
        "2013, J. Exp. Biol. 216, 3442",
        "our water has currents, but no vortices",
    ),
    Absent(
        "eel: impulse of the wake",
        "twice that of elongated-body and resistive models",
        "Tytell 2004, J. Exp. Biol., secondary source",
        "our water has no wake",
    ),
    Absent(
        "eel backwards",
        "steeper frequency over speed, uniform amplitude",
        "D'Aout and Aerts 1999, J. Exp. Biol., secondary source",
        "no animal of ours swims backwards",
    ),
    Absent(
        "newt under water",
        "1.19 lengths from snout to vent a second, duty factor 0.41",
        "Ashley-Ross, Lundin, Johnson 2009, secondary source",
        "it walks on the bottom. Our salamander swims",
    ),
    Absent(
        "model of a salamander: limbs",
        "oscillators of limbs are slower than those of the body",
        "Ijspeert et al. 2007",
        "all oscillators of an animal of ours have the same time constants",
    ),
    Absent(
        "zebrafish larva",
        "up to 100 Hz, displacement 57 to 63 degrees behind curvature",
        "2004, J. Exp. Biol. 207, 853",
        "our animals are controlled 60 times a second",
    ),
    Absent(
        "robot fish",
        "speed predicted to 0.019 m/s",
        "arXiv 2602.23283",
        "its data have no licence, so the program cannot ship them",
    ),
    Absent(
        "Caenorhabditis elegans, crawling",
        "drag across over drag along: 10",
        "arXiv 1112.1118",
        "the ratio is that of the agar. Our worm swims, with a ratio of 1.5",
    ),
]
