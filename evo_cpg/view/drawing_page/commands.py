"""Edits by name with checked arguments, and edits of the world and of single values."""

import functools
import inspect
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, get_type_hints

from pydantic import create_model

from evo_cpg.creature.creature import CreatureError
from evo_cpg.io.errors import KeyProblem
from evo_cpg.io.schema.section import Section
from evo_cpg.io.wording import checked
from evo_cpg.view.drawing_page import blocks, joints, parts, shapes
from evo_cpg.view.drawing_page.document import Data, Edit, EditError
from evo_cpg.view.drawing_page.lookup import tidy

_WATER: Data = {"density": 1000}
# Contact of a new ground, as in the walkers that come with the program.
_GROUND: Data = {"restitution": 0.2, "static_friction": 0.9, "dynamic_friction": 0.8}


# Parameters that the program gives.
_OWN = ("data", "source")


def set_water(data: Data, on: bool, surface: float | None = None) -> None:
    """Fill the world with water, up to a surface (None: everywhere), or remove the water."""
    if not isinstance(data.get("world"), dict):
        data["world"] = {}
    world = data["world"]
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
    if not isinstance(data.get("world"), dict):
        data["world"] = {}
    world = data["world"]
    if not on:
        world["ground"] = None
    elif not isinstance(world.get("ground"), dict):
        world["ground"] = dict(_GROUND)


def set_value(data: Data, key: list[str | int], value: Any) -> None:
    """Set the value of a key, whose parts are names of sections and numbers of entries.

    Sections above the key are created if they are missing.
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


def _above(data: Data, key: list[str | int], create: bool) -> Any:
    if not key:
        raise EditError("a value needs a key")
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
            raise EditError(f"{'.'.join(map(str, key))}: there is no {part}")
    last = key[-1]
    inside = isinstance(place, list) and isinstance(last, int) and 0 <= last < len(place)
    if not (isinstance(place, dict) or inside):
        raise EditError(f"{'.'.join(map(str, key))}: there is no {last}")
    return place


COMMANDS: Mapping[str, Callable[..., Any]] = {
    each.__name__: each
    for each in (
        parts.add_part,
        shapes.add_shape,
        shapes.remove_shape,
        parts.remove_part,
        parts.rename_part,
        shapes.set_shape,
        joints.set_joint,
        joints.set_axes,
        shapes.resize,
        shapes.stretch,
        shapes.add_section,
        shapes.remove_section,
        shapes.move_section,
        shapes.scale_section,
        joints.shift,
        joints.turn,
        blocks.mirror,
        blocks.repeat,
        blocks.radial,
        blocks.separate,
        parts.add_eye,
        parts.add_depth_gauge,
        parts.remove_sensor,
        parts.set_pressure,
        set_water,
        set_ground,
        set_value,
        unset_value,
    )
}


def edit(command: str, source: Path, given: Mapping[str, Any]) -> Edit:
    """Return an edit of a document, by the name of its command and its arguments.

    Raises:
        EditError: there is no such command, or an argument is missing, unknown or of a wrong
            type. The edit raises it if it is not possible.
    """
    function = COMMANDS.get(command)
    if function is None:
        raise EditError(f"there is no command {command!r}. Commands: {', '.join(COMMANDS)}")
    known = checked_arguments(command, function, given)
    if "source" in inspect.signature(function).parameters:
        known["source"] = source

    def apply(data: Data) -> None:
        try:
            function(data, **known)
        except EditError:
            raise
        except KeyProblem as error:
            # The creature is wrong at another place, which `problems` reports, too.
            raise EditError(
                f"first mend {'.'.join(map(str, error.key))}: {error.problem}"
            ) from None
        except CreatureError as error:
            raise EditError(f"first mend the creature: {error}") from None
        except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
            raise EditError(f"{command} is not possible here ({error})") from None

    return apply


def checked_arguments(
    name: str, function: Callable[..., Any], given: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the arguments of a function, converted to its types, with defaults.

    Raises:
        EditError: an argument is missing, unknown or of a wrong type.
    """
    try:
        return dict(checked(_model(function), dict(given)))
    except KeyProblem as error:
        raise EditError(f"{name}: {error}") from None


@functools.cache
def _model(function: Callable[..., Any]) -> type[Section]:
    types = get_type_hints(function, include_extras=True)
    fields: dict[str, Any] = {}
    for name, parameter in inspect.signature(function).parameters.items():
        if name not in _OWN and name != "self":
            required = parameter.default is parameter.empty
            fields[name] = (types[name], ... if required else parameter.default)
    return create_model(function.__name__, __base__=Section, **fields)
