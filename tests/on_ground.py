"""Single bodies on the ground at the walkers' step."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from creatures import quick_jit
from evo_cpg.creature.creature import Body, Creature, Material
from evo_cpg.creature.shapes import Shape
from evo_cpg.creature.tree import build_tree
from evo_cpg.physics.contact.contact_model import Ground, make_contact_model
from evo_cpg.physics.step.step import step
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.state import State, resting_state

H = 1 / 240
GRAVITY = 9.81
DENSITY = 300.0


def alone(
    shape: Shape, restitution: float = 0.0, static: float = 0.5, dynamic: float = 0.5, **ground
) -> World:
    """Return one body on ground of equal friction, whose restitution of 1 keeps the body's."""
    material = Material(DENSITY, restitution, static, dynamic)
    creature = Creature("alone", (Body("body", shape, material),))
    tree = build_tree(creature)
    floor = Ground(
        restitution=1.0,
        static_friction=static,
        dynamic_friction=dynamic,
        restitution_rule="multiply",
        friction_rule="geometric",
        **ground,
    )
    return World(tree, GRAVITY, contact_model=make_contact_model(creature, tree, floor))


def released(world: World, position, velocity=0.0, orientation=(1.0, 0.0, 0.0, 0.0)) -> State:
    """Return a body at ``position`` (3, n) with ``velocity`` (6, n), angular first."""
    position = jnp.asarray(position, jnp.float64)
    count = position.shape[1]
    state = resting_state(world.tree, (count,), jnp.float64, orientation=orientation)
    velocity = jnp.broadcast_to(jnp.asarray(velocity, jnp.float64), (6, count))
    return dataclasses.replace(state, position=position, velocity=velocity)


def recorder(world: World, steps: int, h: float = H):
    """Return a function of state and restitution of every point: states and ground forces."""

    @quick_jit
    def run(state, restitution):
        changed = eqx.tree_at(
            lambda w: w.contact_model, world, world.contact_model._replace(restitution=restitution)
        )

        def advance(s, _):
            s, effort = step(changed, s, jnp.zeros_like(s.q), h)
            return s, (s, effort.contact_frame_force)

        return jax.lax.scan(advance, state, None, steps)[1]

    return run


def record(world: World, state: State, steps: int, h: float = H):
    """Return states and ground forces at every step, as NumPy arrays."""
    run = recorder(world, steps, h)
    return jax.tree.map(np.asarray, run(state, np.asarray(world.contact_model.restitution)))
