"""One brain for every body: trained on random plans, and tested on plans that it has never seen.

*Evolution* is the strategy of Salimans et al. 2017 ("Evolution strategies as a scalable alternative
to reinforcement learning"): the mean moves along a gradient that is estimated from pairs of
opposite random changes of all weights. All pairs drive the same plans to the same lights, so that
their luck is equal.

*Gradients* pass through brain and physics. They grow a millionfold in a few seconds, because limbs
hit their limits. So the trials are short, the light is equally close in proportion, and longer
gradients than the median are scaled down.
"""

import hashlib
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Float

from evo_cpg.api.progress import Work
from evo_cpg.control.body_brain import WEIGHTS, BodyBrain
from evo_cpg.files import make_folder, write_text, write_whole
from evo_cpg.studies.nursery import AllAlike, Nursery
from evo_cpg.studies.study import Table, tabled

if TYPE_CHECKING:
    from evo_cpg.studies.workshop import Workshop

# Number of plans to train on, and seconds of a trial.
_PLANS, _SECONDS = 2048, 20.0
# Pairs of opposite changes, plans that each change drives, size of the changes, and step size.
_PAIRS, _EACH, _SIGMA, _STEP = 64, 16, 0.1, 0.02
# Gradients: seconds of a trial, visits in a step, and step size.
_SHORT, _BATCH, _FINE = 3.0, 256, 0.003
# Updates between two files.
_OFTEN = 20


class Progress(NamedTuple):
    """State of a training.

    Attributes:
        weights: present weights of the brain.
        adam: state of Adam.
        updates: number of updates.
        seconds: processor time so far, s.
    """

    weights: Float[np.ndarray, " w"]
    adam: Any
    updates: int
    seconds: float


Direction = Callable[[np.random.Generator, Float[np.ndarray, " w"]], Float[np.ndarray, " w"]]
"""Function that returns a direction in which the weights get better."""


def evolving(nursery: Nursery, sight: float = 1.0) -> Direction:
    """Return the direction of the evolution strategy."""

    def direction(draw: np.random.Generator, weights: np.ndarray) -> np.ndarray:
        changes = draw.normal(size=(len(weights), _PAIRS))
        brains = weights[:, None] + _SIGMA * np.concatenate([changes, -changes], 1)
        plans, count = draw.integers(len(nursery.lengths), size=_EACH), brains.shape[1]
        lights = nursery.lights(draw, plans)
        visits = nursery.visits(
            np.tile(plans, count), np.tile(lights, count), brains.repeat(_EACH, 1), sight
        )
        covered = nursery.covered(visits).reshape(count, _EACH).mean(1)
        better = (covered[:_PAIRS] - covered[_PAIRS:]) / max(covered.std(), 1e-9)
        return changes @ better / _PAIRS

    return direction


def climbing(nursery: Nursery) -> Direction:
    """Return the direction of gradients through brain and physics."""

    def direction(draw: np.random.Generator, weights: np.ndarray) -> np.ndarray:
        plans = draw.integers(len(nursery.lengths), size=_BATCH)
        visits = nursery.visits(plans, nursery.lights(draw, plans), weights[:, None])
        _, slopes = nursery.gradients(visits)
        # The squares of some slopes overflow in float32.
        length = np.linalg.norm(slopes.astype(float), axis=0)
        finite = np.isfinite(length)
        if not finite.any():
            return np.zeros(len(weights))
        most = np.median(length[finite])
        factor = np.minimum(1.0, most / np.maximum(length[finite], most))
        return (slopes[:, finite] * factor).mean(1)

    return direction


def trained(
    direction: Direction,
    step: float,
    minutes: float,
    file: Path,
    work: Work,
    seed: int = 0,
    start: Float[np.ndarray, " w"] | None = None,
) -> Float[np.ndarray, " w"]:
    """Return the weights after some minutes of training from ``start``, by optax's Adam.

    Without a start, the weights are random and the output is 0. The minutes are processor time, so
    that other work on the machine costs a training nothing. The file keeps the progress. An
    interrupted training goes on from there.
    """
    adam = optax.adam(step, b2=0.99)
    if start is None:
        draw = np.random.default_rng(seed)
        start = np.concatenate([0.5 * draw.normal(size=WEIGHTS[0]), np.zeros(WEIGHTS[1])])
    now = Progress(start, adam.init(start), 0, 0.0)
    if file.is_file():
        now = _read(file, now)
    while now.seconds < 60 * minutes:
        began = time.process_time()
        ahead = direction(np.random.default_rng((seed, now.updates)), now.weights)
        change, state = adam.update(-ahead, now.adam, now.weights)
        seconds = now.seconds + time.process_time() - began
        now = Progress(now.weights + np.asarray(change), state, now.updates + 1, seconds)
        work.reached(int(seconds), int(60 * minutes))
        if now.updates % _OFTEN == 0:
            _write(file, now)
    _write(file, now)
    return now.weights


def _write(file: Path, progress: Progress) -> None:
    leaves = [np.asarray(x) for x in jax.tree.leaves(progress)]
    write_whole(file, lambda opened: np.savez(opened, *leaves))


def _read(file: Path, like: Progress) -> Progress:
    with np.load(file) as stored:
        leaves = [stored[name] for name in stored.files]
    found: Progress = jax.tree.unflatten(jax.tree.structure(like), leaves)
    # NumPy would compute in float64.
    adam = jax.tree.map(jnp.asarray, found.adam)
    return Progress(found.weights, adam, int(found.updates), float(found.seconds))


class Test(NamedTuple):
    """Result of newborns.

    Attributes:
        median: median fraction of the distance that is covered.
        nearer: fraction of the plans that come nearer at all.
        quartiles: lower and upper quartile of the fraction.
    """

    median: float
    nearer: float
    quartiles: tuple[float, float]

    @property
    def cells(self) -> dict[str, str]:
        """Cells of a table."""
        low, high = (f"{100 * x:.0f}" for x in self.quartiles)
        return {
            "distance covered, median": f"{100 * self.median:.0f} %",
            "quartiles": f"{low} to {high} %",
            "plans that come nearer": f"{100 * self.nearer:.1f} %",
        }


def tested(
    nursery: Nursery, weights: Float[np.ndarray, " w"], sight: float = 1.0, seed: int = 1
) -> Test:
    """Return the result of a brain in all plans, each with a light of its own.

    Args:
        nursery: the plans.
        weights: weights of the brain.
        sight: factor on the direction of the light: -1 reverses it, and 0 hides the light.
        seed: seed of the bearings.
    """
    count = len(nursery.lengths)
    lights = nursery.lights(np.random.default_rng(seed), np.arange(count))
    covered = nursery.covered(nursery.visits(np.arange(count), lights, weights[:, None], sight))
    low, median, high = np.percentile(covered, [25, 50, 75]).tolist()
    return Test(median, float((covered > 0).mean()), (low, high))


# Duration of each training, min: the two that are compared, and the one without light.
_MINUTES, _BLIND_MINUTES, _QUICK_MINUTES = 90.0, 20.0, 0.05
# Then the brain by evolution learns to move chains, too: minutes, fraction of chains, and step size
# of each course. Random plans alone hardly prepare it for drawn animals, most of which are chains.
_COURSES = ((19.0, 0.6, 0.02), (26.0, 0.3, 0.012))
# Number of plans that the brains have never seen.
_TESTED, _QUICK_TESTED = 1000, 32


def report(workshop: "Workshop") -> list[Table]:
    """Train brains by evolution and by gradients, and compare them on new plans.

    The file ``newborn.txt`` gets the weights by evolution after more training, with chains.
    """
    quick, work, folder = workshop.quick, workshop.work, workshop.folder / "runs" / "newborns"
    make_folder(folder)
    nursery, short = (Nursery(0, _PLANS, x) for x in (_SECONDS, _SHORT))
    makers = {
        "evolution": (evolving(nursery), _STEP, _MINUTES),
        "gradients": (climbing(short), _FINE, _MINUTES),
        "evolution, blind": (evolving(nursery, 0.0), _STEP, _BLIND_MINUTES),
    }
    brains = {}
    for name, (direction, step, minutes) in makers.items():
        file = folder / f"{name.replace(', ', '_')}.npz"
        work.doing(f"training a brain by {name}")
        brains[name] = trained(direction, step, _QUICK_MINUTES if quick else minutes, file, work)
    own = brains["evolution"]
    for number, (minutes, chains, step) in enumerate(_COURSES, 1):
        work.doing("training the brain by evolution with chains")
        direction = evolving(Nursery(0, _PLANS, _SECONDS, chains=chains))
        file, duration = folder / f"chains_{number}.npz", _QUICK_MINUTES if quick else minutes
        own = trained(direction, step, duration, file, work, number, own)
    brains["shipped: evolution, then chains"] = own
    write_text(folder / "newborn.txt", "".join(f"{x:.4f}\n" for x in own))
    found = _results(brains, own, _QUICK_TESTED if quick else _TESTED)
    return [tabled([{"brain": name} | test.cells for name, test in found.items()])]


def _results(brains: dict[str, np.ndarray], own: np.ndarray, count: int) -> dict[str, Test]:
    """Test all brains, and the shipped one (``own``) with changes, on as many new plans."""
    digest = hashlib.sha256(b"".join(x.tobytes() for x in brains.values())).digest()
    # The plans depend on the brains, so that no brain can have been trained for them.
    seed = int.from_bytes(digest[:3])
    plans, alike, chained = (
        Nursery(seed, count, _SECONDS, brain, fraction)
        for brain, fraction in ((BodyBrain, 0.0), (AllAlike, 0.0), (BodyBrain, 1.0))
    )
    found = {
        name: tested(plans, weights, 0.0 if "blind" in name else 1.0)
        for name, weights in brains.items()
    }
    found["untrained"] = tested(plans, 0 * own)
    found["shipped, light reversed"] = tested(plans, own, -1.0)
    found["shipped, all axes alike"] = tested(alike, own)
    found["shipped, chains with fins"] = tested(chained, own)
    found["evolution, chains with fins"] = tested(chained, brains["evolution"])
    return found
