"""Edits of the world: water, ground, and single values anywhere in the document."""

from typing import Any

from evo_cpg.view.drawing_page.document import Data, DrawingError
from evo_cpg.view.drawing_page.lookup import tidy

_WATER: Data = {"density": 1000}
# Contact of a new ground, as in the walkers that come with the program.
_GROUND: Data = {"restitution": 0.2, "static_friction": 0.9, "dynamic_friction": 0.8}


def set_water(data: Data, on: bool, surface: float | None = None) -> None:
    """Fill the world with water, up to a surface (None: everywhere), or remove the water."""
    world = _world(data)
    if not on:
        world["water"] = None
        return
    if not isinstance(world.get("water"), dict):
        world["water"] = dict(_WATER)
    if surface is not None:
        world["water"]["surface"] = tidy(surface)
    else:
        world["water"].pop("surface", None)


def set_ground(data: Data, on: bool) -> None:
    """Put ground below the animal, or remove it."""
    world = _world(data)
    if not on:
        world["ground"] = None
    elif not isinstance(world.get("ground"), dict):
        world["ground"] = dict(_GROUND)


def set_value(data: Data, key: list[str | int], value: Any) -> None:
    """Set the value of a key, and create the sections above it.

    Args:
        data: data of the document.
        key: key with names of sections and numbers of entries.
        value: new value.
    """
    place = _above(data, key, create=True)
    if isinstance(place, list):
        place[int(key[-1])] = value
    else:
        place[key[-1]] = value


def unset_value(data: Data, key: list[str | int]) -> None:
    """Leave a key out, so that it has its default."""
    place = _above(data, key, create=False)
    if isinstance(place, dict):
        place.pop(key[-1], None)


def _world(data: Data) -> Data:
    if not isinstance(data.get("world"), dict):
        data["world"] = {}
    return data["world"]


def _above(data: Data, key: list[str | int], create: bool) -> Any:
    if not key:
        raise DrawingError("a value needs a key")
    place: Any = data
    for part in key[:-1]:
        if isinstance(place, dict):
            if create and not isinstance(place.get(part), (dict, list)):
                place[part] = {}
            place = place.get(part)
        elif isinstance(place, list) and isinstance(part, int) and 0 <= part < len(place):
            place = place[part]
        else:
            place = None
        if place is None:
            raise DrawingError(f"{'.'.join(map(str, key))}: there is no {part}")
    last = key[-1]
    inside = isinstance(place, list) and isinstance(last, int) and 0 <= last < len(place)
    if not (isinstance(place, dict) or inside):
        raise DrawingError(f"{'.'.join(map(str, key))}: there is no {last}")
    return place
