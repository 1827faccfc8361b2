"""Thrust and power of a tail that moves steadily through the water."""

import numpy as np
import pytest

from creatures import box_chain, in_water
from evo_cpg.analysis.energy import water_power
from evo_cpg.creature.creature import neutral_pose
from evo_cpg.physics.water.reactive_thrust import ReactiveThrust


@pytest.mark.parametrize("current", [0.0, 0.3])
def test_a_steady_tail_has_the_thrust_and_power_of_lighthill(current):
    """A straight body moves ahead at u and sideways at w, without drag.

    Thrust along the body is m w^2 / 2, and the wake takes the power u m w^2 / 2. A current that
    carries the body changes neither.
    """
    creature = box_chain(4, "z")
    world = in_water(
        creature, form_drag=0.0, skin_drag=0.0, current=(current, 0.0, 0.0), reactive_thrust=True
    )
    u, w, steps = 0.8, 0.5, 3
    names = [body.name for body in creature.bodies]
    order = [names.index(name) for name in world.tree.names]
    places = np.asarray(neutral_pose(creature)[0])[order].T
    motion = np.array([u + current, w, 0.0])
    shape = (steps, 3, 4, 1)
    frames = {
        "position": np.broadcast_to(places[None, :, :, None], shape),
        "rotation": np.broadcast_to(np.eye(3)[None, :, :, None, None], (steps, 3, 3, 4, 1)),
        "velocity": np.broadcast_to(motion[None, :, None, None], shape),
        "angular_velocity": np.zeros(shape),
    }
    law = world.law(ReactiveThrust)
    edges = law.edges
    tail = int(np.argmin([places[0, body] for body in law.bodies]))
    across = np.abs(np.asarray(edges.directions)[1, :, tail]).argmax()
    mass = float(edges.masses[across, tail])
    found = water_power(world, frames, 1 / 120)
    np.testing.assert_allclose(found.thrust[:, 0], 0.5 * mass * w**2, rtol=1e-9)
    np.testing.assert_allclose(found.power, 0.5 * mass * u * w**2, rtol=1e-9)


def test_drag_alone_has_no_thrust_of_its_own():
    creature = box_chain(4, "z")
    assert water_power(in_water(creature), {"angular_velocity": np.zeros(1)}, 1 / 120) is None
