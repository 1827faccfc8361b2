"""Random edits of a document: sensible ones, and ones that no user would make."""

import random
import re
from collections.abc import Callable
from typing import Any

from evo_cpg.view.drawing_page.document import Document, EditError
from evo_cpg.view.drawing_page.lookup import all_copies, bodies

# Values that a request can carry and no edit expects.
_SENSELESS: tuple[Any, ...] = (
    None, True, False, 0, -1, 7, 1e308, -1e-308, 1e-320, 10**400, float("nan"), float("inf"), "",
    " ", "x", "all", "world", "{i}", "{side}", "{j}", "{side}_{side}", "ab\u00e9\u4e2d\U0001f41f",
    "a: b # c", "- a", "'\"", "line\nfeed", "\u2028", "\x07", "\ud800", "null", "1e3", "0x10",
    "~", "*a", "&a b", "!!int 3", "{", "a" * 300, "<<", "=", [], {}, [None], [[]], [1], [1, 2, 3],
    ["x", "y", "z"], {"x": 1}, {"": None}, {"type": "box"}, {"type": "mesh", "file": "../../a.stl"},
    {"type": 3}, [1e300, -1e300, 0], ["a", "a"], {"a": {"b": {"c": []}}},
)  # fmt: skip
_KINDS = ("box", "ellipsoid", "sphere", "capsule", "cylinder", "loft")
_AXES = ("ball", [], ["z"], ["x", "y", "z"], [{"slide": "x"}, "y"], [[1, 0, 1], "y"])
_SECTIONS = ("creature", "world", "controller", "evolution", "task", "simulation", "name", "seed")


class RandomEdits:
    """Random edits of one document.

    Args:
        document: the document.
        seed: seed of the sequence.
        sense: fraction of arguments that a user could give.
    """

    def __init__(self, document: Document, seed: int, sense: float = 0.9):
        self.document, self.draw, self.sense = document, random.Random(seed), sense
        self._made: dict[str, Callable[[], dict[str, Any]]] = {
            "add_part": lambda: {"parent": self.part(), **self.surface(), **self.some(
                name=self.name, each=self.yes, shape=self.shape)},
            "add_shape": lambda: {"part": self.part(), **self.surface(),
                                  **self.some(shape=self.shape)},
            "remove_shape": lambda: {"name": self.part(), "index": self.draw.randint(-1, 2)},
            "remove_part": lambda: {"name": self.part()},
            "rename_part": lambda: {"name": self.part(), "new": self.name()},
            "set_shape": lambda: {"name": self.part(), "type": self.draw.choice(_KINDS)},
            "set_axes": lambda: {"name": self.part(), "axes": self.draw.choice(_AXES)},
            "add_section": lambda: {"name": self.part(), "after": self.draw.randint(-1, 2)},
            "remove_section": lambda: {"name": self.part(), "index": self.draw.randint(-1, 2)},
            "move_section": lambda: {"part": self.part(), "index": self.draw.randint(-1, 2),
                                     "by": self.vector(0.05)},
            "scale_section": lambda: {"part": self.part(), "index": self.draw.randint(-1, 2),
                                      "factors": [self.draw.uniform(0.3, 2) for _ in "wh"]},
            "set_joint": lambda: {"name": self.part(), **self.joint()},
            "resize": lambda: {"name": self.part(), **self.size()},
            "stretch": lambda: {"name": self.part(), "factors": [
                self.draw.uniform(0.3, 2) for _ in "xyz"]},
            "shift": lambda: {"part": self.part(), "by": self.vector(0.05)},
            "turn": lambda: {"part": self.part(), "rotation": self.rotation()},
            "mirror": lambda: {"name": self.part(), **self.some(
                axis=lambda: self.draw.choice("xyz"))},
            "repeat": lambda: {"name": self.part(), "count": self.count()},
            "radial": lambda: {"name": self.part(), "count": self.count()},
            "separate": lambda: {"name": self.part()},
            "add_eye": lambda: {"part": self.part(), "place": self.vector(0.1),
                                "axis": self.vector(1), **self.some(
                each=self.yes, field_of_view_deg=lambda: self.draw.uniform(1, 360))},
            "add_depth_gauge": lambda: {"part": self.part(), "place": self.vector(0.1)},
            "remove_sensor": lambda: {
                "kind": self.draw.choice(["light_sensors", "depth_sensors", "sensors"]),
                "index": self.draw.randint(0, 2)},
            "set_pressure": lambda: {"part": self.part(), "on": self.yes()},
            "set_water": lambda: {"on": self.yes(), **self.some(
                surface=lambda: self.draw.uniform(-1, 1))},
            "set_ground": lambda: {"on": self.yes()},
            "set_value": lambda: {"key": self.key(), "value": self.draw.choice(_SENSELESS)},
            "unset_value": lambda: {"key": self.key()},
        }  # fmt: skip

    def next(self) -> tuple[str, dict[str, Any]]:
        """Return the name of a command and its arguments."""
        names = list(self._made)
        # Parts are added more often than removed, so that the animal grows.
        command = self.draw.choice([*names, "add_part", "add_part", "shift", "add_eye", "resize"])
        if command in ("set_value", "unset_value") and self.draw.random() < 0.7:
            command = "set_joint"
        given = self._made[command]()
        for key in given:
            if self.draw.random() > self.sense:
                given[key] = self.draw.choice(_SENSELESS)
        if self.draw.random() > 0.99 and given:
            given.pop(self.draw.choice(list(given)))
        if self.draw.random() > 0.99:
            given["wing"] = 1
        return command, given

    def part(self) -> str:
        try:
            names = [str(each.get("name")) for each in bodies(self.document.data)]
            names += [copy.name for copy in all_copies(self.document.data)]
        except EditError:
            names = []
        return self.draw.choice([*names, *names, *names, "nobody"])

    def name(self) -> str:
        own = self.part()
        word = self.draw.choice(["fin", "leg", "tail", "no", "7", "\u00e9l\u00e8ve", "two words"])
        marks = "".join(re.findall(r"\{\w+\}", own)) if self.draw.random() < 0.5 else ""
        return word + marks

    def vector(self, size: float) -> list[float]:
        return [round(self.draw.uniform(-size, size), 3) for _ in "xyz"]

    def surface(self) -> dict[str, Any]:
        return {"place": self.vector(0.1), "normal": self.vector(1)}

    def yes(self) -> bool:
        return self.draw.random() < 0.5

    def count(self) -> int:
        return self.draw.choice([1, 2, 2, 3, 4])

    def shape(self) -> Any:
        def size() -> float:
            return round(self.draw.uniform(0.005, 0.1), 4)

        return self.draw.choice([
            None,
            {"type": "box", "size": [size(), size(), size()]},
            {"type": "ellipsoid", "radii": [size(), size(), size()]},
            {"type": "sphere", "radius": size()},
            {"type": "capsule", "radius": size(), "length": size()},
            {"type": "cylinder", "radius": size(), "length": size()},
        ])  # fmt: skip

    def size(self) -> dict[str, Any]:
        key = self.draw.choice(["size", "radii", "radius", "length"])

        def one() -> float:
            return round(self.draw.uniform(0.005, 0.2), 4)

        return {"key": key, "value": [one(), one(), one()] if key in ("size", "radii") else one()}

    def joint(self) -> dict[str, Any]:
        def angle() -> float:
            return round(self.draw.uniform(0, 90), 1)

        made: dict[str, Callable[[], Any]] = {
            "axes": lambda: self.draw.sample(["x", "y", "z", "-x", {"turn": "y"}, {"slide": "z"}],
                                             self.draw.randint(0, 3)),
            "limits_deg": lambda: self.draw.choice([None, [-angle(), angle()]]),
            "actuator": lambda: self.draw.choice([None, {"gain": angle()}]),
            "stiffness": lambda: 0.001 * angle(),
            "damping": lambda: 0.001 * angle(),
            "at": lambda: self.vector(0.1),
            "child_at": lambda: self.vector(0.1),
            "rotation_deg": lambda: self.vector(90),
            "parent": self.part,
            "wing": lambda: 1,
        }  # fmt: skip
        key = self.draw.choice(list(made))
        return {"key": key, "value": made[key]()}

    def rotation(self) -> list[list[float]]:
        from scipy.spatial.transform import Rotation

        return Rotation.from_rotvec(self.vector(2)).as_matrix().tolist()

    def key(self) -> list[Any]:
        """Return a key that exists, or almost."""
        place: Any = self.document.data
        key: list[Any] = []
        while self.draw.random() < 0.8:
            if isinstance(place, dict) and place:
                part = self.draw.choice(list(place))
            elif isinstance(place, list) and place:
                part = self.draw.randrange(len(place))
            else:
                break
            key.append(part)
            place = place[part]
        if not key or self.draw.random() < 0.1:
            key.append(self.draw.choice([*_SECTIONS, "wing", 0, 5, -1, None, 1.5, "", "a b"]))
        return key

    def some(self, **given: Callable[[], Any]) -> dict[str, Any]:
        """Return some of the optional arguments."""
        return {key: make() for key, make in given.items() if self.yes()}
