"""Courses: numbers of a configuration that are drawn for each trial.

A pattern such as ``world.ground.obstacles.*.centre.0`` stands for all numbers whose keys match.
Each of them is uniform in the range, independent of the others. All individuals of a generation
have equal courses, so that none is fitter by luck.
"""

import dataclasses
import fnmatch
import functools
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, UInt32
from typing_extensions import override

from evo_cpg.io.batched import UNTRACEABLE, NumbersOfPlan
from evo_cpg.io.errors import ConfigError, KeyProblem, nearest
from evo_cpg.io.numbers import number_at, number_keys, with_numbers
from evo_cpg.io.schema.experiment import ExperimentConfig
from evo_cpg.simulation.noise import uniforms
from evo_cpg.simulation.simulation import CourseBuilder, Simulation

# Sections whose numbers belong to the search or to the trial as a whole.
_FIXED = "controller", "simulation.seconds", "simulation.control_rate_hz"

# Courses from which the plan is made: the ends of all ranges, and random ones.
_RANDOM, _SEED = 6, 0

# Tag that keeps these draws apart from those of a task.
_TAG = 1


class Drawn(NumbersOfPlan, CourseBuilder):
    """Builder of the courses of a configuration (see `CourseBuilder`).

    Attributes:
        ranges: range of each number by key.
    """

    _origin: tuple[str, str]

    def __init__(self, config: ExperimentConfig, source: Path | str):
        """Make the plan from courses of the whole range.

        Raises:
            KeyProblem: a pattern matches no number, or the form of the model depends on a number.
            ConfigError: a course is not allowed, or courses differ in more than numbers.
        """
        self._origin = config.model_dump_json(), str(source)
        self.ranges = ranges_of(config)
        self._low, self._high = np.array(list(self.ranges.values())).T
        drawn = np.random.default_rng(_SEED).random((_RANDOM, len(self.ranges)))
        parts = np.concatenate([np.zeros((1, len(self.ranges))), np.ones_like(drawn[:1]), drawn])
        samples = self._low + (self._high - self._low) * parts
        super().__init__(
            without_draws(config), source, dict(zip(self.ranges, samples.T, strict=True))
        )
        try:
            with jax.enable_x64(True):
                jax.eval_shape(self._one, jax.ShapeDtypeStruct((2,), jnp.uint32))
        except UNTRACEABLE:
            keys = ", ".join(self.ranges)
            problem = f"the form of the model depends on one of them, so it cannot be drawn: {keys}"
            raise KeyProblem(("courses", "draw"), problem) from None

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the configuration alone, because programs cannot be pickled."""
        return _made, self._origin

    @override
    def numbers(self, origin: UInt32[Array, "2"]) -> list[Array]:
        # float64 where JAX allows it: there the same course has the same numbers in all programs.
        parts = uniforms(origin, len(self.ranges), _TAG).astype(float)
        low, high = (jnp.asarray(end, parts.dtype) for end in (self._low, self._high))
        return list(low + (high - low) * parts)

    def course(self, key: UInt32[np.ndarray, "2"]) -> dict[str, float]:
        """Return the numbers of one course by key, given its raw random key."""
        with jax.enable_x64(True):
            found = self.numbers(jnp.asarray(key))
        return dict(zip(self.ranges, map(float, found), strict=True))


def ranges_of(config: ExperimentConfig) -> dict[str, tuple[float, float]]:
    """Return the ranges of the numbers that a configuration draws, by key.

    Raises:
        KeyProblem: a pattern matches no number, or a number has two ranges.
    """
    keys, found = number_keys(config), dict[str, tuple[float, float]]()
    for pattern, (low, high) in config.courses.draw.items():
        where = "courses", "draw", pattern
        own = fnmatch.filter(keys, pattern)
        if not own:
            try:
                number_at(config, pattern)
            except ConfigError as error:
                raise KeyProblem(where, error.problem) from None
            raise KeyProblem(where, f"matches no number: {nearest(pattern, keys)}")
        for key in own:
            if key.startswith(_FIXED):
                raise KeyProblem(where, f"{key} cannot differ from trial to trial")
            if key in found:
                raise KeyProblem(where, f"{key} has two ranges")
            found[key] = (low, high)
    return found


def without_draws(config: ExperimentConfig) -> ExperimentConfig:
    """Return the configuration with numbers that are not drawn."""
    return config.model_copy(update={"courses": config.courses.model_copy(update={"draw": {}})})


def drawn(config: ExperimentConfig, source: Path | str) -> Simulation:
    """Return the simulation of a plan for all courses of a configuration.

    Raises:
        KeyProblem: the configuration draws numbers that cannot be drawn.
        ConfigError: a course is not allowed.
    """
    if config.evolution.body or config.evolution.type == "plans":
        problem = "cannot be drawn in a search whose bodies evolve. Leave out one of both"
        raise KeyProblem(("courses", "draw"), problem)
    courses = _made(config.model_dump_json(), str(source))
    return dataclasses.replace(courses.common, draws=courses)


def config_of_course(
    config: ExperimentConfig,
    simulation: Simulation,
    keys: UInt32[np.ndarray, "w"],
    source: Path | str,
) -> ExperimentConfig:
    """Return the configuration of one course, whose numbers are not drawn any more.

    Args:
        config: configuration with courses.
        simulation: its simulation.
        keys: raw random keys of the trial.
        source: file of the configuration.
    """
    courses = simulation.draws
    if not isinstance(courses, Drawn):
        return config
    own = simulation.course_keys(keys)
    assert own is not None
    return with_numbers(without_draws(config), courses.course(np.asarray(own)), source)


@functools.lru_cache(maxsize=8)
def _made(text: str, source: str) -> Drawn:
    return Drawn(ExperimentConfig.model_validate_json(text), source)
