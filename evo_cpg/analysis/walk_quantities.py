"""Numbers of an animal on the ground, each with its definition."""

import math

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from evo_cpg.analysis.cycles import whole_cycles
from evo_cpg.analysis.feet import Feet, LimbContacts, limb_contacts
from evo_cpg.analysis.quantity import Quantity
from evo_cpg.analysis.walking import (
    SIX,
    froude_number,
    recovery,
    relative_slip,
    tripod_strength,
)
from evo_cpg.creature.creature import Creature
from evo_cpg.simulation.recording import Recording
from evo_cpg.simulation.simulation import Simulation

_NO_LIMB = "no limb ever touches the ground"
_LIMB_DUTY = (
    "fraction of the time on the ground of each limb that ever touches it, without trunk and tail "
    "(Alexander and Jayes 1983)"
)


def ground_quantities(
    simulation: Simulation,
    creature: Creature,
    recording: Recording,
    feet: Feet,
    middle: Float[np.ndarray, "n 3"],
    frequency: float,
    speed: float,
    no_speed: str,
) -> list[Quantity]:
    """Return the numbers of contacts, of the feet's slip, and of walking.

    Args:
        simulation: the trial.
        creature: the animal.
        recording: its motion, with the bodies in its order.
        feet: contacts of its bodies.
        middle: path of the centre of mass in the last part of the trial, m.
        frequency: stride frequency, Hz, or NaN.
        speed: path speed in the last part of the trial, m/s, or NaN.
        no_speed: reason why the speed does not exist.
    """
    airborne, swims = feet.airborne, ""
    if simulation.world.water_level == math.inf:
        airborne, swims = math.nan, "there is water everywhere, which supports it"
    bodies = feet.duty_factor if len(feet.names) else np.array([math.nan])
    never = "" if len(feet.names) else "nothing but the root ever touches the ground"
    slip, aloft = feet.whole_slip, "nothing presses on the ground"
    return [
        Quantity("duty_factor", "duty factor", float(bodies.mean()), "",
                 "fraction of the time on the ground, mean of the bodies that ever touch it, "
                 "except the root (Alexander and Jayes 1983)", never),
        Quantity("airborne", "airborne fraction", airborne, "",
                 "fraction of the control steps in which nothing touches the ground", swims),
        Quantity("slip", "slip", slip, "m/s",
                 "horizontal speed of the material at the points of contact, weighted by load, as "
                 "in the task `walk`", aloft),
        Quantity("relative_slip", "relative slip", slip / speed, "", "slip / path speed",
                 aloft if math.isnan(slip) else no_speed),
        *_of_limbs(simulation, creature, recording, feet, middle, frequency, speed, no_speed),
    ]  # fmt: skip


def _of_limbs(
    simulation: Simulation,
    creature: Creature,
    recording: Recording,
    feet: Feet,
    middle: Float[np.ndarray, "n 3"],
    frequency: float,
    speed: float,
    no_speed: str,
) -> list[Quantity]:
    step = 1.0 / simulation.control_rate
    first = len(recording.time) - len(middle)
    limbs = limb_contacts(creature, feet, step, frequency)
    if limbs is None:
        return [
            Quantity(
                "limb_duty_factor", "duty factor of the limbs", math.nan, "", _LIMB_DUTY, _NO_LIMB
            )
        ]
    gravity = float(simulation.world.gravity)
    hips = _hip_height(simulation, creature, recording, limbs, first)
    found = [
        Quantity("limb_duty_factor", "duty factor of the limbs", float(limbs.duty_factor.mean()),
                 "", _LIMB_DUTY),
        Quantity("foot_slip", "foot slip / speed", float(relative_slip(limbs.slip, speed)), "",
                 "slip of the limbs / path speed",
                 no_speed if math.isnan(speed) else "no limb presses on the ground"),
        Quantity("hip_height", "hip height", hips, "m",
                 "mean height of the limbs' first joints above the floor in the second half"),
        Quantity("froude_number", "Froude number", float(froude_number(speed, gravity, hips)), "",
                 "path speed^2 / (gravity x hip height) (Alexander and Jayes 1983)",
                 no_speed if math.isnan(speed) else "its hips are not above the floor"),
    ]  # fmt: skip
    swapped = _recovery(float(creature.mass), gravity, middle, step, frequency)
    if frequency > 0:
        found.append(
            Quantity("recovery", "energy recovery", swapped, "",
                     "energy that the centre of mass saves by exchange: 1 for a pendulum, 0 for a "
                     "bounce (Cavagna et al. 1977)", "the record has no whole stride")
        )  # fmt: skip
    tripod = _tripods(limbs)
    if tripod is not None:
        found.append(
            Quantity("tripod_strength", "tripod strength",
                     float(tripod_strength(limbs.steady[first:][:, tripod])), "",
                     "time in which all three legs of a tripod swing / time in which any of them "
                     "swings (Wosnitza et al. 2013)", "a tripod never swings")
        )  # fmt: skip
    return found


def _tripods(limbs: LimbContacts) -> list[int] | None:
    """Return the columns of L1, L2, L3, R1, R2, R3, or None if they are not six legs."""
    sides = [[k for k, limb in enumerate(limbs.limbs) if limb.side == side] for side in (1, -1)]
    legs = [*sides[0], *sides[1]]
    return legs if len(legs) == SIX and len(sides[0]) == SIX // 2 else None


def _hip_height(
    simulation: Simulation,
    creature: Creature,
    recording: Recording,
    limbs: LimbContacts,
    first: int,
) -> float:
    """Return the mean height of the limbs' first joints above the floor, m."""
    ground = simulation.world.ground
    assert ground is not None
    heights = []
    for limb in limbs.limbs:
        hip = limb.bodies[0]
        joint = creature.bodies[hip].joint
        assert joint is not None
        turned = recording.rotation[first:, hip] @ np.array(joint.child_anchor, float)
        place = np.asarray(recording.position[first:, hip] + turned, float)
        heights.append(float(np.asarray(ground.floor.distance(jnp.asarray(place.T))[0]).mean()))
    return float(np.mean(heights))


def _recovery(
    mass: float, gravity: float, middle: Float[np.ndarray, "n 3"], step: float, frequency: float
) -> float:
    """Return the energy recovery in whole strides, or NaN without one."""
    if len(middle) < 3:
        return math.nan
    velocity = np.gradient(middle, step, axis=0)
    course = middle[-1, :2] - middle[0, :2]
    far = float(np.linalg.norm(course))
    if not far > 0:
        return math.nan
    ahead = velocity[:, :2] @ (course / far)
    energies = np.stack(
        [
            0.5 * mass * ahead**2,
            mass * gravity * middle[:, 2] + 0.5 * mass * velocity[:, 2] ** 2,
        ],
        -1,
    )
    cycles = whole_cycles(energies, step, frequency)
    return math.nan if cycles is None else float(recovery(*cycles.values.T))
