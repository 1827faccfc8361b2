"""Numbers of a configuration as parameters by which a trial can be differentiated.

Building an experiment is NumPy, but what comes out is a pytree whose numbers are smooth functions
of those in the configuration: a density becomes masses, inertias and limit springs. Those leaves
that change with a parameter p are found by building at neighbouring values, and stand in the
compiled program as

    leaf(p) = leaf(p_0) + sum_k J_k (p_k - p_0k),                                       (1)

everything else as a constant. Value and derivative are exact at p_0, J being differences of fourth
order in float64 (relative error about 1e-11). Far from p_0 the leaves are linear where they should
be curved: whoever moves far builds anew there (`Parameters.at`) and gives the program another
`Linearisation`, with which nothing is compiled again.
"""

import dataclasses
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.config.build import build_experiment
from evo_cpg.config.differences import CENTRAL, ONE_SIDED, Change, derivative
from evo_cpg.config.errors import ConfigError
from evo_cpg.config.numbers import number_at, number_keys, with_numbers
from evo_cpg.config.schema.experiment import ExperimentConfig
from evo_cpg.simulation.batched import Inputs, is_number
from evo_cpg.simulation.rollout import Simulation
from evo_cpg.training.experiment import Experiment

# Distance of neighbouring values, as a share of the value; of 0 it is that itself.
_STEP = 1e-4


# Where the surfaces are that meet the water.
_PATCHES = tuple(jax.tree_util.GetAttrKey(name) for name in ("world", "patches"))

# What does not change may differ by this share: rounding.
_LAYOUT = 1e-9

# Arrays looked up by whole-array programs, which know no derivative by them.
_TABLES = ("heights", "meshes", "triangles")


class Linearisation(NamedTuple):
    """Equation (1): arrays, which a compiled program takes as arguments.

    Attributes:
        centre: p_0.
        leaves: the leaves that change, at p_0.
        slopes: J of each, the parameters along its first axis.
    """

    centre: Float[np.ndarray, " k"] | Float[Array, " k"]
    leaves: tuple[Any, ...]
    slopes: tuple[Any, ...]


@dataclasses.dataclass(frozen=True, eq=False)
class Parameters:
    """A simulation as a function of some numbers of its configuration.

    Attributes:
        keys: of the numbers, as in ``KEY=VALUE`` overrides.
        model: equation (1) at the configuration's own values.
        experiment: at the configuration's own values.
        config: the configuration.
        source: the file that it came from.
        folders: where else a user's own classes are looked for.
        inputs: the numbers of the simulation that change.
        apart: whether bodies with the same surface are treated one by one, because parameters make
            them differ.
    """

    keys: tuple[str, ...]
    model: Linearisation
    experiment: Experiment
    config: ExperimentConfig
    source: Path | str
    folders: tuple[Path, ...]
    inputs: Inputs
    apart: bool

    @property
    def values(self) -> Float[np.ndarray, " k"]:
        """Those in the configuration."""
        return np.array([number_at(self.config, key) for key in self.keys])

    def simulation(
        self, values: Float[Array, " k"], model: Linearisation | None = None
    ) -> Simulation:
        """The trial at some values, which may be traced; to first order about the model's centre.

        Args:
            values: of the parameters, in the precision of the trial.
            model: see `at`; that of the configuration's own values if None.
        """
        model = model or self.model
        dtype = values.dtype
        moved = values - jnp.asarray(model.centre, dtype)
        parts = zip(self.inputs.elements, model.leaves, model.slopes, strict=True)
        changed = [
            jnp.asarray(leaf, dtype).reshape(-1)[own]
            + jnp.tensordot(moved, jnp.asarray(slope, dtype).reshape(len(moved), -1)[:, own], 1)
            for own, leaf, slope in parts
        ]
        return self.inputs.put(self.experiment.simulation, changed)

    def at(self, values: Float[np.ndarray, " k"], curved: bool = True) -> Linearisation:
        """Equation (1) about other values, for the same compiled program.

        Args:
            values: of the parameters.
            curved: with the derivatives there; else all are 0, which takes a single build.

        Raises:
            ConfigError: the values are not allowed, or the simulation is laid out differently.
        """
        config = self.config_at(values)
        build = _builder(self.source, self.folders, self.apart)
        leaves = _same_layout(build, config, self.experiment.simulation)
        if leaves is None or not self._covers(leaves):
            raise ConfigError(
                self.source,
                (),
                f"at {_named(self.keys, values)} the simulation is laid out differently",
            )
        slopes: list[dict[int, Change]] = [{} for _ in self.keys]
        if curved:
            here = jax.tree.unflatten(jax.tree.structure(self.experiment.simulation), leaves)
            slopes = [_slopes(build, config, key, here, self.source) for key in self.keys]
        return _linearisation(np.asarray(values, float), self.inputs.places, leaves, slopes)

    def _covers(self, leaves: list[Any]) -> bool:
        """Whether nothing differs from the configuration's own simulation but what changes."""
        changing = dict(zip(self.inputs.places, self.inputs.elements, strict=True))
        own = jax.tree.leaves(self.experiment.simulation)
        for place, (leaf, old) in enumerate(zip(leaves, own, strict=True)):
            if is_number(leaf):
                rest = np.delete(np.ravel(leaf), changing.get(place, []))
                theirs = np.delete(np.ravel(old), changing.get(place, []))
                if not np.allclose(rest, theirs, rtol=_LAYOUT, atol=0):
                    return False
        return True

    def config_at(self, values: Float[np.ndarray, " k"]) -> ExperimentConfig:
        """The configuration with other values.

        Raises:
            ConfigError: values that are not allowed.
        """
        pairs = dict(zip(self.keys, map(float, values), strict=True))
        return with_numbers(self.config, pairs, self.source)


def parametrise(
    config: ExperimentConfig,
    source: Path | str,
    keys: Sequence[str],
    folders: Iterable[Path] = (),
) -> Parameters:
    """The simulation of a configuration as a function of some of its numbers.

    Args:
        config: the configuration.
        source: file it came from.
        keys: such as ``world.water.form_drag`` or ``creature.bodies.1.shape.size.0``.
        folders: see `evo_cpg.config.build.build_experiment`.

    Raises:
        ConfigError: a key that does not exist, is no real number, changes nothing or more than
            numbers, or has a value at a kink.
    """
    folders = tuple(folders)
    for i, key in enumerate(keys):
        if key in keys[:i]:
            raise ConfigError(source, key.split("."), "is given twice")
        number_at(config, key, source)
    for apart in (False, True):
        build = _builder(source, folders, apart)
        experiment = build(config)
        leaves = jax.tree.leaves(experiment.simulation)
        try:
            slopes = [_slopes(build, config, key, experiment.simulation, source) for key in keys]
        except ConfigError:
            # Grouped surfaces may part, and their points change places.
            if apart:
                raise
        else:
            break
    places = sorted({place for slope in slopes for place in slope})
    moves = [np.any([s[place].moves for s in slopes if place in s], axis=0) for place in places]
    inputs = Inputs(tuple(places), tuple(map(np.flatnonzero, moves)))
    values = np.array([number_at(config, key) for key in keys])
    model = _linearisation(values, places, leaves, slopes)
    return Parameters(tuple(keys), model, experiment, config, source, folders, inputs, apart)


def all_parameters(
    config: ExperimentConfig,
    source: Path | str,
    folders: Iterable[Path] = (),
    surfaces: bool = True,
) -> tuple[str, ...]:
    """The keys of all numbers for which `parametrise` works, in the order of the file.

    Args:
        config: the configuration.
        source: file it came from.
        folders: see `evo_cpg.config.build.build_experiment`.
        surfaces: with those that change the surfaces which meet the water; they make programs
            large, and slow to compile.
    """
    found = []
    folders = tuple(folders)
    for apart in (False, True) if surfaces else (False,):
        build = _builder(source, folders, apart)
        base = build(config).simulation
        paths = jax.tree_util.tree_flatten_with_path(base)[0]
        wet = {i for i, (path, _) in enumerate(paths) if path[:2] == _PATCHES}
        for key in number_keys(config):
            if key in found:
                continue
            try:
                changes = _slopes(build, config, key, base, source)
            except ConfigError:
                continue
            if surfaces or not wet & set(changes):
                found.append(key)
    return tuple(key for key in number_keys(config) if key in found)


class _LayoutError(ConfigError):
    """A number that changes more than numbers."""


_Build = Callable[[ExperimentConfig], Experiment]


def _builder(source: Path | str, folders: tuple[Path, ...], apart: bool) -> _Build:
    return lambda config: build_experiment(config, source, folders, apart)


def _named(keys: Sequence[str], values: Iterable[float]) -> str:
    return ", ".join(f"{key}={value:g}" for key, value in zip(keys, values, strict=True))


def _same_layout(build: _Build, config: ExperimentConfig, other: Simulation) -> list[Any] | None:
    """The leaves of a simulation that differs from another one in its numbers alone, or None."""
    leaves, structure = jax.tree.flatten(build(config).simulation)
    theirs, layout = jax.tree.flatten(other)
    if structure != layout:
        return None
    for mine, given in zip(leaves, theirs, strict=True):
        if not (is_number(given) and is_number(mine)):
            if not np.array_equal(mine, given):
                return None
        elif np.shape(mine) != np.shape(given):
            return None
    return leaves


def _slopes(
    build: _Build,
    config: ExperimentConfig,
    key: str,
    base: Simulation,
    source: Path | str,
) -> dict[int, Change]:
    """Derivatives of the leaves by one number, of those that change; ``base`` is what is built.

    Raises:
        _LayoutError: more than leaves change.
        ConfigError: none does, or there is no derivative.
    """
    value, where = number_at(config, key, source), key.split(".")
    step = _STEP * (abs(value) or 1.0)

    def built(shares: Iterable[float]) -> list[list[Any]]:
        found = []
        for share in shares:
            neighbour = with_numbers(config, {key: value + share * step}, source)
            other = _same_layout(build, neighbour, base)
            if other is None:
                raise _LayoutError(
                    source,
                    where,
                    "changes more than numbers (which parts there are, how they are joined or "
                    "grouped, steps of time), so there is no derivative by it",
                )
            found.append(other)
        return found

    try:
        stencil, found = CENTRAL, built(CENTRAL[0])
    except _LayoutError:
        raise
    except ConfigError:
        # At the end of what is allowed: from the other side.
        stencil, found = ONE_SIDED, []
        for sign in (1.0, -1.0):
            try:
                found = built(sign * share for share in ONE_SIDED[0])
                step *= sign
                break
            except _LayoutError:
                raise
            except ConfigError:
                continue
        if not found:
            raise ConfigError(
                source, where, f"has no allowed values on either side of {value:g}"
            ) from None
    paths = jax.tree_util.tree_flatten_with_path(base)[0]
    changes = {}
    for place, (_, leaf) in enumerate(paths):
        if not is_number(leaf):
            continue
        slope = derivative(stencil, step, leaf, [other[place] for other in found])
        if slope is None:
            name = jax.tree_util.keystr(paths[place][0])[1:]
            raise ConfigError(
                source,
                where,
                f"{value:g} is at a kink of `{name}` (the lowest of several feet, a limit), or a "
                "search of limited accuracy lies between them, so there is no derivative by it",
            )
        if slope.moves.any():
            changes[place] = slope
    if not changes:
        raise ConfigError(source, where, "changes nothing in a trial of this experiment")
    for place in changes:
        if getattr(paths[place][0][-1], "name", None) in _TABLES:
            raise ConfigError(
                source, where, "changes a table of places (a mesh, a relief): not differentiable"
            )
    return changes


def _linearisation(
    centre: np.ndarray, places: Iterable[int], leaves: list[Any], slopes: list[dict[int, Change]]
) -> Linearisation:
    places = tuple(places)
    here = tuple(np.asarray(leaves[place], float) for place in places)
    each = tuple(
        np.array([s[place].slope if place in s else np.zeros_like(leaf) for s in slopes])
        for place, leaf in zip(places, here, strict=True)
    )
    return Linearisation(centre, here, each)
