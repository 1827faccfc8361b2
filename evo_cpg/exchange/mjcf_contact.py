"""Materials, the ground and pairs of bodies that touch, from the contact rules of MJCF.

| in MJCF | becomes |
|---|---|
| first friction of a ``geom`` | static and dynamic friction |
| ``plane`` of the world that the animal can touch | the ground |
| ``contype``, ``conaffinity``, ``exclude``, ``pair``, flag ``contact`` | ``self_collision`` |

Softness, margins and the other friction coefficients are left out: our contacts have laws of their
own. MuJoCo takes the larger friction of two geoms, and so does the ground that is written here.
"""

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np

from evo_cpg.creature.creature import Material
from evo_cpg.exchange.compiled import Compiled, tidy
from evo_cpg.exchange.mjcf_shapes import Placed

# Colour of a geom without one.
_GREY = (0.5, 0.5, 0.5, 1.0)


def touches_nothing(compiled: Compiled) -> bool:
    """Return whether flags switch all contacts off."""
    return compiled.disabled("contact", "constraint")


def read_ground(
    compiled: Compiled, placed: Sequence[Placed], fixed: Sequence[int]
) -> tuple[dict[str, Any] | None, list[int]]:
    """Return the keys of the ground, or None, and the fixed geoms that are not part of it.

    Args:
        compiled: the model.
        placed: bodies of the animal.
        fixed: MuJoCo's numbers of the geoms around the animal.
    """
    model = compiled.model
    own = [solid.geom for body in placed for solid in body.solids]
    planes = [g for g in fixed if int(model.geom_type[g]) == compiled.mujoco.mjtGeom.mjGEOM_PLANE]
    floors = []
    for geom in planes:
        normal = np.array(compiled.data.geom_xmat[geom]).reshape(3, 3)[:, 2]
        if normal[2] > 0.5 and any(_meet(compiled, geom, other) for other in own):
            floors.append((geom, normal))
    if not floors or touches_nothing(compiled):
        return None, list(fixed)
    geom, normal = max(floors, key=lambda floor: float(compiled.data.geom_xpos[floor[0], 2]))
    friction = tidy(float(model.geom_friction[geom, 0]))
    keys: dict[str, Any] = {
        "restitution": 0.0,
        "static_friction": friction,
        "dynamic_friction": friction,
        "friction_rule": "max",
    }
    floor: dict[str, Any] = {}
    height = float(normal @ compiled.data.geom_xpos[geom] / normal[2])
    if tidy(height) and abs(height) > 1e-12:
        floor["height"] = tidy(height)
    slope = float(np.hypot(normal[0], normal[1]))
    if slope > 1e-9:
        floor["slope_deg"] = tidy(float(np.rad2deg(np.arctan2(slope, normal[2]))))
        floor["downhill_deg"] = tidy(float(np.rad2deg(np.arctan2(normal[1], normal[0]))))
    if floor:
        keys["floor"] = {"type": "plane", **floor}
    above = [str(compiled.item("geom", g)) for g in own if not _meet(compiled, geom, g)]
    if above:
        compiled.refusals.leave_out("passage through the ground", *above)
    return keys, [g for g in fixed if g != geom]


def read_self_collision(compiled: Compiled, placed: Sequence[Placed]) -> Any:
    """Return which bodies touch: False, True, or keys of exceptions.

    Bodies touch with all their shapes if any of the shapes touch.
    """
    if touches_nothing(compiled):
        return False
    meeting, apart, added = False, [], []
    partners: dict[str, int] = {body.name: 0 for body in placed if body.solids}
    for first, second in itertools.combinations(placed, 2):
        pairs = [(a.geom, b.geom) for a in first.solids for b in second.solids]
        paired = any(_paired(compiled, *pair) for pair in pairs)
        by_type = any(_meet(compiled, *pair) for pair in pairs)
        meet = paired or (by_type and not _excluded(compiled, first, second))
        joined = first.rigid.lead == second.rigid.parent or second.rigid.lead == first.rigid.parent
        names = [first.name, second.name]
        meeting = meeting or paired or (meet and not joined)
        if joined and paired:
            added.append(names)
        if pairs and not joined:
            apart += [] if meet else [names]
            for name in names:
                partners[name] += 1
    if not meeting:
        return False
    keys = {"exclude": _shortened(apart, partners), "include": added}
    return {name: pairs for name, pairs in keys.items() if pairs} or True


def read_material(compiled: Compiled, geom: int, density: float) -> dict[str, float]:
    """Return the keys of the material of a geom, without those at their defaults."""
    friction = tidy(float(compiled.model.geom_friction[geom, 0]))
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


def _meet(compiled: Compiled, first: int, second: int) -> bool:
    """Return whether two geoms touch by their types, or as a pair."""
    model = compiled.model
    by_type = (
        model.geom_contype[first] & model.geom_conaffinity[second]
        or model.geom_contype[second] & model.geom_conaffinity[first]
    )
    return bool(by_type) or _paired(compiled, first, second)


def _paired(compiled: Compiled, first: int, second: int) -> bool:
    model = compiled.model
    pairs = zip(model.pair_geom1, model.pair_geom2, strict=True)
    return any({int(a), int(b)} == {first, second} for a, b in pairs)


def _excluded(compiled: Compiled, first: Placed, second: Placed) -> bool:
    """Return whether an ``exclude`` names the two bodies."""
    for signature in compiled.model.exclude_signature:
        bodies = int(signature) >> 16, int(signature) & 0xFFFF
        for a, b in (bodies, bodies[::-1]):
            if a in first.rigid.members and b in second.rigid.members:
                return True
    return False


def _shortened(pairs: list[list[str]], partners: dict[str, int]) -> list[list[str]]:
    """Return pairs, with ``all`` for a body that is apart from every body that is no neighbour.

    Args:
        pairs: pairs of names.
        partners: number of other bodies that are no neighbours, by name.
    """
    alone = [
        name
        for name, count in partners.items()
        if sum(name in pair for pair in pairs) == count and count > 1
    ]
    others = [pair for pair in pairs if not set(pair) & set(alone)]
    return [[name, "all"] for name in alone] + others
