"""Materials, the ground and pairs of bodies that touch, from the contact rules of MJCF.

| in MJCF | becomes |
|---|---|
| the most level ``plane`` of the world below the root that the animal can touch | the ground |
| first friction of two ``geom``s or of their ``pair``, ``priority``, ``condim`` 1 | friction |
| ``contype``, ``conaffinity``, ``exclude``, ``pair``, flag ``contact`` | ``self_collision`` |

MuJoCo takes the friction of the pair, otherwise of the geom of higher priority, otherwise the
larger one. The import writes materials and a rule with which each shape has this friction on the
ground. Softness, margins and the other friction coefficients are left out, because our contacts
have laws of their own.
"""

import itertools
from collections.abc import Mapping, Sequence
from operator import itemgetter
from typing import Any

import numpy as np

from evo_cpg.creature.creature import Material
from evo_cpg.io.models.compiled import TOLERANCE, Compiled, tidy
from evo_cpg.io.models.mjcf_fields import SLIDING
from evo_cpg.io.models.mjcf_shapes import Placed
from evo_cpg.physics.contact.contact_model import Combination, combine

# Colour of a geom without one.
_GREY = (0.5, 0.5, 0.5, 1.0)

# Upward component of the normal of the steepest floor. Steeper planes are walls.
_STEEPEST = 0.5

# Rules of friction in the order in which they are tried. MuJoCo's comes first, then our default.
_RULES: tuple[Combination, ...] = ("max", "geometric", "multiply", "average", "min")


def read_ground(
    compiled: Compiled, placed: Sequence[Placed], fixed: Sequence[int]
) -> tuple[dict[str, Any] | None, list[int], dict[int, float]]:
    """Return the ground's keys, or None, fixed geoms beside it, and materials' frictions, by geom.

    ``fixed`` are MuJoCo's numbers of the geoms around the animal.
    """
    model = compiled.model
    own = [solid.geom for body in placed for solid in body.solids]
    frictions = {g: tidy(float(model.geom_friction[g, 0])) for g in own}
    planes = [g for g in fixed if int(model.geom_type[g]) == compiled.mujoco.mjtGeom.mjGEOM_PLANE]
    touched = [g for g in planes if any(_friction(compiled, g, other) is not None for other in own)]
    # The ground is the most level plane below the root, the highest of equally level ones.
    floors = []
    for plane in touched:
        normal, point = _level(compiled, plane)
        if normal[2] > _STEEPEST:
            arm = placed[0].centre - point
            height = float(point[2] - normal[:2] @ arm[:2] / normal[2])
            below = float(normal @ arm) >= 0
            floors.append((below, round(float(normal[2]), 9), height, plane))
    geom = max(floors, key=itemgetter(0, 1, 2))[-1] if floors else None
    if geom is None or compiled.disabled("contact", "constraint"):
        return None, list(fixed), frictions
    required = {g: _friction(compiled, geom, g) for g in own}
    above = [str(compiled.item("geom", g)) for g, value in required.items() if value is None]
    if above:
        compiled.refusals.leave_out("passage through the ground", *above)
    given = {g: value for g, value in required.items() if value is not None}
    # A pair may have another friction in each of two directions, of which the first one counts.
    pairs = [_pair(compiled, geom, g) for g in given]
    for pair in (pair for pair in pairs if pair is not None):
        first, second = model.pair_friction[pair, :2]
        if first != second and model.pair_dim[pair] > 1:
            words = f"its friction, {first:g} and {second:g} in two directions, becomes {first:g}"
            compiled.refusals.change(str(compiled.item("pair", pair)), words)
    rule, friction, materials = _friction_keys(
        frictions, tidy(float(model.geom_friction[geom, 0])), given
    )
    keys: dict[str, Any] = {
        "restitution": 0.0,
        "static_friction": friction,
        "dynamic_friction": friction,
        "friction_rule": rule,
    }
    normal, point = _level(compiled, geom)
    floor: dict[str, float] = {}
    height, slope = float(normal @ point / normal[2]), float(np.hypot(normal[0], normal[1]))
    if tidy(height) and abs(height) > 1e-12:
        floor["height"] = tidy(height)
    if slope > 1e-9:
        floor["slope_deg"] = tidy(float(np.rad2deg(np.arctan2(slope, normal[2]))))
        floor["downhill_deg"] = tidy(float(np.rad2deg(np.arctan2(normal[1], normal[0]))))
    if floor:
        keys["floor"] = {"type": "plane", **floor}
    if model.geom_condim[geom] > SLIDING:
        compiled.refusals.leave_out("condim above 3", str(compiled.item("geom", geom)))
    for other in touched:
        if other != geom:
            lean = np.rad2deg(np.arccos(np.clip(_level(compiled, other)[0][2], -1, 1)))
            item = compiled.item("geom", other)
            compiled.refusals.leave_out(f"{item} (a second plane, tilted by {lean:.3g} degrees)")
    return keys, [g for g in fixed if g not in touched], materials


def _level(compiled: Compiled, geom: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the normal of a plane and a point on it."""
    normal = np.array(compiled.data.geom_xmat[geom]).reshape(3, 3)[:, 2]
    return normal, np.array(compiled.data.geom_xpos[geom])


def _friction_keys(
    own: Mapping[int, float], floor: float, required: Mapping[int, float]
) -> tuple[Combination, float, dict[int, float]]:
    """Return the rule, the ground's friction, and the materials' frictions, by geom.

    ``own`` is the friction of each geom, and ``required`` the friction that it has on the ground.
    """
    for rule in _RULES:
        found = [float(combine(rule, own[g], floor)) for g in required]
        if np.allclose(found, list(required.values()), rtol=TOLERANCE, atol=0):
            return rule, floor, dict(own)
    # No rule describes all geoms, so each material gets the friction of its geom on the ground.
    floor = min(floor, *required.values())
    changed = {g: value for g, value in required.items() if max(own[g], floor) != value}
    return "max", floor, {**own, **changed}


def read_self_collision(compiled: Compiled, placed: Sequence[Placed]) -> Any:
    """Return which bodies touch: False, True, or keys of exceptions.

    Bodies touch with all their shapes if any of the shapes touch.
    """
    if compiled.disabled("contact", "constraint"):
        return False
    meeting, rubs, apart, added = False, False, [], []
    partners: dict[str, int] = {body.name: 0 for body in placed if body.solids}
    for first, second in itertools.combinations(placed, 2):
        pairs = [(a.geom, b.geom) for a in first.solids for b in second.solids]
        frictions = [_friction(compiled, *pair) for pair in pairs]
        joined = first.rigid.lead == second.rigid.parent or second.rigid.lead == first.rigid.parent
        if joined and all(_pair(compiled, *pair) is None for pair in pairs):
            # Neighbours touch only if a pair names them. In MuJoCo a fixed root and its neighbours
            # may touch without a pair, and this contact is lost.
            fixed = first.rigid.parent is None and not (first.rigid.free or first.rigid.joints)
            if fixed and not compiled.urdf and any(x is not None for x in frictions):
                compiled.refusals.leave_out(f"contact of {second.name!r} with the fixed root")
            frictions = [None] * len(pairs)
        found = [friction for friction in frictions if friction is not None]
        names = [first.name, second.name]
        meeting, rubs = meeting or bool(found), rubs or any(found)
        if 0 < len(found) < len(frictions):
            compiled.refusals.leave_out(
                f"that not all shapes of {names[0]!r} and {names[1]!r} meet"
            )
        if joined:
            added += [names] if found else []
        elif frictions:
            apart += [] if found else [names]
            for name in names:
                partners[name] += 1
    # A URDF holds no friction, so nothing of the file is lost with MuJoCo's default.
    if rubs and not compiled.urdf:
        compiled.refusals.leave_out("friction between bodies of the animal")
    if not meeting:
        return False
    # The word all stands for every body that is no neighbour.
    alone = [
        name
        for name, count in partners.items()
        if sum(name in pair for pair in apart) == count and count > 1
    ]
    others = [pair for pair in apart if not set(pair) & set(alone)]
    keys = {"exclude": [*([name, "all"] for name in alone), *others], "include": added}
    return {name: pairs for name, pairs in keys.items() if pairs} or True


def read_material(friction: float, density: float) -> dict[str, float]:
    """Return the keys of a material, without those at their defaults."""
    given = {"density": tidy(density), "static_friction": friction, "dynamic_friction": friction}
    usual = Material(0.0)
    return {
        name: value
        for name, value in given.items()
        if name == "density" or value != getattr(usual, name)
    }


def read_color(compiled: Compiled, geom: int) -> str | None:
    """Return the colour of a geom, or None for MuJoCo's grey."""
    model = compiled.model
    rgba = model.geom_rgba[geom]
    material = int(model.geom_matid[geom])
    if material >= 0 and np.allclose(rgba, _GREY):
        rgba = model.mat_rgba[material]
    if np.allclose(rgba, _GREY):
        return None
    return "#" + "".join(f"{round(255 * float(value)):02x}" for value in np.clip(rgba[:3], 0, 1))


def _friction(compiled: Compiled, first: int, second: int) -> float | None:
    """Return the friction of two geoms, as in MuJoCo, or None if they do not touch."""
    model, pair = compiled.model, _pair(compiled, first, second)
    if pair is not None:
        return tidy(float(model.pair_friction[pair, 0])) if model.pair_dim[pair] > 1 else 0.0
    bodies = model.geom_bodyid[[first, second]]
    signatures = [(int(a) << 16) + int(b) for a, b in (bodies, bodies[::-1])]
    by_type = (
        model.geom_contype[first] & model.geom_conaffinity[second]
        or model.geom_contype[second] & model.geom_conaffinity[first]
    )
    if not by_type or np.isin(signatures, model.exclude_signature).any():
        return None
    priorities = model.geom_priority[[first, second]]
    counting = [g for g in (first, second) if model.geom_priority[g] == priorities.max()]
    if model.geom_condim[counting].max() == 1:
        return 0.0
    return tidy(float(model.geom_friction[counting, 0].max()))


def _pair(compiled: Compiled, first: int, second: int) -> int | None:
    """Return the ``pair`` that names two geoms, or None."""
    model = compiled.model
    found = np.zeros(model.npair, bool)
    for a, b in ((first, second), (second, first)):
        found |= (model.pair_geom1 == a) & (model.pair_geom2 == b)
    return int(found.argmax()) if found.any() else None
