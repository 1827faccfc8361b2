"""The moving animals, by the name of their case."""

import functools
from collections.abc import Callable

from benchmarks.exercise import Postures, Torques, Wave
from benchmarks.jax_peers import GROUNDED, WET
from benchmarks.moving import Animal
from benchmarks.plan import MODELS, experiment_of

# Scalar additions, multiplications, divisions, roots and comparisons in the equations of one
# physics step of the ten-body swimmer. They were counted once on its scalar program, after
# constants were folded and products with zero dropped. The number is fixed, so that a program with
# fewer operations does not get a lower rate.
SWIMMER_FLOPS = 13_944

_MANY = (1, 15, 64, 1024, 4096)


def swimmer() -> Animal:
    """Return the swimmer: ten boxes in water."""
    return Animal(
        "swimmer",
        Wave(experiment_of("iwadate2010_swimmer")),
        (200, *_MANY),
        WET,
        SWIMMER_FLOPS,
        (200, 4096),
    )


def salamander_water() -> Animal:
    """Return the salamander in water: sixteen ellipsoids and capsules."""
    exercise = Wave(experiment_of("iwadate2010_salamander_water"))
    return Animal("salamander-water", exercise, (200,))


def salamander_land() -> Animal:
    """Return the salamander on hills, which are a height field in MuJoCo."""
    exercise = Wave(experiment_of("iwadate2010_salamander_land"))
    return Animal("salamander-land", exercise, (200,))


def quadruped() -> Animal:
    """Return the quadruped: nine boxes on flat ground."""
    return Animal(
        "quadruped",
        Postures(experiment_of("fukui2003_model1")),
        (120, 1, 15, 64, 200, 1024, 4096),
        GROUNDED,
        memory_sizes=(200, 4096),
    )


def imported(name: str) -> Animal:
    """Return an animal of gymnasium on flat ground, as `evo-cpg import` reads its file."""
    return Animal(name, Torques.of(MODELS / f"{name}.xml"), (200, 1, 15))


IMPORTED = ("half_cheetah", "ant", "humanoid")

ANIMALS: dict[str, Callable[[], Animal]] = {
    "swimmer": swimmer,
    "salamander-water": salamander_water,
    "salamander-land": salamander_land,
    "quadruped": quadruped,
    **{name: functools.partial(imported, name) for name in IMPORTED},
}
