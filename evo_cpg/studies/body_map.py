"""Map of bodies: the best fitness of each body in a grid, each with a rhythm of its own.

The bodies are plans (`evo_cpg.creature.graph`) in water. All have a trunk, a tail and a pair of
limbs, each of two parts, and they differ in the three genes of `GENES`. All joint axes of a body
have the same five genes of their oscillator (`evo_cpg.control.limb_oscillators`), so a brain is
five numbers without senses. CMA-ES trains the rhythms of many bodies side by side.

The fitness is the distance from the start (m). It does not reward size alone, because a body with
longer limbs has a shorter tail.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
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
from evo_cpg.training.devices import population_mesh
from evo_cpg.training.evaluate import compile_plan_trials
from evo_cpg.training.run_folder import RunFolderError

RHYTHM = len(limb_oscillators.GENES)
"""Number of genes of a rhythm."""

# A body swims several strokes in a trial, because any rhythm has 0.8 to 2 Hz. Less adaptation or
# more steering may end a rhythm, and a repeated training agrees less with the first.
_BODIES, _CONFIG = 7, "virtual_creatures_water"
_OVERRIDES = (
    f"evolution.plan.bodies={_BODIES} evolution.plan.parts=3 evolution.plan.connections=2 "
    "evolution.plan.joints=[hinge] controller.max_rate=10 controller.min_adaptation_gain=2 "
    "controller.steering_range=0.25 task.settle_seconds=0 task.unit=m"
)

# Half extents of the trunk, and those across a part of the tail or of a limb, m. A part of the tail
# and a part of a limb together have a constant length, m, so that longer limbs are no free gain.
_TRUNK, _ACROSS, _LENGTHS = (0.16, 0.05, 0.05), (0.03, 0.06), 0.46
# Half extents that the genes of sizes span, m.
_LOW, _HIGH = 0.03, 0.2
# A limb further along the trunk would sit on its front or rear.
_ALONG, _SWEEP = 120 / 128, 60.0

# Rhythms in a generation, and the first step size. The best genes of amplitude and period are often
# at the edge of the cube, which a smaller step finds less reliably.
_CHILDREN, _FIRST_STEP = 20, 0.8


class Gene(NamedTuple):
    """A gene of the bodies: its name, its unit, the values of 0 and 1, and words for both."""

    name: str
    unit: str
    low: float
    high: float
    words: tuple[str, str]


GENES = (
    Gene("length of a limb's part", "m", 0.06, 0.4, ("long tail", "long limbs")),
    Gene(
        "place along the trunk",
        "-1 rear, 1 front",
        -_ALONG,
        _ALONG,
        ("limbs behind", "limbs ahead"),
    ),
    Gene("sweep", "degrees", -_SWEEP, _SWEEP, ("swept forwards", "swept backwards")),
)
"""Genes of the bodies, in the order of the grid."""


def grid(cells: int) -> Float[np.ndarray, "n 3"]:
    """Return the genes (0 to 1) of all bodies of a grid, the last gene changing fastest."""
    return np.stack(np.meshgrid(*[np.linspace(0, 1, cells)] * 3, indexing="ij"), -1).reshape(-1, 3)


class Family:
    """Bodies of a grid, ready for trials.

    Args:
        cells: number of values of each gene.
        seconds: duration of a trial, s.
        substeps: number of physical steps in a control step.

    Attributes:
        settings: settings of the bodies and the trials.
        genes: genes of the bodies.
        plans: builder of the bodies.
        genomes: plans of the bodies.
    """

    def __init__(self, cells: int, seconds: float, substeps: int = 2):
        trial = f"simulation.seconds={seconds} simulation.substeps={substeps}"
        self.cells, self.genes, self.settings = cells, grid(cells), f"{_OVERRIDES} {trial}"
        source = shipped(_CONFIG).path
        config = load_config(source, self.settings.split())
        simulation = build_experiment(config, source).simulation
        assert isinstance(simulation.plans, EvolvedPlans)
        self.plans = simulation.plans
        self.genomes = genomes(self.plans.layout, self.genes)
        found, every = self.plans.developed(self.genomes), np.arange(len(self.genes))
        control, numbers = self.plans.given(found, every, _BODIES + 1)
        self._numbers, self._axes = numbers.astype(np.float32), len(control) // RHYTHM
        self._run = compile_plan_trials(simulation, _BODIES + 1, population_mesh())

    def nearest(self, genes: Float[np.ndarray, "*n 3"]) -> Int[np.ndarray, "*n"]:
        """Return the bodies of the grid that are nearest to some genes."""
        return np.round(genes * (self.cells - 1)).astype(int) @ self.cells ** np.array([2, 1, 0])

    def fitness(
        self, bodies: Int[np.ndarray, " n"], rhythms: Float[np.ndarray, "n k 5"]
    ) -> Float[np.ndarray, "n k"]:
        """Return the fitness of bodies with several rhythms, 0 for a trial that broke a rule."""
        control = np.repeat(rhythms.reshape(-1, RHYTHM).T.astype(np.float32), self._axes, 0)
        numbers = self._numbers[:, np.repeat(bodies, rhythms.shape[1])]
        outcome = self._run(control, None, None, 1, (numbers,))
        distance = np.where(outcome.alive, outcome.terms["distance"], 0.0)
        return np.nan_to_num(distance).reshape(rhythms.shape[:2])


def genomes(layout: GraphLayout, genes: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "g n"]:
    """Return the plans of bodies: node 0 is the trunk, 1 the tail, and 2 a limb."""
    spans = np.array([(gene.low, gene.high) for gene in GENES]).T
    length, along, sweep = (spans[0] + np.diff(spans, axis=0) * genes).T
    graph = {name: np.zeros((*shape, len(genes))) for name, shape in layout.shapes.items()}
    size, place = graph["size"], graph["place"]
    size[0], size[1:, 1:] = np.array(_TRUNK)[:, None], np.array(_ACROSS)[:, None]
    size[1, 0], size[2, 0] = (_LENGTHS - length) / 2, length / 2
    size[:] = np.round(256 * np.log(size / _LOW) / np.log(_HIGH / _LOW)) / 256
    graph["used"][:], graph["limits"][:], graph["strength"][:] = 1, 1, 0.5
    graph["label"][:], graph["recursion"][:] = np.array([[[1], [2], [3]], [[1], [2], [2]]])
    graph["on"][[0, 0, 1, 2], [0, 1, 0, 0]] = 1
    graph["to"][[0, 0, 1, 2], [0, 1, 0, 0]] = np.array([1, 2, 1, 2])[:, None]
    # The tail is behind the trunk, and further parts are at the ends of the first ones.
    place[0, 0, 0], place[1:, 0, 0] = -127 / 128, 127 / 128
    place[0, 1, :2] = np.round(128 * along) / 128, np.full_like(along, 127 / 128)
    graph["reflect"][0, 1] = 1
    graph["turn"][0, 1, 0] = np.clip(np.round(128 * sweep / _SWEEP), -127, 127) / 128
    return np.asarray(layout.pack(PlanGraph(**jax.tree.map(jnp.asarray, graph))))


class Map(NamedTuple):
    """Best fitness (m) and rhythm of each body. Bodies that are not trained yet have NaN."""

    settings: Any
    genes: Float[np.ndarray, "n 3"]
    fitness: Float[np.ndarray, " n"]
    rhythm: Float[np.ndarray, "n 5"]


def trained(
    family: Family, bodies: Int[np.ndarray, " n"], generations: int, seed: Sequence[int]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 5"]]:
    """Return the best fitness and rhythm of each body that CMA-ES finds."""
    draw, count = np.random.default_rng(seed), len(bodies)
    searches = cma.started(np.full((count, RHYTHM), 0.5), _FIRST_STEP)
    best, rhythm = np.full(count, -np.inf), np.zeros((count, RHYTHM))
    for _ in range(generations):
        points = cma.children(searches, draw.standard_normal((count, _CHILDREN, RHYTHM)))
        fitness = family.fitness(bodies, points)
        searches = cma.updated(searches, points, fitness)
        better = fitness.max(1) > best
        rhythm[better] = points[np.arange(count), fitness.argmax(1)][better]
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
    size, count = family.cells**2, len(family.genes)
    settings = f"{family.settings} cells={family.cells} {generations=}"
    unknown = np.full(count, np.nan), np.full((count, RHYTHM), np.nan)
    found = Map(settings, family.genes, *unknown)
    if path.is_file():
        with np.load(path) as stored:
            found = Map(**stored)
    if str(found.settings) != settings:
        raise RunFolderError(f"{path} is a map of other settings. Use --fresh, or another --out")
    for start in range(0, count, size):
        block = slice(start, start + size)
        if np.isnan(found.fitness[block]).any():
            own = trained(family, np.arange(count)[block], generations, (0, start))
            found.fitness[block], found.rhythm[block] = own
            write_whole(path, lambda file: np.savez(file, **found._asdict()))
        reached(start + size, count)
    return found
