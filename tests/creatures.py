"""Creatures, states and worlds for several tests of the physics."""

import dataclasses
from importlib.metadata import version

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from evo_cpg.creature.algebra.linear import expand_dims_like
from evo_cpg.creature.algebra.rotation import euler_to_matrix
from evo_cpg.creature.creature import Body, Creature, Joint, Material, Motor
from evo_cpg.creature.shapes import Box, Capsule, Ellipsoid, Shape, Sphere
from evo_cpg.creature.surface import outer_surfaces
from evo_cpg.creature.tree import Tree, build_tree
from evo_cpg.io.models.mujoco_state import dof_order, load_state
from evo_cpg.native.jax_internals import quick_jit
from evo_cpg.physics.step.equations import body_equations
from evo_cpg.physics.step.step import step
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.articulated import solve
from evo_cpg.physics.tree.generalized import generalized_equations
from evo_cpg.physics.tree.joint_torque import passive_torque
from evo_cpg.physics.tree.kinematics import kinematics
from evo_cpg.physics.tree.state import State, resting_state
from evo_cpg.physics.water.added_mass import AddedMass, added_inertia
from evo_cpg.physics.water.buoyancy import make_cells
from evo_cpg.physics.water.fluid import Drag, DragLaw, make_patches
from evo_cpg.physics.water.reactive_thrust import reactive_water
from evo_cpg.physics.water.water import Current, Gradient, Vortex, Water

AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}

# Parent and number of joint axes of every body except the root: chains, stars and mixtures.
STRUCTURES = (
    ((0, 3),),
    ((0, 2), (0, 1), (0, 3)),
    ((0, 1), (1, 1), (1, 3), (2, 2)),
    ((0, 3), (1, 3), (2, 3), (3, 3)),
    ((0, 2), (0, 2), (1, 1), (2, 3), (2, 1)),
    ((0, 1), (0, 3), (0, 3), (2, 2), (2, 3), (5, 1)),
)


def jit_as_for_users(function, **options):
    """Compile like `jax.jit`, but always with the optimisation that users have."""
    chosen = {"xla_backend_optimization_level": 3}
    if version("jaxlib").startswith("0.10."):
        chosen["xla_cpu_use_fusion_emitters"] = True
    return jax.jit(function, compiler_options=chosen, **options)


def random_creature(
    rng: np.random.Generator,
    structure: tuple[tuple[int, int], ...],
    limits: float = 9.0,
    motor: Motor | None = None,
    axes_seed: int = 0,
) -> Creature:
    """Return a creature of a fixed structure with random bodies and joints.

    Args:
        rng: source of random numbers.
        structure: parent and number of axes of every body except the root.
        limits: limit of every joint in both directions, rad.
        motor: motor on every axis.
        axes_seed: seed of a second source, for the joints' axes and orientations.
    """
    turns = np.random.default_rng(axes_seed)
    bodies = [Body("b0", random_shape(rng), Material(rng.uniform(500, 2000)))]
    for i, (parent, count) in enumerate(structure, start=1):
        if turns.random() < 0.5:
            axes = np.eye(3)[turns.permutation(3)[:count]] * turns.choice([-1.0, 1.0], (count, 1))
        else:
            axes = np.linalg.qr(turns.normal(size=(3, 3)))[0][:count]
        aligned = turns.random() < 0.3
        orientation = np.eye(3) if aligned else euler_to_matrix(*turns.normal(size=3))
        joint = Joint(
            parent=f"b{parent}",
            parent_anchor=tuple(rng.normal(scale=0.2, size=3)),
            child_anchor=tuple(rng.normal(scale=0.2, size=3)),
            axes=tuple(map(tuple, axes)),
            lower=(-limits,) * count,
            upper=(limits,) * count,
            orientation=tuple(map(tuple, orientation)),
            stiffness=rng.uniform(0, 5),
            damping=rng.uniform(0, 1),
            armature=rng.choice([0.0, rng.uniform(0, 0.01)]),
            actuator=motor,
        )
        bodies.append(Body(f"b{i}", random_shape(rng), Material(rng.uniform(500, 2000)), joint))
    return Creature("random", tuple(bodies))


def random_shape(rng: np.random.Generator) -> Shape:
    """Return a random box, sphere, ellipsoid or capsule of some 0.1 to 0.4 m."""
    return [
        lambda: Box(tuple(rng.uniform(0.05, 0.4, 3))),
        lambda: Sphere(rng.uniform(0.05, 0.2)),
        lambda: Ellipsoid(tuple(rng.uniform(0.05, 0.2, 3))),
        lambda: Capsule(rng.uniform(0.03, 0.1), rng.uniform(0.05, 0.4)),
    ][rng.integers(4)]()


def random_state(
    tree: Tree, rng: np.random.Generator, batch: tuple[int, ...] = (), speed: float = 1.0
) -> State:
    """Return states of any orientation, angles up to 1 rad, and rates of some 3 ``speed`` rad/s."""
    orientation = rng.normal(size=(4, *batch))
    return State(
        position=jnp.asarray(rng.normal(size=(3, *batch))),
        orientation=jnp.asarray(orientation / np.linalg.norm(orientation, axis=0)),
        velocity=jnp.asarray(speed * rng.normal(scale=2.0, size=(6, *batch))),
        q=jnp.asarray(rng.uniform(-1, 1, (tree.dof_count, *batch))),
        qd=jnp.asarray(speed * rng.normal(scale=3.0, size=(tree.dof_count, *batch))),
    )


def box_chain(
    bodies: int,
    axes: str,
    motor: Motor | None = None,
    size: tuple[float, float, float] = (0.2, 0.1, 0.1),
    gap: float = 0.02,
    density: float = 1000.0,
    limit: float = np.pi / 3,
) -> Creature:
    """Return equal boxes in a row along -x, head first."""
    reach = (size[0] + gap) / 2
    chain = [Body("b0", Box(size), Material(density))]
    for i in range(1, bodies):
        ends = (-reach, 0.0, 0.0), (reach, 0.0, 0.0)
        joint = hinge(f"b{i - 1}", *ends, axes, limit, actuator=motor)
        chain.append(Body(f"b{i}", Box(size), Material(density), joint))
    return Creature("chain", tuple(chain))


def hinge(parent: str, at, child_at, axes: str = "z", limit: float = 1.0, **given) -> Joint:
    """Return a joint about axes of the child's frame, with the same limit in both directions."""
    turns, most = tuple(AXES[axis] for axis in axes), (limit,) * len(axes)
    return Joint(parent, at, child_at, turns, tuple(-x for x in most), most, **given)


def resting(tree: Tree, batch: tuple[int, ...] = (), height=None, **changed) -> State:
    """Return a state at rest in float64, with another height of the root (m) or other fields."""
    state = resting_state(tree, batch, jnp.float64)
    if height is not None:
        changed["position"] = state.position.at[2].set(jnp.asarray(height))
    return dataclasses.replace(state, **{name: jnp.asarray(x) for name, x in changed.items()})


def whole(blocks) -> np.ndarray:
    """Return symmetric matrices ``(6, 6, ...)`` of their angular, mixed and linear blocks."""
    angular, mixed, linear = map(np.asarray, blocks)
    rows = (angular, mixed), (mixed.swapaxes(0, 1), linear)
    return np.concatenate([np.concatenate(row, 1) for row in rows])


def mujocos_accelerations(model, data, tree: Tree, state: State, torque=0.0) -> np.ndarray:
    """Return MuJoCo's accelerations of the root (angular, linear) and of the joints."""
    order, rotation = 6 + dof_order(model, tree), load_state(model, data, tree, state)
    data.qfrc_applied[order] = torque
    mujoco.mj_forward(model, data)
    return np.concatenate([rotation @ data.qacc[3:6], data.qacc[:3], data.qacc[order]])


def slope(function, x, change):
    """Return the central difference of a function over a change of its argument, per change."""
    each = np.ravel(change)
    size = each[np.abs(each).argmax()]
    return (function(x + change) - function(x - change)) / (2 * size)


def in_water(
    creature: Creature,
    resolution: int = 2,
    gravity: float = 9.81,
    density: float = 1000.0,
    form_drag: float = 1.0,
    skin_drag: float = 0.02,
    current: tuple[float, float, float] = (0.0, 0.0, 0.0),
    law: DragLaw = "normal",
    sheltered: bool = True,
    surface: float | None = None,
    added_mass: bool = False,
    reactive_thrust: bool = False,
    gradient: Gradient | None = None,
    vortices: tuple[Vortex, ...] = (),
) -> World:
    """Return the world of a creature in water, with equal quadratures for form and skin drag."""
    tree = build_tree(creature)
    (surfaces,) = surfaces_of(creature, resolution, sheltered=sheltered)
    patches = make_patches(tree, surfaces, surfaces, law, surface is not None)
    forces = (Drag(form_drag, skin_drag, patches, law),)
    moved = (
        added_inertia(creature, tree, density) if added_mass else np.zeros((6, 6, len(tree.names)))
    )
    if reactive_thrust:
        found = reactive_water(creature, tree, density, moved)
        assert found is not None
        forces += (AddedMass(found[0]), found[1])
    elif added_mass:
        forces += (AddedMass(moved),)
    return World(
        tree,
        gravity,
        Water(density, surface, (Current(current, gradient), *vortices)),
        forces,
        cells=() if surface is None else make_cells(creature, tree),
    )


def surfaces_of(creature: Creature, *resolutions: int, **options):
    """Return the surface points of all bodies by name, for each resolution."""
    names = [body.name for body in creature.bodies]
    return [
        dict(zip(names, outer_surfaces(creature, resolution, **options), strict=True))
        for resolution in resolutions
    ]


def clapper(shape: Shape, axes: str, motor: Motor | None = None) -> Creature:
    """Return a trunk with two limbs of two bodies that can clap together in front of it."""
    flesh = Material(500.0, static_friction=0.8, dynamic_friction=0.8)
    bodies = [Body("trunk", Box((0.2, 0.3, 0.1)), flesh)]
    for side, name in ((1, "left"), (-1, "right")):
        for part, parent, place in (
            ("arm", "trunk", (0.1, side * 0.12, 0.0)),
            ("hand", f"{name}_arm", (0.16, 0.0, 0.0)),
        ):
            joint = hinge(parent, place, (-0.16, 0.0, 0.0), axes, 1.2, actuator=motor)
            bodies.append(Body(f"{name}_{part}", shape, flesh, joint))
    return Creature("clapper", tuple(bodies))


def single(shape: Shape, density: float = 1000.0) -> Creature:
    """Return a creature of one body."""
    return Creature("single", (Body("b", shape, Material(density)),))


def rolled(world: World, state: State, commands, h: float):
    """Return states and efforts at every step, for commands or target rates with steps first."""

    @quick_jit
    def motion(state, commands):
        def advance(s, command):
            s, effort = step(world, s, command, h)
            return s, (s, effort)

        return jax.lax.scan(advance, state, commands)[1]

    return jax.tree.map(np.asarray, motion(state, commands))


def coast(world: World, state: State, seconds: float, h: float) -> State:
    """Return the motion with zero target rates of the motors, steps first."""
    rest = jnp.zeros_like(state.qd)

    @quick_jit
    def motion(state):
        def advance(s, _):
            s = step(world, s, rest, h)[0]
            return s, s

        return jax.lax.scan(advance, state, None, round(seconds / h))[1]

    return jax.tree.map(np.asarray, motion(state))


def last(states: State) -> State:
    """Return the last of several states, as JAX arrays."""
    return jax.tree.map(lambda x: jnp.asarray(x[-1]), states)


@quick_jit
def accelerations(tree: Tree, state: State, tau):
    """Return the accelerations on dry land in two ways: by bodies, and by the mass matrix."""
    world = World(tree, 9.81)
    kin = kinematics(tree, state)
    inertia, bias = body_equations(world, kin, 0.0)
    passive, derivative = passive_torque(tree, state, 0.0)
    rotor = derivative + expand_dims_like(tree.armature, tau)
    given = tree, kin, inertia, bias, tau + passive, rotor
    by_bodies = jnp.concatenate(solve(*given))
    return by_bodies, jnp.linalg.solve(*generalized_equations(*given))
