"""Genes of the body: patterns of a configuration as factors on its numbers.

A number of the configuration is its own value times a product of factors, each with an exponent:
``number = own * prod(factor ** exponent)``. The length of a body, for example, scales the size
along one axis, the mass in kg, and the places on the body: its own joint, its children's joints and
its eyes. So joints move with the surfaces that they sit on. The strength of the joint's motors
follows the cross-section: its exponent is the number of scaled axes across the body.

Axes are those of the body's frame. A body is long along the axis from its joint to its centre. A
root is long along its longest edge.
"""

import dataclasses
import fnmatch
import functools
import itertools
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Array, Float
from typing_extensions import override

from evo_cpg.creature.algebra.numerics import Numbers
from evo_cpg.creature.creature import neutral_pose
from evo_cpg.io.batched import NumbersOfPlan
from evo_cpg.io.errors import ConfigError, Key, KeyProblem, nearest
from evo_cpg.io.keys import parts_of
from evo_cpg.io.numbers import number_at, number_keys, with_numbers
from evo_cpg.io.schema.copies import copies_named
from evo_cpg.io.schema.creature import BodyConfig
from evo_cpg.io.schema.evolution import BodyGeneConfig
from evo_cpg.io.schema.experiment import ExperimentConfig
from evo_cpg.io.schema.joint import JointConfig, TurnConfig
from evo_cpg.io.schema.shape import (
    BoxConfig,
    CapsuleConfig,
    CylinderConfig,
    EllipsoidConfig,
    MeshConfig,
    ShapeConfig,
    SphereConfig,
)
from evo_cpg.simulation.simulation import BodyBuilder, BodyGenes, Simulation

_SECTION = "evolution", "body"

# Quantities of a body. All but the last three are lengths in m.
QUANTITIES = ("x", "y", "z", "length", "girth", "scale", "strength")
_FACTORS = ("girth", "scale", "strength")

# Numbers of a motor that its strength multiplies.
_STRENGTHS = ("gain", "stiffness", "torque_limit", "gear", "area")

# Number of bodies from which the plan is made: more if limbs can touch, because every pair that
# touches in any body belongs to the plan. Most are corners of the range, and some are random.
_SAMPLES, _SAMPLES_APART, _RANDOM, _SEED = 32, 10, 4, 0

# Largest distance from the mirror image of a body, as a fraction of the creature's size.
_MIRRORED = 1e-6


class Scaling(NamedTuple):
    """Numbers of a configuration as functions of the factors of the body's genes.

    Attributes:
        genes: genes of the body.
        keys: keys of the numbers that change.
        own: values of the numbers at factors of 1.
        exponents: exponent of each factor for each number.
    """

    genes: BodyGenes
    keys: tuple[str, ...]
    own: Float[np.ndarray, " k"]
    exponents: Float[np.ndarray, "k f"]

    def numbers(self, factors: Float[Numbers, "f *n"]) -> dict[str, Any]:
        """Return the numbers by key, as functions of factors that may be traced."""
        found = {}
        for key, own, row in zip(self.keys, self.own, self.exponents, strict=True):
            powers = (factors[g] if row[g] == 1 else factors[g] ** row[g] for g in row.nonzero()[0])
            found[key] = functools.reduce(lambda a, b: a * b, powers, own)
        return found


class _Gene(NamedTuple):
    """One factor, before the numbers that it scales are known.

    Attributes:
        key: key of the section that defines it.
        name: name of the body, or key of a number, and the quantity.
        given: its section.
        scaled: indices of the bodies and of their axes that it scales.
        strengthened: indices of the bodies whose motors it strengthens.
        unit: value of the quantity at a factor of 1.
        relative: whether the range is one of factors.
    """

    key: str
    name: str
    given: BodyGeneConfig
    scaled: tuple[tuple[int, int], ...]
    strengthened: tuple[int, ...]
    unit: float
    relative: bool


def scaling_of(config: ExperimentConfig, binary: bool) -> Scaling:
    """Return the numbers that the genes of a configuration's body scale.

    Raises:
        KeyProblem: a pattern matches nothing, a quantity does not exist, or a range is wrong.
    """
    genes = [
        gene
        for key, given in config.evolution.body_genes.items()
        for gene in _genes(config, key, given)
    ]
    bodies, count = config.creature.bodies, len(genes)
    axes, motors = np.zeros((len(bodies), 3, count)), np.zeros((len(bodies), count))
    rows: dict[str, np.ndarray] = {}
    for g, gene in enumerate(genes):
        for body, axis in gene.scaled:
            axes[body, axis, g] += 1
        motors[list(gene.strengthened), g] += 1
        if not (gene.scaled or gene.strengthened):
            rows[gene.key] = np.eye(count)[g]
    raw = set(rows)
    for key, row in _rows(config, axes, motors, genes):
        rows[key] = rows.get(key, 0) + row
    own = {key: 1.0 if key in raw else number_at(config, key) for key in rows if rows[key].any()}
    kept = [key for key in own if own[key] != 0]
    for g, gene in enumerate(genes):
        if not any(rows[key][g] for key in kept):
            raise KeyProblem((*_SECTION, gene.key), "changes nothing: no body has such numbers")
    low, high = (tuple(gene.given.range[i] / gene.unit for gene in genes) for i in (0, 1))
    log = tuple(
        (gene.given.scale or ("log" if gene.relative else "linear")) == "log" for gene in genes
    )
    names, units = tuple(gene.name for gene in genes), tuple(gene.unit for gene in genes)
    made = BodyGenes(names, low, high, log, units, binary)
    return Scaling(
        made, tuple(kept), np.array([own[key] for key in kept]), np.array([rows[x] for x in kept])
    )


def _genes(config: ExperimentConfig, key: str, given: BodyGeneConfig) -> Iterator[_Gene]:
    """Yield the genes of one entry of ``evolution.body``."""
    where, (low, high) = (*_SECTION, key), given.range
    if not low < high:
        raise KeyProblem(where, f"the range must rise, got {low:g} to {high:g}")
    if parts_of(key)[0] in type(config).model_fields:
        try:
            number_at(config, key)
        except ConfigError as error:
            raise KeyProblem(where, error.problem) from None
        if given.scale == "log" and low <= 0:
            raise KeyProblem(where, f"a logarithmic range must be positive, got {low:g}")
        yield _Gene(key, key, given, (), (), 1.0, False)
        return
    if low <= 0:
        raise KeyProblem(where, f"the range must be positive, got {low:g} to {high:g}")
    pattern, _, quantity = key.rpartition(".")
    if quantity not in QUANTITIES or not pattern:
        words = f"{quantity!r} is no quantity of a body: {nearest(quantity, QUANTITIES)}"
        raise KeyProblem(where, f"{words}. Write PATTERN.QUANTITY, such as '*_femur.length'")
    for group in _groups(config, key, pattern, given.genes):
        bodies = [config.creature.bodies[i] for i in group]
        scaled = tuple(
            (i, axis)
            for i, body in zip(group, bodies, strict=True)
            for axis in _axes(body, quantity)
        )
        units = {1.0}
        if quantity not in _FACTORS:
            units = {
                _extent(body, axis, where) for body in bodies for axis in _axes(body, quantity)
            }
        if len(units) > 1:
            sizes = ", ".join(f"{unit:g}" for unit in sorted(units))
            raise KeyProblem(
                where,
                f"the bodies of one gene differ ({sizes} m). Give factors, as {pattern}.scale or "
                f"{pattern}.girth, or a gene to each body (genes: each)",
            )
        name = f"{bodies[0].name}.{quantity}"
        motors = group if quantity == "strength" else ()
        yield _Gene(key, name, given, scaled, tuple(motors), units.pop(), quantity in _FACTORS)


def _groups(config: ExperimentConfig, key: str, pattern: str, sharing: str) -> list[list[int]]:
    """Return groups of the creature's entries that match a pattern. Each group shares a gene."""
    creature, matched = config.creature, []
    everything = creature.copies()
    for i, body in enumerate(creature.bodies):
        names = [copy.name for copy in everything if copy.entry == i]
        if fnmatch.fnmatchcase(body.name, pattern) or (
            names and all(fnmatch.fnmatchcase(name, pattern) for name in names)
        ):
            matched.append(i)
        elif some := [name for name in names if fnmatch.fnmatchcase(name, pattern)]:
            problem = f"matches {some[0]!r}, but not all copies of {body.name!r}"
            raise KeyProblem((*_SECTION, key), f"{problem}, which have the same numbers")
    if not matched:
        names = [body.name for body in creature.bodies]
        numbers = [number for number in number_keys(config) if number.startswith("creature.")]
        near = nearest(pattern, [*names, *(numbers if "." in pattern else ())])
        raise KeyProblem((*_SECTION, key), f"{pattern!r} matches no body: {near}")
    if sharing == "one":
        return [matched]
    images = _images(config) if sharing == "pairs" else {}
    return [
        sorted({i, images[i]} if images.get(i) in matched else {i})
        for i in matched
        if images.get(i) not in matched[: matched.index(i)]
    ]


def _images(config: ExperimentConfig) -> dict[int, int]:
    """Return the mirror image, left or right, of entries of the creature that have one."""
    creature = config.creature.build()
    centres = dict(
        zip((body.name for body in creature.bodies), neutral_pose(creature)[0], strict=True)
    )
    slack = _MIRRORED * max(np.ptp(list(centres.values()), axis=0).max(), np.finfo(float).tiny)
    places = [
        np.array([centres[copy.name] for copy in config.creature.copies() if copy.entry == i])
        for i in range(len(config.creature.bodies))
    ]

    def mirrored(i: int, k: int) -> bool:
        one, two = config.creature.bodies[i].shape, config.creature.bodies[k].shape
        here, there = places[i] * [1, -1, 1], places[k]
        if one != two or len(here) != len(there) or not len(here):
            return False
        gaps = np.linalg.norm(here[:, None] - there, axis=-1).min(1)
        return bool((gaps <= slack).all())

    pairs = itertools.permutations(range(len(places)), 2)
    return {i: k for i, k in pairs if mirrored(i, k)}


def _axes(body: BodyConfig, quantity: str) -> tuple[int, ...]:
    """Return the axes of a body that a quantity scales."""
    if quantity in ("scale", "strength"):
        return (0, 1, 2) if quantity == "scale" else ()
    if quantity in "xyz":
        return ("xyz".index(quantity),)
    along = _along(body)
    return (along,) if quantity == "length" else tuple(i for i in range(3) if i != along)


def _along(body: BodyConfig) -> int:
    """Return the axis along which a body is long."""
    place = np.abs(body.joint.child_at if body.joint else np.zeros(3))
    if isinstance(body.shape, (CapsuleConfig, CylinderConfig)):
        return 0
    if not place.any():
        shape = body.shape
        place = np.array(getattr(shape, "size", getattr(shape, "radii", (1.0, 0.0, 0.0))))
    return int(np.argmax(place))


def _extent(body: BodyConfig, axis: int, where: Key) -> float:
    """Return the size of a body along an axis, m."""
    shape = body.shape
    if isinstance(shape, BoxConfig):
        return shape.size[axis]
    if isinstance(shape, EllipsoidConfig):
        return 2 * shape.radii[axis]
    if isinstance(shape, (CapsuleConfig, CylinderConfig)):
        return shape.length if axis == 0 else 2 * shape.radius
    kind = "none" if shape is None else shape.type
    raise KeyProblem(
        where, f"{body.name!r} has the shape {kind}. Only scale and strength apply to it"
    )


# Keys of numbers with the exponents of each factor, and a function that returns equal rows as one.
_Rows = Iterator[tuple[str, Float[np.ndarray, " f"]]]
_One = Callable[[Any, str], np.ndarray]


def _rows(
    config: ExperimentConfig,
    axes: Float[np.ndarray, "b 3 f"],
    motors: Float[np.ndarray, "b f"],
    genes: Sequence[_Gene],
) -> _Rows:
    """Yield the key and the exponents of every number of the creature that genes scale.

    Args:
        config: the configuration.
        axes: exponent of each factor for the axes of each body.
        motors: exponent of each factor for the strength of each body's motors.
        genes: the genes.
    """

    def one(rows: Any, problem: str) -> np.ndarray:
        uneven = np.any([row != rows[0] for row in rows], axis=0)
        if uneven.any():
            raise KeyProblem((*_SECTION, genes[int(uneven.argmax())].key), problem)
        return rows[0]

    for i, body in enumerate(config.creature.bodies):
        key = f"creature.bodies.{i}"
        yield from _of_body(body, key, axes[i], one)
        if body.joint:
            yield from _of_joint(config, i, f"{key}.joint", axes, one)
            strength = axes[i].sum(0) - axes[i, _along(body)] + motors[i]
            yield from _of_motors(body.joint, f"{key}.joint.actuator", strength)
    yield from _of_sensors(config, axes)


def _each(key: str, rows: Any) -> _Rows:
    return ((f"{key}.{k}", row) for k, row in enumerate(rows))


def _of_body(body: BodyConfig, key: str, own: Float[np.ndarray, "3 f"], one: _One) -> _Rows:
    """Yield the exponents of a body's shapes and of its mass."""
    yield from _of_shape(body.shape, f"{key}.shape", own, body.name, one)
    for k, part in enumerate(body.parts):
        if any(part.rotation_deg):
            one(own, f"{body.name!r} has turned parts, so use scale")
        yield from _of_shape(part.shape, f"{key}.parts.{k}.shape", own, body.name, one)
        yield from _each(f"{key}.parts.{k}.at", own)
    if body.mass is not None:
        yield f"{key}.mass", own.sum(0)
    if body.centre_of_mass is not None:
        yield from _each(f"{key}.centre_of_mass", own)
    if body.inertia is not None:
        # A mass that grows with the volume, times a square of lengths.
        row = 5 * one(own, f"{body.name!r} has an inertia in numbers, so use scale")
        yield from _each(f"{key}.inertia", [row] * 6)


def _of_joint(
    config: ExperimentConfig, i: int, key: str, axes: Float[np.ndarray, "b 3 f"], one: _One
) -> _Rows:
    """Yield the exponents of the places of a joint, on its body and on the parents."""
    body, everything = config.creature.bodies[i], config.creature.copies()
    assert body.joint
    yield from _each(f"{key}.child_at", axes[i])
    for k, axis in enumerate(body.joint.axes if body.joint.axes != "ball" else ()):
        if isinstance(axis, TurnConfig) and axis.at is not None:
            yield from _each(f"{key}.axes.{k}.at", axes[i])
    names = {copy.parent for copy in everything if copy.entry == i}
    owners = [axes[k] for k in sorted({copy.entry for copy in everything if copy.name in names})]
    problem = (
        f"joint.at of {body.name!r} lies on several bodies. Let them share a gene (genes: one), or "
        "write the first body of the row as an entry of its own"
    )
    for a in range(3 if owners else 0):
        row = one([own[a] for own in owners], problem)
        if body.radial > 1 and a < 2:
            around = f"{body.name!r} is copied around its parent, whose x and y must scale alike"
            one(owners[0][:2], around)
        yield f"{key}.at.{a}", row


def _of_motors(joint: JointConfig, key: str, row: Float[np.ndarray, " f"]) -> _Rows:
    """Yield the exponents of the strength of a joint's motors."""
    several = isinstance(joint.actuator, list)
    motors: Any = joint.actuator if several else [joint.actuator]
    for k, motor in enumerate(motors):
        for name in _STRENGTHS:
            if isinstance(getattr(motor, name, None), float):
                yield f"{key}.{k}.{name}" if several else f"{key}.{name}", row


def _of_sensors(config: ExperimentConfig, axes: Float[np.ndarray, "b 3 f"]) -> _Rows:
    """Yield the exponents of the places of eyes and other sensors."""
    creature, everything = config.creature, config.creature.copies()
    for kind in ("light_sensors", "depth_sensors", "sensors"):
        for k, sensor in enumerate(getattr(creature, kind)):
            if hasattr(sensor, "position") and hasattr(sensor, "body"):
                carriers = {copy.entry for copy in copies_named(sensor.body, everything)}
                for i in carriers:
                    yield from _each(f"creature.{kind}.{k}.position", axes[i])


def _of_shape(
    shape: ShapeConfig | None, key: str, own: Float[np.ndarray, "3 f"], name: str, one: _One
) -> _Rows:
    """Yield the exponents of the numbers of a shape."""
    if isinstance(shape, BoxConfig):
        yield from _each(f"{key}.size", own)
    elif isinstance(shape, EllipsoidConfig):
        yield from _each(f"{key}.radii", own)
    elif isinstance(shape, (CapsuleConfig, CylinderConfig)):
        yield f"{key}.length", own[0]
        yield f"{key}.radius", one(own[1:], f"{name!r} has one radius. Use length, girth or scale")
    elif isinstance(shape, SphereConfig):
        yield f"{key}.radius", one(own, f"{name!r} is a sphere. Use scale")
    elif shape is not None and own.any():
        row = one(own, f"{name!r} is a {shape.type}, of which only the scale can evolve")
        if isinstance(shape, MeshConfig):
            one([row, 0 * row], f"{name!r} is a mesh, whose size cannot evolve")
        for k in range(len(getattr(shape, "sections", ()))):
            section = f"{key}.sections.{k}"
            yield from (*_each(f"{section}.at", [row] * 3), (f"{section}.width", row))
            yield f"{section}.height", row


class EvolvedBodies(NumbersOfPlan, BodyBuilder):
    """Builder of the bodies of a configuration (see `BodyBuilder`).

    Attributes:
        scaling: numbers of the configuration as functions of the genes' factors.
    """

    _origin: tuple[str, str, bool]

    def __init__(self, config: ExperimentConfig, source: Path | str, scaling: Scaling):
        """Make the plan from bodies of the whole range.

        Raises:
            ConfigError: a body at a bound is not allowed, or bodies differ in more than numbers.
        """
        self.scaling, self.genes = scaling, scaling.genes
        on_ground = config.world.ground is not None
        touching = config.creature.build_self_collision(on_ground) is not None
        count = _SAMPLES if touching else _SAMPLES_APART
        super().__init__(config, source, scaling.numbers(_samples(scaling.genes, count)))

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the configuration alone, because programs cannot be pickled."""
        return _made, self._origin

    @override
    def numbers(self, origin: Array) -> list[Array]:
        return list(self.scaling.numbers(self.genes.factors(origin)).values())

    @override
    def values(self, origin: Float[np.ndarray, "b n"]) -> list[Float[np.ndarray, "_ n"]]:
        return super().values(origin.astype(float))


def _samples(genes: BodyGenes, number: int) -> Float[np.ndarray, "f n"]:
    """Return factors of random bodies, and of bodies at the corners of the range."""
    count = len(genes.names)
    drawn = np.random.default_rng(_SEED).random((number, count))
    ends = [np.zeros(count), np.ones(count)]
    corners = [*ends, *np.eye(count), *(1 - np.eye(count))][: number - _RANDOM]
    return genes.at(np.array([*corners, *drawn])[:number].T)


@functools.lru_cache(maxsize=8)
def _made(text: str, source: str, binary: bool) -> EvolvedBodies:
    config = ExperimentConfig.model_validate_json(text)
    made = EvolvedBodies(without_body_genes(config), source, scaling_of(config, binary))
    made._origin = text, source, binary
    return made


def evolved(config: ExperimentConfig, source: Path | str, simulation: Simulation) -> Simulation:
    """Return the simulation of a plan for all bodies that the configuration's genes allow.

    Raises:
        KeyProblem: genes of the body are wrong (see `scaling_of`).
        ConfigError: a body is not allowed.
    """
    bodies = _made(config.model_dump_json(), str(source), simulation.controller.binary)
    return dataclasses.replace(bodies.common, bodies=bodies)


def without_body_genes(config: ExperimentConfig) -> ExperimentConfig:
    """Return the configuration with a fixed body."""
    search = config.evolution.model_copy(update={"body": {}})
    return config.model_copy(update={"evolution": search})


def config_of(
    config: ExperimentConfig,
    simulation: Simulation,
    genes: Float[np.ndarray, " g"],
    source: Path | str,
) -> ExperimentConfig:
    """Return the configuration of an individual's own body, which does not evolve any more.

    Args:
        config: configuration in which the individual evolved.
        simulation: its simulation.
        genes: whole genome of the individual.
        source: file of the configuration.

    Raises:
        ConfigError: the body is not allowed.
    """
    bodies = simulation.bodies
    if not isinstance(bodies, EvolvedBodies):
        return config
    factors = bodies.genes.factors(simulation.genome.of_body(genes).astype(float))
    numbers = {key: float(x) for key, x in bodies.scaling.numbers(factors).items()}
    return with_numbers(without_body_genes(config), numbers, source)
