"""Controls of bodies that evolve: what does it take away if only bodies, or only brains, evolve?"""

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from evo_cpg.studies.parts import audit_table, audited
from evo_cpg.studies.study import Part, Runs, Table, beside, middle, tabled

if TYPE_CHECKING:
    from evo_cpg.studies.workshop import Workshop

_CONFIG, _SEEDS = "virtual_creatures_water", 20
# Name in tables, and changes to the configuration, of each arm by its run.
_ARMS = {
    "both": ("body and brain", ()),
    "brain": ("brain alone", ("evolution.evolve=brain", "evolution.founders=1")),
    "body": ("body alone, fixed rhythm", ("evolution.evolve=body",)),
    "random": ("random plans, evolved brains", ("evolution.evolve=brain",)),
    "unprotected": ("body and brain, without protection", ("evolution.protect=false",)),
}
_RANDOM = "random plans, evolved brains"
# Champions of each arm that are audited.
_AUDITED = 3


def report(workshop: "Workshop") -> list[Table]:
    """Compare the arms, count their topologies, and audit their best champions."""
    fitness = {
        words: [champion.fitness for champion in workshop.champions(name)]
        for name, (words, _) in _ARMS.items()
    }
    tests = beside(fitness, _RANDOM)
    rows = []
    for name, (words, _) in _ARMS.items():
        best, every, apart = workshop.kept(
            f"diversity_{name}", [name], lambda name=name: _counted(workshop, name)
        )
        rows.append(
            {
                "evolves": words,
                "distance, lengths": middle(fitness[words]),
                f"beside {_RANDOM}": tests[words],
                "topologies of the best 30": middle(best, 0),
                "of all": middle(every, 0),
                "edit distance": middle(apart, 1),
            }
        )
    audits = {words: audited(workshop, name, _AUDITED) for name, (words, _) in _ARMS.items()}
    return [tabled(rows, "In the last generation:"), audit_table("The best champions:", audits)]


def _counted(workshop: "Workshop", name: str) -> list[list[float]]:
    """Return diversity in the last generation of each run: of the best, of all, and distances."""
    from evo_cpg.analysis.diversity import diversity
    from evo_cpg.io.plans import plans_of
    from evo_cpg.training.family import read_family

    member = workshop.member(name)
    plans, last = plans_of(member.config), read_family(member.folder.path)[-1:]
    found = [diversity(plans, last, run) for run in range(member.experiment.runs)]
    rows = [(each.best[0], each.topologies[0], each.distance[0]) for each in found]
    return np.array(rows, float).T.tolist()


def report_learning(workshop: "Workshop") -> list[Table]:
    """Compare champions with and without learning after the same time, compilation apart."""
    clocks = {name: _clock(workshop.column(name, "seconds")[:, 0]) for name in _LEARNING}
    budget = min(clock[-1] for clock in clocks.values())
    ends = {name: int(np.searchsorted(clock, budget)) for name, clock in clocks.items()}
    fitness = {
        words: workshop.column(name, "champion")[ends[name]].tolist()
        for name, (words, _) in _LEARNING.items()
    }
    first = next(iter(fitness))
    tests = beside(fitness, first)
    rows = [
        {
            "search": words,
            f"generations in {budget:.0f} s": str(end + 1),
            "distance, lengths": middle(fitness[words]),
            f"beside {first}": tests[words],
        }
        for words, end in zip(fitness, ends.values(), strict=True)
    ]
    return [tabled(rows)]


def _clock(seconds: Float[np.ndarray, " t"]) -> Float[np.ndarray, " t"]:
    """Return the time after each generation, s, as if nothing had to be compiled.

    Each generation takes the median of those at the same place in a round of learning.
    """
    place = np.arange(len(seconds)) % _ROUND
    usual = np.array([np.median(seconds[place == each]) for each in np.unique(place)])
    return usual[place].cumsum()


# Name in tables, and changes, of each search by its run. Evolution alone has more generations, so
# that it certainly lasts as long as the others.
_LEARNING = {
    "alone": ("evolution alone", ("evolution.generations=240",)),
    "inherited": (
        "with learning, inherited",
        ("evolution.generations=80", "evolution.learning.learners=8"),
    ),
    "forgotten": (
        "with learning, not inherited",
        (
            "evolution.generations=80",
            "evolution.learning.learners=8",
            "evolution.learning.inherited=false",
        ),
    ),
}
_LEARNERS = 4
# Generations in a round of learning, the default of `learning.every`.
_ROUND = 5
RUNS = {name: Runs(_CONFIG, changes, _SEEDS) for name, (_, changes) in _ARMS.items()}
RUNS |= {name: Runs(_CONFIG, changes, _LEARNERS) for name, (_, changes) in _LEARNING.items()}
PART = Part("bodies and brains that evolve, beside those that do not", tuple(_ARMS), report)
LEARNING = Part("learning along gradients, after the same time", tuple(_LEARNING), report_learning)
