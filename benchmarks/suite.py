"""The benchmark suite behind `evo-cpg bench`.

Ours and MuJoCo's (`mujoco.rollout`, as many threads as there are cores) swim the same chain of
ten boxes with the same step of 1/120 s, motors and commands: a travelling wave. Every contender
runs in turn, several times, in one process on the same cores; rates are individual physics steps
per second, ratios are medians over rounds, and compiling is timed apart.
"""

import dataclasses
import functools
import json
import os
import platform
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, PartitionSpec
from rich.console import Console
from rich.table import Table

from benchmarks.mujoco_model import mujoco_model
from benchmarks.timing import Contender, median_ratio, race
from evo_cpg.config.build import build_experiment
from evo_cpg.config.load import load_config
from evo_cpg.physics.state import resting_state
from evo_cpg.physics.step import step
from evo_cpg.physics.world import World
from evo_cpg.training.devices import (
    POPULATION_AXIS,
    fast_jit,
    population_mesh,
    use_cores,
)
from evo_cpg.training.experiment import (
    Experiment,
    breed,
    compile_trials,
    first_population,
    padding,
)

CONFIG = Path(__file__).parents[1] / "configs" / "iwadate2010_swimmer.yaml"
POPULATION = 200

# The travelling wave that both swimmers are told to follow: amplitude (rad/s), frequency (Hz) and
# lag from joint to joint (degrees) of the target rates about z.
WAVE_RATE, WAVE_FREQUENCY, WAVE_LAG = 2.0, 1.0, 36.0


def main(json_path: Path | None, quick: bool) -> None:
    """Run every case, print the table, and write the rows as JSON where asked."""
    cores = use_cores()
    console = Console()
    steps, repeats = (120, 3) if quick else (2000, 7)
    experiment = build_experiment(load_config(CONFIG), CONFIG)
    rows: list[dict[str, Any]] = []
    with console.status("compiling") as status:
        for name, measure in (
            ("swimmer against MuJoCo", lambda: swimmer_cases(experiment, cores, steps, repeats)),
            ("two cores against one", lambda: scaling(experiment, cores, steps, repeats)),
            ("compile time", lambda: compile_time(experiment)),
        ):
            status.update(name)
            rows += measure()
    console.print(_table(rows, cores))
    if json_path is not None:
        json_path.write_text(json.dumps({"machine": _machine(cores), "rows": rows}, indent=1))
        console.print(str(json_path), highlight=False)


def swimmer_cases(
    experiment: Experiment, cores: int, steps: int, repeats: int
) -> list[dict[str, Any]]:
    """Physics alone and the whole stack against MuJoCo with its fluid models."""
    h = experiment.simulation.step_length
    trial_steps = steps // experiment.simulation.substeps
    simulation = dataclasses.replace(experiment.simulation, steps=trial_steps)
    mesh = population_mesh()
    genes = np.asarray(fast_jit(lambda: first_population(experiment))())
    whole = compile_trials(simulation, mesh)
    contenders = [
        Contender("ours, physics", POPULATION * steps, wave_swim(experiment, mesh, steps)),
        Contender(
            "ours, whole stack",
            POPULATION * trial_steps * experiment.simulation.substeps,
            lambda: whole(genes),
        ),
    ]
    peers = {
        "MuJoCo, ellipsoids": {"density": 1000.0, "fluid": 'fluidshape="ellipsoid"'},
        "MuJoCo, inertia box": {"density": 1000.0, "fluid": ""},
        "MuJoCo, no fluid": {"density": 0.0, "fluid": ""},
    }
    peer_steps = max(steps // 8, 10)
    for name, options in peers.items():
        call = mujoco_swim(experiment, options, cores, peer_steps)
        contenders.append(Contender(name, POPULATION * peer_steps, call))
    rates = race(contenders, repeats)
    how = (
        f"individual steps/s, h = 1/{round(1 / h)} s, {cores} cores each, median of {repeats} "
        f"rounds in turn; ours float32 over {steps} steps, MuJoCo float64, implicitfast, "
        f"mujoco.rollout with {cores} threads over {peer_steps} steps"
    )
    return [
        _row(case, rates, ours, peer, how)
        for case, ours in (
            ("swimmer, physics", "ours, physics"),
            ("swimmer, whole stack", "ours, whole stack"),
        )
        for peer in peers
    ]


def scaling(experiment: Experiment, cores: int, steps: int, repeats: int) -> list[dict[str, Any]]:
    """The same work on all cores and on one."""
    names = f"{cores} cores", "1 core"
    rates = race(
        [
            Contender(name, POPULATION * steps, wave_swim(experiment, population_mesh(n), steps))
            for name, n in zip(names, (cores, 1), strict=True)
        ],
        repeats,
    )
    how = f"individual physics steps/s of the swimmer, median of {repeats} rounds in turn"
    return [_row(f"{cores} cores", rates, *names, how)]


def compile_time(experiment: Experiment) -> list[dict[str, Any]]:
    """Cold compilation of one whole generation."""
    # The scan over the trial's steps is compiled once, however many there are.
    simulation = dataclasses.replace(experiment.simulation, steps=1)
    genes = np.asarray(fast_jit(lambda: first_population(experiment))())
    scales = {"energy": np.ones(1, np.float32)}
    start = time.perf_counter()
    outcome = compile_trials(simulation, population_mesh())(genes)
    breeding = fast_jit(functools.partial(breed, experiment))
    jax.block_until_ready(breeding(genes, outcome, np.int32(0), scales))
    seconds = time.perf_counter() - start
    return [
        {
            "case": "compile, cold",
            "population": POPULATION,
            "ours": seconds,
            "unit": "s",
            "peer": None,
            "peer_rate": None,
            "ratio": None,
            "how": "trace, compile and run a generation with trials of one step, no cache",
        }
    ]


def wave_swim(experiment: Experiment, mesh: Mesh, steps: int) -> Callable[[], object]:
    """Our population following the travelling wave: physics with fluid, no brain."""
    world = experiment.simulation.world
    h = experiment.simulation.step_length
    commands = jnp.asarray(wave_commands(world, steps, h), jnp.float32)
    spec = PartitionSpec(None, POPULATION_AXIS)

    def swim(offsets):
        state = resting_state(world.tree, offsets.shape[1:])

        def advance(state, command):
            state, _ = step(world, state, command[:, None] * offsets, h)
            return state, None

        return jax.lax.scan(advance, state, commands)[0].position

    sharded = fast_jit(
        jax.shard_map(swim, mesh=mesh, in_specs=spec, out_specs=spec, check_vma=False)
    )
    # Amplitudes differ a little, so that no two individuals do the same. Empty lanes are computed
    # as in training, but not counted.
    lanes = POPULATION + padding(POPULATION, mesh)
    offsets = jnp.linspace(0.9, 1.1, lanes, dtype=jnp.float32)[None]
    return lambda: jax.block_until_ready(sharded(offsets))


def mujoco_swim(
    experiment: Experiment, options: dict[str, Any], cores: int, steps: int
) -> Callable[[], object]:
    """MuJoCo's population following the same wave with the same motors."""
    import mujoco
    from mujoco import rollout

    world = experiment.simulation.world
    h = experiment.simulation.step_length
    model = mujoco_model(
        experiment.creature,
        # Neutrally buoyant, which MuJoCo has no force for: gravity is left out.
        options={
            "timestep": h,
            "integrator": "implicitfast",
            "density": options["density"],
            "gravity": "0 0 0",
        },
        fluid=options["fluid"],
        motors=True,
    )
    data = [mujoco.MjData(model) for _ in range(cores)]
    start = np.zeros(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS))
    mujoco.mj_getState(model, data[0], start, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    states = np.tile(start, (POPULATION, 1))
    scale = np.linspace(0.9, 1.1, POPULATION)[:, None, None]
    commands = wave_commands(world, steps, h)[None] * scale
    return lambda: rollout.rollout(model, data, states, commands)


def wave_commands(world: World, steps: int, h: float) -> np.ndarray:
    """Target rates ``(steps, d)`` of the travelling wave, rad/s."""
    tree = world.tree
    joint = np.array(tree.dof_bodies) - 1
    bends = np.array([name.endswith(".z") for name in tree.dof_names])
    phase = 2 * np.pi * WAVE_FREQUENCY * h * np.arange(steps)[:, None]
    return WAVE_RATE * bends * np.cos(phase - np.deg2rad(WAVE_LAG) * joint)


def _row(
    case: str, rates: dict[str, list[float]], ours: str, peer: str, how: str
) -> dict[str, Any]:
    return {
        "case": case,
        "population": POPULATION,
        "ours": statistics.median(rates[ours]),
        "unit": "steps/s",
        "peer": peer,
        "peer_rate": statistics.median(rates[peer]),
        "ratio": median_ratio(rates, ours, peer),
        "how": how,
    }


def _table(rows: list[dict[str, Any]], cores: int) -> Table:
    table = Table(
        title=f"{POPULATION} individuals, {cores} cores of {_machine(cores)['processor']}",
        caption="k/s: thousand individual physics steps per second",
    )
    for column in ("case", "ours", "beside", "theirs", "ratio"):
        left = column in ("case", "beside")
        table.add_column(column, justify="left" if left else "right", no_wrap=True)
    for row in rows:
        timed = row["unit"] == "s"
        ours = f"{row['ours']:.1f} s" if timed else f"{row['ours'] / 1e3:,.0f} k/s"
        theirs = f"{row['peer_rate'] / 1e3:,.0f} k/s" if row["peer_rate"] else ""
        ratio = f"{row['ratio']:.2f}x" if row["ratio"] else ""
        table.add_row(row["case"], ours, row["peer"] or "", theirs, ratio)
    return table


def _machine(cores: int) -> dict[str, Any]:
    processor = platform.processor() or platform.machine()
    if os.path.exists("/proc/cpuinfo"):
        with open("/proc/cpuinfo", encoding="utf-8") as file:
            names = [
                line.split(":", 1)[1].strip() for line in file if line.startswith("model name")
            ]
        processor = names[0] if names else processor
    return {"processor": processor, "cores": cores, "jax": jax.__version__}
