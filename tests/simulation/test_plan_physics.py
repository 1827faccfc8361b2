"""Physics of random plans: mass matrix, buoyancy, free fall, energy, and MuJoCo's accelerations."""

import functools

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from creatures import quick_jit
from evo_cpg.control.limb_oscillators import GENES
from evo_cpg.creature.algebra.linear import expand_dims_like
from evo_cpg.creature.development import developed
from evo_cpg.creature.tree import build_tree
from evo_cpg.io.models.mjcf_export import mjcf_model, mjcf_text
from evo_cpg.io.models.mujoco_state import dof_order, load_state, motor_order
from evo_cpg.io.plans import EvolvedPlans, creature_of
from evo_cpg.io.schema.creature import CreatureConfig
from evo_cpg.physics.step.equations import body_equations
from evo_cpg.physics.tree.articulated import solve
from evo_cpg.physics.tree.generalized import generalized_equations, generalized_force
from evo_cpg.physics.tree.joint_torque import passive_torque
from evo_cpg.physics.tree.kinematics import kinematics, motion_of_bodies
from evo_cpg.physics.tree.spatial_algebra import Wrench
from evo_cpg.physics.tree.state import State
from evo_cpg.simulation.batched import BatchedSimulation
from evo_cpg.simulation.recording import Recorder
from evo_cpg.simulation.rollout import rollout
from plans import WATER, plans_of, random_genes

GRAVITY, WATER_DENSITY = 9.81, 1000.0
DRY = {"water": None, "gravity": GRAVITY}
STILL = {"water": {"density": WATER_DENSITY}}
# Number of plans in a vector.
CHUNK = 250
# Bodies and number of plans: fast, and slow.
FEW = 6, 50
MANY = pytest.param(20, 10_000, marks=pytest.mark.slow)
each_size = pytest.mark.parametrize(("bodies", "count"), [FEW, MANY])


@pytest.fixture(autouse=True)
def double_precision():
    with jax.enable_x64(True):
        yield


@functools.cache
def drawn(plans: EvolvedPlans, count: int):
    """Return the genes of random plans and their arrays."""
    genes = random_genes(plans, count)
    return genes, plans.developed(genes)


def chunks(count: int) -> list[np.ndarray]:
    """Return the numbers of the plans of each vector. Vectors are equally long."""
    width = min(CHUNK, count)
    return [np.arange(first, first + width) for first in range(0, count, width)]


def states_of(tree_limits: np.ndarray, count: int, seed: int) -> State:
    """Return random states within joint limits ``(d, n)``. Absent axes do not turn."""
    rng = np.random.default_rng(seed)
    present = tree_limits < 10
    turn = rng.normal(size=(4, count))
    shape = tree_limits.shape
    return State(
        position=jnp.asarray(rng.normal(size=(3, count))),
        orientation=jnp.asarray(turn / np.linalg.norm(turn, axis=0)),
        velocity=jnp.asarray(rng.normal(scale=2.0, size=(6, count))),
        q=jnp.asarray(np.where(present, 0.9 * tree_limits * rng.uniform(-1, 1, shape), 0.0)),
        qd=jnp.asarray(np.where(present, rng.normal(scale=3.0, size=shape), 0.0)),
    )


def limits_of(found: tuple, size: int, axes: int) -> np.ndarray:
    """Return the upper limits ``(d, n)`` of plans in the program for some bodies, rad."""
    return found[2].laws[2, : (size - 1) * axes]


@functools.cache
def mechanics(bodies: int):
    """Compile quantities of dry plans in some states, with motors at target rates."""
    plans = plans_of(DRY, bodies, 0.25)
    inputs = plans.inputs(plans.sizes[-1])

    def one(values, state, target):
        world = inputs.put(inputs.common, [values]).world
        tree = world.tree
        kin = kinematics(tree, state)
        inertia, bias = body_equations(world, kin, 0.0)
        passive, derivative = passive_torque(tree, state, 0.0)
        tau = passive + tree.servo_gain * (target - state.qd)
        rotor = derivative + expand_dims_like(tree.armature, tau)
        given = tree, kin, inertia, bias, tau, rotor
        matrix, _ = generalized_equations(*given)
        moving = motion_of_bodies(tree, kin, state.velocity, state.qd)
        return {
            "matrix": matrix,
            "acceleration": jnp.concatenate(solve(*given)),
            "rotation": kin.rotation,
            "angular": moving.angular,
            "linear": moving.linear,
            "armature": tree.armature + jnp.zeros_like(state.qd),
        }

    return plans, quick_jit(jax.vmap(one, -1, -1))


def observed(bodies: int, count: int):
    """Yield numbers, states, target rates and quantities of dry plans, vector by vector."""
    plans, run = mechanics(bodies)
    _, found = drawn(plans, count)
    size, axes = plans.sizes[-1], len(plans.section.axes)
    limits = limits_of(found, size, axes)
    for own in chunks(count):
        state = states_of(limits[:, own], len(own), own[0])
        target = np.random.default_rng(own[0] + 1).normal(size=(len(limits), len(own)))
        values = plans.given(found, own, size)[1]
        out = jax.tree.map(np.asarray, run(values, state, target))
        numbers = jax.tree.map(lambda x, own=own: x[..., own], found[2])
        yield own, numbers, jax.tree.map(np.asarray, state), target, out


def kinetic_energy(numbers, rotation, angular, linear) -> np.ndarray:
    """Return the kinetic energy of boxes ``(b, *n)`` from their motion about their centres, J."""
    half, mass = numbers.half[:, : rotation.shape[2]], numbers.mass[: rotation.shape[2]]
    square = half * half
    about = mass / 3 * (square.sum(0) - square)
    local = (rotation * angular[:, None]).sum(0)
    return 0.5 * ((mass * (linear**2).sum(0)) + (about * local**2).sum(0)).sum(0)


@each_size
@pytest.mark.slow
def test_mass_matrices_are_positive_definite(bodies, count):
    """Their quadratic form is the kinetic energy, which NumPy sums over boxes, to 1e-10."""
    for _, numbers, state, _, out in observed(bodies, count):
        matrix = np.moveaxis(out["matrix"], -1, 0)
        np.testing.assert_allclose(matrix, matrix.swapaxes(1, 2), rtol=0, atol=1e-12)
        unit = 1 / np.sqrt(np.einsum("nii->ni", matrix))
        assert np.linalg.eigvalsh(unit[:, :, None] * matrix * unit[:, None])[:, 0].min() > 1e-8
        y = np.concatenate([state.velocity, state.qd])
        found = 0.5 * np.einsum("in,nij,jn->n", y, matrix, y)
        reach = np.stack([numbers.reach, *np.zeros((2, *numbers.reach.shape))])
        lever = (out["rotation"] * reach[None, :, : out["rotation"].shape[2]]).sum(1)
        centre = out["linear"] + np.cross(out["angular"], lever, axis=0)
        energy = kinetic_energy(numbers, out["rotation"], out["angular"], centre)
        energy += 0.5 * (out["armature"] * state.qd**2).sum(0)
        np.testing.assert_allclose(found, energy, rtol=1e-10)


@functools.cache
def in_water(bodies: int, density: float):
    """Compile the force and the accelerations of plans at rest in still water."""
    plans = plans_of(STILL, bodies, 0.25, density=density)
    inputs = plans.inputs(plans.sizes[-1])

    def one(values, state):
        world = inputs.put(inputs.common, [values]).world
        tree, none = world.tree, jnp.zeros_like(state.qd)
        kin = kinematics(tree, state)
        inertia, bias = body_equations(world, kin, 0.0)
        rotor = expand_dims_like(tree.armature, none)
        found = solve(tree, kin, inertia, bias, none, rotor)
        force = generalized_force(tree, kin, Wrench(-bias.moment, -bias.force))
        return jnp.concatenate(found), force

    return plans, quick_jit(jax.vmap(one, -1, -1))


def at_rest(bodies: int, count: int, density: float):
    """Yield numbers, accelerations and generalized forces of plans at rest, vector by vector."""
    plans, run = in_water(bodies, density)
    _, found = drawn(plans, count)
    size, axes = plans.sizes[-1], len(plans.section.axes)
    limits = limits_of(found, size, axes)
    for own in chunks(count):
        state = states_of(limits[:, own], len(own), own[0])
        state = State(state.position, state.orientation, 0 * state.velocity, state.q, 0 * state.qd)
        out = run(plans.given(found, own, size)[1], state)
        yield jax.tree.map(lambda x, own=own: x[..., own], found[2]), *map(np.asarray, out)


@each_size
@pytest.mark.slow
def test_displaced_water_weighs_its_volume(bodies, count):
    """The force on bodies of half the density is the weight of as much water as they weigh."""
    density = 0.5 * WATER_DENSITY
    for numbers, _, force in at_rest(bodies, count, density):
        volume = 8 * numbers.half.prod(0).sum(0)
        lift = GRAVITY * (WATER_DENSITY - density) * volume
        np.testing.assert_allclose(force[5], lift, rtol=1e-12)
        np.testing.assert_allclose(force[3:5], 0, atol=1e-12 * lift.max())
        np.testing.assert_allclose(numbers.mass.sum(0), density * volume, rtol=1e-12)


@each_size
@pytest.mark.slow
def test_plans_as_dense_as_water_stay_at_rest(bodies, count):
    """No part accelerates in any pose, because each floats."""
    for _, acceleration, force in at_rest(bodies, count, WATER_DENSITY):
        assert np.abs(acceleration).max() < 1e-9 * GRAVITY
        assert np.abs(force).max() < 1e-9


def trials(world: dict, bodies: int, seconds: float, controller: dict, begin=None):
    """Compile recorded trials of plans whose limbs have no amplitude, and return their builder."""
    plans = plans_of(world, bodies, seconds, controller)
    size = plans.sizes[-1]
    inputs = plans.inputs(size)
    recorder = Recorder(count=None, full=True)

    @quick_jit
    def run(values, genes):
        given = BatchedSimulation(inputs.common, inputs, (values,))
        return rollout(given, genes, observers=recorder, begin=begin)

    def of(found, own):
        genes, values = plans.given(found, own, size)
        genes = genes.reshape(len(GENES), -1, len(own)).copy()
        genes[GENES.index("amplitude")], genes[GENES.index("start")] = 0.0, 0.5
        return jax.tree.map(np.asarray, run(values, genes.reshape(-1, len(own))))

    return plans, of


@each_size
@pytest.mark.slow
def test_plans_fall_freely(bodies, count):
    """All bodies accelerate with g and do not turn, and no joint moves, to 1e-10.

    A step of length h first changes the velocity, so a body falls by ``g t (t + h) / 2``.
    """
    seconds = 0.25 if count < CHUNK else 0.1
    plans, run = trials(DRY, bodies, seconds, {})
    _, found = drawn(plans, count)
    for own in chunks(count):
        out = run(found, own)
        time = np.arange(len(out["position"])) / 60
        moved = out["position"] - out["position"][:1]
        fall = -0.5 * GRAVITY * time * (time + 1 / 120)
        np.testing.assert_allclose(moved[:, :2], 0, atol=1e-10)
        np.testing.assert_allclose(moved[:, 2], fall[:, None, None] + 0 * moved[:, 2], atol=1e-10)
        speed = -GRAVITY * time[:, None, None]
        np.testing.assert_allclose(out["velocity"][:, 2], speed + 0 * moved[:, 2], atol=1e-10)
        for name in ("angular_velocity", "joint_angle", "joint_rate"):
            np.testing.assert_allclose(out[name], 0, atol=1e-10, err_msg=name)


@each_size
@pytest.mark.slow
def test_passive_plans_lose_energy_in_water(bodies, count):
    """Drag and motors at rest only take energy from bodies that begin with random velocities."""

    def begin(state: State) -> State:
        rng = np.random.default_rng(0)
        velocity, qd = rng.normal(size=6), 2 * rng.normal(size=state.qd.shape)
        return State(state.position, state.orientation, jnp.asarray(velocity), state.q, qd)

    seconds = 0.5 if count < CHUNK else 0.1
    idle = {"rate_gain": 0.0, "centring": 0.0}
    plans, run = trials(WATER, bodies, seconds, idle, begin)
    _, found = drawn(plans, count)
    for own in chunks(count):
        out, numbers = run(found, own), jax.tree.map(lambda x, own=own: x[..., own], found[2])
        frames = zip(out["rotation"], out["angular_velocity"], out["velocity"], strict=True)
        energy = np.stack([kinetic_energy(numbers, *frame) for frame in frames])
        assert (energy[0] > 0.01).all()
        assert (np.diff(energy, axis=0) < 1e-9 * energy[0]).mean() > 0.99
        assert (energy <= energy[0] * (1 + 1e-9)).all()
        assert (energy[-1] < 0.95 * energy[0]).all()


@functools.cache
def grown(plans: EvolvedPlans, count: int):
    """Return random plans as NumPy arrays, plans first."""
    genes, _ = drawn(plans, count)

    def one(genes):
        return developed(plans.layout.unpack(genes), plans.layout, plans.bounds)

    grow = quick_jit(jax.vmap(one, -1))
    parts = [jax.tree.map(np.asarray, grow(genes[:, own])) for own in chunks(count)]
    return jax.tree.map(lambda *x: np.concatenate(x), *parts)


def place_of(name: str, axes: tuple[int, ...]) -> int:
    """Return the place of a degree of freedom of an own creature in the program of plans."""
    body, axis = name.rsplit(".", 1)
    return (int(body.removeprefix("part")) - 1) * len(axes) + axes.index("xyz".index(axis[-1]))


@pytest.mark.parametrize(
    ("bodies", "count"), [(3, 20), pytest.param(20, 2000, marks=pytest.mark.slow)]
)
@pytest.mark.slow
def test_plans_accelerate_as_in_mujoco(bodies, count):
    """MuJoCo simulates the exported creatures, with motors at random target rates: 1e-9."""
    plans, _ = mechanics(bodies)
    every, axes, errors = grown(plans, count), plans.section.axes, []
    for own, _, state, target, out in observed(bodies, count):
        for k, i in enumerate(own):
            plan = jax.tree.map(lambda x, i=i: x[i], every)
            data = creature_of(plan, plans.section)
            creature = CreatureConfig.model_validate(data).build()
            tree = build_tree(creature)
            model = mujoco.MjModel.from_xml_string(mjcf_text(mjcf_model(creature, GRAVITY)))
            dofs = np.array([place_of(name, axes) for name in tree.dof_names])
            mujocos, fields = mujoco.MjData(model), ("position", "orientation", "velocity")
            pose = [getattr(state, name)[:, k] for name in fields]
            rotation = load_state(
                model, mujocos, tree, State(*pose, state.q[dofs, k], state.qd[dofs, k])
            )
            mujocos.ctrl = target[dofs, k][motor_order(model, tree)]
            mujoco.mj_forward(model, mujocos)
            a, order = mujocos.qacc, 6 + dof_order(model, tree)
            theirs = np.concatenate([rotation @ a[3:6], a[:3], a[order]])
            ours = out["acceleration"][np.concatenate([np.arange(6), 6 + dofs]), k]
            errors.append(np.abs(ours - theirs).max() / np.abs(theirs).max())
    assert len(errors) == count
    assert max(errors) < 1e-9
