"""Start of a run: its folder, its first genomes, and checks before an earlier run continues."""

import sys
import time
from pathlib import Path
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from evo_cpg.api.machine import machine_changes, machine_fingerprint
from evo_cpg.errors import UsageError
from evo_cpg.io.build import require_genes
from evo_cpg.io.load import dump_config
from evo_cpg.io.run import Run, changes, changes_of_fitness, fingerprint, open_run
from evo_cpg.io.shipped import shipped_name
from evo_cpg.simulation.simulation import Genome
from evo_cpg.simulation.task import term_names
from evo_cpg.system import resolved
from evo_cpg.training.checkpoint import Checkpoint, genes_digest
from evo_cpg.training.experiment import TABLE_COLUMNS, ExperimentParts
from evo_cpg.training.memory import require_memory
from evo_cpg.training.reevaluation import is_finished
from evo_cpg.training.run_folder import RunFolderError

What = Literal["champion", "population"]

# Tag that keeps the draws of the variations apart from other draws of the same seed.
_AROUND = 6


def now() -> str:
    """Return date and time, with the zone."""
    return time.strftime("%Y-%m-%dT%H:%M:%S%z")


class Start(NamedTuple):
    """Initial genomes of a run.

    Attributes:
        genes: genomes of the first populations, run by run.
        provenance: origin of the genomes, for meta.json.
    """

    genes: Float[np.ndarray, "g all"]
    provenance: dict[str, Any]


def begin_run(run: Run, devices: int, source: Path, start: Start | None = None) -> None:
    """Make a run folder, with its configuration and meta.json.

    Raises:
        ConfigError: there are no genes to evolve.
        OutputError: the folder cannot be written.
        RunFolderError: the folder holds a run or other files.
        TooLargeError: the run needs more memory than the machine has.
    """
    require_genes(run.experiment, source)
    require_memory(run.experiment)
    meta = _known(run, devices, source)
    if start is not None:
        meta["start"] = start.provenance
    run.folder.create(dump_config(run.config), meta, None if start is None else start.genes)


def _known(run: Run, devices: int, source: Path) -> dict[str, Any]:
    """Return the contents of meta.json for a run that begins."""
    meta: dict[str, Any] = {
        "name": run.config.name,
        "seed": run.config.seed,
        "config": str(resolved(source)),
        "command": sys.argv[1:],
        "fingerprint": fingerprint(run.config),
        "started": now(),
    }
    meta |= machine_fingerprint(run.experiment.simulation.engine, devices)
    if name := shipped_name(source):
        meta["shipped_config"] = name
    return meta


def reopen_run(run: Run, devices: int, source: Path | None = None) -> list[str]:
    """Record the configuration and machine that a run continues with.

    Args:
        run: run with the configuration to continue with.
        devices: number of devices.
        source: file of the configuration, if known.

    Returns:
        A sentence about changes of the configuration, and one for each difference from the earlier
        machine.

    Raises:
        ConfigError: there are no genes to evolve.
        OutputError: the folder cannot be written.
        RunFolderError: after a change, earlier individuals would have another fitness.
        TooLargeError: the run needs more memory than the machine has.
    """
    folder = run.folder
    before = folder.read_meta()
    changed = changes(before.get("fingerprint"), fingerprint(run.config))
    changed = [each for each in changed if each != "evolution.generations"]
    spoilt = changes_of_fitness(before.get("fingerprint"), run.config) if folder.newest else []
    if spoilt:
        raise RunFolderError(
            f"{folder.path}: changed since the run was last started: {', '.join(spoilt)}. Its "
            "champion was evaluated without the change, so new individuals cannot be compared with "
            "it. Undo the change, or start a new run from this population with `evo-cpg train "
            f"{folder.config} --from {folder.path} --start population --out ...`"
        )
    require_genes(run.experiment, folder.config)
    require_memory(run.experiment)
    # Call this before writing anything: it starts JAX, which may find no device.
    here = machine_fingerprint(run.experiment.simulation.engine, devices)
    folder.reopen(dump_config(run.config))
    noted = {"resumed": now(), "fingerprint": fingerprint(run.config)} | here
    if not before and source is not None:
        # The run was killed before meta.json was written.
        noted = _known(run, devices, source)
    folder.update_meta(**noted)
    found = [f"{difference}. Bits may differ" for difference in machine_changes(before, here)]
    if changed:
        words = f"changed since the run was last started: {', '.join(changed)}"
        found.insert(0, f"{words}. The run continues with the changes")
    return [f"{folder.path}: {difference}" for difference in found]


def require_alike(run: Run) -> Checkpoint | None:
    """Check that a run fits its configuration, and return the newest checkpoint, if any.

    Raises:
        UsageError: more generations are done than requested.
        RunFolderError: genes, individuals or columns of the checkpoint do not fit the
            configuration.
    """
    folder, config, experiment = run.folder, run.config, run.experiment
    done = folder.load()
    if done is None:
        return None
    if done.generation > config.evolution.generations:
        raise UsageError(
            f"{folder.path}: already has {done.generation} generations, more than "
            f"{config.evolution.generations}. Give at least {done.generation}"
        )
    runs, population = experiment.runs, experiment.strategy.population
    expected = experiment.simulation.genome.count, runs * population, runs
    found = *done.genes.shape, len(done.champions)
    if expected != found:
        raise RunFolderError(
            f"{folder.config} was changed: it now has {expected[0]} genes and {expected[1]} "
            f"individuals in {expected[2]} run(s), but the checkpoint has {found[0]}, "
            f"{found[1]} and {found[2]}. Start a new run instead"
        )
    simulation = experiment.simulation
    measured = term_names(simulation.task) + simulation.measures.names
    columns = [*experiment.strategy.metric_names, *(f"best_{name}" for name in measured)]
    columns += [f"best_{name}" for name in simulation.genome.sizes]
    before = done.history[-1]
    added = [name for name in columns if name not in before]
    lost = [name for name in before if name not in (*columns, *TABLE_COLUMNS)]
    if added or lost:
        parts = [("add", added), ("drop", lost)]
        changed = " and ".join(f"{verb} {', '.join(names)}" for verb, names in parts if names)
        raise RunFolderError(
            f"{folder.config} or its task was changed: metrics.csv would {changed}, but all its "
            "rows must have the same columns. Restore task, measures and evolution. Or start a new "
            f"run with `evo-cpg train {folder.config} --from {folder.path} --out ...`"
        )
    return done


def is_complete(run: Run, done: Checkpoint | None) -> bool:
    """Return whether a run is finished, and none of its files was lost or changed since."""
    if done is None or not is_finished(run.experiment, done):
        return False
    folder, best = run.folder, done.champion
    try:
        champion, recording, digests = folder.load_champion()
    except RunFolderError:
        return False
    return (
        "finished" in folder.read_meta()
        and folder.metrics.is_file()
        and recording is not None
        and digests["config_sha256"] == folder.config_digest()
        and best is not None
        and genes_digest(champion.genes) == genes_digest(best.genes)
    )


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
    checkpoint = earlier.folder.load()
    if checkpoint is None or checkpoint.champion is None:
        raise RunFolderError(f"{path} has no champion yet. Train it first")
    # A fixed body may start with the controllers of bodies that evolved.
    fixed = not experiment.simulation.has_own_bodies
    own = checkpoint.champions if len(checkpoint.champions) == experiment.runs else ()
    chosen = [each or checkpoint.champion for each in own or [None] * experiment.runs]
    if fixed and earlier.experiment.simulation.plans:
        # Of plans only the champion's controller fits its body.
        alone = earlier.of_body(checkpoint.champion)
        earlier, chosen, what = alone, [alone.champion] * experiment.runs, "champion"
    plans, simulations = [], (experiment.simulation, earlier.experiment.simulation)
    for one in simulations:
        tree, genome = one.world.tree, Genome(one.controller) if fixed else one.genome
        plans.append(
            {
                "controller": type(one.controller).__name__,
                "bodies": ", ".join(tree.names),
                "degrees of freedom": ", ".join(tree.dof_names),
                "genes": genome.count,
            }
        )
    for name, value in plans[0].items():
        if plans[1][name] != value:
            raise RunFolderError(
                f"{path} holds animals of another plan. Its {name}: {plans[1][name]}. "
                f"Requested: {value}"
            )
    size, strategy = experiment.strategy.population, experiment.strategy
    genes = []
    for run, champion in enumerate(chosen):
        count = experiment.simulation.genome.count
        kept = champion.genes[:count, None]
        if what == "population":
            width = checkpoint.genes.shape[1] // len(checkpoint.champions)
            kept = checkpoint.genes[:count, width * champion.run :][:, : min(width, size)]
        parents = jnp.asarray(np.resize(kept.T, (size, len(kept))).T)
        key = jax.random.fold_in(jax.random.key(experiment.seed + run), _AROUND)
        varied = np.asarray(jax.jit(strategy.around)(key, parents))
        genes.append(np.concatenate([kept, varied[:, kept.shape[1] :]], 1))
    best = max(chosen, key=lambda champion: champion.worth)
    provenance = {
        "from": str(resolved(path)),
        "what": what,
        "generation": best.generation if what == "champion" else checkpoint.generation,
        "fitness": best.fitness,
        "config_sha256": earlier.folder.config_digest(),
        "genes_sha256": genes_digest(best.genes if what == "champion" else checkpoint.genes),
    }
    return Start(np.concatenate(genes, axis=1), provenance)
