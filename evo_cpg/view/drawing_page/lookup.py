"""Parts of a creature in raw data: entries, their copies, and their places at rest."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from evo_cpg.creature.creature import WORLD, Creature, neutral_pose
from evo_cpg.io.errors import KeyProblem
from evo_cpg.io.load import complete_config
from evo_cpg.io.schema.copies import Copy, Entry, MirrorAxis, copies, reflected
from evo_cpg.io.schema.creature import CreatureConfig
from evo_cpg.view.drawing_page.document import Data, EditError

# Number of digits to which the tool writes numbers.
_DIGITS = 5


class Posed(NamedTuple):
    """A creature at rest.

    Attributes:
        config: its checked section.
        creature: the creature.
        copies: the bodies that its entries stand for. The fields below are in their order.
        origins: origins ``(bodies, 3)`` of the bodies' frames in the configuration, m.
        rotations: rotation matrices ``(bodies, 3, 3)`` from body axes to the root's axes.
    """

    config: CreatureConfig
    creature: Creature
    copies: list[Copy]
    origins: Float[np.ndarray, "b 3"]
    rotations: Float[np.ndarray, "b 3 3"]

    def index(self, name: str) -> int:
        """Return the index of a body, or of the first body of an entry.

        Raises:
            EditError: there is no such part.
        """
        entries = [entry.name for entry in self.config.bodies]
        for i, each in enumerate(self.copies):
            if name in (each.name, entries[each.entry]):
                return i
        raise EditError(f"there is no part {name!r}")


def posed(data: Data, source: Path) -> Posed:
    """Return the creature of some data at rest, whatever the other sections contain.

    Args:
        data: data of a document.
        source: file of the document, to whose folder mesh files are relative.

    Raises:
        KeyProblem: the creature is wrong.
    """
    # All other sections have defaults.
    config = complete_config({"name": "x", "creature": data.get("creature")}, source).creature
    creature = config.build()
    centres, rotations = map(np.asarray, neutral_pose(creature))
    everything = config.copies()
    found = [creature.body_index(each.name) for each in everything]
    shapes = [config.bodies[each.entry].shape for each in everything]
    shifts = [
        np.zeros(3)
        if shape is None
        else (shape.mirrored(each.mirror) if each.mirror else shape).build()[0][1]
        for shape, each in zip(shapes, everything, strict=True)
    ]
    turns = rotations[found]
    origins = centres[found] - np.einsum("bij,bj->bi", turns, np.array(shifts))
    return Posed(config, creature, everything, origins, turns)


def bodies(data: Data) -> list[Data]:
    """Return the entries of the creature's bodies.

    Raises:
        EditError: the data have none.
    """
    creature = data.get("creature")
    found = creature.get("bodies") if isinstance(creature, dict) else None
    if not isinstance(found, list) or not all(isinstance(each, dict) for each in found):
        raise EditError("creature.bodies: must be a list of bodies")
    return found


def parent_of(entry: Data) -> str | None:
    """Return the name of the parent of an entry, or None for the root."""
    joint = entry.get("joint")
    parent = joint.get("parent") if isinstance(joint, dict) else None
    return None if parent == WORLD else parent


def all_copies(data: Data) -> list[Copy]:
    """Return all bodies that the entries stand for."""
    entries = [
        Entry(
            str(each.get("name")),
            parent_of(each),
            each.get("repeat", 1),
            each.get("radial", 1),
            each.get("mirror"),
        )
        for each in bodies(data)
    ]
    try:
        return copies(entries)
    except (KeyProblem, TypeError, ValueError) as error:
        raise EditError(str(error)) from None


def entry_index(data: Data, name: str) -> int:
    """Return the index of the entry with a name, or of the entry that a body is a copy of.

    Raises:
        EditError: there is no such part.
    """
    for i, entry in enumerate(bodies(data)):
        if entry.get("name") == name:
            return i
    for each in all_copies(data):
        if each.name == name:
            return each.entry
    raise EditError(f"there is no part {name!r}")


def entry_of(data: Data, name: str) -> Data:
    """Return the entry of a part, see `entry_index`."""
    return bodies(data)[entry_index(data, name)]


def joint_of(data: Data, name: str) -> Data:
    """Return the joint of a part.

    Raises:
        EditError: there is no such part, or it has no joint.
    """
    joint = entry_of(data, name).get("joint")
    if not isinstance(joint, dict):
        raise EditError(f"{name} is the root, which has no joint")
    return joint


def limb_of(data: Data, index: int) -> list[int]:
    """Return the indices of an entry and of all entries that it carries."""
    found, everything = [index], all_copies(data)
    while True:
        names = {each.name for each in everything if each.entry in found}
        carried = {each.entry for each in everything if each.parent in names}
        if carried <= set(found):
            return found
        found += sorted(carried - set(found))


def free_name(data: Data, proposed: str) -> str:
    """Return a name that no part has: the proposed one, or with a number."""
    taken = {each.name for each in all_copies(data)} | {str(x.get("name")) for x in bodies(data)}
    number, name = 2, proposed
    while name in taken:
        name, number = f"{proposed}{number}", number + 1
    return name


def tidy(values: Any) -> Any:
    """Return numbers with five digits, relative to the largest of them, and 2 in place of 2.0."""
    array = np.asarray(values, float)
    largest = np.abs(array).max(initial=0.0)
    if not np.isfinite(largest):
        raise EditError("numbers must be finite")
    digits = _DIGITS - 1 - int(np.floor(np.log10(largest))) if largest > 0 else 0
    rounded = np.round(array, digits)

    def plain(x: Any) -> Any:
        return [plain(each) for each in x] if isinstance(x, list) else int(x) if x == int(x) else x

    return plain(rounded.tolist())


def reflected_if(place: Sequence[float] | np.ndarray, axis: MirrorAxis | None) -> np.ndarray:
    """Return a position or direction as written in the entry of a body that may be mirrored."""
    x, y, z = map(float, place)
    return np.array(reflected((x, y, z), axis) if axis else (x, y, z))
