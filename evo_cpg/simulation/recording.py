"""The motion of one individual, as films, plots and exports need it."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from evo_cpg.creature.creature import Creature
from evo_cpg.errors import UserError


class RecordingError(UserError, ValueError):
    """A motion of which nothing can be shown."""


class Recording(NamedTuple):
    """What one animal did in one trial, sampled once per control step.

    Bodies are in the order of ``creature.bodies``, degrees of freedom in that of ``dof_names``.

    Attributes:
        time: s.
        position: centre of every body in the world, m.
        rotation: body to world.
        joint_angle: rad.
        target_rate: what the controller asked of each motor, rad/s.
        cpg_output: output of each oscillator, or of whatever drives a degree of freedom.
        torque: applied by each motor, N m.
        distance: from the root to its goal, m; without a goal from the start, over ground.
        goal: place of the light in the world, m; NaN where there is none.
        dof_names: ``body.axis``.
    """

    time: Float[np.ndarray, " t"]
    position: Float[np.ndarray, "t b 3"]
    rotation: Float[np.ndarray, "t b 3 3"]
    joint_angle: Float[np.ndarray, "t d"]
    target_rate: Float[np.ndarray, "t d"]
    cpg_output: Float[np.ndarray, "t d"]
    torque: Float[np.ndarray, "t d"]
    distance: Float[np.ndarray, " t"]
    goal: Float[np.ndarray, "3"]
    dof_names: tuple[str, ...]

    def __repr__(self) -> str:
        span = f" from {self.time[0]:.4g} to {self.time[-1]:.4g} s" if len(self.time) else ""
        return (
            f"Recording({len(self.time)} instants{span}, {self.position.shape[1]} bodies, "
            f"{len(self.dof_names)} joint axes)"
        )


def require_shapes(recording: Recording) -> None:
    """Check that the arrays of a recording are of one motion.

    Raises:
        RecordingError: they hold nothing, or have different numbers of instants, bodies or joints.
    """
    instants, dofs = len(recording.time), len(recording.dof_names)
    bodies = recording.position.shape[1] if recording.position.ndim > 1 else 0
    shapes = {
        "time": (instants,),
        "position": (instants, bodies, 3),
        "rotation": (instants, bodies, 3, 3),
        "joint_angle": (instants, dofs),
        "target_rate": (instants, dofs),
        "cpg_output": (instants, dofs),
        "torque": (instants, dofs),
        "distance": (instants,),
        "goal": (3,),
    }
    for name, shape in shapes.items():
        found = getattr(recording, name).shape
        if found != shape or not (instants and bodies):
            raise RecordingError(f"its {name} has the shape {found}, not {shape}")


def require_whole(recording: Recording, creature: Creature) -> None:
    """Check that a recording shows an animal from its start to its end.

    Args:
        recording: the motion.
        creature: the animal.

    Raises:
        RecordingError: it holds no instant, has other bodies, or is not finite.
    """
    if not len(recording.time):
        raise RecordingError("the recording is empty: it holds no instant")
    if recording.position.shape[1] != len(creature.bodies):
        raise RecordingError(
            f"the recording has {recording.position.shape[1]} bodies, "
            f"but {creature.name!r} has {len(creature.bodies)}; they do not belong together"
        )
    finite = np.isfinite(recording.position).all((1, 2))
    finite &= np.isfinite(recording.rotation).all((1, 2, 3))
    if not finite.all():
        raise RecordingError(
            f"the recording diverges at {recording.time[finite.argmin()]:g} s: "
            "positions or rotations are not finite from there on"
        )
