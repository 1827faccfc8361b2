"""The same creature as a MuJoCo model: the tests' oracle and the benchmarks' peer."""

from collections.abc import Sequence
from xml.etree.ElementTree import Element

import mujoco
import numpy as np

from evo_cpg.creature.creature import Creature
from evo_cpg.creature.tree import Tree
from evo_cpg.exchange.mjcf_export import mjcf_model, mjcf_text
from evo_cpg.physics.footing import Ground
from evo_cpg.physics.state import State

GRAVITY = 9.81


def mujoco_model(
    creature: Creature,
    options: dict[str, float | str] | None = None,
    fluid: str = "",
    motors: bool = False,
    limits: bool = False,
    ground: Ground | None = None,
    start: tuple[float, float, float] = (0.0, 0.0, 0.0),
    pairs: Sequence[tuple[str, str]] = (),
) -> mujoco.MjModel:
    """Compile a creature for MuJoCo.

    Args:
        creature: the animal.
        options: attributes of MuJoCo's ``option`` element.
        fluid: the ``fluidshape`` of every geom; empty for MuJoCo's default, the inertia box.
        motors: let the motors work (see `motor_order`).
        limits: hold every joint within its limits, with MuJoCo's own soft constraint.
        ground: that every body may touch.
        start: place of the root's centre at the start, m.
        pairs: names of bodies that may touch each other.
    """
    root = mjcf_model(creature, GRAVITY, ground, start=start, pairs=pairs)
    for key, value in (options or {}).items():
        _part(root, "option").set(key, str(value))
    if fluid:
        _part(root, "default/geom").set("fluidshape", fluid)
    model = mujoco.MjModel.from_xml_string(mjcf_text(root))
    for off, flag in (
        (not motors, mujoco.mjtDisableBit.mjDSBL_ACTUATION),
        (not limits, mujoco.mjtDisableBit.mjDSBL_LIMIT),
        (ground is None and not pairs, mujoco.mjtDisableBit.mjDSBL_CONTACT),
    ):
        if off:
            model.opt.disableflags |= flag
    return model


def dof_order(model: mujoco.MjModel, tree: Tree) -> np.ndarray:
    """Index of MuJoCo's joint degree of freedom for each of the tree's, the root's six left out."""
    order = []
    for name in dict.fromkeys(tree.names[i] for i in tree.dof_bodies):
        body = model.body(name)
        order.extend(range(body.dofadr[0] - 6, body.dofadr[0] - 6 + body.dofnum[0]))
    return np.array(order, int)


def motor_order(model: mujoco.MjModel, tree: Tree) -> np.ndarray:
    """Index of the tree's degree of freedom that each of MuJoCo's motors drives."""
    driven = model.jnt_dofadr[model.actuator_trnid[:, 0]] - 6
    return np.argsort(dof_order(model, tree))[driven]


def load_state(model: mujoco.MjModel, data: mujoco.MjData, tree: Tree, state: State) -> np.ndarray:
    """Put one individual's pose and velocities into MuJoCo's data.

    Returns:
        The root's rotation matrix: MuJoCo has the root's angular velocity in its own axes.
    """
    order = dof_order(model, tree)
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, np.asarray(state.orientation, float))
    rotation = rotation.reshape(3, 3)
    data.qpos[:3], data.qpos[3:7] = state.position, state.orientation
    data.qpos[7 + order] = state.q
    data.qvel[:3], data.qvel[3:6] = state.velocity[3:], rotation.T @ state.velocity[:3]
    data.qvel[6 + order] = state.qd
    return rotation


def _part(root: Element, path: str) -> Element:
    """The element at a path that every exported model has."""
    found = root.find(path)
    assert found is not None
    return found
