"""Fields of MuJoCo's compiled model that a creature has no words for, and what becomes of them.

| table | what becomes of a field |
|---|---|
| `NEUTRAL` | any other value than this one is refused |
| `REFUSED_COUNTS` | any element of this kind is refused |
| `OPTIONS_LEFT_OUT` | any other value than these is left out, by name |

All other fields are read, or do not change how the animal moves. A test decides on every field of
the installed MuJoCo, so a new one is noticed. Fields that older versions lack are skipped.
"""

from typing import NamedTuple

import numpy as np

from evo_cpg.exchange.compiled import TOLERANCE, Compiled


class Neutral(NamedTuple):
    """A field that a creature has no words for.

    Attributes:
        kind: of the elements that have it; ``dof`` for degrees of freedom of joints.
        word: the attribute in MJCF.
        values: the only ones that are allowed.
    """

    kind: str
    word: str
    values: float | tuple[float, ...] = 0.0


# MuJoCo's defaults of how soft constraints are. Our limits and contacts have rules of their own.
_SOLREF, _SOLIMP = (0.02, 1.0), (0.9, 0.95, 0.001, 0.5, 2.0)

NEUTRAL = {
    "body_mocapid": Neutral("body", "mocap", -1.0),
    "jnt_margin": Neutral("joint", "margin"),
    "jnt_solref": Neutral("joint", "solreflimit", _SOLREF),
    "jnt_solimp": Neutral("joint", "solimplimit", _SOLIMP),
    "jnt_actgravcomp": Neutral("joint", "actuatorgravcomp"),
    "jnt_stiffnesspoly": Neutral("joint", "stiffness polynomial"),
    "jnt_springyield": Neutral("joint", "springyield"),
    "jnt_plasticadr": Neutral("joint", "plastic state", -1.0),
    "dof_frictionloss": Neutral("dof", "frictionloss"),
    "dof_dampingpoly": Neutral("dof", "damping polynomial"),
    "geom_margin": Neutral("geom", "margin"),
    "geom_gap": Neutral("geom", "gap"),
    "geom_solref": Neutral("geom", "solref", _SOLREF),
    "geom_solimp": Neutral("geom", "solimp", _SOLIMP),
    "geom_solmix": Neutral("geom", "solmix", 1.0),
    "geom_priority": Neutral("geom", "priority"),
    "geom_condim": Neutral("geom", "condim", 3.0),
    "geom_adhesion": Neutral("geom", "adhesion"),
    "geom_surfacevel": Neutral("geom", "surfacevel"),
    "actuator_delay": Neutral("actuator", "delay"),
    "actuator_damping": Neutral("actuator", "damping"),
    "actuator_dampingpoly": Neutral("actuator", "damping polynomial"),
    "actuator_armature": Neutral("actuator", "armature"),
}

# A contact pair that does no more than keep two bodies apart.
PLAIN_PAIR: dict[str, float | tuple[float, ...]] = {
    "pair_solref": _SOLREF,
    "pair_solimp": _SOLIMP,
    "pair_margin": 0.0,
    "pair_gap": 0.0,
    "pair_adhesion": 0.0,
}

# Counts of elements that no creature has, and what they are called.
REFUSED_COUNTS = {
    "neq": "equality",
    "ntendon": "tendon",
    "nflex": "flex",
    "nplugin": "plugin",
}

# Flags of the option element that have to be as they are by default. Older versions of MuJoCo have
# "passive" for springs and dampers.
ENABLED_FLAGS = ("constraint", "passive", "spring", "damper", "limit", "actuation")
DISABLED_FLAGS = ("override", "sleep", "diagexact", "ipc", "speculative")

# Fields of the option element that belong to the world, and values of them that need no word.
OPTIONS_LEFT_OUT: dict[str, tuple[float, ...]] = {
    "gravity": (0.0, 0.0, 0.0),
    "density": (0.0,),
    "viscosity": (0.0,),
    "wind": (0.0, 0.0, 0.0),
    # Euler and implicitfast, which our own export chooses.
    "integrator": (0.0, 3.0),
    "cone": (0.0,),
    "impratio": (1.0,),
    "noslip_iterations": (0.0,),
}


def refuse_fields(compiled: Compiled) -> None:
    """Refuse the elements of the creature with a property that no creature has."""
    model = compiled.model
    for field, (kind, word, values) in NEUTRAL.items():
        found = getattr(model, field, None)
        if found is None or not len(found):
            continue
        wrong = ~np.isclose(found, values, rtol=TOLERANCE, atol=0)
        for owner, number, place in compiled.owners(kind, wrong.reshape(len(wrong), -1).any(1)):
            if np.any(values) and np.min(values) >= 0:
                problem, allowed = (
                    f"its {word} is {_text(np.ravel(found[place]))}",
                    _text(np.ravel(values)),
                )
            else:
                problem, allowed = f"it has {word}", f"no {word}"
            compiled.refuse(owner, number, problem, allowed)


def refuse_elements(compiled: Compiled) -> None:
    """Refuse elements and flags that no creature has."""
    for count, kind in REFUSED_COUNTS.items():
        for number in range(int(getattr(compiled.model, count, 0))):
            compiled.refuse(kind, number, "no creature has such a thing", f"no {kind}")
    for flag in ENABLED_FLAGS:
        if compiled.disabled(flag):
            compiled.refuse_as(f"flag {flag!r}", "it is disabled; allowed: enable")
    for flag in DISABLED_FLAGS:
        if compiled.enabled(flag):
            compiled.refuse_as(f"flag {flag!r}", "it is enabled; allowed: disable")


def left_out_options(compiled: Compiled) -> list[str]:
    """Names of options of the world that differ from those that need no word."""
    found = []
    for name, allowed in OPTIONS_LEFT_OUT.items():
        value = np.ravel(getattr(compiled.model.opt, name, allowed))
        usual = value.tolist() == list(allowed) if len(value) > 1 else value[0] in allowed
        if not usual:
            found.append(name)
    return found


def _text(values: np.ndarray) -> str:
    return " ".join(f"{value:g}" for value in values)
