"""Contacts of a recorded animal with the ground, by body and by limb."""

from collections.abc import Mapping
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from evo_cpg.analysis import footfalls
from evo_cpg.analysis.footfalls import Phases
from evo_cpg.creature.creature import Creature
from evo_cpg.creature.limbs import Limb, limbs
from evo_cpg.simulation.measures import Slip, slip_of_points
from evo_cpg.simulation.recording import Recording
from evo_cpg.simulation.simulation import Simulation


class Feet(NamedTuple):
    """Bodies that touch the ground, except the root.

    Attributes:
        names: names of the bodies that ever touch, in the order of the creature.
        touched: whether each body touches in each control step.
        steady: ``touched`` without chatter.
        duty_factor: duty factor of each body.
        phases: phases of the touch-downs in the second half of the trial.
        load: mean load of each body, N.
        slip: slip speed of each body, m/s (`evo_cpg.simulation.measures`). NaN without load.
        whole_slip: slip speed of everything that touches the ground, the root included, m/s. NaN
            without load.
        airborne: fraction of the control steps in which nothing touches, the root included.
    """

    names: tuple[str, ...]
    touched: Bool[np.ndarray, "t f"]
    steady: Bool[np.ndarray, "t f"]
    duty_factor: Float[np.ndarray, " f"]
    phases: Phases
    load: Float[np.ndarray, " f"]
    slip: Float[np.ndarray, " f"]
    whole_slip: float
    airborne: float


class LimbContacts(NamedTuple):
    """Contacts of limbs, each with all its bodies. A limb is not a tail (`creature.limbs`).

    Attributes:
        limbs: limbs that ever touch the ground, from front to back.
        touched: whether each limb touches in each control step.
        steady: ``touched`` without chatter.
        duty_factor: duty factor of each limb.
        slip: slip speed of all limbs, m/s. NaN without load.
    """

    limbs: tuple[Limb, ...]
    touched: Bool[np.ndarray, "t l"]
    steady: Bool[np.ndarray, "t l"]
    duty_factor: Float[np.ndarray, " l"]
    slip: float


def contacts(
    simulation: Simulation,
    creature: Creature,
    frames: Mapping[str, Array | np.ndarray],
    recording: Recording,
    first: int,
    frequency: float,
) -> Feet | None:
    """Return the contacts of a recorded animal, or None without ground.

    Args:
        simulation: the trial.
        creature: the animal.
        frames: frames of one individual, see `evo_cpg.simulation.rollout.record`.
        recording: recording of the same trial, in the order of the creature.
        first: first sample of the part in which strides are measured.
        frequency: stride frequency, Hz, or NaN.
    """
    contact_model, tree = simulation.world.contact_model, simulation.world.tree
    if contact_model is None:
        return None
    step = 1.0 / simulation.control_rate
    force = np.asarray(frames["contact_force"])[..., 0]
    owners = np.array(contact_model.bodies, int)
    names = [body.name for body in creature.bodies]
    bodies = sorted(set(owners.tolist()), key=lambda i: names.index(tree.names[i]))
    touched = footfalls.touching(force, owners, bodies)
    ever = np.flatnonzero(touched.any(0))
    bodies, touched = [bodies[i] for i in ever], touched[:, ever]
    sums = [_slip(frames, owners == body) for body in bodies]
    load = np.array([each.load for each in sums], float)
    slip = np.array([each.speed() if each.load > 0 else np.nan for each in sums], float)
    whole = mean_slip(slip, load)
    feet = np.array([body > 0 for body in bodies], bool)
    touched = touched[:, feet]
    steady = footfalls.settled(touched, step, footfalls.chatter(frequency))
    return Feet(
        names=tuple(tree.names[body] for body in bodies if body > 0),
        touched=touched,
        steady=steady,
        duty_factor=footfalls.duty_factors(touched),
        phases=footfalls.phases(steady[first:], step),
        load=load[feet] / len(force),
        slip=slip[feet],
        whole_slip=whole,
        airborne=footfalls.airborne_fraction((force != 0).any(1)),
    )


def limb_contacts(
    creature: Creature, feet: Feet, step: float, frequency: float
) -> LimbContacts | None:
    """Return the contacts of the limbs, or None if no limb ever touches the ground.

    Args:
        creature: the animal.
        feet: contacts of its bodies.
        step: time between samples, s.
        frequency: stride frequency, Hz, or NaN.
    """
    found, columns, own = [], [], []
    for limb in limbs(creature):
        names = [creature.bodies[i].name for i in limb.bodies]
        rows = [k for k, name in enumerate(feet.names) if name in names]
        if rows:
            found.append(limb)
            own += rows
            columns.append(feet.touched[:, rows].any(1))
    if not found:
        return None
    touched = np.stack(columns, -1)
    return LimbContacts(
        limbs=tuple(found),
        touched=touched,
        steady=footfalls.settled(touched, step, footfalls.chatter(frequency)),
        duty_factor=footfalls.duty_factors(touched),
        slip=mean_slip(feet.slip[own], feet.load[own]),
    )


def _slip(frames: Mapping[str, Array | np.ndarray], points: Bool[np.ndarray, " p"]) -> Slip:
    """Return the slip of some contact points of the recorded animal, summed over the trial."""
    force, velocity = (
        jnp.asarray(frames[name])[:, :, points, 0] for name in ("contact_force", "contact_velocity")
    )
    every = slip_of_points(*(jnp.moveaxis(each, 0, -1) for each in (force, velocity)))
    return Slip(every.slide.sum(), every.load.sum())


def mean_slip(slip: Float[np.ndarray, " f"], load: Float[np.ndarray, " f"]) -> float:
    """Return the slip speed of several feet together, m/s, or NaN without load.

    Args:
        slip: slip speed of each foot, m/s, or NaN.
        load: mean load of each foot, N.
    """
    loaded = load > 0
    return float(np.average(slip[loaded], weights=load[loaded])) if loaded.any() else np.nan
