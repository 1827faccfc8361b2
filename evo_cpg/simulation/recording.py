"""The motion of one individual, as films, plots and exports need it."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float


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
