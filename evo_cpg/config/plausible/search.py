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


RULES = (selection,)
