"""The champion's line of descent in a film and pictures, if body plans evolve."""

from pathlib import Path

import numpy as np

from evo_cpg.analysis.descent import Step, descent, told
from evo_cpg.analysis.diversity import diversity
from evo_cpg.api.progress import working
from evo_cpg.errors import UsageError
from evo_cpg.io.plans import EvolvedPlans
from evo_cpg.io.run import Run
from evo_cpg.training.crowd import CrowdMotion, compile_motions
from evo_cpg.training.family import line_of, read_family
from evo_cpg.training.run_folder import RunFolderError
from evo_cpg.view.family import diversity_figure, family_figure
from evo_cpg.view.figure import save_figure
from evo_cpg.view.growth import NEEDED, RATE, grown
from evo_cpg.view.scene import Panel, panel_of


def ancestors_panel(opened: Run, trial: int) -> Panel:
    """Return a panel in which the champion's ancestors become each other.

    All of them meet the noise of the champion's generation.

    Raises:
        UsageError: no body plans evolve in the run.
        RunFolderError: the family tree does not reach the champion.
    """
    experiment, champion, simulation = opened.experiment, opened.champion, opened.experiment.simulation
    with working("recording the ancestors"):
        steps, plans = _descent_of(opened)
        record = compile_motions(experiment, min(NEEDED, simulation.duration), RATE)
        genes = np.stack([plans.genes_kept(step.ancestor.record["genome"]) for step in steps], 1)
        places = np.array([step.ancestor.index for step in steps])
        time, found = record(genes, champion.generation, champion.run, places, trial)
    place, turn = (np.moveaxis(found[x], (-1, -2), (1, 2)) for x in ("position", "rotation"))
    motions = [
        CrowdMotion(time, *(x[:, [i], : len(step.match)] for x in (place, turn)), np.full(3, np.nan))
        for i, step in enumerate(steps)
    ]
    union, motion, growth = grown(
        steps, [each.recording(0, 0) for each in motions], simulation.world.ground is not None
    )
    words = [
        f"Generation {one.generation} (fitness {one.record['fitness']:.3g}): {told(step, 1)}"
        for step in steps
        for one in [step.ancestor]
    ]
    panel = panel_of(experiment, motion, "Ancestors of the champion")
    return panel._replace(
        creature=plans.creature(union), growth=growth._replace(words=tuple(words))
    )


def family_pictures(opened: Run, folder: Path) -> list[Path]:
    """Draw ``family.png`` and ``diversity.png`` of a run into a folder, and return their paths.

    Raises:
        UsageError: no body plans evolve in the run.
        RunFolderError: the family tree does not reach the champion.
    """
    name, run = opened.experiment.name, opened.champion.run
    with working("drawing the family tree"):
        steps, plans = _descent_of(opened)
        family = read_family(opened.folder.path)
        others = [
            one and plans.creature(plans.kept(one["genome"][None])[0])
            for one in (step.ancestor.other for step in steps)
        ]
        best = np.array([block["fitness"][run].max() for block in family])
        animals = [plans.creature(step.plan) for step in steps]
        figure = family_figure(steps, animals, others, best, f"{name}: ancestors of the champion")
        made = [save_figure(figure, folder / "family.png")]
        figure = diversity_figure(diversity(plans, family, run), f"{name}: diversity of body plans")
        return [*made, save_figure(figure, folder / "diversity.png")]


def _descent_of(opened: Run) -> tuple[list[Step], EvolvedPlans]:
    champion, plans = opened.champion, opened.experiment.simulation.plans
    if not isinstance(plans, EvolvedPlans):
        raise UsageError(
            f"{opened.folder.path} has no family tree, because its search does not evolve body "
            "plans (evolution.type: plans)"
        )
    line = line_of(opened.folder.path, champion.generation, champion.index, champion.run)
    if line is None:
        raise RunFolderError(
            f"{opened.folder.path}: the family tree does not reach generation "
            f"{champion.generation} of the champion"
        )
    return descent(plans, line), plans
