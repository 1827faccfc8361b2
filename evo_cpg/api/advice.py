"""Warnings about an animal before it evolves: idle oscillators, and long steps."""

import dataclasses
import functools
import math
from collections.abc import Sequence

import jax
import numpy as np

from evo_cpg.analysis.limit_cycle import resting
from evo_cpg.control.couplings import uncoupled
from evo_cpg.control.matsuoka import parts
from evo_cpg.physics.water.added_mass import AddedMass
from evo_cpg.physics.water.reactive_thrust import ReactiveThrust
from evo_cpg.simulation.noise import Noise, raw_keys
from evo_cpg.simulation.rollout import rollout
from evo_cpg.simulation.simulation import Simulation

# Mass of the water that slender chains carry, relative to the animal's mass, above which the
# physics step is tested. Plates roll in the flow with a frequency that grows with this ratio. The
# step integrates the water's moment explicitly, so it must be short. Among 45 random swimmers of
# plates, divergence began at ratios of about 27 with two substeps, and of about 12 with one. The
# shipped eel has 3, so the test spares animals of this kind.
_LIGHT = 5.0

# Individuals of a test of the physics step, its longest time (s), and the multiples of the substeps
# that it tries.
_TESTED, _TEST_SECONDS, _FINER = 8, 5.0, (2, 4, 8, 16)

# Random courses that are tested.
_COURSES = 64

# Most oscillators in the example of a ring.
_IN_RING = 4


def about_oscillators(simulation: Simulation) -> list[str]:
    """Return warnings of oscillators that are uncoupled or at rest, with keys to change."""
    oscillators, tree = simulation.controller.rhythm_generator, simulation.world.tree
    if oscillators is None:
        return []
    cpg, network, rate_gain = oscillators
    # Warn only of oscillators that drive a joint.
    driven = (tree.of_commands("servo_gain") > 0) | (tree.of_commands("servo_stiffness") > 0)
    driven = driven & (rate_gain != 0)
    if tree.muscles is not None:
        driven = driven | np.array(tree.muscles.driven)
    driven = driven | np.array(tree.torque_driven, bool)
    gains = cpg.min_adaptation_gain, cpg.max_adaptation_gain
    alone = [i for i in uncoupled(network.matrix) if driven[i]]
    still = [i for i in resting(network, cpg.max_tonic_input, *gains) if driven[i]]
    drive = cpg.max_tonic_input + cpg.constant_input
    least = 1 + network.rise_time / network.adaptation_time
    if drive <= 0:
        total = "controller.cpg.max_tonic_input + constant_input"
        cure = f"{total} is {drive:g} and must be positive"
    else:
        cure = (
            f"An isolated pair oscillates if controller.cpg.pair_weight ({cpg.pair_weight:.3g}) is "
            f"more than {least:.3g} (constants: {cpg.constants}) and less than 1 + the adaptation "
            f"gain ({gains[0]:g} to {gains[1]:g})"
        )
    couple = "Couple them with controller.cpg.couplings or rings"
    couple_alone = couple + _ring([tree.dof_names[i] for i in alone])
    rest = "at rest under a constant drive"
    matters = (
        ("coupled to no other oscillator", couple_alone, [i for i in alone if i not in still]),
        (
            f"coupled to no other oscillator, and {rest}",
            f"{couple_alone}. {cure}",
            [i for i in alone if i in still],
        ),
        (rest, cure, [i for i in still if i not in alone]),
    )
    lines = []
    for what, change, found in matters:
        if found:
            names = ", ".join(tree.dof_names[i] for i in found)
            lines.append(f"{what}: {names}. {change}")
    # Groups of several driven oscillators that are coupled or turn the same bodies.
    apart: list[list[int]] = []
    for part in parts(network):
        own = [i for i in part if driven[i]] if len(part) > 1 else []
        turned = {tree.dof_bodies[i] for i in own}
        for group in [group for group in apart if turned & {tree.dof_bodies[i] for i in group}]:
            apart.remove(group)
            own = sorted(group + own)
        apart += [own] if own else []
    # Legs must step in turn. In water a trunk and its fins may have rhythms of their own, so only
    # groups of equal size count there, such as pairs of fins.
    if simulation.world.contact_model is None:
        sizes = [len(group) for group in apart]
        apart = [group for group in apart if sizes.count(len(group)) > 1]
    if len(apart) > 1:
        named = [dict.fromkeys(tree.names[tree.dof_bodies[i]] for i in group) for group in apart]
        bodies = "; ".join(map(", ".join, named))
        ring = _ring([tree.dof_names[group[0]] for group in apart])
        lines.append(
            f"{len(apart)} groups of limbs are not coupled to each other, so they have no order in "
            f"which to move, and a walker may stand still: {bodies}. {couple}{ring} "
            "(docs/walker.md)"
        )
    return lines


def _ring(names: Sequence[str]) -> str:
    """Return an example of a ring of some oscillators, or "" for a single one."""
    # One oscillator of each body.
    first = {name.partition(".")[0]: name for name in reversed(names)}
    bodies = list(dict.fromkeys(name.partition(".")[0] for name in names))[:_IN_RING]
    if len(bodies) < 2:
        return ""
    # The axis of an imported joint may be a vector, such as knee.(0,0.6,0.8).
    ring = ", ".join(f"'{first[body]}'" if "," in first[body] else first[body] for body in bodies)
    # Lags around a ring add up to whole turns.
    return f", such as rings: [{{oscillators: [{ring}], lag_deg: {360 // len(bodies)}}}]"


def is_light_in_water(simulation: Simulation) -> bool:
    """Return whether slender chains with reactive thrust carry far more water than they weigh."""
    world = simulation.world
    if not any(isinstance(law, ReactiveThrust) for law in world.forces):
        return False
    carried = [law.carried[3:, 3:] for law in world.forces if isinstance(law, AddedMass)]
    water = sum(np.linalg.eigvalsh(np.moveaxis(m, -1, 0))[:, -1].sum() for m in carried)
    return bool(water > _LIGHT * np.sum(world.tree.mass))


def about_courses(simulation: Simulation) -> str:
    """Return a warning if some random courses are refused, or "".

    All individuals count as diverged on such a course.
    """
    if simulation.draws is None:
        return ""
    keys = raw_keys(jax.random.split(jax.random.key(0), _COURSES))
    numbers = simulation.draws.values(np.asarray(simulation.course_keys(keys)))
    refused = int(np.isnan(np.concatenate(numbers)).any(0).sum())
    if not refused:
        return ""
    return (
        f"courses.draw: {refused} of {_COURSES} random courses are refused, because a number is "
        "not allowed or changes the form of the model. Narrow the ranges"
    )


def about_step(simulation: Simulation) -> str:
    """Return a warning of a physics step at which random individuals diverge, or "".

    Some random individuals run for at most `_TEST_SECONDS` seconds without noise, each on its own
    course if courses are drawn. With plain JAX nothing is tested, because compiling their trials
    would take minutes.
    """
    if simulation.engine.name == "jax":
        return ""
    steps = min(simulation.steps, math.ceil(_TEST_SECONDS * simulation.control_rate))
    tested = dataclasses.replace(simulation, steps=steps, rules=None, noise=Noise())
    genes = simulation.genome.random(jax.random.key(0), (_TESTED,))
    keys = None if tested.silent else raw_keys(jax.random.split(jax.random.key(0), _TESTED))
    now, found = simulation.substeps, ""
    for more in (factor * now for factor in (1, *_FINER)):
        finer = dataclasses.replace(tested, substeps=more)
        lost = int((~jax.jit(functools.partial(rollout, finer))(genes, keys).alive).sum())
        if not lost:
            return found and (
                f"{found}, because the physics step of {simulation.step_length:.2g} s is too long. "
                f"With simulation.substeps: {more} none diverges"
            )
        found = found or (
            f"simulation.substeps: {now}: {lost} of {_TESTED} random individuals diverge within "
            f"{steps / simulation.control_rate:.3g} s"
        )
    return f"{found}, also with {_FINER[-1] * now} substeps. Is a force or a motor too strong?"
