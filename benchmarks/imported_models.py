"""Import all models in a folder, and compare their accelerations with MuJoCo's.

    python -m benchmarks.imported_models FOLDER [--drop] [--states 100]

A line for each MJCF or URDF file of at least two moving bodies says whether it comes in, and the
largest difference of the accelerations, relative to the largest acceleration. The states, the
rates and the controls are random. Contact, limits, dry friction and the fluid are off in both
programs. For a refused model the line gives the reasons.
"""

import argparse
import contextlib
import dataclasses
import os
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from evo_cpg.creature.algebra.linear import expand_dims_like
from evo_cpg.creature.creature import Creature, neutral_pose
from evo_cpg.creature.tree import Tree, build_tree
from evo_cpg.io.load import check_config
from evo_cpg.io.models.compiled import Compiled, compile_model
from evo_cpg.io.models.mjcf_import import Imported, read_model
from evo_cpg.io.models.refusals import ExchangeError
from evo_cpg.physics.step.equations import body_equations
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.articulated import solve
from evo_cpg.physics.tree.generalized import generalized_force, mass_matrix
from evo_cpg.physics.tree.joint_torque import (
    MotorCommand,
    clamp_torque,
    motor_torque,
    passive_torque,
)
from evo_cpg.physics.tree.kinematics import kinematics
from evo_cpg.physics.tree.root import ROOT_DOFS
from evo_cpg.physics.tree.spatial_algebra import Wrench
from evo_cpg.physics.tree.state import State, resting_state
from evo_cpg.physics.tree.tendon import TendonForce, tendon_laws

# Spread of random angles (rad or m) and rates (rad/s or m/s).
_ANGLE, _RATE = 0.5, 2.0

# Accelerations (rad/s^2 or m/s^2) below which a model counts as at rest. Rounding is relative to
# the forces that cancel, and this is a hundredth of gravity.
_RESTING = 0.1

# Bodies of the smallest model that counts, with the world.
_FEWEST = 3


class Sample(NamedTuple):
    """Random states of a model in both programs.

    Attributes:
        state: our states. The last axis is the sample.
        command: our commands.
        expected: MuJoCo's accelerations in our coordinates: root (if free), then joints.
    """

    state: State
    command: MotorCommand
    expected: np.ndarray


def largest_difference(path: Path, states: int = 100, drop: bool = False, seed: int = 0) -> float:
    """Return the largest difference of accelerations, relative to the largest one.

    Raises:
        ExchangeError: the model is refused.
    """
    imported = read_model(path, drop=drop)
    config = check_config(imported.experiment, path)
    creature = config.creature.build()
    tree = build_tree(creature)
    compiled = compile_model(path, drop)
    with jax.enable_x64(True):
        sample = sampled(imported, creature, tree, compiled, states, np.random.default_rng(seed))
        world = World(tree, config.world.gravity)
        found = np.asarray(accelerations(world, sample.state, sample.command))
    scale = np.maximum(np.abs(sample.expected).max(0), _RESTING)
    return float((np.abs(found - sample.expected).max(0) / scale).max())


@jax.jit
def accelerations(world: World, state: State, command: MotorCommand) -> jax.Array:
    """Return the accelerations in many states, as by a step of no time: root (if free), joints.

    Springs, dampers, rotors, motors and tendons act. Contact, limits and dry friction do not.
    """
    tree = world.tree
    state = state.placed(tree)
    kin = kinematics(tree, state)
    inertia, bias = body_equations(world, kin, 0.0)
    passive, derivative = passive_torque(tree, state, 0.0)
    motor = clamp_torque(tree, motor_torque(tree, state, command, 0.0).start)
    rotor = derivative + expand_dims_like(tree.armature, motor)
    if tree.tendons is None:
        found = solve(tree, kin, inertia, bias, passive + motor, rotor)
        free = () if tree.hanging is not None else (found.root,)
        return jnp.concatenate([*free, found.qdd])
    laws = tendon_laws(tree.tendons, state, command, 0.0)
    assert laws is not None
    pull = laws.passive + clamp_torque(tree.tendons, laws.motor.start)
    still = jnp.zeros((ROOT_DOFS, *motor.shape[1:]))
    own = jnp.concatenate([still, jnp.broadcast_to(rotor, motor.shape)])
    matrix = mass_matrix(tree, kin, inertia) + jnp.eye(len(own))[..., None] * own[None]
    force = generalized_force(tree, kin, Wrench(-bias.moment, -bias.force))
    force = force + jnp.concatenate([still, passive + motor])
    matrix, force = TendonForce(tree.tendons, pull, laws.derivative).added_to(matrix, force)
    every = jnp.linalg.solve(jnp.moveaxis(matrix, -1, 0), force.T[..., None])[..., 0].T
    return every if tree.hanging is None else every[ROOT_DOFS:]


def sampled(
    imported: Imported,
    creature: Creature,
    tree: Tree,
    compiled: Compiled,
    count: int,
    rng: np.random.Generator,
) -> Sample:
    """Return random states and MuJoCo's accelerations in them."""
    mujoco, model = compiled.mujoco, compiled.model
    _switch_off(compiled, bool(imported.experiment["world"]["water"]))
    data = mujoco.MjData(model)
    rest = resting_state(tree, dtype=float, position=imported.place)
    turns = dict(zip([b.name for b in creature.bodies], neutral_pose(creature)[1], strict=True))
    free = tree.hanging is None
    dofs = _dofs(imported, tree, compiled)
    rows, expected = [], []
    for _ in range(count):
        data.qpos[:] = model.qpos0
        data.qvel[:] = rng.normal(scale=_RATE, size=model.nv)
        mujoco.mj_integratePos(model, data.qpos, rng.normal(scale=_ANGLE, size=model.nv), 1.0)
        data.act[:] = rng.uniform(-1.0, 1.0, model.na)
        low, high = model.actuator_ctrlrange.T
        limited = model.actuator_ctrllimited.astype(bool)
        data.ctrl[:] = rng.uniform(np.where(limited, low, -1.0), np.where(limited, high, 1.0))
        mujoco.mj_forward(model, data)
        q, qd, qdd = (np.zeros(tree.dof_count) for _ in range(3))
        for dof in dofs:
            q[dof.ours], qd[dof.ours], qdd[dof.ours] = dof.read(
                compiled, data, turns[tree.names[dof.body]]
            )
        command = _command(tree, compiled, data, dofs)
        root, root_acceleration = _root(imported, tree, compiled, data) if free else (rest, [])
        rows.append((dataclasses.replace(root, q=q, qd=qd), command))
        expected.append(np.concatenate([root_acceleration, qdd]))
    state, command = jax.tree.map(lambda *x: np.stack(x, -1), *rows)
    return Sample(state, command, np.array(expected).T)


class Dof(NamedTuple):
    """Degrees of freedom of one of MuJoCo's joints.

    Attributes:
        joint: MuJoCo's number of the joint.
        body: our number of its body.
        ours: our numbers of the degrees of freedom.
    """

    joint: int
    body: int
    ours: slice

    def read(self, compiled: Compiled, data: Any, axes: np.ndarray) -> tuple[Any, Any, Any]:
        """Return angles, rates and accelerations in our coordinates.

        Args:
            compiled: MuJoCo's model.
            data: MuJoCo's state.
            axes: axes of our body in the neutral pose, in the world ``(3, 3)``.
        """
        model = compiled.model
        place, dof = int(model.jnt_qposadr[self.joint]), int(model.jnt_dofadr[self.joint])
        count = self.ours.stop - self.ours.start
        rate, acceleration = data.qvel[dof : dof + count], data.qacc[dof : dof + count]
        if count == 1:
            return data.qpos[place] - model.qpos0[place], rate, acceleration
        # A ball. MuJoCo's axes are those of its body, and ours those of our body.
        neutral = compiled.data.xmat[model.jnt_bodyid[self.joint]]
        turn = axes.T @ np.array(neutral).reshape(3, 3)
        angle = Rotation.from_quat(data.qpos[place : place + 4], scalar_first=True).as_rotvec()
        return turn @ angle, turn @ rate, turn @ acceleration


def _dofs(imported: Imported, tree: Tree, compiled: Compiled) -> list[Dof]:
    ball = compiled.mujoco.mjtJoint.mjJNT_BALL
    found = []
    for name, joints in imported.joints.items():
        body = tree.names.index(name)
        first = tree.dof_bodies.index(body)
        for joint in joints:
            count = 3 if int(compiled.model.jnt_type[joint]) == ball else 1
            found.append(Dof(joint, body, slice(first, first + count)))
            first += count
    return found


def _root(
    imported: Imported, tree: Tree, compiled: Compiled, data: Any
) -> tuple[State, np.ndarray]:
    """Return the pose and velocity of a free root in our frame, and its acceleration."""
    model, start = compiled.model, compiled.data
    body = _root_body(imported, compiled)
    dof = int(model.body_dofadr[body])
    turn = np.array(data.xmat[body]).reshape(3, 3)
    moved = turn @ np.array(start.xmat[body]).reshape(3, 3).T
    arm = moved @ (np.array(imported.place) - start.xpos[body])
    spin, push = turn @ data.qvel[dof + 3 : dof + 6], data.qvel[dof : dof + 3]
    turning, pushing = turn @ data.qacc[dof + 3 : dof + 6], data.qacc[dof : dof + 3]
    quaternion = Rotation.from_matrix(moved).as_quat(scalar_first=True)
    velocity = np.concatenate([spin, push + np.cross(spin, arm)])
    linear = pushing + np.cross(turning, arm) + np.cross(spin, np.cross(spin, arm))
    still = np.zeros(tree.dof_count)
    place, q = jnp.asarray(data.xpos[body] + arm), jnp.asarray(still)
    state = State(place, jnp.asarray(quaternion), jnp.asarray(velocity), q, q)
    return state, np.concatenate([turning, linear])


def _root_body(imported: Imported, compiled: Compiled) -> int:
    name = imported.experiment["creature"]["bodies"][0]["name"]
    model = compiled.model
    tops = [
        b for b in range(1, model.nbody) if model.body_parentid[b] == 0 and model.body_dofnum[b]
    ]
    mujoco = compiled.mujoco
    named = [b for b in tops if mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY, b) == name]
    return (named or tops)[0]


def _command(tree: Tree, compiled: Compiled, data: Any, dofs: list[Dof]) -> MotorCommand:
    """Return our commands for MuJoCo's controls."""
    mujoco, model = compiled.mujoco, compiled.model
    rate, angle, torque = (np.zeros(tree.dof_count) for _ in range(3))
    ours = {dof.joint: dof.ours.start for dof in dofs}
    for number in range(model.nu):
        target, laws = int(model.actuator_trnid[number, 0]), tree
        if int(model.actuator_trntype[number]) == mujoco.mjtTrn.mjTRN_TENDON:
            name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_TENDON, target)
            if tree.tendons is None or name not in tree.tendons.names:
                continue
            laws, i = tree.tendons, tree.tendons.names.index(name)
            channel, neutral = tree.tendons.channels[i], float(model.tendon_length0[target])
        elif int(model.actuator_trntype[number]) <= 1 and target in ours:
            channel = i = ours[target]
            neutral = float(model.qpos0[model.jnt_qposadr[target]])
        else:
            continue
        gear, address = float(model.actuator_gear[number, 0]), int(model.actuator_actadr[number])
        control = data.ctrl[number] if address < 0 else data.act[address]
        push = gear * float(model.actuator_gainprm[number, 0] * control)
        if int(model.actuator_biastype[number]):
            push += gear * float(model.actuator_biasprm[number, 0])
        spring, gain = float(laws.servo_stiffness[i]), float(laws.servo_gain[i])
        if spring:
            angle[channel] = push / spring - neutral
        elif gain:
            rate[channel] = push / gain
        else:
            torque[channel] = push
    return MotorCommand(jnp.asarray(rate), jnp.asarray(angle), torque=jnp.asarray(torque))


def _switch_off(compiled: Compiled, floats: bool) -> None:
    """Switch off what the comparison leaves out."""
    model, flags = compiled.model, compiled.mujoco.mjtDisableBit
    off = flags.mjDSBL_CONTACT | flags.mjDSBL_LIMIT | flags.mjDSBL_FRICTIONLOSS
    model.opt.disableflags |= off | flags.mjDSBL_EQUALITY
    model.opt.density = model.opt.viscosity = 0.0
    model.opt.wind[:] = 0.0
    if floats:
        model.body_gravcomp[:] = 0.0


def models(folder: Path) -> Iterator[Path]:
    """Yield the files in a folder that MuJoCo compiles to at least two bodies."""
    for path in sorted(folder.rglob("*")):
        if path.suffix not in (".xml", ".urdf") or not path.is_file():
            continue
        text = path.read_text(errors="replace")
        if "<mujoco" not in text and "<robot" not in text:
            continue
        with contextlib.suppress(ExchangeError):
            if compile_model(path).model.nbody >= _FEWEST:
                yield path


def report(folder: Path, states: int, drop: bool, write: Callable[[str], object] = print) -> int:
    """Write a line for each model, and return the number of models that come in."""
    count = found = 0
    for path in models(folder):
        count += 1
        name = path.relative_to(folder)
        try:
            difference = largest_difference(path, states, drop)
        except ExchangeError as error:
            write(f"refused   {name}: {error}")
            continue
        found += 1
        write(f"{difference:9.1e} {name}")
    write(f"{found} of {count} models come in")
    return found


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--drop", action="store_true")
    parser.add_argument("--states", type=int, default=100)
    given = parser.parse_args()
    os.environ.setdefault("JAX_PLATFORMS", "cpu")
    warnings.simplefilter("ignore")
    report(given.folder, given.states, given.drop)


if __name__ == "__main__":
    main()
