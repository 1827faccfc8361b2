"""Double precision, as in MuJoCo, and compiled models."""

import jax
import mujoco
import numpy as np
import pytest

from evo_cpg.creature.tree import build_tree
from evo_cpg.io.models.mjcf_export import mjcf_model, mjcf_text
from evo_cpg.io.models.mjcf_import import read_model
from evo_cpg.io.models.mujoco_state import dof_order, load_state, motor_order


@pytest.fixture(autouse=True)
def double_precision():
    with jax.enable_x64(True):
        yield


@pytest.fixture
def compiled():
    """Export a creature with arguments of `mjcf_model`, and compile it with MuJoCo."""

    def make(*arguments, **options) -> mujoco.MjModel:
        return mujoco.MjModel.from_xml_string(mjcf_text(mjcf_model(*arguments, **options)))

    return make


@pytest.fixture
def same_inertias(compiled):
    """Compare every body's mass, centre of mass and inertia about it with MuJoCo's."""

    def compare(creature, accuracy: float) -> None:
        tree, model = build_tree(creature), compiled(creature, 9.81)
        assert model.nbody == tree.body_count + 1
        for i, name in enumerate(tree.names):
            body, turn = model.body(name), np.zeros(9)
            assert body.mass[0] == pytest.approx(tree.mass[i], rel=accuracy)
            np.testing.assert_allclose(body.ipos, tree.com[:, i], atol=0.01 * accuracy)
            mujoco.mju_quat2Mat(turn, body.iquat)
            turn = turn.reshape(3, 3)
            expected = creature.bodies[creature.body_index(name)].shape.inertia(tree.mass[i])
            inertia = turn @ np.diag(body.inertia) @ turn.T
            np.testing.assert_allclose(inertia, expected, atol=accuracy * expected.max())

    return compare


@pytest.fixture
def mujocos():
    """Return MuJoCo's accelerations of the root and the joints, in our order."""

    def accelerations(data, tree, state, control) -> np.ndarray:
        rotation = load_state(data.model, data, tree, state)
        data.ctrl = control[motor_order(data.model, tree)]
        mujoco.mj_forward(data.model, data)
        order = 6 + dof_order(data.model, tree)
        return np.concatenate([rotation @ data.qacc[3:6], data.qacc[:3], data.qacc[order]])

    return accelerations


@pytest.fixture
def write(tmp_path):
    """Write a model."""

    def call(text: str):
        path = tmp_path / "model.xml"
        path.write_text(text, encoding="utf-8")
        return path

    return call


@pytest.fixture
def read(write):
    """Import a model from text."""
    return lambda text, **options: read_model(write(text), **options)
