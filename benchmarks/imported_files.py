"""Import all models in folders, and compare them with an independent reading of their files.

    python -m benchmarks.imported_files FOLDER ... [--drop]

For each model of at least two moving bodies, a reader of this file adds up the masses of welded
links from the XML text alone. The import must give every body the same mass, centre of mass and
inertia (in the neutral pose), and every joint the same limits and motor. Otherwise a sentence of
the import must name the body or the joint. The command fails if a difference is not named.
"""

import argparse
import dataclasses
import os
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from html.parser import HTMLParser
from pathlib import Path
from xml.etree.ElementTree import Element, TreeBuilder

import numpy as np
from scipy.spatial.transform import Rotation

from evo_cpg.creature.creature import NO_LIMIT, WORLD, TorqueMotor, neutral_pose
from evo_cpg.io.models.mjcf_import import Imported, read_model
from evo_cpg.io.models.refusals import ExchangeError
from evo_cpg.io.schema.creature import CreatureConfig

# Largest relative difference of numbers that count as equal. They are rounded, because MuJoCo
# stores the axes of an inertia as a quaternion.
_EQUAL = 1e-9


@dataclasses.dataclass
class Part:
    """Mass properties of a body.

    Attributes:
        mass: mass, kg.
        moment: mass times the centre of mass in the world, kg m.
        inertia: inertia about the origin of the world, kg m^2.
    """

    mass: float = 0.0
    moment: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(3))
    inertia: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros((3, 3)))

    def add(self, mass: float, centre: np.ndarray, inertia: np.ndarray) -> None:
        """Add a mass with an inertia about its own centre."""
        self.mass += mass
        self.moment = self.moment + mass * centre
        self.inertia = self.inertia + inertia + mass * _steiner(centre)

    def values(self) -> tuple[float, np.ndarray, np.ndarray]:
        """Return mass, centre of mass and inertia about the centre of mass."""
        centre = self.moment / self.mass if self.mass else np.zeros(3)
        return self.mass, centre, self.inertia - self.mass * _steiner(centre)


@dataclasses.dataclass
class Reading:
    """A model, read from its file or from the result of the import.

    Attributes:
        bodies: mass properties of the moving bodies, by the name of their first link.
        joints: lower and upper limit (rad or m), and torque of the motor (N m or N), by the name of
            the moved body.
        names: names of the links and joints that make up each body. A sentence of the import may
            name any of them.
    """

    bodies: dict[str, Part] = dataclasses.field(default_factory=dict)
    joints: dict[str, tuple[float, float, float]] = dataclasses.field(default_factory=dict)
    names: dict[str, set[str]] = dataclasses.field(default_factory=dict)


def read_urdf(text: str) -> Reading:
    """Read a URDF. Limits of 0 to 0 make a weld, and the link ``world`` is the fixed world."""
    robot = _tree(text)
    links = {link.get("name", ""): link for link in robot.findall("link")}
    below: dict[str, list[Element]] = {name: [] for name in links}
    children = set()
    for joint in robot.findall("joint"):
        below[_attribute(joint, "parent", "link")].append(joint)
        children.add(_attribute(joint, "child", "link"))
    reading = Reading()

    def visit(name: str, carrier: str, turn: np.ndarray, place: np.ndarray) -> None:
        part = reading.bodies.setdefault(carrier, Part()) if name != WORLD else Part()
        reading.names.setdefault(carrier, set()).add(name)
        inertial = links[name].find("inertial")
        if inertial is not None:
            own_turn, own_place = _pose(inertial)
            axes = turn @ own_turn
            inertia = axes @ _inertia(inertial) @ axes.T
            part.add(_number(inertial, "mass", "value"), place + turn @ own_place, inertia)
        for joint in below[name]:
            child, (own_turn, own_place) = _attribute(joint, "child", "link"), _pose(joint)
            lower, upper = (_number(joint, "limit", key) for key in ("lower", "upper"))
            kind, torque = joint.get("type"), _number(joint, "limit", "effort")
            limited = kind in ("revolute", "prismatic") and joint.find("limit") is not None
            moves = kind != "fixed" and not (limited and lower == upper == 0)
            top = child if moves or carrier == WORLD else carrier
            reading.names.setdefault(top, set()).add(joint.get("name", ""))
            if moves:
                limits = (lower, upper) if limited else (-np.inf, np.inf)
                reading.joints[child] = *limits, torque
            visit(child, top, turn @ own_turn, place + turn @ own_place)

    for root in links.keys() - children:
        visit(root, root, np.eye(3), np.zeros(3))
    return reading


def imported_reading(imported: Imported) -> Reading:
    """Return an imported creature as a reading."""
    config = CreatureConfig.model_validate(imported.experiment["creature"])
    creature = config.build()
    reading = Reading()
    centres, turns = neutral_pose(creature)
    moved = np.array(imported.place) - centres[0]
    for body, centre, turn in zip(creature.bodies, centres, turns, strict=True):
        own = np.zeros(3) if body.inertial is None else np.asarray(body.inertial.centre)
        place = moved + centre + turn @ own
        part = reading.bodies.setdefault(body.whole or body.name, Part())
        part.add(float(body.mass), place, turn @ np.asarray(body.inertia) @ turn.T)
        joint = None if body.whole else creature.joint_of(body)
        for dof in joint.dofs if joint else ():
            limits = (float(dof.lower), float(dof.upper))
            free = limits == (-NO_LIMIT, NO_LIMIT)
            torque = dof.actuator.gear if isinstance(dof.actuator, TorqueMotor) else 0.0
            reading.joints[body.name] = *((-np.inf, np.inf) if free else limits), float(torque)
    return reading


def differences(file: Reading, imported: Reading) -> Iterator[tuple[str, str]]:
    """Yield the name of each body that differs, and the word for the difference in messages."""
    for name in file.bodies.keys() | imported.bodies.keys():
        if name not in file.bodies or name not in imported.bodies:
            yield name, "body"
            continue
        old, new = file.bodies[name].values(), imported.bodies[name].values()
        reach = np.sqrt(abs(np.trace(old[2])) / old[0]) if old[0] else 0.0
        scales = old[0], reach + np.abs(old[1]).max(), np.abs(old[2]).max()
        for word, a, b, scale in zip(("mass", "mass", "inertia"), old, new, scales, strict=True):
            if np.abs(a - b).max() > _EQUAL * scale:
                yield name, word
    for name in file.joints.keys() | imported.joints.keys():
        old, new = file.joints.get(name, ()), imported.joints.get(name, ())
        if not (old and new and np.allclose(old[:2], new[:2], _EQUAL, _EQUAL)):
            yield name, "limits"
        if not (old and new and np.isclose(old[2], new[2], _EQUAL, 0)):
            yield name, "effort"
    old, new = (sum(part.mass for part in each.bodies.values()) for each in (file, imported))
    if abs(new - old) > _EQUAL * old:
        yield "", "mass"


def compare(path: Path, file: Reading, drop: bool) -> tuple[list[str], list[str]]:
    """Import a file, and return the differences that the import names, and all others.

    Raises:
        ExchangeError: the file is refused.
    """
    free = bool(file.bodies.keys() - file.joints.keys())
    imported = read_model(path, drop=drop, free=free)
    sentences = *imported.changed, *imported.dropped
    said, unsaid = [], []
    for name, what in differences(file, imported_reading(imported)):
        names = [repr(own) for own in file.names.get(name, ())] or [""]
        named = any(own in each and what in each for own in names for each in sentences)
        (said if named else unsaid).append(f"{what} of {name or 'all bodies'}")
    return said, unsaid


def models(folder: Path) -> Iterator[tuple[Path, Reading]]:
    """Yield the files in a folder with at least two moving bodies, and their readings.

    The reading of a file with faults is empty, so that every import except a refusal differs.
    """
    for path in sorted(folder.rglob("*.urdf")):
        try:
            file = read_urdf(path.read_text(errors="replace"))
        except ValueError:
            yield path, Reading()
            continue
        if len(file.bodies) > 1:
            yield path, file


def report(folder: Path, drop: bool, write: Callable[[str], object] = print) -> Counter[str]:
    """Write a line for each model, and return the numbers of models by their result."""
    counts: Counter[str] = Counter()
    for path, file in models(folder):
        name = path.relative_to(folder)
        try:
            said, unsaid = compare(path, file, drop)
        except ExchangeError as error:
            counts["refused"] += 1
            write(f"refused  {name}: {str(error).removeprefix(f'{path}: ')}")
            continue
        result = "UNSAID" if unsaid else "said" if said else "equal"
        counts[result] += 1
        write(f"{result:8} {name} {'; '.join(unsaid or said)}")
    write(f"{folder}: {sum(counts.values())} models: {dict(counts)}")
    return counts


class _Parser(HTMLParser):
    """A reader of tags that continues after a fault in the XML, unlike a strict parser."""

    def __init__(self) -> None:
        super().__init__()
        self.builder, self.open = TreeBuilder(), []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.builder.start(tag, {key: value or "" for key, value in attrs})
        self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        self.builder.end(tag)
        self.open.pop()


def _tree(text: str) -> Element:
    parser = _Parser()
    parser.feed(text)
    return parser.builder.close()


def _attribute(element: Element, tag: str, key: str, default: str = "") -> str:
    found = element.find(tag)
    return default if found is None else found.get(key, default)


def _number(element: Element, tag: str, key: str) -> float:
    return float(_attribute(element, tag, key, "0"))


def _pose(element: Element) -> tuple[np.ndarray, np.ndarray]:
    xyz, rpy = (_attribute(element, "origin", key, "0 0 0").split() for key in ("xyz", "rpy"))
    return Rotation.from_euler("xyz", np.array(rpy, float)).as_matrix(), np.array(xyz, float)


def _inertia(inertial: Element) -> np.ndarray:
    keys = ("ixx", "ixy", "ixz", "ixy", "iyy", "iyz", "ixz", "iyz", "izz")
    return np.array([_number(inertial, "inertia", key) for key in keys]).reshape(3, 3)


def _steiner(arm: np.ndarray) -> np.ndarray:
    return arm @ arm * np.eye(3) - np.outer(arm, arm)


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, nargs="+")
    parser.add_argument("--drop", action="store_true", help="import without refused parts")
    given = parser.parse_args()
    os.environ.setdefault("JAX_PLATFORMS", "cpu")
    counts = sum((report(folder, given.drop) for folder in given.folder), Counter())
    print(f"{sum(counts.values())} models: {dict(counts)}")
    sys.exit(bool(counts["UNSAID"]))


if __name__ == "__main__":
    main()
