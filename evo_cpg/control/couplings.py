"""Couplings that a creature's tree does not give: between chosen oscillators, and around rings.

With A the inhibition of each oscillator (row) by the other side of each other one (column), and
with negative A by the same side, both in units of ``pair_weight``, a pair in which the target
follows the source by the lag L is coupled by

    A[target, source] = w (cos L + sin L),    A[source, target] = w (cos L - sin L),        (1)

and n oscillators around a ring, each behind the one before it by L, with n L whole turns, by

    A[i, j] = w / (n - 1) (cos (i - j) L + sin (i - j) L)    for all i and j of the ring.    (2)

The cosine is the same both ways, and holds the distance; the sine runs one way, and tells which of
the two leads. At L = 0 all swing together, at 180 degrees neighbours swing against each other, and
at 90 degrees the source pushes the target, which pulls it back.

In a ring of equal oscillators with equal drives a wave with exactly this lag is a solution, for the
network looks the same from each of them. ``docs/models/controller.md`` says which waves grow.
"""

import dataclasses
import fnmatch
import functools
import re
from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float

from evo_cpg.creature.tree import Tree
from evo_cpg.errors import nearest
from evo_cpg.spatial.decisions import chosen
from evo_cpg.spatial.numerics import Number, Numbers, xp

# Cosines and sines below this are rounding.
_NO_COUPLING = 1e-12

# A ring closes if its lags add up to whole turns but for so many degrees: 51.43 for 7 is enough.
_CLOSED_DEG = 0.1


class UnfitError(ValueError):
    """Settings of a controller that do not fit the creature.

    Attributes:
        where: path of the offending value in the settings, such as ``("groups", "legs", 0)``.
    """

    def __init__(self, message: str, where: Sequence[str | int]):
        super().__init__(message)
        self.where = tuple(where)


class CouplingError(UnfitError):
    """Couplings that do not fit a creature.

    Attributes:
        where: path of the offending value in the settings of the oscillators, such as
            ``("rings", 0, "lag_deg")``.
    """


@dataclasses.dataclass(frozen=True)
class Coupling:
    """What one oscillator, or each of several, does to another one.

    Attributes:
        source: a degree of freedom, or a pattern such as ``left_*.z``.
        target: likewise; several sources act on as many targets one on one, in the order of the
            bodies, and one acts on several, or several on one.
        weight: in units of ``pair_weight``; without a lag, positive where the source inhibits the
            target's other side (they swing together), negative where its own (against each other).
        lag_deg: what the target is to be behind the source, degrees; both then act on each other.
            None for one way alone, from source to target.

    Raises:
        ValueError: a value outside its range.
    """

    source: str
    target: str
    weight: float = 0.5
    lag_deg: float | None = None

    def __post_init__(self):
        _check_lag(self.lag_deg)
        if self.lag_deg is not None and not self.weight >= 0:
            raise ValueError(
                "weight is the strength with which a lag is held and must not be negative, got "
                f"{self.weight}"
            )


@dataclasses.dataclass(frozen=True)
class Ring:
    """Oscillators around a ring, each as far behind the one before it.

    Attributes:
        oscillators: degrees of freedom, or patterns such as ``arm*_1.y``, in the order of the ring;
            those of a pattern in the order of the bodies.
        lag_deg: of each behind the one before it, degrees; as many of them as there are oscillators
            make whole turns.
        weight: how much inhibition the others together may exert on one, in units of
            ``pair_weight``, at least 0.

    Raises:
        ValueError: a value outside its range.
    """

    oscillators: tuple[str, ...]
    lag_deg: float
    weight: float = 0.5

    def __post_init__(self):
        _check_lag(self.lag_deg)
        if not self.weight >= 0:
            raise ValueError(
                "weight is the strength with which a lag is held and must not be negative, got "
                f"{self.weight}"
            )


def axis_names(tree: Tree) -> tuple[str, ...]:
    """Axis of each degree of freedom: the part of its name behind the body's, mostly x, y or z."""
    return tuple(
        name[len(tree.names[body]) + 1 :]
        for name, body in zip(tree.dof_names, tree.dof_bodies, strict=True)
    )


def matching_bodies(tree: Tree, patterns: tuple[str, ...], where: Sequence[str | int]) -> set[int]:
    """Indices of the bodies that are named by patterns such as ``*_arm``.

    Args:
        tree: the creature.
        patterns: names, in which ``*`` stands for anything.
        where: path of the setting, for the message.

    Raises:
        UnfitError: a pattern that no body matches.
    """
    found: set[int] = set()
    for i, pattern in enumerate(patterns):
        matches = fnmatch.filter(tree.names, pattern)
        if not matches:
            problem = f"{pattern!r} matches no body; {_near(pattern, tree.names)}"
            raise UnfitError(problem, (*where, i))
        found.update(map(tree.names.index, matches))
    return found


def matching_oscillators(tree: Tree, pattern: str, where: Sequence[str | int]) -> list[int]:
    """Oscillators that are named by a pattern such as ``arm*_1.y``, in the order of the bodies.

    Args:
        tree: the creature.
        pattern: a degree of freedom, in which ``*`` stands for anything.
        where: path of the setting, for the message.

    Raises:
        CouplingError: no degree of freedom matches.
    """
    found = [i for i, name in enumerate(tree.dof_names) if fnmatch.fnmatchcase(name, pattern)]
    if not found:
        problem = f"{pattern!r} is no degree of freedom; {_near(pattern, tree.dof_names)}"
        raise CouplingError(problem, where)
    return found


def _near(pattern: str, names: Sequence[str]) -> str:
    """Return a hint for a pattern that matches none of the names."""
    starred = re.sub(r"\{\w+\}", "*", pattern)
    if starred != pattern:
        return f"placeholders stand for nothing here, write {starred!r}; {nearest(starred, names)}"
    return nearest(pattern, names)


def explicit_weights(
    tree: Tree, couplings: tuple[Coupling, ...], rings: tuple[Ring, ...]
) -> dict[tuple[int, int], Number]:
    """What each target (first) is inhibited with by each source, in units of ``pair_weight``.

    Raises:
        CouplingError: names that do not exist or do not fit together, a ring that does not close,
            or two couplings of the same source and target.
    """
    weights: dict[tuple[int, int], Number] = {}
    written: dict[tuple[int, int], str] = {}

    def put(target: int, source: int, weight: Number, where: tuple[str, int]) -> None:
        if (target, source) in weights:
            names = f"{tree.dof_names[source]!r} and {tree.dof_names[target]!r}"
            raise CouplingError(
                f"couples {names}, which {written[target, source]} couples already", where
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
    """By how much each oscillator starts behind the first of those that it is coupled to, rad.

    Lags that are asked for count first; what else is joined starts together. Where lags contradict
    each other around a loop of couplings, those written first count.

    Args:
        tree: the creature.
        couplings: with lags.
        rings: likewise.
        joined: not 0 where two oscillators are coupled at all.
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
            together = chosen(functools.partial(_is_together, coupling.weight))
            lag = 0.0 if together else 180.0
        for source, target in _pairs(tree, coupling, i):
            lags[source].setdefault(target, xp.deg2rad(lag))
            lags[target].setdefault(source, -xp.deg2rad(lag))
    together = chosen(lambda: np.asarray((joined != 0) | (joined.T != 0)))
    phases: list[Number] = [0.0] * len(lags)
    placed: set[int] = set()
    for first in range(len(lags)):
        # What the tree alone joins waits until no lag is left to follow.
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
    """The oscillators of a ring, in its order.

    Args:
        tree: the creature.
        ring: names them.
        number: which of the settings' rings it is, for messages.

    Raises:
        CouplingError: fewer than two, one that stands there twice, or a ring that does not close.
    """
    where = ("rings", number, "oscillators")
    found = [
        oscillator
        for i, pattern in enumerate(ring.oscillators)
        for oscillator in matching_oscillators(tree, pattern, (*where, i))
    ]
    names = [tree.dof_names[i] for i in found]
    for i, name in enumerate(names):
        if name in names[:i]:
            raise CouplingError(f"{name!r} stands in the ring twice", where)
    count = len(found)
    if count < 2:
        raise CouplingError(f"a ring needs at least two, got {', '.join(names) or 'none'}", where)
    if not chosen(functools.partial(_closes, ring.lag_deg, count)):
        allowed = sorted({(360 * k / count + 180) % 360 - 180 for k in range(count)})
        allowed.sort(key=lambda lag: (round(abs(lag), 6), -lag))
        raise CouplingError(
            f"{count} lags around the ring must make whole turns, as "
            f"{', '.join(f'{lag:.5g}' for lag in allowed[:5])} degrees do, got {ring.lag_deg:g}",
            ("rings", number, "lag_deg"),
        )
    return found


def _is_together(weight: float) -> bool:
    return bool(weight >= 0)


def _closes(lag_deg: float, count: int) -> bool:
    turns = count * lag_deg / 360
    return bool(abs(turns - round(turns)) * 360 / count <= _CLOSED_DEG)


def uncoupled(matrix: Float[np.ndarray, "o o"]) -> list[int]:
    """Oscillators that no other one inhibits, and that inhibit no other one.

    Args:
        matrix: see `evo_cpg.control.matsuoka.inhibition_matrix`.
    """
    others = matrix - np.diag(np.diag(matrix))
    return [int(i) for i in np.flatnonzero(~others.any(0) & ~others.any(1))]


def _pairs(tree: Tree, coupling: Coupling, number: int) -> Iterator[tuple[int, int]]:
    """Sources and targets, one on one.

    Raises:
        CouplingError: they are neither as many nor one, or an oscillator would act on itself.
    """
    where = ("couplings", number)
    sources = matching_oscillators(tree, coupling.source, (*where, "source"))
    targets = matching_oscillators(tree, coupling.target, (*where, "target"))
    count = max(len(sources), len(targets))
    if {len(sources), len(targets)} - {1, count}:
        raise CouplingError(
            f"{coupling.source!r} stands for {len(sources)} degrees of freedom and "
            f"{coupling.target!r} for {len(targets)}; there must be as many of both, or one",
            where,
        )
    sources, targets = sources * (count // len(sources)), targets * (count // len(targets))
    for source, target in zip(sources, targets, strict=True):
        if source == target:
            raise CouplingError(f"couples {tree.dof_names[source]!r} to itself", where)
        yield source, target


def _cosine_and_sine(lag_deg: Number) -> tuple[Number, Number]:
    """Of a lag in degrees; exactly 0 where they are, so that no coupling is nearly none."""
    cosine, sine = xp.cos(xp.deg2rad(lag_deg)), xp.sin(xp.deg2rad(lag_deg))
    cosine_counts, sine_counts = chosen(
        lambda: (abs(cosine) > _NO_COUPLING, abs(sine) > _NO_COUPLING)
    )
    return cosine if cosine_counts else 0.0, sine if sine_counts else 0.0


def _check_lag(lag_deg: float | None) -> None:
    if lag_deg is not None and not -180 <= lag_deg <= 180:
        raise ValueError(f"lag_deg must be from -180 to 180, got {lag_deg}")
