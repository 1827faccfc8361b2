"""Study of the program's speed: a part for each case of `python -m benchmarks`, without runs."""

from functools import partial

from evo_cpg.studies.study import Part, Study, Table
from evo_cpg.studies.workshop import Workshop

# Cases that simulate an animal. Their rates are also drawn as a picture.
_MOVING = (
    "swimmer",
    "salamander-water",
    "salamander-land",
    "quadruped",
    "half_cheetah",
    "ant",
    "humanoid",
)


def measure(workshop: Workshop, case: str) -> list[Table]:
    """Measure a case and return its tables."""
    # Peers such as MuJoCo are packages that a list of the studies does not need.
    from benchmarks import suite

    request = suite.Selection((case,), quick=workshop.quick)
    machine, rows = suite.measure(request, workshop.devices, workshop.work)
    if case in _MOVING:
        suite.picture.draw(rows, machine, workshop.picture())
    return suite.report.page_tables(rows, machine)


_TITLES = {
    "swimmer": "chain of ten boxes in water, compared with MuJoCo, MJX and Brax",
    "salamander-water": "sixteen ellipsoids and capsules in water, compared with MuJoCo",
    "salamander-land": "sixteen ellipsoids and capsules on hills, compared with MuJoCo",
    "quadruped": "nine boxes on flat ground, compared with MuJoCo, MJX and Brax",
    "half_cheetah": "gymnasium's half_cheetah, imported, compared with MuJoCo",
    "ant": "gymnasium's ant, imported, compared with MuJoCo",
    "humanoid": "gymnasium's humanoid, imported, compared with MuJoCo",
    "cpg": "oscillators of the swimmer",
    "brain": "neural network of the swimmer",
    "ga": "step of the genetic algorithm, compared with evosax",
    "generation": "whole generation of the swimmer",
    "gradient": "fitness and its gradient, compared with fitness alone",
    "bodies": "individual bodies, compared with one body for all",
    "loop": "Python loop over steps of the half cheetah, compared with gymnasium",
    "large-creatures": "walkers and chains of up to 60 bodies: compile time, memory, run time",
    "engines": "native code for every shipped configuration, compared with plain JAX",
    "scaling": "all cores, compared with one core and with processes",
    "startup": "time from the prompt to the end of generation 0",
}

STUDY = Study(
    "benchmarks",
    "Speed of the program",
    {},
    {case: Part(title, (), partial(measure, case=case)) for case, title in _TITLES.items()},
)
