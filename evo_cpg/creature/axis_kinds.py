"""Kinds of joint axes, and the names of degrees of freedom.

A kind states how far its axis turns a body about itself and carries it along itself, per unit of
its coordinate. Kinematics, elimination, contacts, effective inertia and bounds on the reach of
limbs use these two numbers, so that they name no kind. A new kind is a class here.
"""

import dataclasses
import functools
import itertools
import re
from collections.abc import Iterable
from typing import ClassVar

import numpy as np

from evo_cpg.creature.algebra.decisions import chosen
from evo_cpg.creature.algebra.numerics import Triple

# Number of axes that span all rotations, such as those of a ball.
SPANNING = 3


@dataclasses.dataclass(frozen=True)
class AxisKind:
    """A kind of joint axis. It is static and hashable, because it shapes the traced program.

    Attributes:
        key: word for the kind in configurations and on pages.
        prefix: beginning of the axis in the names of degrees of freedom.
        motion: what the axis does, for messages.
        unit: unit of its coordinate, and of its rate per second.
        force_unit: unit of the force that its motor, spring and limits exert.
        mujoco: type of the joint in MuJoCo that is the same, or None if there is none.
        at_once: whether coordinates of neighbouring axes are components of one rotation.
        rotation: 1 if the axis turns, so that its coordinate is the angle about it, else 0.
        translation: displacement along the axis per unit of the coordinate, m.
    """

    key: ClassVar[str]
    prefix: ClassVar[str]
    motion: ClassVar[str]
    unit: ClassVar[str] = "rad"
    force_unit: ClassVar[str] = "N m"
    mujoco: ClassVar[str | None] = None
    at_once: ClassVar[bool] = False
    rotation: float
    translation: float

    def mirrored(self) -> "AxisKind":
        """Return the kind of the mirror image, in which rotations turn the other way round."""
        if not self.rotation or not self.translation:
            return self
        return dataclasses.replace(self, translation=-self.translation)


@dataclasses.dataclass(frozen=True)
class Turn(AxisKind):
    """Rotation about the axis."""

    key: ClassVar[str] = "turn"
    prefix: ClassVar[str] = ""
    motion: ClassVar[str] = "turns"
    mujoco: ClassVar[str | None] = "hinge"
    rotation: float = 1.0
    translation: float = 0.0


@dataclasses.dataclass(frozen=True)
class Slide(AxisKind):
    """Displacement along the axis."""

    key: ClassVar[str] = "slide"
    prefix: ClassVar[str] = "slide_"
    motion: ClassVar[str] = "slides"
    unit: ClassVar[str] = "m"
    force_unit: ClassVar[str] = "N"
    mujoco: ClassVar[str | None] = "slide"
    rotation: float = 0.0
    translation: float = 1.0


@dataclasses.dataclass(frozen=True)
class BallComponent(AxisKind):
    """One of the three components of a ball's rotation vector."""

    key: ClassVar[str] = "ball"
    prefix: ClassVar[str] = "ball_"
    motion: ClassVar[str] = "is a ball's"
    mujoco: ClassVar[str | None] = "ball"
    at_once: ClassVar[bool] = True
    rotation: float = 1.0
    translation: float = 0.0


def names_of_dofs(axes: Iterable[tuple[str, AxisKind, Triple]]) -> tuple[str, ...]:
    """Return the names of degrees of freedom, unique in each body.

    Such names are ``leg.x``, ``leg.(1,0,0.5)``, ``leg.slide_x`` and ``leg.slide_(1,0,0.5)``. A
    number at the end tells equal axes of a body apart.
    """
    names: list[str] = []
    for body, kind, axis in axes:
        name = f"{body}.{kind.prefix}{chosen(functools.partial(_label, axis))}"
        again = itertools.chain([name], (f"{name}_{k}" for k in itertools.count(2)))
        names.append(next(free for free in again if free not in names))
    return tuple(names)


def _label(axis: Triple) -> str:
    for name, unit in zip("xyz", np.eye(3), strict=True):
        if np.allclose(np.abs(axis), unit):
            return name
    return "(" + ",".join(f"{value:g}" for value in axis) + ")"


def body_and_axis(dof_name: str) -> tuple[str, str]:
    """Return the two parts of the name of a degree of freedom (`names_of_dofs`)."""
    oblique = re.fullmatch(r"(.*)\.(\w*\([^()]*\)\w*)", dof_name)
    body, axis = oblique.groups() if oblique else dof_name.rpartition(".")[::2]
    return body, axis


def kind_named(dof_name: str) -> type[AxisKind]:
    """Return the kind of a degree of freedom, which its name contains."""
    axis = body_and_axis(dof_name)[1]
    special = (kind for kind in AxisKind.__subclasses__() if kind.prefix)
    return next((kind for kind in special if axis.startswith(kind.prefix)), Turn)
