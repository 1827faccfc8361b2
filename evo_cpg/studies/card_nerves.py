"""Rows of the report card: muscles, feedback, and cuts of the spinal cord."""

from evo_cpg.studies import card_measures as m
from evo_cpg.studies.card import Question, Row, above, below, points, within

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
]

SENSES = [
    Row(
        "model of a salamander: frequency with feedback over without",
        "above 1",
        _PAZZAGLIA,
        above(1.0),
        FELT,
        m.ratio("stride_frequency", "feedback", 0.0, 1.0),
        "3 drives",
        "ours is the eel",
    ),
    Row(
        "model of a salamander: lag along the body with feedback over without",
        "below 1",
        _PAZZAGLIA,
        below(1.0),
        FELT,
        m.ratio("lag", "feedback", 0.0, 1.0),
        "3 drives",
        "ours is the eel",
    ),
    Row(
        "eel, cord cut at mid-body: speed that is left with feedback, percent",
        "it swims on",
        _YASUI,
        above(70.0),
        PARTED,
        m.where(m.ratio("path_speed", "cut", "none", "middle1", 100.0), feedback=1.0),
        "3 adaptation gains",
        "the source's figure was not seen. The limit of 70 % is ours",
        0,
    ),
    Row(
        "eel, cord cut at mid-body: cycles until the lag across the cut returns, with feedback",
        "it returns",
        _YASUI,
        below(5.0),
        PARTED,
        m.where(m.cycles_to_return("middle1.z", _INTACT, _CUT), feedback=1.0),
        "3 adaptation gains",
        "the cut is made at the start. The limit of 5 cycles is ours",
        0,
    ),
    Row(
        "model without feedback, cord cut: cycles until the lag returns",
        "never",
        _YASUI,
        above(20.0),
        PARTED,
        m.where(m.cycles_to_return("middle1.z", _INTACT, _CUT), feedback=0.0),
        "3 adaptation gains",
        "a lag that never returns counts as the whole trial",
        0,
    ),
]

MUSCLES = [
    Row(
        "leech: speed of the wave of muscle activity over that of bending",
        "2 to 3",
        _LEECH,
        within(2.0, 3.0),
        FELT,
        m.outrunning,
        "9 settings",
        "ours is the eel",
    ),
    Row(
        "leech: speed of the wave of muscle activity over that of bending. "
        "Ours: neighbours couple nearly alike",
        "2 to 3",
        _LEECH,
        within(2.0, 3.0),
        EVEN,
        m.outrunning,
        "9 settings",
        "the couplings were chosen for this row",
    ),
    Row(
        "mackerel and saithe: speed of the wave of activity, body lengths a cycle",
        "1.5 to 1.6",
        _MACKEREL,
        within(1.5, 1.6),
        FELT,
        m.activity_speed,
        "9 settings",
        "ours is the eel, which has a shorter wave",
    ),
    Row(
        "mackerel and saithe: part of the cycle with activity in front, percent",
        "41 to 47",
        _MACKEREL,
        within(41.0, 47.0),
        FELT,
        m.burst(0.25),
        "9 settings",
        "ours is activity above 10 % of the largest",
        0,
    ),
    Row(
        "mackerel and saithe: part of the cycle with activity behind, percent",
        "25 to 27",
        _MACKEREL,
        within(25.0, 27.0),
        FELT,
        m.burst(0.85),
        "9 settings",
        "ours is activity above 10 % of the largest",
        0,
    ),
    Row(
        "salamander: growth of the lead of activity on bending from front to tail, cycles",
        "above 0",
        "Frolich and Biewener 1992, J. Exp. Biol. 162, 107",
        above(0.0),
        FELT,
        m.lead_grows,
        "9 settings",
        "ours is the eel",
        3,
    ),
]
