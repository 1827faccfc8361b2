"""Measure the steepest slope on which animals stand: `python -m benchmarks.slopes [CONFIG ...]`.

Motors hold the neutral pose, and weight increases slowly. The table also shows the limit of statics
for the animal's final pose. That is the steepest slope on which forces within the friction
cones of the touching points balance the weight, by a linear program. The figures are in
docs/models/contact.md.
"""

import argparse
import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float
from rich.console import Console
from scipy.optimize import linprog

from benchmarks.plan import experiment_of
from evo_cpg.creature.algebra.linear import matvec
from evo_cpg.physics.contact.contact import find_contacts
from evo_cpg.physics.contact.contact_model import ContactModel
from evo_cpg.physics.contact.contact_points import clearance
from evo_cpg.physics.contact.terrain import Plane
from evo_cpg.physics.step.step import first_warmstart, step
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.joint_torque import MotorCommand
from evo_cpg.physics.tree.kinematics import kinematics
from evo_cpg.physics.tree.state import State, resting_state

CONFIGS = (
    "fukui2003_model1",
    "fukui2003_model2",
    "fukui2003_model3",
    "hexapod",
    "iwadate2010_salamander_land",
    "starfish_land",
)

# Time in which the weight increases, and time to settle, s. The last second shows whether the
# animal stands.
LOADING, SETTLING = 3.0, 3.0

# Speed in the last second from which an animal slides instead of creeping, m/s.
SLIDES = 0.01

# Number of edges of each friction cone in the linear program. The cone lies inside the round one,
# and is narrower by at most 0.2 %.
_EDGES = 48


class Standing(NamedTuple):
    """State of an animal that stands on a slope.

    Attributes:
        creep: speed of the root in the last second, m/s.
        points: points that carry the animal, in the slope's frame (x down the slope, z off it), m.
        friction: static friction of each point.
        centre: centre of mass in the slope's frame, m.
    """

    creep: float
    points: Float[np.ndarray, "p 3"]
    friction: Float[np.ndarray, " p"]
    centre: Float[np.ndarray, "3"]


def stander(world: World, h: float) -> Callable[[float], Standing]:
    """Return a function that lets an animal stand on a slope (degrees) with a step of h (s)."""
    contact_model = world.contact_model
    assert contact_model is not None
    friction, dtype = np.asarray(contact_model.static_friction), np.dtype(np.float32)
    second = round(1 / h)

    @jax.jit
    def stand(angle: Array) -> tuple[Array, Array, Array, Array]:
        slope, start = _on_slope(world, angle)
        warmstart = first_warmstart(slope, (1,), dtype)
        still = jnp.zeros_like(start.q)

        def advance(carry: tuple, index: Array) -> tuple[tuple, tuple]:
            state, warmstart = carry
            fraction = jnp.minimum((index + 1) * h / LOADING, 1.0)
            loaded = dataclasses.replace(slope, gravity=world.gravity * fraction)
            state, effort = step(loaded, state, MotorCommand(still, still), h, warmstart)
            assert effort.contact_frame_force is not None
            return (state, effort.warmstart), (
                state.position[:, 0],
                effort.contact_frame_force[2, :, 0],
            )

        steps = jnp.arange(round((LOADING + SETTLING) / h))
        (end, _), (displacement, support) = jax.lax.scan(advance, (start, warmstart), steps)
        kin = kinematics(slope.tree, end)
        places = kin.origin[:, np.array(contact_model.bodies)]
        places = places + find_contacts(_sloping(contact_model, angle), kin, h).offset
        creep = jnp.linalg.norm(displacement[-1] - displacement[-1 - second])
        return creep, support[-1], places[..., 0], _centre(slope, end)

    def of(degrees: float) -> Standing:
        angle = np.deg2rad(degrees)
        creep, support, places, centre = map(np.asarray, stand(jnp.asarray(angle, dtype)))
        cosine, sine = np.cos(angle), np.sin(angle)
        turn = np.array([[cosine, 0, -sine], [0, 1, 0], [sine, 0, cosine]])
        carries = support > 1e-3 * support.max(initial=0.0)
        return Standing(
            float(creep), places[:, carries].T @ turn.T, friction[carries], turn @ centre
        )

    return of


def _centre(world: World, state: State) -> Float[Array, "3"]:
    """Return the centre of mass of one animal, m."""
    kin, tree = kinematics(world.tree, state), world.tree
    places = kin.origin + matvec(kin.rotation, jnp.asarray(tree.com, state.q.dtype)[..., None])
    return places[..., 0] @ jnp.asarray(tree.mass / tree.mass.sum(), state.q.dtype)


def _on_slope(world: World, angle: Array) -> tuple[World, State]:
    """Return a dry, bare world that falls towards x, and an animal with its lowest point on it."""
    assert world.contact_model is not None
    contact_model, none = _sloping(world.contact_model, angle), jnp.zeros_like(angle)
    slope = dataclasses.replace(world, contact_model=contact_model, water=None, forces=(), cells=())
    half = jnp.stack([jnp.cos(angle / 2), none, jnp.sin(angle / 2), none])
    state = resting_state(world.tree, (1,), angle.dtype)
    state = dataclasses.replace(state, orientation=half[:, None])
    gap = clearance(contact_model, kinematics(slope.tree, state)).min(0)
    down = jnp.stack([jnp.sin(angle), none, jnp.cos(angle)])[:, None] * gap[None]
    return slope, dataclasses.replace(state, position=state.position - down)


def _sloping(contact_model: ContactModel, angle: Array) -> ContactModel:
    """Return the contact model on a sloping plane."""
    floor = Plane((jnp.sin(angle), 0.0, jnp.cos(angle)))
    return contact_model._replace(
        ground=dataclasses.replace(contact_model.ground, floor=floor, obstacles=())
    )


def limit_of_statics(standing: Standing) -> float:
    """Return the steepest slope on which forces at the contact points can hold the animal, degrees.

    The forces stay within the friction cones. Bisection finds the slope to 0.1 degrees.
    """
    turns = 2 * np.pi * np.arange(_EDGES) / _EDGES
    edges = np.stack([np.cos(turns), np.sin(turns), np.zeros(_EDGES)])
    columns = []
    for point, friction in zip(standing.points, standing.friction, strict=True):
        forces = friction * edges + np.array([0, 0, 1.0])[:, None]
        moments = np.cross(point - standing.centre, forces, axisb=0, axisc=0)
        columns.append(np.concatenate([forces, moments]))
    if not columns:
        return 0.0
    cone = np.concatenate(columns, 1)

    def holds(degrees: float) -> bool:
        angle = np.deg2rad(degrees)
        needed = np.array([-np.sin(angle), 0, np.cos(angle), 0, 0, 0])
        found = linprog(np.zeros(cone.shape[1]), A_eq=cone, b_eq=needed, method="highs")
        return found.status == 0

    low, high = 0.0, 80.0
    while high - low > 0.1:
        middle = (low + high) / 2
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low


def steepest(stand: Callable[[float], Standing]) -> tuple[float, float, Standing]:
    """Find the steepest slope on which an animal stands, at least 1 degree below the statics limit.

    The limit of statics belongs to the animal's final pose. It is much above the slope if the
    animal slides or falls earlier.

    Args:
        stand: result of `stander`.

    Returns:
        The limit of statics, the steepest slope (both in degrees, the slope to 0.2), and the state
        of the animal on this slope.
    """
    level = stand(0.0)
    low, high = (0.0, level), 60.0
    while high - low[0] > 0.2:
        middle = (low[0] + high) / 2
        standing = stand(middle)
        if stands(standing, level) and limit_of_statics(standing) - 1 >= middle:
            low = middle, standing
        else:
            high = middle
    slope, standing = low
    return limit_of_statics(standing), slope, standing


def stands(standing: Standing, level: Standing) -> bool:
    """Return whether an animal does not slide, and keeps two thirds of its level height."""
    return standing.creep < SLIDES and standing.centre[2] > 2 / 3 * level.centre[2]


def main() -> None:
    """Find the steepest slope of each animal, and print the table."""
    parser = argparse.ArgumentParser(description=str(__doc__).split("\n", 1)[0])
    parser.add_argument("configs", nargs="*", metavar="CONFIG", default=CONFIGS)
    console = Console()
    console.print(
        "| animal | step, s | limit of statics | stands at | creeps, mm/s | at 2 degrees more |\n"
        "|---|---|---|---|---|---|",
        soft_wrap=True,
    )
    for name in parser.parse_args().configs:
        simulation = experiment_of(name).simulation
        stand = stander(simulation.world, simulation.step_length)
        limit, slope, standing = steepest(stand)
        beyond = stand(slope + 2).creep
        console.print(
            f"| {name} | 1/{round(1 / simulation.step_length)} | {limit:.1f} | {slope:.1f} | "
            f"{1e3 * standing.creep:.2f} | {1e3 * beyond:.3g} mm/s |",
            soft_wrap=True,
        )


if __name__ == "__main__":
    main()
