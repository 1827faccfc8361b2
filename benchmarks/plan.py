"""Settings of a measurement, shared by all cases."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np

from evo_cpg.io.build import build_experiment
from evo_cpg.io.load import check_config, load_config
from evo_cpg.io.models.mjcf_import import Imported, read_model
from evo_cpg.simulation.simulation import Simulation
from evo_cpg.training.experiment import ExperimentParts

ROOT = Path(__file__).parents[1]
CONFIGS = ROOT / "configs"
# Models of gymnasium (see the README there).
MODELS = ROOT / "benchmarks" / "models"


# Overrides for three of the swimmer's ten bodies, a small population and short trials.
SMALL_SWIMMER = (
    "creature.bodies.1.repeat=2",
    "simulation.seconds=1",
    "evolution.population=32",
    "evolution.elites=4",
)


class Plan(NamedTuple):
    """Settings of all cases of a run.

    Attributes:
        cores: number of cores for every contender.
        sizes: sizes of the populations, if a case can choose, or None for each case's own.
        call_seconds: approximate length of a call, s.
        repeats: number of rounds, over which medians are taken.
        limit: longest compile time of a peer in a process of its own, s.
        quick: whether to measure little, for a first look.
        say: function that reports progress.
    """

    cores: int
    sizes: tuple[int, ...] | None = None
    call_seconds: float = 0.5
    repeats: int = 7
    limit: float = 120.0
    quick: bool = False
    say: Callable[[str], object] = lambda text: None

    def sizes_or(self, *own: int) -> tuple[int, ...]:
        """Return the chosen population sizes, or else the case's own (only the first if quick)."""
        return self.sizes or (own[:1] if self.quick else own)


def random_genes(simulation: Simulation, size: int) -> np.ndarray:
    """Return a random population ``(genes, size)``, float32, the same in every process."""
    draw = jax.jit(lambda: simulation.genome.random(jax.random.key(0), (size,), np.float32))
    return np.asarray(draw())


def swimmer_settings(plan: Plan) -> tuple[str, ...]:
    """Return overrides of the swimmer's config: none, or the overrides that make it small."""
    return SMALL_SWIMMER if plan.quick else ()


def experiment_of(name: str, *overrides: str) -> ExperimentParts:
    """Return the experiment of a config of this checkout.

    Args:
        name: name of its file, without ``.yaml``.
        overrides: ``key=value`` settings.
    """
    path = CONFIGS / f"{name}.yaml"
    return build_experiment(load_config(path, list(overrides)), path)


def imported_experiment(path: Path) -> tuple[ExperimentParts, Imported]:
    """Return the experiment that `evo-cpg import` makes of a file, and the import."""
    imported = read_model(path)
    return build_experiment(check_config(imported.experiment, path), path), imported
