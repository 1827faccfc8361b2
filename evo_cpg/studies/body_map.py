"""Map of bodies: the best fitness of each body in a grid, each with a rhythm of its own.

The bodies are plans (`evo_cpg.creature.graph`) in water. All have a trunk, a tail and a pair of
limbs, each of two parts, and they differ in the three genes of `GENES`. All joint axes of a body
have the same five genes of their oscillator (`evo_cpg.control.limb_oscillators`), so a brain is
five numbers without senses. CMA-ES trains the rhythms of many bodies side by side.

The fitness is the distance from the start (m). It does not reward size alone, because a body with
longer limbs has a shorter tail.
"""

import itertools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from evo_cpg.control import limb_oscillators
from evo_cpg.creature.graph import GraphLayout, PlanGraph
from evo_cpg.evolution import cma
from evo_cpg.files import write_whole
from evo_cpg.io.build import build_experiment
from evo_cpg.io.load import load_config
from evo_cpg.io.plans import EvolvedPlans
from evo_cpg.io.shipped import shipped
from evo_cpg.simulation.planned import SINK
from evo_cpg.training.devices import population_mesh
from evo_cpg.training.evaluate import compile_plan_trials
from evo_cpg.training.run_folder import RunFolderError

RHYTHM = len(limb_oscillators.GENES)
"""Number of genes of a rhythm."""

_BODIES = 7
_CONFIG = "virtual_creatures_water"
_OVERRIDES = (
    f"evolution.plan.bodies={_BODIES}",
    "evolution.plan.parts=3",
    "evolution.plan.connections=2",
    "evolution.plan.joints=[hinge]",
    # A body swims several strokes in a trial, because any rhythm has 0.8 to 2 Hz. Weaker adaptation
    # or more steering may end the rhythm, and then a search repeats worse.
    "controller.time_scale=0.5",
    "controller.min_adaptation_gain=2",
    "controller.steering_range=0.25",
    "controller.rate_gain=15",
    "controller.max_rate=10",
)

# Half extents of the trunk, and those across a part of the tail or of a limb, m. A part of the tail
# and a part of a limb together have a constant length, m, so that longer limbs are no free gain.
_TRUNK, _ACROSS, _LENGTHS = (0.16, 0.05, 0.05), (0.03, 0.06), 0.46
_STRENGTH = 0.5
# Half extents that the genes of sizes span, m.
_HALF = 0.03, 0.2
# Largest value of a signed gene. A limb further along the trunk would sit on its front or rear.
_MOST, _ALONG = 127 / 128, 120 / 128

# Rhythms in a generation, and the first step size. The best genes of amplitude and period are often
# at the edge of the cube, which a smaller step finds less reliably.
_CHILDREN, _FIRST_STEP = 20, 0.8
_SEED = 0


class Gene(NamedTuple):
    """A gene of the bodies.

    Attributes:
        name: name in pictures.
        unit: unit or meaning of the values.
        low: value at 0.
        high: value at 1.
        words: descriptions of the values 0 and 1.
    """

    name: str
    unit: str
    low: float
    high: float
    words: tuple[str, str]

    def value(self, gene: Any) -> Any:
        """Return the value of a gene from 0 to 1."""
        return self.low + (self.high - self.low) * gene


GENES = (
    Gene("length of a limb's part", "m", 0.06, 0.4, ("long tail", "long limbs")),
    Gene(
        "limbs' place along the trunk",
        "-1: rear, 1: front",
        -_ALONG,
        _ALONG,
        ("limbs at the rear", "limbs at the front"),
    ),
    Gene("sweep", "degrees", -60.0, 60.0, ("swept forwards", "swept backwards")),
)
"""Genes of the bodies, in the order of the grid."""


def grid(cells: int) -> Float[np.ndarray, "n 3"]:
    """Return the genes of all bodies of a grid, the last gene changing fastest."""
    return np.array(list(itertools.product(np.linspace(0, 1, cells), repeat=3)))


class Family:
    """Bodies of a grid, ready for trials.

    Args:
        cells: number of values of each gene.
        seconds: duration of a trial, s.
        substeps: number of physical steps in a control step.

    Attributes:
        settings: settings of the bodies and the trials, as text.
        genes: genes of the bodies.
        plans: builder of the bodies.
    """

    def __init__(self, cells: int, seconds: float = 5.0, substeps: int = 2):
        self.cells, self.genes = cells, grid(cells)
        trial = (f"simulation.seconds={seconds}", f"simulation.substeps={substeps}")
        overrides, source = [*_OVERRIDES, *trial], shipped(_CONFIG).path
        self.settings = " ".join([*overrides, f"{cells=}"])
        simulation = build_experiment(load_config(source, overrides), source).simulation
        assert isinstance(simulation.plans, EvolvedPlans)
        self.plans = simulation.plans
        self._axes = _BODIES * len(self.plans.section.axes)
        found = self.plans.developed(genomes(self.plans.layout, self.genes))
        numbers = self.plans.given(found, np.arange(len(self.genes)), _BODIES + 1)[1]
        self._numbers = numbers.astype(np.float32)
        self._run = compile_plan_trials(simulation, _BODIES + 1, population_mesh())

    def nearest(self, genes: Float[np.ndarray, "*n 3"]) -> Int[np.ndarray, " *n"]:
        """Return the bodies of the grid that are nearest to some genes."""
        places = np.round(genes * (self.cells - 1)).astype(int)
        return places @ self.cells ** np.array([2, 1, 0])

    def fitness(
        self, bodies: Int[np.ndarray, " n"], rhythms: Float[np.ndarray, "n k 5"]
    ) -> Float[np.ndarray, "n k"]:
        """Return the fitness of bodies with several rhythms, 0 for a trial that broke a rule."""
        flat = rhythms.reshape(-1, RHYTHM).T.astype(np.float32)
        numbers = self._numbers[:, np.repeat(bodies, rhythms.shape[1])]
        outcome = self._run(np.repeat(flat, self._axes, 0), None, None, 1, (numbers,))
        distance = np.where(outcome.alive, outcome.terms["distance"], 0.0)
        return np.nan_to_num(distance).reshape(rhythms.shape[:2])


def genomes(layout: GraphLayout, genes: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "g n"]:
    """Return the plans of bodies."""
    length, along, sweep = (gene.value(x) for gene, x in zip(GENES, genes.T, strict=True))
    graph = {name: np.zeros((*shape, len(genes))) for name, shape in layout.shapes.items()}
    graph["used"][:], graph["limits"][:], graph["strength"][:] = 1, 1, _STRENGTH
    graph["label"][:], graph["recursion"][:] = np.array([[1, 1], [2, 2], [3, 2]]).T[..., None]
    (low, high), sizes = _HALF, np.empty_like(graph["size"])
    sizes[0], sizes[1:, 1:] = np.array(_TRUNK)[:, None], np.array(_ACROSS)[:, None]
    sizes[1, 0], sizes[2, 0] = (_LENGTHS - length) / 2, length / 2
    graph["size"][:] = np.round(256 * np.log(sizes / low) / np.log(high / low)) / 256
    ahead, side = (_MOST, 0), (along, _MOST)
    links = (0, 0, 1, (-_MOST, 0)), (0, 1, 2, side), (1, 0, 1, ahead), (2, 0, 2, ahead)
    for node, link, to, place in links:
        graph["on"][node, link], graph["to"][node, link] = 1, to
        for axis, value in enumerate(place):
            graph["place"][node, link, axis] = np.round(128 * value) / 128
    graph["reflect"][0, 1] = 1
    graph["turn"][0, 1, 0] = np.clip(np.round(128 / GENES[2].high * sweep), -127, 127) / 128
    return np.asarray(layout.pack(PlanGraph(**{name: jnp.asarray(x) for name, x in graph.items()})))


def outline(family: Family, body: int) -> Float[np.ndarray, "b 4 2"]:
    """Return the corners of each part of a body in its neutral pose, seen from above (m)."""
    plan = family.plans.plan(genomes(family.plans.layout, family.genes[[body]])[:, 0])
    centres, turns, corners = [], [], []
    for i in np.flatnonzero(plan.present):
        joint, turn, parent = SINK * plan.place[i], plan.rotation[i], plan.parent[i]
        centre = np.zeros(3)
        if parent >= 0:
            turn = turns[parent] @ turn
            centre = centres[parent] + turns[parent] @ joint + SINK * plan.half[i, 0] * turn[:, 0]
        centres.append(centre)
        turns.append(turn)
        flat = np.array([[1, 1, 0], [1, -1, 0], [-1, -1, 0], [-1, 1, 0]]) * plan.half[i]
        corners.append((centre + flat @ turn.T)[:, :2])
    return np.array(corners)


class Map(NamedTuple):
    """Best fitness and rhythm of bodies. Bodies that are not trained yet have NaN.

    Attributes:
        settings: what the map was made of, as text.
        genes: genes of the bodies.
        fitness: best fitness, m.
        rhythm: rhythm with the best fitness.
    """

    settings: Any
    genes: Float[np.ndarray, "n 3"]
    fitness: Float[np.ndarray, " n"]
    rhythm: Float[np.ndarray, "n 5"]


def trained(
    family: Family, bodies: Int[np.ndarray, " n"], generations: int, seed: Sequence[int]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 5"]]:
    """Return the best fitness and rhythm of each body that CMA-ES finds."""
    draw, rows = np.random.default_rng(seed), np.arange(len(bodies))
    searches = cma.begun(np.full((len(bodies), RHYTHM), 0.5), _FIRST_STEP)
    best, rhythm = np.full(len(bodies), -np.inf), np.zeros((len(bodies), RHYTHM))
    for _ in range(generations):
        points = cma.children(searches, draw.standard_normal((len(bodies), _CHILDREN, RHYTHM)))
        fitness = family.fitness(bodies, points)
        searches = cma.updated(searches, points, fitness)
        better = fitness.max(1) > best
        rhythm = np.where(better[:, None], points[rows, fitness.argmax(1)], rhythm)
        best = np.maximum(best, fitness.max(1))
    return best, rhythm


def made_map(
    path: Path, family: Family, generations: int, reached: Callable[[int, int], None]
) -> Map:
    """Return the map of all bodies, and keep it in a file after each block of bodies.

    A block has all bodies with one value of the first gene, and random numbers of its own. So an
    interrupted map continues to the same file.

    Raises:
        RunFolderError: the file is a map of other bodies, trials or generations.
    """
    found = _read(path, f"{family.settings} {generations=}", family)
    size, count = family.cells**2, len(family.genes)
    for start in range(0, count, size):
        block = slice(start, start + size)
        if np.isnan(found.fitness[block]).any():
            own = trained(family, np.arange(count)[block], generations, (_SEED, start))
            found.fitness[block], found.rhythm[block] = own
            write_whole(path, lambda file: np.savez(file, **found._asdict()))
        reached(start + size, count)
    return found


def _read(path: Path, settings: str, family: Family) -> Map:
    """Return the map in a file, or a map without trained bodies if there is no file."""
    count = len(family.genes)
    unknown = np.full(count, np.nan), np.full((count, RHYTHM), np.nan)
    if not path.is_file():
        return Map(settings, family.genes, *unknown)
    with np.load(path) as stored:
        found = Map(**stored)
    if str(found.settings) != settings:
        raise RunFolderError(f"{path} is a map of other settings. Use --fresh, or another --out")
    return found
