"""What changed on a line of descent, in words.

Parts of two plans are matched from the root outwards. A part continues an earlier part with the
same label and side, if both hang on parts that match. Copies of a node then keep their places when
a limb grows in front of them.
"""

import itertools
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Int

from evo_cpg.control.limb_oscillators import GENES
from evo_cpg.creature.development import Plan
from evo_cpg.io.plans import EvolvedPlans
from evo_cpg.training.family import Ancestor

# Least change that is reported: logarithm of a length, place relative to the parent's half extents,
# turn (rad), relative joint angle and strength, and gene of the oscillator.
_LENGTH, _PLACE, _TURN, _REACH, _GENE = 0.04, 0.2, np.radians(8), 0.1, 0.1
# Weights of a grown or lost part, of other joint axes, of another part in the same place, and of an
# oscillator. Other changes weigh as much as they change.
_PARTS, _AXES, _REPLACED, _RHYTHM = 3.0, 1.5, 0.5, 0.4
# Place on the parent from which a limb is named after a second direction, too.
_ALSO = 0.6
# Words for more and less of each of `GENES`.
_RHYTHMS = dict(
    zip(
        GENES,
        [
            ("stronger strokes", "weaker strokes"),
            *(("a new rhythm",) * 2, ("a new timing",) * 2, ("a new resting bend",) * 2, ("a new start",) * 2),
        ],
        strict=True,
    )
)


class Step(NamedTuple):
    """An ancestor, and what changed since the ancestor that is shown before.

    Attributes:
        ancestor: the ancestor.
        plan: its plan.
        match: body of the plan before that each body continues, or -1. None of the first plan's.
        changes: changes in words, the most important first.
        weight: sum of the importance of all changes.
        births: number of births since the ancestor before.
    """

    ancestor: Ancestor
    plan: Plan
    match: Int[np.ndarray, " b"]
    changes: tuple[str, ...]
    weight: float
    births: int


def descent(plans: EvolvedPlans, line: Sequence[Ancestor], most: int = 10) -> list[Step]:
    """Return the most telling ancestors of a line, with the first one and the last one.

    A step tells much if it changes the body or the oscillators much, or gains fitness.
    """
    grown = plans.kept(np.stack([one.record["genome"] for one in line]))
    fitness = np.array([one.record["fitness"] for one in line])
    gain = np.diff(np.where(np.isfinite(fitness), fitness, fitness[np.isfinite(fitness)].min()))
    weights = [sum(weight for weight, _ in changes(*pair)) for pair in itertools.pairwise(grown)]
    telling = [np.minimum(weights, _PARTS), gain.clip(0)]
    telling = sum(part / max(part.sum(), 1e-9) for part in telling)
    # Each of the others stands for an equal part of all changes, so that no time is left out.
    turn = np.cumsum(telling) / max(telling.sum(), 1e-9) * (most - 2)
    turns = [np.flatnonzero((turn > i) & (turn <= i + 1) & (telling > 0)) for i in range(most - 2)]
    chosen = [int(own[telling[own].argmax()]) + 1 for own in turns if own.size]
    shown = sorted({0, len(line) - 1, *chosen})
    steps = [Step(line[0], grown[0], np.full(len(grown[0].parent), -1), (), 0.0, 0)]
    for before, i in itertools.pairwise(shown):
        found = changes(grown[before], grown[i])
        told, weight = tuple(words for _, words in found), sum(weight for weight, _ in found)
        match = matched(grown[before], grown[i])
        steps.append(Step(line[i], grown[i], match, told, weight, i - before))
    return steps


def told(step: Step, most: int) -> str:
    """Return a step's most important changes, or the number of parts of the first ancestor."""
    if not step.births:
        return f"a body of {len(step.match)} parts"
    return "; ".join(step.changes[:most]) or "small changes"


def matched(before: Plan, after: Plan) -> Int[np.ndarray, " b"]:
    """Return the body of an earlier plan that each body continues, or -1. Roots always match."""
    found, free = [0], set(range(1, len(before.parent)))
    for i in range(1, len(after.parent)):
        # Another part in the same place continues what it replaces.
        own = [
            (other, away, j)
            for j in free
            if before.parent[j] == found[after.parent[i]] and before.mirror[j] == after.mirror[i]
            for other, away in [(before.label[j] != after.label[i], _away(before, after, j, i))]
            if not other or away < _PLACE
        ]
        found.append(min(own)[2] if own else -1)
        free.discard(found[-1])
    return np.array(found)


def _away(before: Plan, after: Plan, old: int, new: int) -> float:
    """Return the distance between the places of two joints, relative to the parents' sizes."""
    places = (plan.place[i] / plan.half[plan.parent[i]] for plan, i in ((before, old), (after, new)))
    return float(np.abs(np.subtract(*places)).max())


def changes(before: Plan, after: Plan) -> list[tuple[float, str]]:
    """Return the changes between two plans with their weights, the most important first."""
    match = matched(before, after)
    lost = ~np.isin(np.arange(len(before.parent)), match)
    found = [*_parts(before, lost, "was lost", "lost"), *_parts(after, match < 0, "grew", "grew")]
    kept = np.flatnonzero(match >= 0)
    sizes = np.log(after.half[kept] / before.half[match[kept]])
    if len(kept) > 1 and np.ptp(sizes) < _LENGTH < np.abs(sizes).min():
        found += [(weight, f"whole body {words}") for weight, words in _resizing(sizes)]
        sizes = np.zeros_like(sizes)
    # Names of the parts that changed in the same way.
    alike: dict[str, list[str]] = {}
    weights: dict[str, float] = {}
    for label in dict.fromkeys(after.label[kept].tolist()):
        own = after.label[kept] == label
        pair = match[kept[own]][0], kept[own][0]
        for weight, words in [*_resizing(sizes[own]), *_others(before, after, *pair)]:
            alike.setdefault(words, []).append(_name(after, kept[own]))
            weights[words] = weights.get(words, 0.0) + weight
    for words, names in alike.items():
        name = names[0] if len(names) == 1 else f"{names[0]} and {len(names) - 1} more"
        if len(names) > 1 and len(names) == len({*after.label[1:]}):
            name = "all limbs"
        found.append((weights[words], f"{name} {words}"))
    return sorted(found, key=lambda change: -change[0])


def _parts(plan: Plan, new: np.ndarray, of_limb: str, of_part: str) -> Iterator[tuple[float, str]]:
    """Yield changes for parts that grew or were lost, the parts of one label as one change."""
    tops = [i for i in np.flatnonzero(new) if not new[plan.parent[i]]]
    for label in dict.fromkeys(plan.label[tops].tolist()):
        own = np.array([i for i in tops if plan.label[i] == label])
        paths = [_path(plan, i) for i in range(len(new))]
        parts = sum(own[0] in path for path in paths)
        many, size = len(own) > 1, f"{parts} part{'s' * (parts > 1)}"
        each = " each" * many
        if len(paths[own[0]]) > 1:
            limbs = np.array([paths[i][-1] for i in own])
            words = f"{_name(plan, limbs)} {of_part} {size}{each}"
        else:
            count = "a pair of" if plan.mirror[own].sum() == 0 else len(own) if many else "a"
            verb = of_limb.replace("was", "were") if many and count != "a pair of" else of_limb
            words = f"{count} {_name(plan, own)}{f' of {size}{each}' * (parts > 1)} {verb}"
        yield _PARTS + 0.3 * parts * len(own) + (of_part == "grew"), words


def _path(plan: Plan, body: int) -> list[int]:
    """Return a body and the bodies between it and the root, without the root."""
    found = []
    while body > 0:
        found.append(body)
        body = plan.parent[body]
    return found


def _name(plan: Plan, bodies: np.ndarray) -> str:
    """Return the name of the bodies of a node, after the place of their limb on the trunk."""
    paths = [_path(plan, body) for body in bodies]
    depth = min(map(len, paths))
    if not depth:
        return "trunk"
    same = [path for path in paths if len(path) == depth]
    limb = same[0][-1]
    x, y, z = plan.place[limb] / plan.half[0]
    sides = [(abs(x), "front" if x > 0 else "rear"), (abs(z), "upper" if z > 0 else "lower")]
    sides.append((abs(y), "side" if len(same) > 1 else "left" if y > 0 else "right"))
    where = " ".join(word for part, word in sides if part > _ALSO)
    level = "" if depth == 1 else f"part {depth} of the "
    return f"{level}{where} limb{'s' * (len(same) > 1)}"


def _resizing(sizes: np.ndarray) -> Iterator[tuple[float, str]]:
    """Yield changes of size, from logarithms of the ratios of half extents. Lengths are along x."""
    along, across = float(sizes[:, 0].mean()), float(sizes[:, 1:].mean())
    words = [(along, "longer", "shorter"), (across, "thicker", "thinner")]
    if abs(along - across) < _LENGTH:
        words = [(float(sizes.mean()), "larger", "smaller")]
    for change, more, less in words:
        if abs(change) > _LENGTH:
            percent = 100 * abs(np.expm1(change))
            yield abs(change), f"{more if change > 0 else less} by {percent:.0f}%"


def _others(before: Plan, after: Plan, old: int, new: int) -> Iterator[tuple[float, str]]:
    """Yield changes of a part's joint, place and oscillators."""
    if new and after.label[new] != before.label[old]:
        yield _REPLACED, "replaced by another part"
    axes, earlier = after.axes[new], before.axes[old]
    if (axes != earlier).any():
        count = ("no joint axis", "one joint axis", "two joint axes", "three joint axes")[axes.sum()]
        yield _AXES, f"with {'another joint axis' if axes.sum() == earlier.sum() else count}"
    if new and not after.parent[new]:
        moved = after.place[new] / after.half[0] - before.place[old] / before.half[0]
        axis = int(np.abs(moved).argmax())
        if abs(moved[axis]) > _PLACE:
            words = (("back", "forward"), ("inward", "outward"), ("down", "up"))[axis]
            further = moved[axis] * (np.sign(after.place[new][1]) if axis == 1 else 1) > 0
            yield float(abs(moved[axis])), f"moved {words[int(further)]}"
    turn = np.arccos(np.clip((np.sum(after.rotation[new] * before.rotation[old]) - 1) / 2, -1, 1))
    if turn > _TURN:
        yield float(turn), f"turned by {np.degrees(turn):.0f} degrees"
    both = axes & earlier
    wider = np.log(after.limit[new][both] / before.limit[old][both]).sum()
    if abs(wider) > _REACH:
        yield 0.5 * float(abs(wider)), f"may bend {'farther' if wider > 0 else 'less far'}"
    stronger = float(after.strength[new] - before.strength[old])
    if new and abs(stronger) > _REACH:
        yield 0.5 * abs(stronger), "stronger" if stronger > 0 else "weaker"
    genes = (after.control[new] - before.control[old])[both].reshape(-1, len(GENES))
    if genes.size and np.abs(genes).max() > _GENE:
        row, gene = np.unravel_index(np.abs(genes).argmax(), genes.shape)
        words = _RHYTHMS[GENES[gene]][int(genes[row, gene] < 0)]
        yield _RHYTHM * float(np.abs(genes).max()), f"with {words}"
