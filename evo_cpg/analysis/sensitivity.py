"""Sensitivity of an animal's speed and fitness to each parameter.

With a measure m (a speed, a fitness) and a parameter p the elasticity is

    e = (p / m) dm/dp,

per cent of m per per cent of p. The derivative of the whole trial is computed by automatic
differentiation. It predicts the effect of *small* changes. One per cent may not be small if feet
hit the ground, or in a long trial. Finite differences therefore check each derivative: the
parameter changes by one per cent to both sides, or to the allowed side, and each trial runs again.
"""

import dataclasses
import math
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.creature.algebra.numerics import Number
from evo_cpg.physics.step.world import World
from evo_cpg.simulation.judge import score
from evo_cpg.simulation.measures import Displacement, Measure, Measures, Trial, no_displacement
from evo_cpg.simulation.rollout import rollout
from evo_cpg.simulation.simulation import Simulation
from evo_cpg.simulation.task import Transition

# Relative change that checks a derivative, or absolute change of a parameter that is 0.
CHANGE = 0.01

# Largest relative error of a confirmed derivative's prediction for such a change.
_AGREEMENT = 0.2

# Difference of prediction and result, as a fraction of the measure, that is negligible.
_NEGLIGIBLE = 1e-5

# Largest measure (m/s, or fitness) without an elasticity, because it may be a rounding error.
_NOTHING = 1e-9

MEASURES = ("speed", "fitness")

# Name of the term with the speed. No term of a task or measure has this name.
_SPEED = "(speed of the root)"


class Sensitivity(NamedTuple):
    """Sensitivity of a measure to one parameter.

    Attributes:
        key: key of the parameter.
        value: value of the parameter.
        slope: dm/dp.
        change: m at the larger value less m at the smaller one.
        step: difference of the two values.
        measure: m itself.
    """

    key: str
    value: float
    slope: float
    change: float
    step: float
    measure: float

    @property
    def elasticity(self) -> float:
        """Change of the measure in per cent, per per cent of the parameter.

        For a parameter of 0, it is the relative change of the measure per unit of the parameter.
        If the measure is about 0, it is NaN.
        """
        return self._relative(self.slope)

    @property
    def finite(self) -> float:
        """Elasticity from simulations with finite changes of the parameter."""
        return self._relative(self.change / self.step if self.step else math.nan)

    def _relative(self, slope: float) -> float:
        size = abs(self.measure)
        return slope * (self.value or 1.0) / size if size > _NOTHING else math.nan

    @property
    def confirmed(self) -> bool:
        """Return whether the derivative predicts the effect of ``CHANGE``."""
        predicted = self.step * self.slope
        larger = max(abs(predicted), abs(self.change))
        bound = _AGREEMENT * larger + _NEGLIGIBLE * abs(self.measure)
        return bool(self.step and np.isfinite(larger) and abs(predicted - self.change) <= bound)


class _Progress(Measure):
    """Speed of the root, m/s: towards the light, ahead, or in any direction.

    Attributes:
        duration: time from the first control step to the last, s.
        axes: number of axes along which the displacement counts. 1 is ahead or towards the light.
    """

    duration: Number
    axes: int = eqx.field(static=True)

    def begin(self, world: World, batch: tuple[int, ...], dtype: jnp.dtype) -> Displacement:
        """See `Measure.begin`."""
        del world
        return no_displacement(batch, dtype)

    def update(self, tally: Displacement, transition: Transition) -> Displacement:
        """See `Measure.update`."""
        place, light = transition.before.state.position, transition.before.light_position
        if light is not None and self.axes == 1:
            away = place - light
            place = jnp.stack([-jnp.sqrt((away * away).sum(0)), 0 * place[1], 0 * place[2]])
        return tally.moved(transition.step == 0, place, place)

    def finish(self, tally: Displacement, trial: Trial) -> Float[Array, " *n"]:
        """See `Measure.finish`."""
        del trial
        displacement = (tally.end - tally.start)[: self.axes]
        along = (
            displacement[0] if self.axes == 1 else jnp.sqrt((displacement * displacement).sum(0))
        )
        return along / self.duration


def measured(
    simulation: Simulation,
    genes: Float[Array, "g *n"],
    scales: dict[str, float],
    keys: Array | None = None,
) -> Float[Array, "2 *n"]:
    """Return speed (m/s) and fitness (`MEASURES`) of a trial.

    With a light at rest, only the decrease of the distance to it counts. Otherwise, the speed is
    ahead if the task's heading is forward, else in any direction. Height does not count over
    ground.
    """
    ahead = simulation.goals[0] is not None or simulation.task.heading == "forward"
    duration = (simulation.steps - 1) / simulation.control_rate
    axes = 1 if ahead else 3 if simulation.world.contact_model is None else 2
    progress = Measures((_SPEED,), (_Progress(duration=duration, axes=axes),))
    with_speed = dataclasses.replace(simulation, measures=simulation.measures | progress)
    outcome = rollout(with_speed, genes, keys)
    own_scales = {name: jnp.asarray(value, genes.dtype) for name, value in scales.items()}
    return jnp.stack([outcome.terms[_SPEED], score(simulation.task, outcome, own_scales)])


def changed(
    values: Float[np.ndarray, " k"], allowed: Callable[[Float[np.ndarray, " k"]], bool]
) -> Float[np.ndarray, "2 k k"]:
    """Return the values with each of them in turn made smaller, and larger, by ``CHANGE``.

    A change that is not allowed is left out, such as a fraction of more than 1.

    Args:
        values: values of the parameters.
        allowed: function of values that returns whether a simulation can have them.
    """
    steps = np.diag(CHANGE * np.where(values, np.abs(values), 1.0))
    places = values + np.stack([-steps, steps])
    return np.array([[p if allowed(p) else values for p in side] for side in places])


def sensitivities(
    keys: tuple[str, ...],
    values: Float[np.ndarray, " k"],
    measures: Float[np.ndarray, " m"],
    slopes: Float[np.ndarray, "m k"],
    after: Float[np.ndarray, "m 2 k"],
    steps: Float[np.ndarray, " k"],
) -> tuple[tuple[Sensitivity, ...], ...]:
    """Return the sensitivities of each measure to all parameters, the most important first.

    Args:
        keys: keys of the parameters.
        values: values of the parameters.
        measures: measures at these values.
        slopes: derivatives.
        after: measures with each parameter made smaller, and larger.
        steps: difference of the larger and the smaller value, 0 if neither is allowed.
    """

    def weight(one: Sensitivity) -> tuple[bool, float]:
        size = one.elasticity if one.confirmed else one.finite
        return one.value != 0, abs(size) if np.isfinite(size) else 0.0

    found = []
    for measure, slope, (less, more) in zip(measures, slopes, after, strict=True):
        numbers = zip(values, slope, more - less, steps, strict=True)
        rows = [
            Sensitivity(key, float(p), float(dm), float(change), float(step), float(measure))
            for key, (p, dm, change, step) in zip(keys, numbers, strict=True)
        ]
        found.append(tuple(sorted(rows, key=weight, reverse=True)))
    return tuple(found)


def differentiate(
    function: Callable[[Array], Array], values: Float[Array, " k"]
) -> tuple[Float[Array, " m"], Float[Array, "m k"]]:
    """Return values and derivatives in forward mode, with all parameters side by side.

    Reverse mode would compile longer. Forward mode is fast, because the tangents of one animal fill
    a vector.
    """
    slopes, result = jax.jacfwd(lambda p: (function(p),) * 2, has_aux=True)(values)
    return result, slopes
