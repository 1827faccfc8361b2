"""The champion's line of descent in a film and pictures, if body plans evolve."""

from pathlib import Path

import numpy as np

from evo_cpg.analysis.descent import Milestone, descent
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

# Most ancestors in a film and in a picture.
_IN_FILM, _IN_PICTURE = 10, 12


def ancestors_panel(opened: Run, trial: int) -> Panel:
    """Return a panel in which the champion's ancestors become each other.

    All of them meet the noise of the champion's generation.

    Raises:
        UsageError: no body plans evolve in the run, or its trials are too short.
        RunFolderError: the family tree does not reach the champion.
    """
    experiment, champion = opened.experiment, opened.champion
    plans, simulation = _plans_of(opened), experiment.simulation
    if simulation.duration < NEEDED:
        raise UsageError(
            f"ancestors: a trial of {opened.folder.path} has {simulation.duration:g} s. The film "
            f"needs {NEEDED:g} s (simulation.seconds)"
        )
    with working("recording the ancestors"):
        steps = _steps(opened, plans, _IN_FILM)
        record = compile_motions(experiment, NEEDED, RATE)
        genomes = np.stack([step.ancestor.record["genome"] for step in steps], 1)
        genes = np.asarray(plans.layout.from_bytes(genomes), np.float32)
        places = np.array([step.ancestor.index for step in steps])
        time, found = record(genes, champion.generation, champion.run, places, trial)
    position = np.moveaxis(found["position"], (3, 2), (1, 2))
    rotation = np.moveaxis(found["rotation"], (4, 3), (1, 2))
    motions = []
    for i, step in enumerate(steps):
        own = np.s_[:, [i], : len(step.match)]
        motion = CrowdMotion(time, position[own], rotation[own], np.full(3, np.nan))
        motions.append(motion.recording(0, 0))
    union, motion, growth = grown(steps, motions, simulation.world.ground is not None)
    words = (
        f"Generation {one.generation}: {step.words[0]} (fitness {one.record['fitness']:.3g})"
        for one, step in ((step.ancestor, step) for step in steps)
    )
    panel = panel_of(experiment, motion, experiment.name)._replace(numbers=False)
    growth = growth._replace(words=tuple(words))
    return panel._replace(creature=plans.creature(union), growth=growth)


def family_pictures(opened: Run, folder: Path) -> list[Path]:
    """Draw ``family.png`` and ``diversity.png`` of a run into a folder, and return their paths.

    Raises:
        UsageError: no body plans evolve in the run.
        RunFolderError: the family tree does not reach the champion.
    """
    name, run, plans = opened.experiment.name, opened.champion.run, _plans_of(opened)
    with working("drawing the family tree"):
        steps, family = _steps(opened, plans, _IN_PICTURE), read_family(opened.folder.path)
        others = [
            None if one is None else plans.creature(plans.kept(one["genome"][None])[0])
            for one in (step.ancestor.other for step in steps)
        ]
        animals = [plans.creature(step.plan) for step in steps]
        title = f"{name}: ancestors of the champion"
        figure = family_figure(steps, animals, others, title)
        made = [save_figure(figure, folder / "family.png")]
        figure = diversity_figure(diversity(plans, family, run), f"{name}: diversity of bodies")
        return [*made, save_figure(figure, folder / "diversity.png")]


def _plans_of(opened: Run) -> EvolvedPlans:
    plans = opened.experiment.simulation.plans
    if not isinstance(plans, EvolvedPlans):
        raise UsageError(
            f"{opened.folder.path} has no family tree, because its search does not evolve body "
            "plans (evolution.type: plans)"
        )
    return plans


def _steps(opened: Run, plans: EvolvedPlans, most: int) -> list[Milestone]:
    champion, folder = opened.champion, opened.folder.path
    line = line_of(folder, champion.generation, champion.index, champion.run)
    if line is None:
        raise RunFolderError(
            f"{folder}: the family tree does not reach generation {champion.generation}, in which "
            "the champion was found"
        )
    return descent(plans, line, most)
