"""Speed of a population of different bodies, relative to a population with one shared body.

Short trials of the whole stack run on one core. The numbers in `_DRAWN` are random: sizes,
densities, places of joints, constants of motors and drag. Each is within a tenth of the
configuration's value.
"""

import dataclasses
import functools
import statistics
from collections.abc import Iterator

import jax
import numpy as np

from benchmarks.moving import UNIT
from benchmarks.plan import CONFIGS, Plan, random_genes
from benchmarks.rows import Row
from benchmarks.timing import Contender, race, ratio_quartiles, seconds
from evo_cpg.io.batched import build_batch
from evo_cpg.io.load import load_config
from evo_cpg.io.numbers import number_at
from evo_cpg.simulation.batched import BatchedSimulation
from evo_cpg.simulation.rollout import rollout

_SIZE = 200
_STEPS = 120
# Number of different creatures. Building one takes a tenth of a second. The individuals of the
# population use these creatures in turn.
_BUILT = 25
_DRAWN = {
    "iwadate2010_swimmer": (
        "creature.materials.body.density",
        "creature.bodies.0.shape.size.0",
        "creature.bodies.1.shape.size.0",
        "creature.bodies.1.shape.size.1",
        "creature.bodies.1.shape.size.2",
        "creature.bodies.1.joint.actuator.gain",
        "world.water.form_drag",
    ),
    "fukui2003_model1": (
        "creature.materials.torso.density",
        "creature.materials.leg.density",
        "creature.bodies.0.shape.size.0",
        "creature.bodies.1.shape.size.2",
        "creature.bodies.1.joint.at.0",
        "creature.bodies.1.joint.actuator.stiffness",
    ),
}


def measure(plan: Plan) -> Iterator[Row]:
    """Yield a row per config and size, with the speed relative to one shared body."""
    for name in list(_DRAWN)[: 1 if plan.quick else None]:
        for size in plan.sizes_or(_SIZE):
            yield _measure(name, size, plan)


def _measure(name: str, size: int, plan: Plan) -> Row:
    plan.say(f"bodies: building {_BUILT} of {name}")
    batched = _population(name, size, short=plan.quick)
    common = dataclasses.replace(batched.common, steps=_STEPS)
    genes = random_genes(common, size)
    work = size * _STEPS * common.substeps
    values = [np.asarray(value, np.float32) for value in batched.values]
    each = jax.jit(
        lambda values, genes: rollout(BatchedSimulation(common, batched.inputs, values), genes)
    )
    alike = jax.jit(functools.partial(rollout, common))
    contenders, compiling = [], {}
    for kind, live in (
        ("each", functools.partial(each, values, genes)),
        ("alike", functools.partial(alike, genes)),
    ):
        plan.say(f"bodies: compiling {name}, {kind}")
        call = functools.partial(_finished, live)
        compiling[kind] = seconds(call)
        contenders.append(Contender(kind, work, call))
    plan.say(f"bodies: {name}")
    rates = race(contenders, plan.repeats)
    low, ratio, high = ratio_quartiles(rates, "each", "alike")
    return Row(
        "bodies",
        name,
        size,
        statistics.median(rates["each"]),
        UNIT,
        f"trials of {_STEPS} control steps on one core, median of {plan.repeats} rounds in turn",
        compiling["each"],
        peer=f"one body for all, compiled in {compiling['alike']:.0f} s",
        peer_rate=statistics.median(rates["alike"]),
        ratio=ratio,
        ratio_spread=(low, high),
    )


def _population(name: str, size: int, short: bool) -> BatchedSimulation:
    """Return a simulation whose individuals use the random bodies in turn.

    Args:
        name: name of the config.
        size: number of individuals.
        short: whether to build few bodies, of a short swimmer.
    """
    path, rng = CONFIGS / f"{name}.yaml", np.random.default_rng(0)
    config = load_config(path, ["creature.bodies.1.repeat=2"] if short else [])
    built = 3 if short else _BUILT
    drawn = {key: number_at(config, key) * rng.uniform(0.9, 1.1, built) for key in _DRAWN[name]}
    batched = build_batch(config, path, drawn)
    turns = np.arange(size) % built
    return batched._replace(values=tuple(value[:, turns] for value in batched.values))


def _finished(live: functools.partial) -> None:
    jax.block_until_ready(live())
