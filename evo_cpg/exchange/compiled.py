"""A file as MuJoCo understands it, and how its elements are called and refused."""

import importlib
import os
import re
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple, TypeVar
from xml.etree import ElementTree

import numpy as np
import pydantic

from evo_cpg.config.schema.section import Section
from evo_cpg.exchange.errors import ExchangeError
from evo_cpg.exchange.refusals import Lines, Refusal, Refusals, RefusedError, element_lines
from evo_cpg.installation import command_for

_Section = TypeVar("_Section", bound=Section)

# Relative differences that nobody would tell apart, and digits that are written.
TOLERANCE = 1e-6
_DIGITS = 12

# Those of the world's elements belong to this body.
WORLD = 0

# Numbers that are read: their fields in the compiled model, whose they are and how they are
# written.
_FINITE = {
    "body_pos": ("body", "pos"),
    "body_quat": ("body", "orientation"),
    "body_gravcomp": ("body", "gravcomp"),
    "geom_pos": ("geom", "pos"),
    "geom_quat": ("geom", "orientation"),
    "geom_size": ("geom", "size"),
    "geom_friction": ("geom", "friction"),
    "geom_rgba": ("geom", "rgba"),
    "jnt_pos": ("joint", "pos"),
    "jnt_axis": ("joint", "axis"),
    "jnt_range": ("joint", "range"),
    "jnt_stiffness": ("joint", "stiffness"),
    "dof_damping": ("dof", "damping"),
    "dof_armature": ("dof", "armature"),
    "actuator_gear": ("actuator", "gear"),
    "actuator_gainprm": ("actuator", "gain"),
    "actuator_biasprm": ("actuator", "bias"),
}
# Likewise, those that MuJoCo makes of others.
_MADE_OF_OTHERS = {
    "body_mass": ("body", "mass"),
    "body_ipos": ("body", "centre of mass"),
    "body_iquat": ("body", "inertia"),
    "body_inertia": ("body", "inertia"),
}
# Likewise; infinite ones limit nothing.
_LIMITS = {
    "jnt_actfrcrange": ("joint", "actuatorfrcrange"),
    "actuator_forcerange": ("actuator", "forcerange"),
    "actuator_ctrlrange": ("actuator", "ctrlrange"),
}


class Compiled(NamedTuple):
    """MuJoCo, and what it made of a file.

    Attributes:
        mujoco: the module.
        model: the compiled model.
        source: the file, for messages.
        refusals: what was found that no creature can have.
        lines: where the elements stand in the file.
    """

    mujoco: Any
    model: Any
    source: Path
    refusals: Refusals
    lines: Lines

    def named(self, kind: str, number: int) -> str:
        """An element as it is called in messages."""
        name = self._name(kind, number)
        if name:
            return f"{kind} {name!r}"
        owner = {"joint": "jnt_bodyid", "geom": "geom_bodyid"}.get(kind)
        if owner is None:
            return f"{kind} number {number} (unnamed)"
        return f"unnamed {kind} of {self.named('body', int(getattr(self.model, owner)[number]))}"

    def refusal(self, kind: str, number: int, problem: str, allowed: str) -> RefusedError:
        """An error that ends the reading of an element that no creature can have."""
        return RefusedError(self._refused(kind, number, problem, allowed))

    def refuse(self, kind: str, number: int, problem: str, allowed: str) -> None:
        """Remember an element that no creature can have, and go on."""
        self.refusals.add(self._refused(kind, number, problem, allowed))

    def refuse_as(self, what: str, problem: str) -> None:
        """Remember what is no element of its own."""
        self.refusals.add(Refusal(what, problem))

    def _refused(self, kind: str, number: int, problem: str, allowed: str) -> Refusal:
        said = f"{problem}; allowed: {allowed}"
        return Refusal(self.named(kind, number), said, self._line(kind, number))

    def _line(self, kind: str, number: int) -> int | None:
        sizes = {"body": "nbody", "joint": "njnt", "geom": "ngeom", "equality": "neq"}
        count = getattr(self.model, sizes.get(kind, f"n{kind}"), None)
        if count is None:
            count = self.model.nu
        return self.lines.find(kind, number, int(count), self._name(kind, number))

    def _name(self, kind: str, number: int) -> str | None:
        code = getattr(self.mujoco.mjtObj, f"mjOBJ_{kind.upper()}", None)
        return None if code is None else self.mujoco.mj_id2name(self.model, code, number)

    def enabled(self, flag: str) -> bool:
        """Whether a flag of the option element is that is not by default."""
        bit = getattr(self.mujoco.mjtEnableBit, f"mjENBL_{flag.upper()}", 0)
        return bool(self.model.opt.enableflags & int(bit))

    def disabled(self, flag: str) -> bool:
        """Whether a flag of the option element is; of one that MuJoCo does not know, not."""
        bit = getattr(self.mujoco.mjtDisableBit, f"mjDSBL_{flag.upper()}", 0)
        return bool(self.model.opt.disableflags & int(bit))

    def require_numbers(self) -> None:
        """Refuse elements with NaN or an infinite number, which no comparison would find.

        Raises:
            ExchangeError: there are some; nothing else can be told of such a model.
        """
        for fields in (_FINITE | _LIMITS, _MADE_OF_OTHERS):
            for field, (kind, word) in fields.items():
                self._require_finite(field, kind, word)
            self.refusals.check()

    def _require_finite(self, field: str, kind: str, word: str) -> None:
        values = np.asarray(getattr(self.model, field))
        wrong = np.isnan(values) if field in _LIMITS else ~np.isfinite(values)
        allowed = "numbers" if field in _LIMITS else "finite numbers"
        for owner, number, place in self.owners(kind, wrong):
            self.refuse(owner, number, f"its {word} holds {values[place]:g}", allowed)

    def owners(self, kind: str, wrong: Any) -> Iterator[tuple[str, int, tuple[int, ...]]]:
        """Yield kind and number of the elements with wrong values, and the place of each value.

        Args:
            kind: of the elements; ``dof`` for degrees of freedom of joints.
            wrong: which of their values are wrong.
        """
        for place in np.argwhere(wrong).tolist():
            number = place[0]
            if kind == "dof":
                yield "joint", int(self.model.dof_jntid[number]), tuple(place)
            elif kind != "geom" or self.model.geom_bodyid[number] != WORLD:
                yield kind, number, tuple(place)

    def checked(
        self,
        what: str,
        section: type[_Section],
        values: dict[str, Any],
        at: tuple[str, int] | None = None,
    ) -> _Section:
        """A section of the creature, or what its own rules say against an element.

        Args:
            what: the element, as `named` has it.
            section: to be made of it.
            values: of its keys; None for what is left open.
            at: kind and number of the element; None for the model.

        Raises:
            RefusedError: they break its rules.
        """
        try:
            return section(**{key: value for key, value in values.items() if value is not None})
        except pydantic.ValidationError as error:
            problem = error.errors()[0]
        said = problem["msg"].removeprefix("Value error, ")
        if problem["type"] != "value_error":
            said = f"{problem['input']}: {said[:1].lower()}{said[1:]}"
        key = ".".join(map(str, problem["loc"]))
        line = None if at is None else self._line(*at)
        raise RefusedError(Refusal(what, ": ".join([*([key] if key else []), said]), line))


def compile_model(path: Path) -> Compiled:
    """Have MuJoCo read a file.

    Raises:
        ExchangeError: MuJoCo is missing or cannot load the file, or not all of it is text.
    """
    try:
        mujoco = importlib.import_module("mujoco")
    except ModuleNotFoundError:
        raise ExchangeError(
            f"reading MJCF needs MuJoCo, which `{command_for('mujoco')}` installs"
        ) from None
    _require_mjcf(path)
    try:
        model = mujoco.MjModel.from_xml_path(os.fsencode(path))
        bytes(model.names).decode()
    except UnicodeDecodeError as error:
        # From one end of a name, in the file or in MuJoCo's words, to the other.
        before, after = error.object[: error.start], error.object[error.start :]
        word = re.split(rb"[\0\s'\"]", before)[-1] + re.split(rb"[\0\s'\"]", after)[0]
        raise ExchangeError(f"{path}: {word!r} is not UTF-8 text; save it as UTF-8") from None
    except ValueError as error:
        raise ExchangeError(
            f"{path}: MuJoCo cannot load it: {' '.join(str(error).split())}"
        ) from None
    return Compiled(mujoco, model, path, Refusals(path), element_lines(path))


def _require_mjcf(path: Path) -> None:
    """Check that a file can be read, of which MuJoCo has no words, and is no URDF."""
    try:
        mode = path.stat().st_mode
        # A pipe or a device need not end.
        if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
            raise OSError(None, "is no ordinary file")
        with path.open("rb") as file:
            _, first = next(ElementTree.iterparse(file, ["start"]), (None, None))
    except FileNotFoundError:
        raise ExchangeError(f"{path}: no such file") from None
    except OSError as error:
        raise ExchangeError(f"{path}: cannot be read ({error.strerror})") from None
    except (ElementTree.ParseError, LookupError, ValueError):
        # What is wrong with it MuJoCo says.
        return
    if first is not None and first.tag == "robot":
        raise ExchangeError(f"{path}: it is a URDF; allowed: MJCF, as MuJoCo saves it")


def rotation(compiled: Compiled, quaternion: np.ndarray) -> np.ndarray:
    """Rotation matrix ``(3, 3)`` of one of the model's quaternions."""
    matrix = np.zeros(9)
    compiled.mujoco.mju_quat2Mat(matrix, quaternion)
    return matrix.reshape(3, 3)


def tidy(value: float) -> float:
    """A number without the digits that rounding in the compiler leaves; 0 has no sign."""
    return float(f"{value:.{_DIGITS}g}") + 0.0


def tidy_difference(value: float) -> float:
    """As `tidy`, and 0 for what rounding leaves where numbers cancel."""
    return 0.0 if abs(value) <= 10.0**-_DIGITS else tidy(value)


def tidy_vector(values: np.ndarray) -> tuple[float, float, float]:
    """Three numbers as `tidy_difference` has them."""
    x, y, z = (tidy_difference(value) for value in values)
    return x, y, z


def tidy_size(values: np.ndarray) -> tuple[float, float, float]:
    """Three numbers as `tidy` has them."""
    x, y, z = (tidy(value) for value in values)
    return x, y, z
