"""Reference traces of the physics: `make traces`.

A trace is the motion of one animal with fixed genes over the first half second of a trial. The file
`traces.json` holds the traces of all shipped configurations, and of a body with the parts that none
of them has. `tests/bench/test_traces.py` compares. `make traces` writes the file anew, and prints
the animals that moved.

Trials are computed in float64, without noise. Contact amplifies rounding, so every trace is
repeated with small changes of the initial state. `NUDGE` is about a million roundings, and must not
change a trace by more than `TOLERANCE`. Rounding therefore stays far below the tolerance.
"""

import dataclasses
import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from evo_cpg.io.build import build_experiment
from evo_cpg.io.load import load_config
from evo_cpg.io.schema.experiment import ExperimentConfig
from evo_cpg.physics.tree.state import State
from evo_cpg.simulation.judge import JUDGE
from evo_cpg.simulation.measures import Measures
from evo_cpg.simulation.noise import Noise, raw_keys
from evo_cpg.simulation.recording import Recorder
from evo_cpg.simulation.rollout import rollout
from evo_cpg.simulation.simulation import Simulation

ROOT = Path(__file__).parents[1]
FILE = Path(__file__).with_name("traces.json")
CONFIGS = (*sorted((ROOT / "configs").glob("*.yaml")), ROOT / "benchmarks/models/medley.yaml")

# Length of a trace, s, and the recorded fractions of it.
DURATION = 0.5
INSTANTS = (0.1, 0.25, 0.5, 1.0)

# Largest difference that counts as no change: m, rad, and relative for terms above 1.
TOLERANCE = 1e-7

# Changes of the initial position and joints (m, rad), and how often they are drawn.
NUDGE = 1e-10
NUDGES = 3

# Decimal places in the file.
_PLACES = 10

# Sections of a configuration that do not change the motion.
_WITHOUT_EFFECT = {"name", "seed", "runs", "noise", "measures", "evolution", "audit"}
_TRIALS_WITHOUT_EFFECT = {"seconds", "trials"}

Trace = dict[str, Any]


class Animal(NamedTuple):
    """Configurations with the same motion, of which the first is simulated."""

    names: tuple[str, ...]
    config: ExperimentConfig
    source: Path


def animals() -> list[Animal]:
    """Return all animals. Configurations that differ only in noise or search are one animal."""
    found: dict[str, Animal] = {}
    for source in CONFIGS:
        config = load_config(source)
        if config.evolution.body or config.evolution.type == "plans":
            # Another configuration has the same creature with a fixed body, or there is none.
            continue
        motion = config.model_dump(mode="json", exclude=_WITHOUT_EFFECT)
        for key in _TRIALS_WITHOUT_EFFECT:
            if not isinstance(motion["simulation"][key], list):
                del motion["simulation"][key]
        key = json.dumps(motion, sort_keys=True)
        before = found.get(key, Animal((), config, source))
        found[key] = before._replace(names=(*before.names, source.stem))
    return list(found.values())


def genes_of(simulation: Simulation) -> np.ndarray:
    """Return fixed genes. NumPy guarantees that the stream of `RandomState` never changes."""
    drawn = np.random.RandomState(0).uniform(-1.0, 1.0, simulation.genome.count)
    return (drawn > 0).astype(float) if simulation.genome.binary else drawn


def trace(animal: Animal, nudges: int = 0, engine: str = "auto") -> list[Trace]:
    """Return the trace of an animal, and those with nudged initial states."""
    config = animal.config.model_copy(update={"engine": engine})
    with jax.enable_x64(True):
        simulation = build_experiment(config, animal.source).simulation
        steps = round(DURATION * float(simulation.control_rate))
        simulation = dataclasses.replace(
            simulation, steps=steps, noise=Noise(), rules=None, measures=Measures()
        )
        count = nudges + 1
        genes = jnp.asarray(np.tile(genes_of(simulation)[:, None], count))
        random = np.random.RandomState(1)

        def begin(state: State) -> State:
            def nudged(x: jax.Array) -> jax.Array:
                change = NUDGE * random.choice([-1.0, 1.0], x.shape)
                change[..., 0] = 0.0
                return x + change

            # Rates stay zero: their sign decides which muscles of a resting joint are stretched.
            return dataclasses.replace(state, position=nudged(state.position), q=nudged(state.q))

        trial = jnp.zeros(count, jnp.int32)
        both = JUDGE, Recorder(count=None)
        keys = None
        if simulation.draws_course:
            # All individuals have the same course.
            keys = jnp.tile(raw_keys(jax.random.key(0))[:, None], count)
        run = jax.jit(lambda genes: rollout(simulation, genes, keys, trial, both, begin=begin))
        outcome, frames = jax.device_get(run(genes))
    instants = [max(round(part * steps), 1) - 1 for part in INSTANTS]
    dofs = simulation.world.tree.dof_names

    def one(k: int) -> Trace:
        angles = frames["joint_angle"][instants, :, k]
        return {
            "time": [float(i / simulation.control_rate) for i in instants],
            "root position": frames["position"][instants, :, 0, k],
            "root orientation": frames["rotation"][instants, :, :, 0, k],
            "joints": {name: angles[:, i] for i, name in enumerate(dofs)},
            "terms": {name: term[k] for name, term in outcome.terms.items()},
        }

    return [one(k) for k in range(count)]


def numbers(trace: Mapping[str, Any], path: str = "") -> dict[str, np.ndarray]:
    """Return the arrays of a trace by the names of their places."""
    found = {}
    for name, value in trace.items():
        place = f"{path}{name}"
        if isinstance(value, Mapping):
            found |= numbers(value, f"{place} ")
        else:
            found[place] = np.asarray(value, float)
    return found


def difference(found: Mapping[str, Any], stored: Mapping[str, Any]) -> tuple[float, str]:
    """Return the largest difference of two traces and its place. Other parts differ infinitely."""
    ours, theirs = numbers(found), numbers(stored)
    other = sorted(ours.keys() ^ theirs.keys()) + [
        name for name in ours.keys() & theirs.keys() if ours[name].shape != theirs[name].shape
    ]
    if other:
        return np.inf, other[0]
    sizes = {
        name: np.nan_to_num(
            np.abs(ours[name] - theirs[name]) / np.maximum(1.0, np.abs(theirs[name])), nan=np.inf
        ).max(initial=0.0)
        for name in ours
    }
    place = max(sizes, key=lambda name: sizes[name])
    return float(sizes[place]), place


def moved(found: Trace, stored: Trace) -> str | None:
    """Return a sentence about the changes of a trace, or None within the tolerance."""
    far, place = difference(found, stored)
    if far <= TOLERANCE:
        return None
    if far == np.inf:
        return f"another {place}"
    ours, theirs = numbers(found), numbers(stored)
    apart = [
        np.abs(ours[name] - theirs[name]).reshape(len(INSTANTS), -1).max(1)
        for name in ours
        if not name.startswith("terms")
    ]
    late = np.flatnonzero(np.max(apart, 0) > TOLERANCE)
    since = f", apart since {stored['time'][late[0]]:.3g} s" if late.size else ""
    return f"moved by up to {far:.1e} ({place}){since}"


def stored_traces() -> dict[str, Trace]:
    """Return the traces in the file by the animals' first names. Without a file there is none."""
    return json.loads(FILE.read_text(encoding="utf-8")) if FILE.is_file() else {}


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {name: _plain(each) for name, each in value.items()}
    return np.round(np.asarray(value, float), _PLACES).tolist()


def main() -> int:
    """Write the file, and print the animals that moved. Return 1 if rounding moves one."""
    before, made, unsteady = stored_traces(), {}, 0
    for animal in animals():
        name = animal.names[0]
        own, *nudged = trace(animal, NUDGES)
        rounding, place = max(difference(near, own) for near in nudged)
        made[name] = _plain(own)
        change = moved(made[name], before[name]) if name in before else "new"
        print(
            f"{', '.join(animal.names)}: {change or 'unchanged'}; nudged {rounding:.0e}", flush=True
        )
        if rounding > TOLERANCE:
            unsteady += 1
            print(f"  a nudge moves its {place} by more than {TOLERANCE:g}. Shorten the traces")
    for name in sorted(before.keys() - made.keys()):
        print(f"{name}: gone")
    lines = (f"{json.dumps(name)}: {json.dumps(each)}" for name, each in made.items())
    FILE.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")
    return int(unsteady > 0)


if __name__ == "__main__":
    sys.exit(main())
