"""Additional couplings between chosen oscillators and around rings, beyond the tree's couplings.

A[i, j] is the inhibition of oscillator i by the opposite side of oscillator j: extensor by flexor,
and flexor by extensor. A negative element is inhibition by the same side. Elements are in units of
``pair_weight``. A pair in which the target lags behind the source by L is coupled by

    A[target, source] = w (cos L + sin L),    A[source, target] = w (cos L - sin L),        (1)

n oscillators around a ring, each behind the previous one by L, where n L is a multiple of 360
degrees, are coupled by

    A[i, j] = w / (n - 1) (cos (i - j) L + sin (i - j) L)    for all i and j of the ring.    (2)

The cosine term is equal in both directions of a pair and sets the size of the lag. The sine term
changes its sign with the direction and selects the leader. At L = 0 all swing together. At 180
degrees neighbours swing against each other. At 90 degrees the source acts on the target with w, and
the target on the source with -w.

In a ring of equal oscillators with equal drives, a wave with exactly this lag is a solution by
symmetry. ``docs/models/controller.md`` shows which waves grow.
"""

import dataclasses
import fnmatch
import re
from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float

from evo_cpg.creature.algebra.decisions import chosen
from evo_cpg.creature.algebra.numerics import Number, Numbers, xp
from evo_cpg.creature.tree import Tree
from evo_cpg.errors import nearest

# Cosines and sines of a smaller size are rounding errors.
_NO_COUPLING = 1e-12

# A ring closes if each lag is this near (degrees) to a multiple of 360 / n. So a lag of 51.43
# closes a ring of 7.
_CLOSED_DEG = 0.1


class UnfitError(ValueError):
    """Raised for settings of a controller that do not fit the creature.

    Attributes:
        where: path of the offending value in the settings, such as ``("groups", "legs", 0)``.
        unknown_name: whether the value names a part that the creature lacks.
    """

    def __init__(self, message: str, where: Sequence[str | int], unknown_name: bool = False):
        super().__init__(message)
        self.where, self.unknown_name = tuple(where), unknown_name


class CouplingError(UnfitError):
    """Raised for couplings that do not fit a creature.

    Attributes:
        where: path of the offending value in the settings of the oscillators, such as
            ``("rings", 0, "lag_deg")``.
    """


class _Lagging:
    """Settings whose lag, and the weight with which the lag is held, are checked."""

    lag_deg: float | None
    weight: float

    def __post_init__(self):
        if self.lag_deg is None:
            return
        if not -180 <= self.lag_deg <= 180:
            raise ValueError(f"lag_deg must be from -180 to 180, got {self.lag_deg}")
        if not self.weight >= 0:
            raise ValueError(
                "weight is the strength with which a lag is held and must not be negative, got "
                f"{self.weight}"
            )


@dataclasses.dataclass(frozen=True)
class Coupling(_Lagging):
    """Coupling of one pair of oscillators, source and target, or of several pairs.

    Attributes:
        source: a degree of freedom, or a pattern such as ``left_*.z``.
        target: a degree of freedom, or a pattern. Sources and targets are equal in number and pair
            up in the order of the bodies, or there is one source or one target.
        weight: strength in units of ``pair_weight``. Positive without a lag: the source inhibits
            the target's other side, and the target swings the same way. Negative without a lag: it
            inhibits the same side, and the target swings the opposite way. The target is exactly
            in step only if both receive equal inhibition. Otherwise it lags or leads.
        lag_deg: lag of the target behind the source, degrees, with coupling in both directions.
            None couples in one direction only: the source acts on the target. Other couplings of
            the two change the lag.

    Raises:
        ValueError: a value is outside its range.
    """

    source: str
    target: str
    weight: float = 0.5
    lag_deg: float | None = None


@dataclasses.dataclass(frozen=True)
class Ring(_Lagging):
    """Oscillators around a ring, with a constant lag from each to the next.

    Attributes:
        oscillators: degrees of freedom, or patterns such as ``arm*_1.y``, in the order of the
            ring. Matches of a pattern are in the order of the bodies.
        lag_deg: lag of each oscillator behind the previous one, degrees. All lags around the ring
            add up to a multiple of 360 degrees.
        weight: upper bound for the sum of all inhibitions of one oscillator by the others, in units
            of ``pair_weight``, at least 0.

    Raises:
        ValueError: a value is outside its range.
    """

    oscillators: tuple[str, ...]
    lag_deg: float
    weight: float = 0.5


def axis_names(tree: Tree) -> tuple[str, ...]:
    """Return the axis of each degree of freedom: its name without the body, such as x."""
    return tuple(
        name[len(tree.names[body]) + 1 :]
        for name, body in zip(tree.dof_names, tree.dof_bodies, strict=True)
    )


def axis_parents(tree: Tree) -> list[int | None]:
    """Return the oscillator of the same axis on the nearest ancestor that has one, or None."""
    axes = axis_names(tree)
    oscillator = {key: i for i, key in enumerate(zip(tree.dof_bodies, axes, strict=True))}
    found: list[int | None] = []
    for body, axis in zip(tree.dof_bodies, axes, strict=True):
        ancestor = tree.parents[body]
        while ancestor >= 0 and (ancestor, axis) not in oscillator:
            ancestor = tree.parents[ancestor]
        found.append(oscillator.get((ancestor, axis)))
    return found


def axis_directions(tree: Tree) -> list[int]:
    """Return -1 for each degree of freedom whose axis has no positive component, otherwise 1."""
    return chosen(
        lambda: [-1 if (np.asarray(axis) <= 0).all() else 1 for axis in tree.joint_axes.T]
    )


def matching_bodies(
    tree: Tree,
    patterns: tuple[str, ...],
    where: Sequence[str | int],
    unfit: type[UnfitError] = UnfitError,
) -> set[int]:
    """Return the indices of the bodies that match patterns such as ``*_arm``.

    Args:
        tree: the creature.
        patterns: names, in which ``*`` matches anything.
        where: path of the setting, for the message.
        unfit: kind of the error, which says what the path starts from.

    Raises:
        UnfitError: no body matches a pattern.
    """
    found: set[int] = set()
    for i, pattern in enumerate(patterns):
        matches = fnmatch.filter(tree.names, pattern)
        if not matches:
            problem = f"{pattern!r} matches no body ({_near(pattern, tree.names)})"
            raise unfit(problem, (*where, i), unknown_name=True)
        found.update(map(tree.names.index, matches))
    return found


def matching_oscillators(tree: Tree, pattern: str, where: Sequence[str | int]) -> list[int]:
    """Return the oscillators that match a pattern such as ``arm*_1.y``, in the order of bodies.

    Raises:
        CouplingError: no degree of freedom matches.
    """
    found = [i for i, name in enumerate(tree.dof_names) if fnmatch.fnmatchcase(name, pattern)]
    if not found:
        problem = f"{pattern!r} is no degree of freedom ({_near(pattern, tree.dof_names)})"
        raise CouplingError(problem, where, unknown_name=True)
    return found


def listed_oscillators(
    tree: Tree, patterns: Sequence[str], where: Sequence[str | int]
) -> list[int]:
    """Return the oscillators of several patterns, in the order of the patterns.

    Raises:
        CouplingError: no degree of freedom matches a pattern.
    """
    return [
        oscillator
        for i, pattern in enumerate(patterns)
        for oscillator in matching_oscillators(tree, pattern, (*where, i))
    ]


def _near(pattern: str, names: Sequence[str]) -> str:
    """Return a hint for a pattern that matches none of the names."""
    starred = re.sub(r"\{\w+\}", "*", pattern)
    if starred != pattern:
        return f"placeholders have no meaning here: write {starred!r}, {nearest(starred, names)}"
    return nearest(pattern, names)


def explicit_weights(
    tree: Tree, couplings: tuple[Coupling, ...], rings: tuple[Ring, ...]
) -> dict[tuple[int, int], Number]:
    """Return the weight of each target (first) and source (second), in units of ``pair_weight``.

    Raises:
        CouplingError: names do not exist or do not fit together, a ring does not close, or two
            couplings have the same source and target.
    """
    weights: dict[tuple[int, int], Number] = {}
    written: dict[tuple[int, int], str] = {}

    def put(target: int, source: int, weight: Number, where: tuple[str, int]) -> None:
        if (target, source) in weights:
            names = f"{tree.dof_names[source]!r} and {tree.dof_names[target]!r}"
            raise CouplingError(
                f"couples {names}, which {written[target, source]} already couples", where
            )
        weights[target, source] = weight
        written[target, source] = ".".join(map(str, where))

    for i, coupling in enumerate(couplings):
        for source, target in _pairs(tree, coupling, i):
            if coupling.lag_deg is None:
                put(target, source, coupling.weight, ("couplings", i))
                continue
            cosine, sine = _cosine_and_sine(coupling.lag_deg)
            put(target, source, coupling.weight * (cosine + sine), ("couplings", i))
            put(source, target, coupling.weight * (cosine - sine), ("couplings", i))
    for i, ring in enumerate(rings):
        members = ring_members(tree, ring, i)
        weight = ring.weight / (len(members) - 1)
        for place, target in enumerate(members):
            for other, source in enumerate(members):
                if place != other:
                    cosine, sine = _cosine_and_sine((place - other) * ring.lag_deg)
                    put(target, source, weight * (cosine + sine), ("rings", i))
    return weights


def start_phases(
    tree: Tree,
    couplings: tuple[Coupling, ...],
    rings: tuple[Ring, ...],
    joined: Float[Numbers, "o o"],
) -> Float[Numbers, " o"]:
    """Return the initial phase lag of each oscillator behind the first of its connected group, rad.

    Rings and couplings set the lags of their oscillators. A coupling without a lag sets 0, or 180
    degrees if its weight is negative. Oscillators coupled only by the tree start in phase. If lags
    contradict each other around a loop, rings come first, then couplings in the order of the
    settings.

    Args:
        tree: the creature.
        couplings: couplings, with or without a lag.
        rings: rings of oscillators.
        joined: matrix that is not 0 where two oscillators are coupled.
    """
    lags: list[dict[int, Number]] = [{} for _ in tree.dof_names]
    for i, ring in enumerate(rings):
        members = ring_members(tree, ring, i)
        for before, behind in zip(members, members[1:] + members[:1], strict=True):
            lags[before].setdefault(behind, xp.deg2rad(ring.lag_deg))
            lags[behind].setdefault(before, -xp.deg2rad(ring.lag_deg))
    for i, coupling in enumerate(couplings):
        lag = coupling.lag_deg
        if lag is None:
            together = chosen(lambda weight=coupling.weight: bool(weight >= 0))
            lag = 0.0 if together else 180.0
        for source, target in _pairs(tree, coupling, i):
            lags[source].setdefault(target, xp.deg2rad(lag))
            lags[target].setdefault(source, -xp.deg2rad(lag))
    together = chosen(lambda: np.asarray((joined != 0) | (joined.T != 0)))
    phases: list[Number] = [0.0] * len(lags)
    placed: set[int] = set()
    for first in range(len(lags)):
        # Couplings of the tree wait until no explicit lag is left to follow.
        now, later = [first] if first not in placed else [], []
        placed.add(first)
        while now or later:
            if now:
                here = now.pop(0)
                reached = lags[here]
                later.append(here)
            else:
                here = later.pop(0)
                reached = dict.fromkeys(np.flatnonzero(together[here]).tolist(), 0.0)
            for other, lag in reached.items():
                if other not in placed:
                    placed.add(other)
                    phases[other] = phases[here] + lag
                    now.append(other)
    return xp.array(phases)


def ring_members(tree: Tree, ring: Ring, number: int) -> list[int]:
    """Return the oscillators of a ring, in its order.

    Raises:
        CouplingError: fewer than two oscillators, one twice, or a ring that does not close.
    """
    where = ("rings", number, "oscillators")
    found = listed_oscillators(tree, ring.oscillators, where)
    names = [tree.dof_names[i] for i in found]
    for i, name in enumerate(names):
        if name in names[:i]:
            raise CouplingError(f"{name!r} is in the ring twice", where)
    count = len(found)
    if count < 2:
        problem = f"a ring needs at least two oscillators, got {', '.join(names) or 'none'}"
        raise CouplingError(problem, where)
    # Distance of the sum of lags from whole turns, in turns.
    if not chosen(
        lambda: bool(abs((count * ring.lag_deg / 360 + 0.5) % 1 - 0.5) * 360 / count <= _CLOSED_DEG)
    ):
        allowed = sorted({(360 * k / count + 180) % 360 - 180 for k in range(count)})
        allowed.sort(key=lambda lag: (round(abs(lag), 6), -lag))
        raise CouplingError(
            f"{count} lags around the ring must add up to whole turns (for example "
            f"{', '.join(f'{lag:.5g}' for lag in allowed[:5])} degrees), got {ring.lag_deg:g}",
            ("rings", number, "lag_deg"),
        )
    return found


def uncoupled(matrix: Float[np.ndarray, "o o"]) -> list[int]:
    """Return the oscillators that neither inhibit another one nor are inhibited by one."""
    others = matrix - np.diag(np.diag(matrix))
    return [int(i) for i in np.flatnonzero(~others.any(0) & ~others.any(1))]


def _pairs(tree: Tree, coupling: Coupling, number: int) -> Iterator[tuple[int, int]]:
    """Yield sources and targets, pair by pair.

    Raises:
        CouplingError: the numbers of sources and targets differ and neither is one, or an
            oscillator couples to itself.
    """
    where = ("couplings", number)
    sources = matching_oscillators(tree, coupling.source, (*where, "source"))
    targets = matching_oscillators(tree, coupling.target, (*where, "target"))
    count = max(len(sources), len(targets))
    if {len(sources), len(targets)} - {1, count}:
        raise CouplingError(
            f"{coupling.source!r} matches {len(sources)} degrees of freedom and "
            f"{coupling.target!r} matches {len(targets)} (allowed: equal numbers, or 1 and any)",
            where,
        )
    sources, targets = sources * (count // len(sources)), targets * (count // len(targets))
    for source, target in zip(sources, targets, strict=True):
        if source == target:
            raise CouplingError(f"couples {tree.dof_names[source]!r} to itself", where)
        yield source, target


def _cosine_and_sine(lag_deg: Number) -> tuple[Number, Number]:
    """Return cosine and sine of a lag. Values below `_NO_COUPLING` become exactly 0."""
    cosine, sine = xp.cos(xp.deg2rad(lag_deg)), xp.sin(xp.deg2rad(lag_deg))
    cosine_counts, sine_counts = chosen(
        lambda: (abs(cosine) > _NO_COUPLING, abs(sine) > _NO_COUPLING)
    )
    return cosine if cosine_counts else 0.0, sine if sine_counts else 0.0
