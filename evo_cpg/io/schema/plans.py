"""Section of body plans that evolve, and the creature that stands for all of them."""

import math
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, model_validator

from evo_cpg.creature.creature import Actuator, Muscle
from evo_cpg.creature.development import PlanBounds
from evo_cpg.creature.graph import JOINT_AXES, GraphLayout
from evo_cpg.io.schema.section import NotNegative, Positive, Section
from evo_cpg.simulation.planned import PlanPhysics

# Kinds of joints by their numbers in `evo_cpg.creature.graph.JOINT_AXES`.
_KINDS: dict[str, tuple[int, ...]] = {"hinge": (0, 1), "universal": (2,), "ball": (3,)}

# Boxes may overlap at birth by this fraction of the least edge.
_OVERLAP = 1 / 3

PLANS = "plans"
"""Name of the creature that stands for all plans."""


class PlanConfig(Section):
    """What body plans may be like.

    Attributes:
        bodies: largest number of bodies.
        parts: largest number of different parts. A part may grow several times.
        connections: largest number of places on a part at which others grow.
        joints: kinds of joints: about one axis, two or three.
        edges: shortest and longest edge of a body before the volume is limited, m.
        volume: largest volume of all bodies, m^3.
        density: density of the bodies, kg/m^3.
        friction: friction of the bodies, static and dynamic.
        restitution: restitution of the bodies.
        largest_angle_deg: largest joint angle in each direction, degrees.
        actuator: whether motors (servos) or muscles move the joints.
        motor_gain: gain of the strongest motors over the cross-section and the half thickness of
            the thinner of both parts, N m s/rad per m^3.
        muscle_area: cross-section of the strongest muscles on each side, as a fraction of that of
            the thinner part. Their stress is that of a joint's muscles.
        eyes: whether eyes evolve: then a part of a `body_brain` senses the light only if it has an
            eye or hangs on a part that senses it.
    """

    bodies: Annotated[int, Field(ge=2, le=20)] = 20
    parts: Annotated[int, Field(ge=1, le=12)] = 6
    connections: Annotated[int, Field(ge=1, le=6)] = 3
    joints: Annotated[tuple[Literal["hinge", "universal", "ball"], ...], Field(min_length=1)] = (
        "hinge",
        "universal",
    )
    edges: tuple[Positive, Positive] = (0.06, 0.4)
    volume: Positive = 0.05
    density: Positive = 1000.0
    friction: NotNegative = 0.8
    restitution: Annotated[float, Field(ge=0, le=1)] = 0.1
    largest_angle_deg: Annotated[float, Field(gt=1, le=80)] = 60.0
    actuator: Literal["motor", "muscle"] = "motor"
    motor_gain: Positive = 2e4
    muscle_area: Annotated[float, Field(gt=0, le=0.5)] = 0.25
    eyes: bool = False

    @model_validator(mode="after")
    def _check(self) -> "PlanConfig":
        if not self.edges[0] < self.edges[1]:
            raise ValueError(f"edges: {self.edges[0]:g} is not below {self.edges[1]:g}")
        return self

    @property
    def layout(self) -> GraphLayout:
        """Sizes of the genome."""
        kinds = tuple(k for name in dict.fromkeys(self.joints) for k in _KINDS[name])
        return GraphLayout(self.parts, self.connections, kinds=kinds)

    @property
    def bounds(self) -> PlanBounds:
        """Limits of all plans."""
        low, high = self.edges[0] / 2, self.edges[1] / 2
        angle, overlap = math.radians(self.largest_angle_deg), _OVERLAP * self.edges[0]
        angles = angle, angle, angle
        return PlanBounds(self.bodies, (low, high), self.volume, angles=angles, overlap=overlap)

    @property
    def axes(self) -> tuple[int, ...]:
        """Axes (0 x, 1 y, 2 z) that any joint may have."""
        return tuple(np.flatnonzero(JOINT_AXES[list(self.layout.kinds)].any(0)).tolist())

    def physics(self, water: Any, clearance: float, meet: bool = False) -> PlanPhysics:
        """Return the physical settings, in a world's water (its section or None)."""
        resolutions = (water.form_resolution, water.skin_resolution) if water else (1, 1)
        return PlanPhysics(
            self.density,
            self.motor_gain,
            self.muscle_area if self.actuator == "muscle" else None,
            form_resolution=resolutions[0],
            skin_resolution=resolutions[1],
            clearance=clearance,
            axes=self.axes,
            meet=meet,
            eyes=self.eyes,
        )

    @property
    def materials(self) -> dict[str, Any]:
        """Materials of the creature."""
        surface = {"static_friction": self.friction, "dynamic_friction": self.friction}
        return {"body": {"density": self.density, "restitution": self.restitution, **surface}}

    def star(self, bodies: int | None = None) -> dict[str, Any]:
        """Return a creature of some bodies, by default of the most, with all parts on the root."""
        edge = math.sqrt(self.edges[0] * self.edges[1])
        box = {"shape": {"type": "box", "size": [edge] * 3}, "material": "body"}
        motor = self.physics(None, 0.0).actuator(1.0, [edge] * 3, edge**3)
        joint = {
            "parent": "part0",
            "at": [0, 0, 0],
            "child_at": [-edge / 2, 0, 0],
            "axes": ["xyz"[axis] for axis in self.axes],
            "limits_deg": [-self.largest_angle_deg, self.largest_angle_deg],
            "actuator": actuator_section(motor),
        }
        parts = [{"name": f"part{i}", **box} for i in range(bodies or self.bodies)]
        for part in parts[1:]:
            part["joint"] = joint
        given = {"materials": self.materials, "bodies": parts, "self_collision": False}
        return {"name": PLANS} | given


def actuator_section(actuator: Actuator | Muscle) -> dict[str, Any]:
    """Return the section of a motor or of muscles."""
    if isinstance(actuator, Actuator):
        return {"gain": float(actuator.gain)}
    names = "area", "arm", "fibre_length"
    return {"type": "muscle"} | {name: float(getattr(actuator, name)) for name in names}
