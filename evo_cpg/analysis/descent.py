"""What changed on a line of descent, in words.

Parts of two plans are matched from the root outwards. A part continues an earlier part with the
same label and side, if both hang on parts that match. Copies of a node then keep their places when
a limb grows in front of them. A part that another part replaces in the same place continues, too.
"""

import itertools
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Int

from evo_cpg.creature.development import Plan
from evo_cpg.io.plans import EvolvedPlans
from evo_cpg.training.family import Ancestor

# Distance of joints, relative to their parents' half extents, up to which a part replaces another
# one, and distance that is added for another label.
_NEAR, _OTHER = 0.2, 4.0
# Weights of parts that grew or were lost, of each of them, and of the least change of another kind
# that is reported.
_PARTS, _EACH, _LEAST = 3.0, 0.4, 0.1
# Least changes that are reported, and words for more and less: logarithms of lengths, place
# relative to the parent's half extents, turn and sum of angles (rad), strength, and genes of an
# oscillator (`evo_cpg.control.limb_oscillators.GENES`).
_WORDS = (
    (0.04, "larger by {:.0%}", "smaller by {:.0%}"),
    (0.04, "longer by {:.0%}", "shorter by {:.0%}"),
    (0.04, "thicker by {:.0%}", "thinner by {:.0%}"),
    (0.2, "moved forward", "moved back"),
    (0.2, "moved up", "moved down"),
    (0.14, "turned", ""),
    (0.1, "with more joint axes", "with fewer joint axes"),
    (0.14, "may bend farther", "may bend less"),
    (0.1, "stronger", "weaker"),
    (0.1, "with stronger strokes", "with weaker strokes"),
    *(
        (0.1, *(f"with a new {word}",) * 2)
        for word in ("rhythm", "timing", "resting bend", "start")
    ),
)
# Place on the parent from which on a limb is named after a second direction, too.
_ALSO = 0.6


class Milestone(NamedTuple):
    """An ancestor, and what changed since the ancestor that is shown before.

    Attributes:
        ancestor: the ancestor.
        plan: its plan, see `evo_cpg.io.plans.EvolvedPlans.kept`.
        match: body of the plan before that each body continues, or -1.
        births: number of births since the ancestor before.
        words: changes in words, the most important first.
    """

    ancestor: Ancestor
    plan: Plan
    match: Int[np.ndarray, " b"]
    births: int
    words: tuple[str, ...]


def descent(plans: EvolvedPlans, line: Sequence[Ancestor], most: int) -> list[Milestone]:
    """Return the most telling ancestors of a line, with the first one and the last one.

    A step tells much if it changes the body or the oscillators much, or gains fitness. Each of the
    others stands for an equal part of all that is told, so that no time is left out.
    """
    grown = plans.kept(np.stack([one.record["genome"] for one in line]))
    gain = np.diff([one.record["fitness"] for one in line])
    change = [sum(weight for weight, _ in changes(*pair)) for pair in itertools.pairwise(grown)]
    parts = np.nan_to_num(gain, posinf=0, neginf=0).clip(0), np.minimum(change, _PARTS)
    telling = np.sum([part / max(part.sum(), 1e-9) for part in parts], axis=0)
    turn = np.ceil(np.cumsum(telling) / max(telling.sum(), 1e-9) * (most - 2))
    best = [np.where(turn == i, telling, -1).argmax() for i in np.unique(turn[telling > 0])]
    # Then the most telling ones of the rest.
    rest = [i for i in np.argsort(-telling, kind="stable") if telling[i] > 0]
    chosen = list(dict.fromkeys(map(int, (*best, *rest))))[: most - 2]
    shown = sorted({0, len(line) - 1, *(i + 1 for i in chosen)})
    steps = [Milestone(line[0], grown[0], np.full(len(grown[0].parent), -1), 0, ())]
    for i, j in itertools.pairwise(shown):
        words = tuple(words for _, words in changes(grown[i], grown[j])) or ("small changes",)
        steps.append(Milestone(line[j], grown[j], matched(grown[i], grown[j]), j - i, words))
    return [steps[0]._replace(words=(f"a body of {len(grown[0].parent)} parts",)), *steps[1:]]


def matched(before: Plan, after: Plan) -> Int[np.ndarray, " b"]:
    """Return the body of an earlier plan that each body continues, or -1. Roots always match."""
    found = np.where(np.arange(len(after.parent)) > 0, -1, 0)
    spots, earlier = (x.place / x.half[x.parent.clip(0)] for x in (after, before))
    for parent in range(len(found)):
        # The nearest children come first.
        near, own = [], np.flatnonzero(after.parent == parent)
        for i, j in itertools.product(own, np.flatnonzero(before.parent == found[parent])):
            away = np.abs(earlier[j] - spots[i]).max() + _OTHER * (
                before.label[j] != after.label[i]
            )
            if before.mirror[j] == after.mirror[i] and away < _OTHER + _NEAR:
                near.append((away, i, j))
        for _, i, j in sorted(near):
            if found[i] < 0 and j not in found:
                found[i] = j
    return found


def changes(before: Plan, after: Plan) -> list[tuple[float, str]]:
    """Return the changes between two plans with their weights, the most important first."""
    match = matched(before, after)
    lost, kept = ~np.isin(np.arange(len(before.parent)), match), np.flatnonzero(match >= 0)
    found = [*_parts(after, match < 0, "grew"), *_parts(before, lost, "lost")]
    labels, alike = dict.fromkeys(after.label[kept].tolist()), {}
    for own in (kept[after.label[kept] == label] for label in labels):
        for weight, words in _altered(before, after, match[own], own):
            alike.setdefault(words, []).append((weight, _name(after, own)))
    for words, parts in alike.items():
        name = parts[0][1] + " and others" * (len(parts) > 1)
        name = "whole body" if 1 < len(labels) == len(parts) else name
        found.append((sum(weight for weight, _ in parts), f"{name} {words}"))
    return sorted(found, key=lambda change: -change[0])


def _parts(plan: Plan, new: Bool[np.ndarray, " b"], verb: str) -> Iterator[tuple[float, str]]:
    """Yield changes for parts that grew or were lost, the parts of one label as one change."""
    tops = np.flatnonzero(new & ~new[plan.parent])
    for label in dict.fromkeys(plan.label[tops].tolist()):
        own = tops[plan.label[tops] == label]
        count = sum(bool({*own} & {*_path(plan, i)}) for i in range(len(new)))
        limbs = np.unique([_path(plan, i)[-1] for i in own])
        size = f"{count} part{'s' * (count > 1)}"
        words = f"{_name(plan, limbs)} {verb} {size}"
        if plan.parent[own[0]] == 0:
            words = f"{_name(plan, limbs)}{f' of {size}' * (count > len(own))} {verb}"
        yield _PARTS + _EACH * count + (verb == "grew"), words


def _path(plan: Plan, body: Any) -> list[int]:
    """Return a body and the bodies between it and the root, without the root."""
    return [body, *_path(plan, plan.parent[body])] if body else []


def _name(plan: Plan, bodies: Int[np.ndarray, " n"]) -> str:
    """Return the name of the bodies of a node, after the place of their limb on the trunk."""
    paths = sorted((_path(plan, body) for body in bodies), key=len)
    depth = len(paths[0])
    if not depth:
        return "trunk"
    many = sum(len(path) == depth for path in paths) > 1
    x, y, z = plan.place[paths[0][-1]] / plan.half[0]
    sides = [(abs(x), "front" if x > 0 else "rear"), (abs(z), "upper" if z > 0 else "lower")]
    sides.append((abs(y), "side" if many else "left" if y > 0 else "right"))
    where = " ".join(word for part, word in sides if part > _ALSO)
    return f"{f'part {depth} of the ' * (depth > 1)}{where} limb{'s' * many}"


def _altered(
    before: Plan, after: Plan, old: Int[np.ndarray, " n"], new: Int[np.ndarray, " n"]
) -> Iterator[tuple[float, str]]:
    """Yield changes of the bodies of a node. Joint, place and oscillators are the first one's."""
    i, j = old[0], new[0]
    length, *across = np.log(after.half[new] / before.half[old]).mean(0)
    thick, alike = np.mean(across), abs(length - np.mean(across)) < _WORDS[0][0]
    found = [np.mean([length, *across]), 0, 0] if alike else [0, length, thick]
    if j:
        moved = after.place[j] / after.half[after.parent[j]]
        moved = moved - before.place[i] / before.half[before.parent[i]]
        cosine = (np.sum(after.rotation[j] * before.rotation[i]) - 1) / 2
        turned = np.arccos(np.clip(cosine, -1, 1))
        axes = np.sum(after.axes[j], dtype=int) - np.sum(before.axes[i], dtype=int)
        limit = np.sum(after.limit[j] - before.limit[i])
        strength = after.strength[j] - before.strength[i]
        genes = (after.control[j] - before.control[i])[before.axes[i] & after.axes[j]]
        found += [moved[0], moved[2], turned, axes, limit, strength]
        found += [*genes[np.abs(genes).max(1).argmax()]] if len(genes) else []
    for change, (least, more, less) in zip(found, _WORDS, strict=False):
        if abs(change) >= least:
            words = (more if change > 0 else less).format(abs(np.expm1(change)))
            yield _LEAST * float(abs(change)) / least, words
