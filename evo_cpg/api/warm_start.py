"""Start of a run from the champion or the population of an earlier run."""

from pathlib import Path
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from evo_cpg.io.run import open_run
from evo_cpg.system import name_of, resolved
from evo_cpg.training.checkpoint import Champion, Checkpoint, genes_digest
from evo_cpg.training.experiment import ExperimentParts
from evo_cpg.training.run_folder import RunFolderError

What = Literal["champion", "population"]

# Tag that keeps the draws of the variations apart from other draws of the same seed.
_AROUND = 6


class Start(NamedTuple):
    """Initial genomes of a run.

    Attributes:
        genes: genomes of the first populations, run by run.
        provenance: origin of the genomes, for meta.json.
    """

    genes: Float[np.ndarray, "g all"]
    provenance: dict[str, Any]


def warm_start(experiment: ExperimentParts, path: Path, what: What) -> Start:
    """Return the first populations of an experiment, from a run with an equal body plan.

    If both have the same number of runs, each run starts from its own champion. Otherwise all
    start from the best. All genomes but the first are variations of the champion, made by the
    strategy. A larger population is cut, and a smaller one is filled with variations.

    Args:
        experiment: experiment that begins.
        path: folder of the earlier run.
        what: what to start from: the champion, or the newest population of the earlier run.

    Raises:
        RunFolderError: there is no such run or champion, or its animals have another plan.
        ConfigError: the earlier run's configuration is wrong.
    """
    earlier = open_run(path)
    _require_same_plan(experiment, earlier.experiment, path)
    checkpoint = earlier.folder.load()
    if checkpoint is None or checkpoint.champion is None:
        raise RunFolderError(f"{path} has no champion yet. Train it first")
    chosen = [_of_run(checkpoint, experiment, run) for run in range(experiment.runs)]
    genes = [
        _first_population(experiment, checkpoint, champion, run, what)
        for run, champion in enumerate(chosen)
    ]
    best = max(chosen, key=lambda champion: champion.worth)
    provenance = {
        "from": name_of(resolved(path)),
        "what": what,
        "generation": best.generation if what == "champion" else checkpoint.generation,
        "fitness": best.fitness,
        "config_sha256": earlier.folder.config_digest(),
        "genes_sha256": genes_digest(best.genes if what == "champion" else checkpoint.genes),
    }
    return Start(np.concatenate(genes, axis=1), provenance)


def _of_run(checkpoint: Checkpoint, experiment: ExperimentParts, run: int) -> Champion:
    """Return the champion that a run continues from."""
    own = checkpoint.champions[run] if len(checkpoint.champions) == experiment.runs else None
    best = own or checkpoint.champion
    assert best is not None
    return best


def _first_population(
    experiment: ExperimentParts, checkpoint: Checkpoint, champion: Champion, run: int, what: What
) -> Float[np.ndarray, "g n"]:
    size, strategy = experiment.strategy.population, experiment.strategy
    kept = champion.genes[:, None]
    if what == "population":
        width = checkpoint.genes.shape[1] // len(checkpoint.champions)
        kept = checkpoint.genes[:, width * champion.run :][:, : min(width, size)]
    count = kept.shape[1]
    parents = jnp.asarray(np.resize(kept.T, (size, len(kept))).T)
    key = jax.random.fold_in(jax.random.key(experiment.seed + run), _AROUND)
    return np.concatenate([kept, np.asarray(jax.jit(strategy.around)(key, parents))[:, count:]], 1)


def _require_same_plan(experiment: ExperimentParts, earlier: ExperimentParts, path: Path) -> None:
    """Check that controller, names of bodies and joints, and number of genes are equal.

    Raises:
        RunFolderError: the plans differ.
    """

    def plan(of: ExperimentParts) -> dict[str, Any]:
        controller, tree = of.simulation.controller, of.simulation.world.tree
        return {
            "controller": type(controller).__name__,
            "bodies": ", ".join(tree.names),
            "degrees of freedom": ", ".join(tree.dof_names),
            "genes": of.simulation.genome.count,
        }

    expected, found = plan(experiment), plan(earlier)
    for name, value in expected.items():
        if found[name] != value:
            raise RunFolderError(
                f"{path} holds animals of another plan. Its {name}: {found[name]}. "
                f"Requested: {value}"
            )
