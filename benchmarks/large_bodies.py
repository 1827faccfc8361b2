"""Creatures of any number of bodies: walkers and chains on flat ground, as configurations."""

from typing import Any

# Distances along the trunk, m: between two pairs of legs, and from an outer pair to the end of the
# trunk, less the trunk's radius.
_BETWEEN_LEGS, _ENDS = 0.1, 0.03
_TRUNK_RADIUS = 0.05
# Radius and cylinder length of the capsules of a leg's upper and lower body, m.
_FEMUR, _TIBIA = (0.015, 0.12), (0.012, 0.18)
_MUSCLE = {"gain": 3, "torque_limit": 20}


def walker(legs: int, shape: str) -> dict[str, Any]:
    """Return a walker: a trunk, and legs of two bodies and three joint axes.

    Args:
        legs: number of legs, even. The number of bodies is 2 * legs + 1.
        shape: shape of all bodies, "capsule" or "box".
    """
    pairs = legs // 2
    length = _BETWEEN_LEGS * (pairs - 1) + 2 * (_ENDS + _TRUNK_RADIUS)
    trunk = (
        {"type": "box", "size": [length, 0.14, 0.06]}
        if shape == "box"
        else {"type": "capsule", "radius": _TRUNK_RADIUS, "length": length}
    )
    bodies: list[dict[str, Any]] = [{"name": "trunk", "shape": trunk, "material": "shell"}]
    for pair in range(pairs):
        place = round((pair - (pairs - 1) / 2) * _BETWEEN_LEGS, 4)
        femur = {
            "parent": "trunk",
            "at": [place, 0.07, 0],
            "child_at": [-0.07, 0, 0],
            "rotation_deg": [0, -20, 90],
            "axes": ["-z", "-y"],
            "limits_deg": [[-35, 35], [-30, 30]],
            "actuator": _MUSCLE,
        }
        tibia = {
            "parent": f"{{side}}_femur{pair}",
            "at": [0.07, 0, 0],
            "child_at": [-0.1, 0, 0],
            "rotation_deg": [0, 95, 0],
            "axes": ["-y"],
            "limits_deg": [-40, 40],
            "actuator": _MUSCLE,
        }
        bodies.append(_limb(f"{{side}}_femur{pair}", shape, _FEMUR, femur) | {"mirror": "y"})
        bodies.append(_limb(f"{{side}}_tibia{pair}", shape, _TIBIA, tibia))
    shell = {"density": 500, "static_friction": 0.9, "dynamic_friction": 0.8}
    config = _on_ground(f"walker_{legs}_{shape}", bodies, {"shell": shell}, hidden=4)
    # The brain is small without sensors, so that the figures measure the physics.
    config["creature"]["pressure_sensors"] = []
    config["simulation"] = {"substeps": 4}
    return config


def chain(bodies: int) -> dict[str, Any]:
    """Return a chain of boxes with a motor between neighbours.

    Args:
        bodies: number of boxes.
    """
    box = {"shape": {"type": "box", "size": [0.1, 0.05, 0.05]}, "material": "flesh"}
    joint = {
        "parent": "head",
        "at": [-0.055, 0, 0],
        "child_at": [0.055, 0, 0],
        "axes": ["z"],
        "limits_deg": [-60, 60],
        "actuator": {"gain": 2},
    }
    parts = [
        {"name": "head", **box},
        {"name": "segment{i}", "repeat": bodies - 1, **box, "joint": joint},
    ]
    return _on_ground(f"chain_{bodies}", parts, {"flesh": {"density": 1000}}, hidden=2)


def _limb(
    name: str, shape: str, size: tuple[float, float], joint: dict[str, Any]
) -> dict[str, Any]:
    radius, length = size
    thick = 2 * radius
    found = (
        {"type": "box", "size": [length + thick, thick, thick]}
        if shape == "box"
        else {"type": "capsule", "radius": radius, "length": length}
    )
    return {"name": name, "shape": found, "material": "shell", "joint": joint}


def _on_ground(
    name: str, bodies: list[dict[str, Any]], materials: dict[str, Any], hidden: int
) -> dict[str, Any]:
    return {
        "name": name,
        "creature": {"name": name, "materials": materials, "bodies": bodies},
        "world": {"water": None, "ground": {}},
        "controller": {"type": "brain_cpg", "brain": {"hidden": [hidden]}},
        "task": {"type": "distance"},
        "evolution": {"generations": 2, "population": 32, "elites": 2},
    }
