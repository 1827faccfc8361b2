"""Tables of all fields of MuJoCo's compiled model, by their treatment in the import.

| table | a field is |
|---|---|
| `READ`, `READ_LIMITS` | part of a creature, and must hold numbers |
| `COMPUTED` | computed by MuJoCo from others, and read |
| `REFUSED` | refused, unless it has this value, because it changes the motion |
| `LEFT_OUT` | left out, by name, unless it has this value: softness and rules of contacts |
| `COUNTS` | a number of elements that are left out, by name |
| `OPTIONS_LEFT_OUT` | an option that is left out, by name |

All other fields do not affect the animal's motion, or hold the addresses of other fields. A test
covers every field of the installed MuJoCo, so a new field is noticed. Fields that older versions
lack are skipped. The page "Bring your own model" prints these tables.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from evo_cpg.io.models.compiled import TOLERANCE, Compiled, Item


class Source(NamedTuple):
    """A field that is read.

    Attributes:
        kind: kind of the elements with the field, ``dof`` for degrees of freedom of joints.
        word: the attribute in MJCF.
        key: place of the value in a configuration, for the docs.
    """

    kind: str
    word: str
    key: str


READ = {
    "body_pos": Source("body", "pos", "`joint.at`, `joint.child_at`"),
    "body_quat": Source("body", "quat, euler, axisangle, xyaxes, zaxis", "`joint.rotation_deg`"),
    "body_gravcomp": Source("body", "gravcomp", "buoyancy or gravity, if equal for all bodies"),
    "geom_pos": Source("geom", "pos, fromto", "origin of the body's frame, or `at` of a part"),
    "geom_quat": Source(
        "geom", "quat, euler, ...", "axes of the body, or `rotation_deg` of a part"
    ),
    "geom_size": Source("geom", "size", "`shape`"),
    "geom_friction": Source(
        "geom", "friction (first number)", "`static_friction`, `dynamic_friction`"
    ),
    "geom_rgba": Source("geom", "rgba, material", "`color`"),
    "geom_condim": Source("geom", "condim (1)", "friction of 0 on the ground"),
    "geom_priority": Source("geom", "priority", "whose friction counts on the ground"),
    "pair_friction": Source("pair", "friction (first number)", "friction on the ground"),
    "pair_dim": Source("pair", "condim (1)", "friction of 0 on the ground"),
    "jnt_pos": Source("joint", "pos", "`joint.child_at`, or `at` of an axis"),
    "jnt_axis": Source("joint", "axis", "`joint.axes`"),
    "jnt_range": Source("joint", "range, ref", "`limits_deg`, or `limits_m` of a slide"),
    "jnt_stiffness": Source("joint", "stiffness", "`joint.stiffness`"),
    "qpos_spring": Source("joint", "springref", "`joint.rest_deg`, or `rest_m` of a slide"),
    "dof_damping": Source("dof", "damping", "`joint.damping`"),
    "dof_armature": Source("dof", "armature", "`joint.armature`"),
    "dof_frictionloss": Source("dof", "frictionloss", "`joint.friction_loss`"),
    "actuator_gear": Source("actuator", "gear", "`actuator.gear`, `gain`, `stiffness`"),
    "actuator_gainprm": Source("actuator", "kp, gain, gainprm", "`actuator`"),
    "actuator_biasprm": Source("actuator", "kp, kv, bias, biasprm", "`actuator`"),
    "tendon_stiffness": Source("tendon", "stiffness", "`tendons.stiffness`"),
    "tendon_damping": Source("tendon", "damping", "`tendons.damping`"),
    "tendon_armature": Source("tendon", "armature", "`tendons.armature`"),
    "tendon_frictionloss": Source("tendon", "frictionloss", "`tendons.friction_loss`"),
    "tendon_range": Source("tendon", "range", "`tendons.limits`"),
    "tendon_lengthspring": Source("tendon", "springlength", "`tendons.rest`"),
    "wrap_prm": Source("wrap", "coef", "`tendons.joints`"),
}
# These values may be infinite. An infinite value limits nothing.
READ_LIMITS = {
    "jnt_actfrcrange": Source("joint", "actuatorfrcrange", "`actuator.torque_limit`"),
    "tendon_actfrcrange": Source("tendon", "actuatorfrcrange", "`actuator.torque_limit`"),
    "actuator_forcerange": Source("actuator", "forcerange", "`actuator.torque_limit`"),
    "actuator_ctrlrange": Source("actuator", "ctrlrange", "`actuator.torque_limit` of a motor"),
    "actuator_actrange": Source("actuator", "actrange", "`actuator.torque_limit` of a motor"),
}
COMPUTED = {
    "body_mass": Source("body", "mass, density", "`mass`, or density of the material"),
    "body_ipos": Source("body", "inertial pos", "`centre_of_mass`"),
    "body_iquat": Source("body", "inertial quat", "`inertia`"),
    "body_inertia": Source("body", "diaginertia, fullinertia", "`inertia`"),
}


class Neutral(NamedTuple):
    """A field with no counterpart in a creature.

    Attributes:
        kind: kind of the elements with the field, ``dof`` for degrees of freedom of joints.
        word: the attribute in MJCF.
        values: the only values without effect.
    """

    kind: str
    word: str
    values: float | tuple[float, ...] = 0.0


# MuJoCo's defaults for the softness of constraints. Our limits and contacts have rules of their
# own.
_SOLREF, _SOLIMP = (0.02, 1.0), (0.9, 0.95, 0.001, 0.5, 2.0)

# Value of condim for a contact with sliding friction only. Larger values add torsional and rolling
# friction, which are left out. The only smaller value, 1, is a contact without friction.
SLIDING = 3.0

REFUSED = {
    "jnt_actgravcomp": Neutral("joint", "actuatorgravcomp"),
    "jnt_stiffnesspoly": Neutral("joint", "stiffness polynomial"),
    "jnt_springyield": Neutral("joint", "springyield"),
    "jnt_plasticadr": Neutral("joint", "plastic state", -1.0),
    "dof_dampingpoly": Neutral("dof", "damping polynomial"),
    "actuator_delay": Neutral("actuator", "delay"),
    "actuator_damping": Neutral("actuator", "damping"),
    "actuator_dampingpoly": Neutral("actuator", "damping polynomial"),
    "actuator_armature": Neutral("actuator", "armature"),
    "tendon_stiffnesspoly": Neutral("tendon", "stiffness polynomial"),
    "tendon_dampingpoly": Neutral("tendon", "damping polynomial"),
    "tendon_springyield": Neutral("tendon", "springyield"),
    "tendon_plasticadr": Neutral("tendon", "plastic state", -1.0),
}

LEFT_OUT = {
    "jnt_margin": Neutral("joint", "margin"),
    "jnt_solref": Neutral("joint", "solreflimit", _SOLREF),
    "jnt_solimp": Neutral("joint", "solimplimit", _SOLIMP),
    "dof_solref": Neutral("dof", "solreffriction", _SOLREF),
    "dof_solimp": Neutral("dof", "solimpfriction", _SOLIMP),
    "geom_margin": Neutral("geom", "margin"),
    "geom_gap": Neutral("geom", "gap"),
    "geom_solref": Neutral("geom", "solref", _SOLREF),
    "geom_solimp": Neutral("geom", "solimp", _SOLIMP),
    "geom_solmix": Neutral("geom", "solmix", 1.0),
    "geom_condim": Neutral("geom", "condim above 3", SLIDING),
    "geom_adhesion": Neutral("geom", "adhesion"),
    "geom_surfacevel": Neutral("geom", "surfacevel"),
    "pair_margin": Neutral("pair", "margin"),
    "pair_gap": Neutral("pair", "gap"),
    "pair_solref": Neutral("pair", "solref", _SOLREF),
    "pair_solreffriction": Neutral("pair", "solreffriction"),
    "pair_solimp": Neutral("pair", "solimp", _SOLIMP),
    "pair_dim": Neutral("pair", "condim above 3", SLIDING),
    "tendon_margin": Neutral("tendon", "margin"),
    "tendon_solref_lim": Neutral("tendon", "solreflimit", _SOLREF),
    "tendon_solimp_lim": Neutral("tendon", "solimplimit", _SOLIMP),
    "tendon_solref_fri": Neutral("tendon", "solreffriction", _SOLREF),
    "tendon_solimp_fri": Neutral("tendon", "solimpfriction", _SOLIMP),
}

# Counts of elements that no creature has, and their names. All of them change the motion.
REFUSED_COUNTS = {"neq": "equality", "nflex": "flex", "nplugin": "plugin"}

# Counts of elements without a part in the motion.
COUNTS = {
    "nlight": "light",
    "ncam": "camera",
    "nsite": "site",
    "nsensor": "sensor",
    "nskin": "skin",
    "nkey": "keyframe",
}

# Flags of the option element that are honoured: they switch a part of the model off.
FLAGS = {
    "gravity": "`world.gravity: 0`",
    "limit": "joints without limits",
    "constraint": "no limits, no friction loss, no contact",
    "contact": "no ground, no self-collision",
    "frictionloss": "no `friction_loss`",
    "spring": "no `stiffness`",
    "damper": "no `damping`",
    "passive": "no `stiffness`, no `damping`",
    "actuation": "no motors",
    "equality": "equality constraints are ignored",
    "clampctrl": "`ctrlrange` is ignored",
}

# Fields of the option element that are left out, and values of them that are not reported.
OPTIONS_LEFT_OUT: dict[str, tuple[float, ...]] = {
    # Euler and implicitfast, which our own export chooses.
    "integrator": (0.0, 3.0),
    "cone": (0.0,),
    "impratio": (1.0,),
    "noslip_iterations": (0.0,),
}


def refuse_elements(compiled: Compiled) -> None:
    """Refuse elements that no creature has, and elements with a field of `REFUSED`.

    Raises:
        ExchangeError: elements hold NaN or an infinite number, so that no other check is possible.
    """
    for fields in (READ | READ_LIMITS, COMPUTED):
        for field, (kind, word, _) in fields.items():
            if kind == "wrap" or field == "qpos_spring":
                continue
            values = np.asarray(getattr(compiled.model, field, np.zeros(0)))
            limits = field in READ_LIMITS
            wrong = np.isnan(values) if limits else ~np.isfinite(values)
            allowed = "numbers" if limits else "finite numbers"
            for item, place in compiled.owners(kind, wrong):
                item.refuse(f"its {word} holds {values[place]:g}", allowed, vital=True)
        compiled.refusals.check()
    model = compiled.model
    for count, kind in REFUSED_COUNTS.items():
        for number in range(int(getattr(model, count, 0))):
            idle = compiled.disabled("equality", "constraint")
            if kind == "equality" and (idle or not model.eq_active0[number]):
                continue
            vital = kind == "flex"
            compiled.item(kind, number).refuse("a creature cannot have it", f"no {kind}", vital)
    for body in np.flatnonzero(model.body_mocapid >= 0).tolist():
        compiled.item("body", body).refuse("it is a mocap body, moved from outside", "no mocap")
    # Flags that are off by default. Older versions of MuJoCo do not know all of them.
    for flag in ("override", "sleep", "diagexact", "ipc", "speculative"):
        bit = getattr(compiled.mujoco.mjtEnableBit, f"mjENBL_{flag.upper()}", 0)
        if model.opt.enableflags & int(bit):
            compiled.refusals.leave_out(f"flag {flag}")
    # Neighbours at a joint touch here only if a pair names them.
    if compiled.disabled("filterparent"):
        compiled.refusals.leave_out("flag filterparent")
    for word, item in _unusual_fields(compiled, REFUSED):
        item.refuse(f"it has {word}", f"no {word}")


def leave_out_elements(compiled: Compiled) -> None:
    """Name fields and options with unusual values, and elements without a part in the motion."""
    for word, item in _unusual_fields(compiled, LEFT_OUT):
        compiled.refusals.leave_out(word, str(item))
    for name, allowed in OPTIONS_LEFT_OUT.items():
        value = np.ravel(getattr(compiled.model.opt, name, allowed))
        if value[0] not in allowed:
            compiled.refusals.leave_out(f"option {name}")
    for count, kind in COUNTS.items():
        if number := int(getattr(compiled.model, count, 0)):
            compiled.refusals.leave_out(f"{number} {kind}{'s' if number > 1 else ''}")


def _unusual_fields(compiled: Compiled, table: dict[str, Neutral]) -> Iterator[tuple[str, Item]]:
    """Yield the attribute and the element of each value that differs from the table's."""
    for field, (kind, word, values) in table.items():
        found = getattr(compiled.model, field, None)
        if found is None or not len(found):
            continue
        if word == "condim above 3":
            found = np.maximum(found, values)
        wrong = ~np.isclose(found, values, rtol=TOLERANCE, atol=0)
        for item, _ in compiled.owners(kind, wrong.reshape(len(wrong), -1).any(1)):
            yield word, item
