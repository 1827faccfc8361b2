"""A file compiled by MuJoCo, with the names, lines and places of its elements.

All places are those of the neutral pose (``qpos0``), in world axes. MuJoCo computes them. If
gravity is tilted, the whole world is turned until gravity points down. A level ground becomes a
slope.
"""

import contextlib
import importlib
import os
import re
import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from evo_cpg.io.models.refusals import ExchangeError, Refusal, Refusals, RefusedError
from evo_cpg.io.models.urdf import read_urdf, read_xml, restore_inertials, set_inertials_aside
from evo_cpg.system import command_for

# Largest relative difference of values that count as equal, and number of digits that are written.
TOLERANCE = 1e-6
_DIGITS = 14

# MuJoCo's number of the body that holds the elements of the world.
WORLD = 0


class Compiled(NamedTuple):
    """MuJoCo, and the model that it compiled from a file.

    Attributes:
        mujoco: the module.
        model: the compiled model.
        data: places of all elements in the neutral pose, in world axes.
        source: the file, for messages.
        refusals: faults found so far, for which the file is refused.
        lines: known lines of the elements in the file, by kind and number.
        urdf: whether the file is a URDF.
        tilt: angle by which the world is turned, so that gravity points down, rad.
    """

    mujoco: Any
    model: Any
    data: Any
    source: Path
    refusals: Refusals
    lines: Mapping[tuple[str, int], int]
    urdf: bool = False
    tilt: float = 0.0

    def item(self, kind: str, number: int) -> "Item":
        """Return an element by its kind and number."""
        return Item(self, kind, number)

    def disabled(self, *flags: str) -> bool:
        """Return whether any of these flags, on by default, is disabled. Skip unknown flags."""
        bits = (getattr(self.mujoco.mjtDisableBit, f"mjDSBL_{flag.upper()}", 0) for flag in flags)
        return any(self.model.opt.disableflags & int(bit) for bit in bits)

    def owners(self, kind: str, wrong: Any) -> Iterator[tuple["Item", tuple[int, ...]]]:
        """Yield the elements with wrong values, and the index of each. Skip geoms of the world.

        Args:
            kind: kind of the elements, ``dof`` for degrees of freedom of joints.
            wrong: mask of the wrong values.
        """
        for place in np.argwhere(wrong).tolist():
            number = place[0]
            if kind == "dof":
                yield self.item("joint", int(self.model.dof_jntid[number])), tuple(place)
            elif kind != "geom" or self.model.geom_bodyid[number] != WORLD:
                yield self.item(kind, number), tuple(place)


class Item(NamedTuple):
    """An element of a compiled model.

    Attributes:
        compiled: the model.
        kind: kind of the element.
        number: number in the compiled model.
    """

    compiled: Compiled
    kind: str
    number: int

    def __str__(self) -> str:
        """Return the name of the element in messages."""
        mujoco, model = self.compiled.mujoco, self.compiled.model
        code = getattr(mujoco.mjtObj, f"mjOBJ_{self.kind.upper()}", None)
        name = None if code is None else mujoco.mj_id2name(model, code, self.number)
        if name:
            return f"{self.kind} {name!r}"
        # Name the element that an element without a name belongs to.
        if self.kind in ("joint", "geom"):
            body = (model.jnt_bodyid if self.kind == "joint" else model.geom_bodyid)[self.number]
            owner = self.compiled.item("body", int(body))
        elif self.kind == "pair":
            ends = int(model.pair_geom1[self.number]), int(model.pair_geom2[self.number])
            owner = self.compiled.item("geom", max(ends, key=lambda geom: model.geom_bodyid[geom]))
        elif self.kind == "equality":
            word = mujoco.mjtObj(model.eq_objtype[self.number]).name.removeprefix("mjOBJ_").lower()
            if word == "unknown":
                # MuJoCo gives the kind of the connected elements only for bodies and sites.
                word = mujoco.mjtEq(model.eq_type[self.number]).name.removeprefix("mjEQ_").lower()
            owner = self.compiled.item(word, int(model.eq_obj1id[self.number]))
        else:
            return f"{self.kind} number {self.number} (unnamed)"
        return f"unnamed {self.kind} of {owner}"

    @property
    def line(self) -> int | None:
        """Line of the element in the file, or None if it is unknown."""
        return self.compiled.lines.get((self.kind, self.number))

    def refuse(self, problem: str, allowed: str, vital: bool = False) -> None:
        """Record that no creature can have the element, and continue."""
        self.compiled.refusals.add(self.refusal(problem, allowed, vital).refusal)

    def refusal(self, problem: str, allowed: str, vital: bool = False) -> RefusedError:
        """Return an error that ends the reading of the element."""
        return RefusedError(Refusal(str(self), f"{problem}. Allowed: {allowed}", self.line, vital))


def compile_model(path: Path, drop: bool = False, free: bool = False) -> Compiled:
    """Compile a file with MuJoCo.

    Args:
        path: MJCF or URDF file.
        drop: whether the user accepts the loss of refused elements.
        free: whether the first body is released from the world.

    Raises:
        ExchangeError: MuJoCo is missing or cannot load the file, or not all of it is text.
    """
    try:
        # Reading a pipe or a device might never end.
        if not (path.is_file() or path.is_dir()) and path.stat():
            raise OSError(None, "is no ordinary file")
        content = path.read_bytes()
    except FileNotFoundError:
        raise ExchangeError(f"{path}: no such file") from None
    except OSError as error:
        raise ExchangeError(f"{path}: cannot be read ({error.strerror})") from None
    try:
        mujoco = importlib.import_module("mujoco")
    except ModuleNotFoundError:
        raise ExchangeError(
            f"reading a model needs MuJoCo. Install it with `{command_for('mujoco')}`"
        ) from None
    refusals = Refusals(path, drop)
    try:
        text = read_xml(content)
        # The first element says which kind of file it is. MuJoCo ignores case.
        first = re.search(r"<([^\W\d][^\s/>]*)", text)
        urdf = first is not None and first[1].lower() == "robot"
        with _collected_warnings(mujoco, refusals):
            if urdf:
                given = read_urdf(text, path, refusals)
                spec = mujoco.MjSpec.from_string(given.text, assets=given.meshes)
            else:
                spec = mujoco.MjSpec.from_file(os.fsdecode(path))
            if free:
                body = spec.worldbody.first_body()
                if body is None:
                    raise ExchangeError(f"{path}: it holds no body")
                if all(joint.type != 0 for joint in body.joints):
                    if body.joints:
                        problem = f"the body {body.name!r} hangs on joints already"
                        raise ExchangeError(f"{path}: --free: {problem}")
                    body.add_freejoint()
            inertials = set_inertials_aside(spec, refusals) if urdf else {}
            model = spec.compile()
        bytes(model.names).decode()
    except UnicodeDecodeError as error:
        # Find the whole name around the bad byte, in the file or in MuJoCo's message.
        before, after = error.object[: error.start], error.object[error.start :]
        word = re.split(rb"[\0\s'\"]", before)[-1] + re.split(rb"[\0\s'\"]", after)[0]
        raise ExchangeError(f"{path}: {word!r} is not UTF-8 text. Save the file as UTF-8") from None
    except (ValueError, mujoco.FatalError) as error:
        raise ExchangeError(
            f"{path}: MuJoCo cannot load it: {' '.join(str(error).split())}"
        ) from None
    if urdf:
        restore_inertials(mujoco, model, inertials, refusals)
    tilt = _set_upright(mujoco, model)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return Compiled(mujoco, model, data, path, refusals, _lines(spec, path), urdf, tilt)


def _set_upright(mujoco: Any, model: Any) -> float:
    """Turn the world until gravity points down, and return the angle, rad."""
    strength = float(np.linalg.norm(model.opt.gravity))
    # A gravity that is not finite is refused later.
    off = model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_GRAVITY)
    if off or not 0 < strength < np.inf:
        return 0.0
    down = model.opt.gravity / strength
    axis, sine = np.cross(down, [0.0, 0.0, -1.0]), float(np.hypot(down[0], down[1]))
    angle = float(np.arctan2(sine, -down[2]))
    if not angle:
        return 0.0
    turn = np.zeros(4)
    # The world is turned about x if gravity points up, so that the front stays the front.
    mujoco.mju_axisAngle2Quat(turn, axis / sine if sine else np.eye(3)[0], angle)

    def turned(vector: np.ndarray) -> np.ndarray:
        found = np.zeros(3)
        mujoco.mju_rotVecQuat(found, vector, turn)
        return found

    def place(where: np.ndarray, attitude: np.ndarray) -> None:
        where[:] = turned(where.copy())
        mujoco.mju_mulQuat(attitude, turn, attitude.copy())

    model.opt.gravity[:] = 0.0, 0.0, -strength
    model.opt.wind[:] = turned(model.opt.wind)
    for body in np.flatnonzero(model.body_parentid == WORLD)[1:]:
        place(model.body_pos[body], model.body_quat[body])
    for geom in np.flatnonzero(model.geom_bodyid == WORLD):
        place(model.geom_pos[geom], model.geom_quat[geom])
        # MuJoCo would take the frame of the world for a geom that had it.
        model.geom_sameframe[geom] = 0
    for joint in np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE):
        address = int(model.jnt_qposadr[joint])
        for pose in (model.qpos0, model.qpos_spring):
            place(pose[address : address + 3], pose[address + 3 : address + 7])
    return angle


def _lines(spec: Any, path: Path) -> dict[tuple[str, int], int]:
    """Return the lines of elements, none for a file of a single line.

    MuJoCo gives an included element its line in the included file. Such an element is left out. It
    is recognised because that line of this file does not hold its name.
    """
    text = path.read_text(encoding="utf-8", errors="replace").splitlines()
    kinds = {
        "body": spec.bodies,
        "joint": spec.joints,
        "geom": spec.geoms,
        "actuator": spec.actuators,
        "equality": spec.equalities,
        "tendon": spec.tendons,
        "pair": spec.pairs,
    }
    whole = not any("<include" in line for line in text)
    lines = {}
    for kind, elements in kinds.items():
        for each in elements:
            line = int(each.info.removeprefix("line ") or 0)
            own = whole or (each.name and f'"{each.name}"' in "".join(text[line - 1 : line]))
            if line and own and len(text) > 1:
                lines[kind, each.id] = line
    return lines


@contextlib.contextmanager
def _collected_warnings(mujoco: Any, refusals: Refusals) -> Iterator[None]:
    """Report MuJoCo's warnings. MuJoCo would print them, and write them to a file."""
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda words: refusals.warnings.append(printed(words)))
    try:
        with warnings.catch_warnings():
            # MuJoCo's Python module warns about attributes that it will drop.
            warnings.simplefilter("ignore")
            yield
    finally:
        mujoco.set_mju_user_warning(before)


def printed(text: str) -> str:
    """Return a name or a sentence on one line, without control characters."""
    return re.sub(r"[\x00-\x1f\x7f-\x9f\u2028\u2029]", "_", text)


def tidy(value: float) -> float:
    """Return a number without digits left by rounding in the compiler. 0 has no sign."""
    return float(f"{value:.{_DIGITS}g}") + 0.0


def tidy_vector(values: np.ndarray) -> list[float]:
    """Return coordinates after `tidy`. A tiny remainder of numbers that cancel becomes 0."""
    least = 10.0**-_DIGITS * max(1.0, float(np.abs(values).max(initial=0.0)))
    return [0.0 if abs(value) <= least else tidy(value) for value in np.ravel(values)]
