"""A free eel with Carling's motion against computed flow (Kern and Koumoutsakos 2006).

The body, its motion and its viscosity are those of the computation. Lengths are in body lengths L
and times in periods T. The computed speed is a secondary source: about 0.4 L/T for this motion, and
0.26 to 0.5 L/T for all motions of the paper.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from creatures import hinge, in_water, quick_jit
from evo_cpg.creature.creature import Actuator, Body, Creature, Material
from evo_cpg.creature.shapes import Box
from evo_cpg.physics.step.step import step
from evo_cpg.physics.tree.state import resting_state
from evo_cpg.physics.water.reactive_thrust import Edges, ReactiveThrust

H, SECONDS = 1 / 120, 16.0
# Viscosity over density, L^2 / T.
VISCOSITY = 1.4e-4


def half_widths(s):
    """Half-width and half-height of the elliptical sections at a distance s from the nose."""
    head = np.sqrt(np.maximum(0.08 * s - s * s, 0.0))
    trunk = 0.04 - 0.03 * ((s - 0.04) / 0.91) ** 2
    width = np.where(s < 0.04, head, np.where(s < 0.95, trunk, 0.2 * (1 - s)))
    return width, 0.08 * np.sqrt(np.maximum(1 - ((s - 0.51) / 0.51) ** 2, 0.0))


def eel(segments: int) -> Creature:
    """Boxes with the areas of the sections."""
    ends, bodies = np.linspace(0, 1, segments + 1), []
    for i in range(segments):
        width, height = half_widths(np.linspace(ends[i], ends[i + 1], 9))
        area, ratio = np.pi * (width * height).mean(), height.mean() / width.mean()
        reach = 0.5 / segments
        joint = None
        if i:
            ends = (-reach, 0.0, 0.0), (reach, 0.0, 0.0)
            joint = hinge(f"b{i - 1}", *ends, limit=2.0, actuator=Actuator(1e3))
        shape = Box((1 / segments, np.sqrt(area / ratio), np.sqrt(area * ratio)))
        bodies.append(Body(f"b{i}", shape, Material(1000.0), joint))
    return Creature("eel", tuple(bodies))


def swimming_speed(segments: int, sharp: bool) -> float:
    """Mean speed, L/T. Sharp bodies shed at every joint, and round ones at the tail alone."""
    creature = eel(segments)
    world = in_water(creature, 1, 0.0, form_drag=0.0, skin_drag=1.0, reactive_thrust=True)
    law = world.law(ReactiveThrust)
    assert law is not None
    if not sharp:
        ends = Edges(*(column[..., :2] for column in law.edges))
        law = dataclasses.replace(law, bodies=law.bodies[:2], edges=ends)
    drag, *others = world.forces[:2]
    x = np.linspace(0, 1, segments + 1)
    midline = 0.125 * (x + 0.03125) / 1.03125 * np.exp(-2j * np.pi * x)
    slopes = jnp.asarray(np.diff(midline) * segments)[:, None]

    def angles(time):
        u = jnp.clip(time / 2, 0.0, 1.0)
        wave = (slopes * jnp.exp(2j * jnp.pi * time)).real
        return -jnp.diff(jnp.arctan(u * u * (3 - 2 * u) * wave), axis=0)

    @quick_jit
    def path(friction):
        forces = (dataclasses.replace(drag, skin_drag=friction), *others, law)
        swimming = dataclasses.replace(world, forces=forces)

        def advance(state, n):
            now, ahead = angles(n * H), angles((n + 1) * H)
            rate = (ahead - now) / H + 30.0 * (now - state.q)
            return step(swimming, state, rate, H)[0], state.position

        start = resting_state(world.tree, (1,), jnp.float64)
        return jax.lax.scan(advance, start, jnp.arange(round(SECONDS / H)))[1]

    # The friction of a laminar plate (Blasius) depends on the speed.
    speed, window = 0.4, round(4 / H)
    for _ in range(4):
        track = np.asarray(path(1.328 * np.sqrt(VISCOSITY / speed)))
        speed = float(np.linalg.norm(track[-1] - track[-1 - window]) / 4)
    return speed


@pytest.mark.slow
@pytest.mark.parametrize(("sharp", "expected"), [(False, 0.3), (True, 0.5)])
def test_speed_of_an_eel_beside_computed_flow(sharp, expected):
    """The two rules for edges lie on either side of 0.4 L/T."""
    assert swimming_speed(20, sharp) == pytest.approx(expected, abs=0.05)
