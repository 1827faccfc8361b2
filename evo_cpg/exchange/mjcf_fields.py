"""Tables of all fields of MuJoCo's compiled model, by their treatment in the import.

| table | a field is |
|---|---|
| `READ`, `READ_LIMITS` | part of a creature, and must hold numbers |
| `COMPUTED` | computed by MuJoCo from others, and checked or read |
| `NEUTRAL` | refused, unless it has this value |
| `REFUSED_COUNTS` | a number of elements, all of which are refused |
| `OPTIONS_LEFT_OUT`, `LEFT_OUT_COUNTS` | left out, by name |

All other fields do not affect the animal's motion, or hold the addresses of other fields. A test
covers every field of the installed MuJoCo, so a new field is noticed. Fields that older versions
lack are skipped.
"""

from typing import NamedTuple

import numpy as np

from evo_cpg.exchange.compiled import TOLERANCE, Compiled
from evo_cpg.exchange.refusals import Refusal

# Kind of elements in MJCF and their attribute, for each field of the compiled model.
READ = {
    "body_pos": ("body", "pos"),
    "body_quat": ("body", "orientation"),
    "body_gravcomp": ("body", "gravcomp"),
    "geom_pos": ("geom", "pos"),
    "geom_quat": ("geom", "orientation"),
    "geom_size": ("geom", "size"),
    "geom_friction": ("geom", "friction"),
    "geom_rgba": ("geom", "rgba"),
    "jnt_pos": ("joint", "pos"),
    "jnt_axis": ("joint", "axis"),
    "jnt_range": ("joint", "range"),
    "jnt_stiffness": ("joint", "stiffness"),
    "dof_damping": ("dof", "damping"),
    "dof_armature": ("dof", "armature"),
    "actuator_gear": ("actuator", "gear"),
    "actuator_gainprm": ("actuator", "gain"),
    "actuator_biasprm": ("actuator", "bias"),
}
# These values may be infinite. An infinite value limits nothing.
READ_LIMITS = {
    "jnt_actfrcrange": ("joint", "actuatorfrcrange"),
    "actuator_forcerange": ("actuator", "forcerange"),
    "actuator_ctrlrange": ("actuator", "ctrlrange"),
}
COMPUTED = {
    "body_mass": ("body", "mass"),
    "body_ipos": ("body", "centre of mass"),
    "body_iquat": ("body", "inertia"),
    "body_inertia": ("body", "inertia"),
}


class Neutral(NamedTuple):
    """A field with no counterpart in a creature.

    Attributes:
        kind: kind of the elements with the field, ``dof`` for degrees of freedom of joints.
        word: the attribute in MJCF.
        values: the only allowed values.
    """

    kind: str
    word: str
    values: float | tuple[float, ...] = 0.0


# MuJoCo's defaults for the softness of constraints. Our limits and contacts have rules of their
# own.
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

# Values of a contact pair that only keeps two bodies apart, by field.
PLAIN_PAIR: dict[str, float | tuple[float, ...]] = {
    "pair_solref": _SOLREF,
    "pair_solimp": _SOLIMP,
    "pair_margin": 0.0,
    "pair_gap": 0.0,
    "pair_adhesion": 0.0,
}

# Counts of elements that no creature has, and their names.
REFUSED_COUNTS = {
    "neq": "equality",
    "ntendon": "tendon",
    "nflex": "flex",
    "nplugin": "plugin",
}

# Counts of elements without a part in the motion.
LEFT_OUT_COUNTS = {
    "nlight": "light",
    "ncam": "camera",
    "nsite": "site",
    "nsensor": "sensor",
    "nskin": "skin",
    "nkey": "keyframe",
}

# Flags of the option element that must keep their defaults. Older versions of MuJoCo have "passive"
# for springs and dampers.
ENABLED_FLAGS = ("constraint", "passive", "spring", "damper", "limit", "actuation")
DISABLED_FLAGS = ("override", "sleep", "diagexact", "ipc", "speculative")

# Fields of the option element that belong to the world, and values of them that are not reported.
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


def require_numbers(compiled: Compiled) -> None:
    """Refuse elements with NaN or an infinite number, which no comparison would find.

    Raises:
        ExchangeError: such elements exist, so that no other check is possible.
    """
    for fields in (READ | READ_LIMITS, COMPUTED):
        for field, (kind, word) in fields.items():
            values = np.asarray(getattr(compiled.model, field))
            limits = field in READ_LIMITS
            wrong = np.isnan(values) if limits else ~np.isfinite(values)
            allowed = "numbers" if limits else "finite numbers"
            for item, place in compiled.owners(kind, wrong):
                item.refuse(f"its {word} holds {values[place]:g}", allowed)
        compiled.refusals.check()


def refuse_fields(compiled: Compiled) -> None:
    """Refuse elements of the animal with a field that has another value than in `NEUTRAL`."""
    model = compiled.model
    for field, (kind, word, values) in NEUTRAL.items():
        found = getattr(model, field, None)
        if found is None or not len(found):
            continue
        wrong = ~np.isclose(found, values, rtol=TOLERANCE, atol=0)
        for item, place in compiled.owners(kind, wrong.reshape(len(wrong), -1).any(1)):
            if np.any(values) and np.min(values) >= 0:
                problem = f"its {word} is {_text(np.ravel(found[place]))}"
                allowed = _text(np.ravel(values))
            else:
                problem, allowed = f"it has {word}", f"no {word}"
            item.refuse(problem, allowed)


def refuse_elements(compiled: Compiled) -> None:
    """Refuse elements and flags that no creature has."""
    for count, kind in REFUSED_COUNTS.items():
        for number in range(int(getattr(compiled.model, count, 0))):
            compiled.item(kind, number).refuse("a creature cannot have it", f"no {kind}")
    for flag in filter(compiled.disabled, ENABLED_FLAGS):
        compiled.refusals.add(Refusal(f"flag {flag!r}", "it is disabled. Allowed: enable"))
    for flag in filter(compiled.enabled, DISABLED_FLAGS):
        compiled.refusals.add(Refusal(f"flag {flag!r}", "it is enabled. Allowed: disable"))


def left_out_options(compiled: Compiled) -> list[str]:
    """Return names of the world's options that have unusual values, to be reported as left out."""
    found = []
    for name, allowed in OPTIONS_LEFT_OUT.items():
        value = np.ravel(getattr(compiled.model.opt, name, allowed))
        usual = value.tolist() == list(allowed) if len(value) > 1 else value[0] in allowed
        if not usual:
            found.append(name)
    return found


def left_out_counts(compiled: Compiled) -> list[str]:
    """Return the numbers of elements without a part in the motion, such as ``2 sites``."""
    counts = {kind: int(getattr(compiled.model, n, 0)) for n, kind in LEFT_OUT_COUNTS.items()}
    return [text for kind, number in counts.items() for text in counted(number, kind)]


def counted(number: int, kind: str) -> list[str]:
    """Return a phrase for a number of elements, or an empty list for none."""
    return [f"{number} {kind}{'s' if number > 1 else ''}"] if number else []


def _text(values: np.ndarray) -> str:
    return " ".join(f"{value:g}" for value in values)
