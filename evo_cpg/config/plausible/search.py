"""Settings of the search that come to nothing."""

from collections.abc import Iterator

from evo_cpg.config.plausible.doubt import Case, Doubt
from evo_cpg.config.schema.evolution import RealEvolutionConfig


def selection(case: Case) -> Iterator[Doubt]:
    """Lexicase selection goes through the trials of an individual, one after the other."""
    evolution, trials = case.config.evolution, case.config.simulation.trials
    if not (isinstance(evolution, RealEvolutionConfig) and evolution.selection == "lexicase"):
        return
    # Without noise so many trials in one situation are the same one.
    many = 1 if case.config.noise.silent else trials
    count = len(trials) if isinstance(trials, list) else many
    if count == 1:
        problem = "individuals have but one trial; give several in simulation.trials, or take rank"
        yield Doubt(("evolution", "selection"), evolution.selection, problem)


def trials_alike(case: Case) -> Iterator[Doubt]:
    """Several trials that differ in nothing."""
    trials = case.config.simulation.trials
    if not case.config.noise.silent:
        return
    if isinstance(trials, int):
        count, told = trials, "one is run"
    else:
        alike = all(trial == trials[0] for trial in trials)
        count, told = (len(trials) if alike else 1), "one would do"
    if count > 1:
        problem = (
            f"without noise all {count} trials are alike, so {told}; give noise, or a list of "
        )
        yield Doubt(("simulation", "trials"), count, f"{problem}situations that differ")


RULES = (selection, trials_alike)
