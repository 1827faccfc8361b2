"""Each outer update of the step solver alone."""

import jax.numpy as jnp
import numpy as np

from evo_cpg.physics.step.outer_updates import Cone, reduced


def test_cone_iteration_solves_linear_fixed_point_in_three_rounds():
    """``L = a L + b`` has the solution b / (1 - a), which one secant step (Anderson) finds."""
    gain, offset = 0.6, 2.0
    cone = Cone.first(jnp.array([[1.0]], jnp.float32))
    plain = 1.0
    for _ in range(3):
        cone = cone.updated(gain * cone.radius + offset)
        plain = gain * plain + offset
    np.testing.assert_allclose(cone.radius, offset / (1 - gain), rtol=1e-6)
    assert abs(plain - offset / (1 - gain)) > 0.5
    assert int(cone.rounds[0]) == 3


def test_first_cone_update_takes_allowed_radius():
    cone = Cone.first(jnp.array([[1.0]])).updated(jnp.array([[5.0]]))
    assert float(cone.radius[0, 0]) == 5.0


def test_cone_radius_is_never_negative():
    cone = Cone.first(jnp.array([[1.0]])).updated(jnp.array([[0.5]])).updated(jnp.array([[0.0]]))
    assert float(cone.radius[0, 0]) == 0.0


def test_restitution_is_halved_twice_then_zero():
    values, fraction = [], jnp.float32(1)
    for _ in range(4):
        fraction = reduced(fraction)
        values.append(float(fraction))
    assert values == [0.5, 0.25, 0.0, 0.0]
