"""Our animals and MuJoCo's are equal in the benchmark, and get equal commands."""

import dataclasses

import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from benchmarks.exercise import Postures, Torques, Wave
from benchmarks.mujoco_model import mujoco_model
from benchmarks.mujoco_peer import DRY, WET, Motion, Peer, peer_model, stopped
from benchmarks.plan import MODELS, experiment_of
from evo_cpg.io.models.mujoco_state import dof_order, motor_order
from evo_cpg.simulation.situation import Situation

COUNT = 24


@pytest.fixture(scope="module")
def quadruped():
    return experiment_of("fukui2003_model1")


@pytest.fixture(scope="module")
def model(quadruped):
    return peer_model(Postures(quadruped), DRY[0])


def test_the_model_has_the_animals_masses_motors_and_limits(quadruped, model):
    tree = quadruped.simulation.world.tree
    for name, mass in zip(tree.names, tree.mass, strict=True):
        assert model.body(name).mass[0] == pytest.approx(mass, rel=1e-12)
    motors = motor_order(model, tree)
    assert sorted(motors) == list(range(8))
    np.testing.assert_allclose(model.actuator_gainprm[:, 0], tree.servo_stiffness[motors])
    np.testing.assert_allclose(-model.actuator_biasprm[:, 2], tree.servo_gain[motors])
    limit = tree.torque_limit[motors]
    np.testing.assert_allclose(model.actuator_forcerange, np.stack([-limit, limit], -1))
    joints = dof_order(model, tree) + 1
    np.testing.assert_allclose(model.jnt_range[joints], np.stack([tree.lower, tree.upper], -1))
    assert model.jnt_limited[1:].all()


def test_bodies_touch_the_floor_and_our_contact_pairs(quadruped, model):
    """A folded animal in the floor has friction with the floor, and none between limbs."""
    data = mujoco.MjData(model)
    data.qpos[2], data.qpos[7:] = 0.0, 2.5
    mujoco.mj_forward(model, data)
    (floor,) = np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE)
    on_floor = (data.contact.geom == floor).any(1)
    assert on_floor.sum() > 4 and (~on_floor).sum() > 4
    np.testing.assert_allclose(data.contact.friction[on_floor, 0], 0.8)
    np.testing.assert_array_equal(data.contact.dim, np.where(on_floor, 3, 1))
    limbs = {
        frozenset(model.geom(number).name for number in pair)
        for pair in data.contact.geom[~on_floor]
    }
    assert limbs <= set(map(frozenset, quadruped.simulation.world.pair_names))


def walk(experiment, steps):
    """Return the states of MuJoCo's individuals from rest."""
    exercise = Postures(experiment)
    motion = Motion(exercise, DRY[0], exercise.lanes(COUNT), 1)
    return motion.states(motion.rest(), motion.signals(steps))


def test_mujoco_reaches_the_postures_of_the_controller(quadruped):
    """In free fall, the springs bring the joints to their angles: 1/3 s is 17 time constants.

    Limbs pass through each other here, so that none blocks another.
    """
    aloft = (Situation((0.0, 0.0, 20.0)),)
    ghost = dataclasses.replace(quadruped.simulation.world, pairs=None)
    simulation = dataclasses.replace(quadruped.simulation, situations=aloft, world=ghost)
    world, h, steps = simulation.world, simulation.step_length, 160
    exercise = Postures(quadruped)
    assert exercise.numbers(np.arange(steps + 1)).tolist() == [0] * 80 + [1] * 80 + [2]
    states = walk(quadruped._replace(simulation=simulation), steps)
    assert not stopped(states, steps * h).any()
    angles = simulation.controller.decode(jnp.asarray(exercise.lanes(COUNT)))
    order = dof_order(mujoco_model(quadruped.creature), world.tree)
    for posture in (0, 1):
        # The clock and the root's pose come first.
        joints = states[:, 80 * posture + 79, 1 + 7 : 1 + 7 + 8][:, order].T
        np.testing.assert_allclose(joints, angles[posture], atol=np.deg2rad(1))


def test_individuals_that_diverged_are_counted(quadruped, monkeypatch, tmp_path):
    """At 1/60 s, many individuals diverge within 7 steps. MuJoCo logs each of them."""
    monkeypatch.chdir(tmp_path)  # MuJoCo writes its log into the working folder
    simulation = dataclasses.replace(quadruped.simulation, substeps=1)
    states, seconds = walk(quadruped._replace(simulation=simulation), 7), 7 / 60
    lost = stopped(states, seconds)
    logged = (tmp_path / "MUJOCO_LOG.TXT").read_text().count("unstable")
    assert lost.sum() == logged
    assert 0 < logged < COUNT
    states[~lost, -1, 5] = np.nan
    assert stopped(states, seconds).all()


@pytest.mark.parametrize("kind", ["wave", "postures", "torques"])
def test_both_sides_get_equal_commands(quadruped, kind):
    """Our commands are computed step by step, and MuJoCo's all at once."""
    exercise = {
        "wave": lambda: Wave(experiment_of("iwadate2010_swimmer")),
        "postures": lambda: Postures(quadruped),
        "torques": lambda: Torques.of(MODELS / "ant.xml"),
    }[kind]()
    lanes = exercise.lanes(3)
    np.testing.assert_array_equal(lanes, exercise.lanes(50)[:, :3])
    index = np.array([0, 1, 79, 80, 119, 120, 300])
    signals = exercise.signals(lanes, index)
    commands = exercise.prepare(jnp.asarray(lanes))
    for place, number in enumerate(index):
        rate, angle, _, torque = exercise.command(commands, jnp.int32(number))
        ours = next((x for x in (angle, torque) if x is not None), rate)
        np.testing.assert_allclose(ours.T, signals[:, place], atol=1e-5)
    assert np.ptp(signals, axis=0).max() > 0.1


def test_the_swimmer_has_three_kinds_of_water():
    exercise = Wave(experiment_of("iwadate2010_swimmer"))
    models = [peer_model(exercise, kind) for kind in WET]
    assert [model.opt.density for model in models] == [1000, 1000, 0]
    assert [bool(model.geom_fluid[:, 0].any()) for model in models] == [True, False, False]
    assert all(not model.opt.gravity.any() for model in models)


@pytest.mark.parametrize("name", ["half_cheetah", "ant"])
def test_an_imported_animal_starts_at_our_height_with_our_motors(name):
    """MuJoCo's controls times gears are our torques at the joints of the same names."""
    exercise = Torques.of(MODELS / f"{name}.xml")
    simulation, lanes = exercise.experiment.simulation, exercise.lanes(2)
    model, *_ = Peer.of(exercise, DRY[0])
    assert model.opt.timestep == simulation.step_length
    motion = Motion(exercise, DRY[0], lanes, 1)
    start = motion.places(motion.rest()[:, None])
    np.testing.assert_allclose(start[:, 0], simulation.situations[0].start_position, atol=1e-9)
    forces = motion.signals(1)[:, 0] * model.actuator_gear[:, 0]
    torques = exercise.signals(lanes, np.array([0]))[:, 0]
    joints = [model.joint(number).name for number in model.actuator_trnid[:, 0]]
    tree = simulation.world.tree
    ours = [tree.names[body] for body in tree.dof_bodies]
    own = {joint: name for name, (joint, *_) in exercise.imported.joints.items()}
    for place, joint in enumerate(joints):
        body = own[model.actuator_trnid[place, 0]]
        np.testing.assert_allclose(forces[:, place], torques[:, ours.index(body)], err_msg=joint)
    assert (np.abs(motion.signals(40)) <= 1).all()
