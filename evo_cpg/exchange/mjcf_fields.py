"""Every field of MuJoCo's compiled model: whether it is read, refused, left out or no matter.

A test walks all fields of the installed MuJoCo, so that none is dropped without a decision. Fields
that older versions do not have are skipped.

| table | what becomes of a field |
|---|---|
| `READ` | part of the creature, or of what is left out by name |
| `NEUTRAL` | any other value than this one is refused |
| `REFUSED_COUNTS` | any element of this kind is refused |
| `NO_MATTER` | it does not change how the animal moves, for the reason that stands there |
"""

from typing import NamedTuple

import numpy as np

from evo_cpg.exchange.compiled import TOLERANCE, WORLD, Compiled


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

# Flags without a part in the motion of what a creature can have, and why.
FLAGS_OF_NO_MATTER = {
    "equality": "no creature has equalities",
    "frictionloss": "no creature has dry friction in its joints",
    "sensor": "sensors are left out by name",
    "warmstart": "where the solver begins",
    "refsafe": "a bound for softness, which is MuJoCo's default",
    "midphase": "how contacts are found",
    "nativeccd": "how contacts are found",
    "multiccd": "how contacts are found",
    "eulerdamp": "how MuJoCo integrates",
    "autoreset": "after it diverged",
    "island": "how the solver works",
    "energy": "a reading",
    "fwdinv": "a reading",
    "invdiscrete": "inverse dynamics",
}
# Flags that `mjcf_import` takes account of, or leaves out by name.
FLAGS_READ = ("gravity", "clampctrl", "contact", "filterparent")

# Fields of the option element, and why they do not matter. The others are in `OPTIONS_LEFT_OUT`.
OPTIONS_OF_NO_MATTER = {
    "timestep": "the step is that of simulation",
    "iterations": "how exactly MuJoCo solves",
    "tolerance": "how exactly MuJoCo solves",
    "ls_iterations": "how exactly MuJoCo solves",
    "ls_tolerance": "how exactly MuJoCo solves",
    "noslip_tolerance": "how exactly MuJoCo solves",
    "ccd_iterations": "how exactly contacts are found",
    "ccd_tolerance": "how exactly contacts are found",
    "sdf_initpoints": "how exactly contacts are found",
    "sdf_iterations": "how exactly contacts are found",
    "solver": "how MuJoCo solves",
    "jacobian": "how MuJoCo stores",
    "magnetic": "for sensors alone",
    "sleep_tolerance": "the flag sleep is refused",
    "o_margin": "the flag override is refused",
    "o_solref": "the flag override is refused",
    "o_solimp": "the flag override is refused",
    "o_friction": "the flag override is refused",
    "disableflags": "flag by flag",
    "enableflags": "flag by flag",
    "disableactuator": "actuator by actuator",
}
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

# Beginnings of the names of fields that are read, and how they go on.
# fmt: off
READ = {
    "": (
        "opt", "names", "qpos0", "qpos_spring", "nbody", "njnt", "ngeom", "nu", "npair",
        "nexclude", "nlight", "ncam", "nsite", "nsensor", "nskin", "nkey"
    ),
    "body_": (
        "parentid", "rootid", "pos", "quat", "gravcomp", "mass", "ipos", "iquat", "inertia",
        "jntnum", "jntadr", "geomnum", "geomadr"
    ),
    "jnt_": (
        "type", "pos", "axis", "range", "limited", "stiffness", "qposadr", "dofadr", "bodyid",
        "actfrclimited", "actfrcrange"
    ),
    "dof_": (
        "damping", "armature", "jntid"
    ),
    "geom_": (
        "bodyid", "type", "size", "pos", "quat", "friction", "rgba", "dataid", "contype",
        "conaffinity"
    ),
    "mesh_": (
        "vert", "vertadr", "vertnum", "face", "faceadr", "facenum"
    ),
    "actuator_": (
        "trnid", "trntype", "dyntype", "gaintype", "gainprm", "biastype", "biasprm", "gear",
        "forcelimited", "forcerange", "ctrllimited", "ctrlrange", "group"
    ),
    "pair_": (
        "geom1", "geom2", "dim", "solref", "solimp", "margin", "gap", "adhesion"
    ),
}
# fmt: on

# Fields, or beginnings of their names with a "*", and why they do not matter.
NO_MATTER = {
    # Made of others by the compiler.
    "n*": "a size; what it counts has fields of its own",
    "B_*": "how MuJoCo stores matrices",
    "D_*": "how MuJoCo stores matrices",
    "M_*": "how MuJoCo stores matrices",
    "map*": "how MuJoCo stores matrices",
    "efm*": "how MuJoCo stores matrices",
    "bvh_*": "how contacts are found",
    "oct_*": "how contacts are found",
    "name_*": "where names are stored",
    "names_map": "where names are stored",
    "path*": "where assets were found",
    "signature": "of the compiler",
    "stat": "sizes for the solver and for pictures",
    "tree_*": "what hangs together; the flag sleep is refused",
    "flg_*": "whether anything has a property that is read or refused",
    "body_bvhadr": "how contacts are found",
    "body_bvhnum": "how contacts are found",
    "body_contype": "of the geoms, whose own are read",
    "body_conaffinity": "of the geoms, whose own are read",
    "body_margin": "of the geoms, whose own is refused",
    "body_dofadr": "where numbers are stored",
    "body_dofnum": "of the joints, which are read",
    "body_invweight0": "made of masses and joints",
    "body_subtreemass": "made of masses",
    "body_sameframe": "made of places",
    "body_simple": "made of masses",
    "body_treeid": "what hangs together",
    "body_weldid": "what hangs together; a welded body is refused",
    "body_plugin": "plugins are refused",
    "jnt_actuatorid": "of the actuators, which are read",
    "dof_M0": "made of masses and joints",
    "dof_Madr": "where numbers are stored",
    "dof_bodyid": "of the joints, which are read",
    "dof_invweight0": "made of masses and joints",
    "dof_length": "made of sizes, for the flag sleep",
    "dof_parentid": "of the joints, which are read",
    "dof_simplenum": "made of masses",
    "dof_treeid": "what hangs together",
    "dof_solref": "of friction loss, which is refused",
    "dof_solimp": "of friction loss, which is refused",
    "geom_aabb": "made of sizes",
    "geom_rbound": "made of sizes",
    "geom_sameframe": "made of places",
    "geom_fluid": "only in a fluid, which is left out by name",
    "geom_plugin": "plugins are refused",
    "actuator_acc0": "made of masses and gears",
    "actuator_length0": "made of gears",
    "actuator_lengthrange": "of muscles, whose law is refused",
    "actuator_actadr": "of activations, which a servo without dynamics has not",
    "actuator_actnum": "of activations, which a servo without dynamics has not",
    "actuator_actlimited": "of activations, which a servo without dynamics has not",
    "actuator_actrange": "of activations, which a servo without dynamics has not",
    "actuator_actearly": "of activations, which a servo without dynamics has not",
    "actuator_dynprm": "of activations, which a servo without dynamics has not",
    "actuator_cranklength": "of slider-cranks, which are refused",
    "actuator_ctrladr": "where numbers are stored",
    "actuator_ctrlnum": "1 where an actuator drives a hinge by its law",
    "actuator_ctrlspec": "what the control of a law that is read is called",
    "actuator_outadr": "where numbers are stored",
    "actuator_outnum": "1 where an actuator drives a hinge",
    "actuator_history": "of a delay, which is refused",
    "actuator_historyadr": "of a delay, which is refused",
    "actuator_plugin": "plugins are refused",
    "mesh_*": "vertices and faces, which are read, in other forms",
    # Without a part in the motion.
    "vis": "pictures",
    "*_user": "data of the user's own",
    "*_group": "what is shown",
    "geom_matid": "pictures",
    "geom_castshadow": "pictures",
    "mat_*": "pictures",
    "tex_*": "pictures",
    "light_*": "lights are left out by name",
    "cam_*": "cameras are left out by name",
    "site_*": "sites are left out by name; what drives one is refused",
    "sensor_*": "sensors are left out by name",
    "skin_*": "skins are left out by name",
    "key_*": "keyframes are left out by name",
    "numeric_*": "data of the user's own",
    "text_*": "data of the user's own",
    "tuple_*": "data of the user's own",
    # Of what is refused or left out as a whole.
    "hfield_*": "of the ground, whose geoms are left out by name, or a shape that is refused",
    "pair_friction": "of a pair that is left out by name",
    "pair_solreffriction": "of a pair that is left out by name",
    "pair_signature": "of a pair that is left out by name",
    "exclude_*": "which bodies touch is left out by name",
    "eq_*": "equalities are refused",
    "ten_*": "tendons are refused",
    "tendon_*": "tendons are refused",
    "wrap_*": "tendons are refused",
    "flex*": "flexes are refused",
    "plugin*": "plugins are refused",
}


def treatment(field: str) -> str | None:
    """What becomes of a field of the compiled model; None where nobody decided.

    Args:
        field: as MuJoCo calls it.
    """
    for start, ends in READ.items():
        if field.startswith(start) and field.removeprefix(start) in ends:
            return "read"
    if field in NEUTRAL or field in REFUSED_COUNTS:
        return "refused"
    for pattern, reason in NO_MATTER.items():
        start, star, end = pattern.partition("*")
        if field == pattern or (star and field.startswith(start) and field.endswith(end)):
            return reason
    return None


def refuse_fields(compiled: Compiled) -> None:
    """Refuse the elements of the creature with a property that no creature has."""
    model = compiled.model
    for field, (kind, word, values) in NEUTRAL.items():
        found = getattr(model, field, None)
        if found is None or not len(found):
            continue
        wrong = ~np.isclose(found, values, rtol=TOLERANCE, atol=0)
        for number in np.flatnonzero(wrong.reshape(len(wrong), -1).any(1)).tolist():
            if kind == "geom" and model.geom_bodyid[number] == WORLD:
                continue
            owner = ("joint", int(model.dof_jntid[number])) if kind == "dof" else (kind, number)
            if np.any(values) and np.min(values) >= 0:
                problem, allowed = (
                    f"its {word} is {_text(np.ravel(found[number]))}",
                    _text(np.ravel(values)),
                )
            else:
                problem, allowed = f"it has {word}", f"no {word}"
            compiled.refuse(*owner, problem, allowed)


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
