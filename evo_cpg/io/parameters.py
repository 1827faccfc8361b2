"""Numbers of a configuration as differentiable parameters of a trial.

The simulation is built from traced numbers (see `evo_cpg.io.numbers`). The result is
exact at all values with unchanged decisions. Elements that no parameter changes remain constants
of the compiled program (see `Inputs`).

Building at neighbouring values shows which elements change, and whether decisions or kinks are
near.
"""

import dataclasses
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.creature.algebra.decisions import all_hold
from evo_cpg.creature.algebra.numerics import TABLES, is_number, is_traced
from evo_cpg.creature.surface import PointLayout
from evo_cpg.io.body_genes import without_body_genes
from evo_cpg.io.build import CommonPlan, build_experiment
from evo_cpg.io.errors import ConfigError, KeyProblem
from evo_cpg.io.keys import parts_of
from evo_cpg.io.load import located
from evo_cpg.io.numbers import Building, number_at, number_keys, values_of, with_numbers
from evo_cpg.io.schema.experiment import ExperimentConfig
from evo_cpg.native.jax_internals import Tracer
from evo_cpg.simulation.batched import Inputs
from evo_cpg.simulation.simulation import Simulation
from evo_cpg.training.experiment import ExperimentParts

# Distance of neighbouring values, as a fraction of the value, or absolute if the value is 0.
_STEP = 1e-4

# Fractions of the step to build at: on both sides, or on one if the other is not allowed.
_BOTH_SIDES, _ONE_SIDE = (-1.0, -0.5, 0.5, 1.0), (0.5, 1.0)

# The even part of a smooth change is quadratic in the step. A larger deviation is a kink. This is
# its threshold, as a fraction of the largest change in the same array.
_KINK = 1e-3

# Accuracy of poses that are found by a search, m and rad.
_SEARCHED = 1e-7

# Differences up to this fraction count as rounding.
_ROUNDING = 16 * np.finfo(float).eps

# Attribute of force laws that contains the wetted surfaces.
_PATCHES = jax.tree_util.GetAttrKey("patches")

# Attributes of wetted surfaces that contain the root of a distance from the end of a chain. At the
# end itself JAX has no derivative of the root, although the elements change smoothly. A `where`
# around the root in `evo_cpg.physics.water.viscous_bodies` would make `_finite` unnecessary.
_ROOTS = jax.tree_util.GetAttrKey("forward"), jax.tree_util.GetAttrKey("backward")
_INFINITE = (
    "changes the distances along a chain of bodies in water with a viscosity, which have no "
    "derivative in this version"
)

# Mask of the elements that depend on a number, by the index of the leaf that holds the elements.
Change = dict[int, np.ndarray]


@dataclasses.dataclass(frozen=True, eq=False)
class Parameters:
    """A simulation as a function of some numbers of its configuration.

    Attributes:
        keys: keys of the numbers, as in ``KEY=VALUE`` overrides.
        experiment: experiment at the configuration's own values.
        config: the configuration.
        source: file of the configuration.
        folders: further folders with a user's own classes.
        inputs: numbers of the simulation that change.
        building: builder of the simulation.
        kinks: reasons why keys have no derivative, by key.
    """

    keys: tuple[str, ...]
    experiment: ExperimentParts
    config: ExperimentConfig
    source: Path | str
    folders: tuple[Path, ...]
    inputs: Inputs
    building: Building
    kinks: Mapping[str, str]

    @property
    def values(self) -> Float[np.ndarray, " k"]:
        """Values of the parameters in the configuration."""
        return np.array([number_at(self.config, key) for key in self.keys])

    def simulation(self, values: Float[Array, " k"]) -> Simulation:
        """Return the simulation at some values, which may be traced.

        Args:
            values: values of the parameters, in the precision of the trial (see `checked`).

        Raises:
            ConfigError: the simulation is differentiated with respect to a value at a kink.
        """
        given = dict(zip(self.keys, values, strict=True))
        for key, reason in self.kinks.items():
            refusal = ConfigError(self.source, parts_of(key), reason)
            given[key] = _undifferentiated(given[key], refusal)
        leaves = self.building.traced(self.config, given)
        changed = values_of(leaves, self.inputs, values.dtype)
        return self.inputs.put(self.experiment.simulation, changed)

    def require(self, values: Float[np.ndarray, " k"]) -> None:
        """Check that `simulation` is valid at other values.

        Raises:
            ConfigError: the values are not allowed, or change the layout of the simulation.
        """
        with located(self.source):
            other, own = self.building.known(self.config_at(values)), self.building.own
            if not (other.has_layout_of(own) and all_hold(own.agrees(other.leaves, self.inputs))):
                named = zip(self.keys, values, strict=True)
                place = ", ".join(f"{key}={value:g}" for key, value in named)
                raise KeyProblem((), f"the simulation has another layout at {place}")

    def checked(self, values: Float[Array, " k"]) -> Float[Array, " k"]:
        """Return the values, and raise the error of `require` as soon as the values are known.

        Traced values are known when the compiled function runs. JAX then raises its own error,
        with this message.
        """

        def check(given: Array) -> np.ndarray:
            # Values that equal the configuration's own values in the trial's precision count as
            # these values.
            known = np.asarray(given)
            own = self.values.astype(known.dtype)
            self.require(np.where(known == own, self.values, known))
            return np.zeros((), np.int8)

        if not isinstance(values, Tracer):
            check(values)
            return values
        shape, known = jax.ShapeDtypeStruct((), np.int8), jax.lax.stop_gradient(values)
        zero = jax.pure_callback(check, shape, known, vmap_method="sequential")
        return values + zero.astype(values.dtype)

    def config_at(self, values: Float[np.ndarray, " k"]) -> ExperimentConfig:
        """Return the configuration with other values.

        Raises:
            ConfigError: the values are not allowed.
        """
        pairs = dict(zip(self.keys, map(float, values), strict=True))
        return with_numbers(self.config, pairs, self.source)


def parametrise(
    config: ExperimentConfig,
    source: Path | str,
    keys: Sequence[str],
    folders: Iterable[Path] = (),
    smooth: bool = True,
) -> Parameters:
    """Return the simulation of a configuration as a function of some of its numbers.

    Args:
        config: the configuration.
        source: file of the configuration.
        keys: keys such as ``world.water.form_drag`` or ``creature.bodies.1.shape.size.0``.
        folders: see `evo_cpg.io.build.build_experiment`.
        smooth: whether a value at a kink is refused at once, and not only when differentiated.

    Raises:
        ConfigError: a key does not exist, is not a real number, changes nothing or more than
            numbers, or has a value at a kink.
    """
    folders, config = tuple(folders), without_body_genes(config)
    for i, key in enumerate(keys):
        if key in keys[:i]:
            raise ConfigError(source, parts_of(key), "is given twice")
        number_at(config, key, source)
    # This also makes a user's own classes importable.
    experiment = build_experiment(config, source, folders)
    kinks: dict[str, str] = {}

    def changes() -> dict[str, Change]:
        kinks.clear()
        return {key: _change(building, config, key, None if smooth else kinks) for key in keys}

    with located(source):
        building = Building(config)
        try:
            found = changes()
        except KeyProblem:
            # Merged surfaces may separate, which reorders their points.
            building = Building(config, CommonPlan("separate"))
            found = changes()
            experiment = build_experiment(config, source, folders, CommonPlan("separate"))
        followed = _followed(building, config, found)
        for key in found:
            if key not in followed:
                problem = _hindrance(building, config, {key: found[key]})
                raise KeyProblem(parts_of(key), f"{problem}, so it has no derivative")
        finite = _finite(building, config, found)
        for key in found:
            if key not in finite:
                if smooth:
                    raise KeyProblem(parts_of(key), _INFINITE)
                kinks[key] = _INFINITE
    every = found.values()
    places = sorted({place for change in every for place in change})
    moves = [np.any([c[place] for c in every if place in c], axis=0) for place in places]
    inputs = Inputs(tuple(places), tuple(map(np.flatnonzero, moves)))
    return Parameters(tuple(keys), experiment, config, source, folders, inputs, building, kinks)


def all_parameters(
    config: ExperimentConfig,
    source: Path | str,
    folders: Iterable[Path] = (),
    surfaces: bool = True,
) -> tuple[str, ...]:
    """Return the keys of all numbers that `parametrise` accepts, in the order of the file.

    Args:
        config: the configuration.
        source: file of the configuration.
        folders: see `evo_cpg.io.build.build_experiment`.
        surfaces: whether to include numbers that change the wetted surfaces, which make programs
            large and slow to compile.
    """
    found: list[str] = []
    infinite: set[str] = set()
    config = without_body_genes(config)
    experiment = build_experiment(config, source, folders)
    paths = jax.tree_util.tree_flatten_with_path(experiment.simulation)[0]
    wet = {i for i, (path, _) in enumerate(paths) if _PATCHES in path}
    layouts: tuple[PointLayout, ...] = ("merged", "separate") if surfaces else ("merged",)
    for layout in layouts:
        building = Building(config, CommonPlan(layout))
        changes = {}
        for key in number_keys(config):
            if key in found or key in infinite:
                continue
            try:
                change = _change(building, config, key)
            except KeyProblem:
                continue
            if surfaces or not wet & set(change):
                changes[key] = change
        followed = _followed(building, config, changes)
        finite = _finite(building, config, {key: changes[key] for key in followed})
        infinite |= set(followed) - set(finite)
        found += finite
    return tuple(key for key in number_keys(config) if key in found)


def _change(
    building: Building, config: ExperimentConfig, key: str, kinks: dict[str, str] | None = None
) -> Change:
    """Return the elements of leaves that depend on one number.

    Args:
        building: builder of simulations.
        config: the configuration.
        key: key of the number.
        kinks: dict that gets the reason why there is no derivative at a kink, or None to raise it.

    Raises:
        KeyProblem: more than numbers changes, no leaf changes, or there is no derivative.
    """
    value, where = number_at(config, key), parts_of(key)
    step = _STEP * (abs(value) or 1.0)
    # Build on both sides, or on one side if the other one is not allowed.
    for fractions in (_BOTH_SIDES, _ONE_SIDE, [-fraction for fraction in _ONE_SIDE]):
        try:
            near = [with_numbers(config, {key: value + x * step}, "") for x in fractions]
            others, both = [building.known(each) for each in near], fractions is _BOTH_SIDES
            break
        except KeyProblem:
            continue
    else:
        raise KeyProblem(where, f"has no allowed values on either side of {value:g}")
    if not all(other.has_layout_of(building.own) for other in others):
        raise KeyProblem(
            where,
            "changes more than numbers (such as joints, couplings of oscillators or the time "
            "step), so it has no derivative",
        )
    change: Change = {}
    for place, leaf in enumerate(building.own.leaves):
        if not is_number(leaf):
            continue
        first = getattr(building.own.paths[place][0], "name", None)
        searched = first == "situations" and building.own.choices.searched
        accuracy = _SEARCHED if searched else 0.0
        known = np.isfinite(leaf)
        centre = np.where(known, leaf, 0.0)
        moved = np.array([np.where(known, x.leaves[place], 0.0) for x in others]) - centre
        least = _ROUNDING * max(float(np.abs(centre).max(initial=0.0)), np.finfo(float).tiny)
        moved[np.abs(moved) < least] = 0.0
        bend = 0.0
        if both:
            even = moved[0] + moved[-1] - 4 * (moved[1] + moved[-2])
            bend = float(np.abs(even).max(initial=0.0))
        largest = float(np.abs(moved).max(initial=0.0))
        if not bend <= _KINK * largest + 40 * least + accuracy:
            problem = (
                f"{value:g} is at a kink of `{building.name(place)}` (such as a limit, or the "
                "lowest of several feet), so it has no derivative"
            )
            if kinks is None:
                raise KeyProblem(where, problem)
            kinks[key] = problem
        if moved.any():
            change[place] = np.asarray(moved.any(0))
    if not change:
        raise KeyProblem(where, "changes nothing in a trial of this experiment")
    for place in change:
        if getattr(building.own.paths[place][-1], "name", None) in TABLES:
            problem = "changes a table of positions (a mesh or a relief), so it has no derivative"
            raise KeyProblem(where, problem)
    return change


def _followed(
    building: Building, config: ExperimentConfig, changes: dict[str, Change]
) -> list[str]:
    """Return the keys of the numbers whose changes of leaves JAX can trace."""
    return _passing(
        list(changes),
        lambda keys: not _hindrance(building, config, {key: changes[key] for key in keys}),
    )


def _passing(keys: list[str], test: Callable[[list[str]], bool]) -> list[str]:
    """Return the keys that pass a test, which a list of keys passes if each of them does."""
    if not keys or test(keys):
        return keys
    if len(keys) == 1:
        return []
    middle = len(keys) // 2
    return _passing(keys[:middle], test) + _passing(keys[middle:], test)


def _hindrance(building: Building, config: ExperimentConfig, changes: dict[str, Change]) -> str:
    """Return why traced leaves do not depend on some numbers, or empty if they do."""
    places = sorted({place for change in changes.values() for place in change})
    constant: list[int] = []

    def trace(numbers: list[Array]) -> None:
        leaves = building.traced(config, dict(zip(changes, numbers, strict=True)))
        constant.extend(place for place in places if not is_traced(leaves[place]))

    try:
        jax.eval_shape(trace, [jnp.zeros(())] * len(changes))
    except (jax.errors.JAXTypeError, TypeError, ValueError) as error:
        return f"cannot be traced by JAX: {str(error).partition(chr(10))[0]}"
    if not constant:
        return ""
    names = ", ".join(f"`{building.name(place)}`" for place in constant)
    return f"changes {names} in a way that JAX cannot trace"


def _finite(building: Building, config: ExperimentConfig, changes: dict[str, Change]) -> list[str]:
    """Return the keys of the numbers by which all changing roots have a finite derivative.

    The roots are those that change with any of the numbers. Another number, such as the angle of a
    joint, may make their derivative infinite without changing them.
    """
    every = sorted({place for change in changes.values() for place in change})
    paths = building.own.paths
    roots = [i for i in every if _PATCHES in paths[i] and paths[i][-1] in _ROOTS]
    if not roots:
        return list(changes)

    def is_finite(keys: list[str]) -> bool:
        def trace(numbers: Array) -> list[Array]:
            leaves = building.traced(config, dict(zip(keys, numbers, strict=True)))
            return [jnp.asarray(leaves[place]) for place in roots]

        values = jnp.array([number_at(config, key) for key in keys])
        _, slopes = jax.jit(lambda x: jax.jvp(trace, (x,), (jnp.ones_like(x),)))(values)
        return all(np.isfinite(slope).all() for slope in slopes)

    return _passing(list(changes), is_finite)


def _undifferentiated(value: Array, refusal: ConfigError) -> Array:
    """Return the value unchanged. Raise the refusal when JAX differentiates it."""

    @jax.custom_jvp
    def same(value: Array) -> Array:
        return value

    @same.defjvp
    def refuse(*_: Any) -> Any:
        raise refusal

    return same(value)
