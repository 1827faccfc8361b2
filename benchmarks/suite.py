"""The benchmark suite behind `evo-cpg bench`.

Ours and MuJoCo's (`mujoco.rollout`, as many threads as there are cores) move the same animal with
the same step, motors and commands: a chain of ten boxes and a salamander of sixteen ellipsoids and
capsules that swim with a travelling wave (1/120 s), and a quadruped that takes random postures in
turn on the ground (1/240 s). Every contender runs in
turn, several times, in one process on the same cores; rates are individual physics steps per
second, ratios are medians over rounds, and compiling is timed apart.
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
import mujoco
import numpy as np
from jax import Array
from jax.sharding import Mesh, PartitionSpec
from mujoco import rollout
from rich.console import Console
from rich.table import Table

from benchmarks.mujoco_model import motor_order, mujoco_model
from benchmarks.timing import Contender, median_ratio, race
from evo_cpg.config.build import build_experiment
from evo_cpg.config.load import load_config
from evo_cpg.physics.state import resting_state
from evo_cpg.physics.step import step
from evo_cpg.physics.world import World
from evo_cpg.simulation.rollout import Simulation
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

CONFIGS = Path(__file__).parents[1] / "configs"
SWIMMERS = 200

# The travelling wave that all swimmers are told to follow: amplitude (rad/s), frequency (Hz) and
# lag from joint to joint (degrees) of the target rates about z.
WAVE_RATE, WAVE_FREQUENCY, WAVE_LAG = 2.0, 1.0, 36.0


def main(json_path: Path | None, quick: bool) -> None:
    """Run every case, print the table, and write the rows as JSON where asked."""
    cores = use_cores()
    console = Console()
    steps, repeats = (120, 3) if quick else (2000, 7)
    swimmer, salamander, quadruped = (
        build_experiment(load_config(path), path)
        for path in (
            CONFIGS / "iwadate2010_swimmer.yaml",
            CONFIGS / "iwadate2010_salamander_water.yaml",
            CONFIGS / "fukui2003_model1.yaml",
        )
    )
    rows: list[dict[str, Any]] = []
    with console.status("compiling") as status:
        for name, measure in (
            (
                "swimmer against MuJoCo",
                lambda: swimming_cases("swimmer", swimmer, cores, steps, repeats),
            ),
            (
                "salamander against MuJoCo",
                lambda: swimming_cases("salamander in water", salamander, cores, steps, repeats),
            ),
            (
                "quadruped against MuJoCo",
                lambda: quadruped_cases(quadruped, cores, steps, repeats),
            ),
            ("two cores against one", lambda: scaling(swimmer, cores, steps, repeats)),
            ("compile time", lambda: compile_time(swimmer)),
        ):
            status.update(name)
            rows += measure()
    console.print(_table(rows, cores))
    if json_path is not None:
        json_path.write_text(json.dumps({"machine": _machine(cores), "rows": rows}, indent=1))
        console.print(str(json_path), highlight=False)


def swimming_cases(
    animal: str, experiment: Experiment, cores: int, steps: int, repeats: int
) -> list[dict[str, Any]]:
    """Physics alone and the whole stack against MuJoCo with its fluid models."""
    h = experiment.simulation.step_length
    trial_steps = steps // experiment.simulation.substeps
    simulation = dataclasses.replace(experiment.simulation, steps=trial_steps)
    mesh = population_mesh()
    genes = np.asarray(fast_jit(lambda: first_population(experiment))())
    whole = compile_trials(simulation, mesh)
    contenders = [
        Contender("ours, physics", SWIMMERS * steps, wave_swim(experiment, mesh, steps)),
        Contender(
            "ours, whole stack",
            SWIMMERS * trial_steps * experiment.simulation.substeps,
            lambda: whole(genes),
        ),
    ]
    water = simulation.world.water
    assert water is not None
    peers = {
        "MuJoCo, ellipsoids": {"density": water.density, "fluid": "ellipsoid"},
        "MuJoCo, inertia box": {"density": water.density, "fluid": ""},
        "MuJoCo, no fluid": {"density": 0.0, "fluid": ""},
    }
    peer_steps = max(steps // 8, 10)
    for name, options in peers.items():
        call = mujoco_swim(experiment, options, cores, peer_steps)
        contenders.append(Contender(name, SWIMMERS * peer_steps, call))
    rates = race(contenders, repeats)
    how = (
        f"individual steps/s, h = 1/{round(1 / h)} s, {cores} cores each, median of {repeats} "
        f"rounds in turn; ours float32 over {steps} steps, MuJoCo float64, implicitfast, "
        f"mujoco.rollout with {cores} threads over {peer_steps} steps"
    )
    return [
        _row(case, SWIMMERS, rates, ours, peer, how)
        for case, ours in (
            (f"{animal}, physics", "ours, physics"),
            (f"{animal}, whole stack", "ours, whole stack"),
        )
        for peer in peers
    ]


def quadruped_cases(
    experiment: Experiment, cores: int, steps: int, repeats: int
) -> list[dict[str, Any]]:
    """Physics alone and the whole stack on the ground against MuJoCo."""
    simulation, mesh = experiment.simulation, population_mesh()
    genes = np.asarray(fast_jit(lambda: first_population(experiment))())
    population = genes.shape[1]
    trial_steps = steps // simulation.substeps
    whole = compile_trials(dataclasses.replace(simulation, steps=trial_steps), mesh)
    physics = posture_walk(simulation, mesh, genes, steps)
    theirs = mujoco_walk(experiment, genes, cores, steps)
    rates = race(
        [
            Contender("ours, physics", population * steps, physics),
            Contender(
                "ours, whole stack",
                population * trial_steps * simulation.substeps,
                lambda: whole(genes),
            ),
            Contender("MuJoCo", population * steps, theirs),
        ],
        repeats,
    )
    peer_lost = int(stopped(theirs(), steps * simulation.step_length).sum())

    def how(lost: int) -> str:
        return (
            f"individual steps/s, h = 1/{round(1 / simulation.step_length)} s, {cores} cores each, "
            f"{steps} steps a call, median of {repeats} rounds in turn; ours float32, MuJoCo "
            f"float64, implicitfast, mujoco.rollout with {cores} threads; of {population} "
            f"individuals diverged {lost} of ours and {peer_lost} of MuJoCo's"
        )

    lost = int((~np.isfinite(physics())).any(0).sum()), int((~whole(genes).alive).sum())
    return [
        _row(f"quadruped, {part}", population, rates, f"ours, {part}", "MuJoCo", how(count))
        for part, count in zip(("physics", "whole stack"), lost, strict=True)
    ]


def scaling(experiment: Experiment, cores: int, steps: int, repeats: int) -> list[dict[str, Any]]:
    """The same work on all cores and on one."""
    names = f"{cores} cores", "1 core"
    rates = race(
        [
            Contender(name, SWIMMERS * steps, wave_swim(experiment, population_mesh(n), steps))
            for name, n in zip(names, (cores, 1), strict=True)
        ],
        repeats,
    )
    how = f"individual physics steps/s of the swimmer, median of {repeats} rounds in turn"
    return [_row(f"{cores} cores", SWIMMERS, rates, *names, how)]


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
            "population": SWIMMERS,
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

    def swim(offsets):
        state = resting_state(world.tree, offsets.shape[1:])

        def advance(state, command):
            state, _ = step(world, state, command[:, None] * offsets, h)
            return state, None

        return jax.lax.scan(advance, state, commands)[0].position

    sharded = _on_all_cores(swim, mesh)
    # Amplitudes differ a little, so that no two individuals do the same. Empty lanes are computed
    # as in training, but not counted.
    lanes = SWIMMERS + padding(SWIMMERS, mesh)
    offsets = jnp.linspace(0.9, 1.1, lanes, dtype=jnp.float32)[None]
    return lambda: jax.block_until_ready(sharded(offsets))


def mujoco_swim(
    experiment: Experiment, options: dict[str, Any], cores: int, steps: int
) -> Callable[[], object]:
    """MuJoCo's population following the same wave with the same motors."""
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
    scale = np.linspace(0.9, 1.1, SWIMMERS)[:, None, None]
    commands = wave_commands(world, steps, h)[None] * scale
    return _mujoco_rollout(model, commands[..., motor_order(model, world.tree)], cores)


def posture_walk(
    simulation: Simulation, mesh: Mesh, genes: np.ndarray, steps: int
) -> Callable[[], np.ndarray]:
    """Our population taking its postures on the ground: physics alone, with the angles given.

    The call returns the positions ``(3, n)`` at the end, m.
    """
    world, h = simulation.world, simulation.step_length
    postures = posture_numbers(simulation, steps)

    def walk(genes):
        angles = simulation.controller.decode(genes)
        still = jnp.zeros_like(angles[0])
        place = simulation.situations[0].start_position
        state = resting_state(world.tree, genes.shape[1:], position=place)

        def advance(state, posture):
            state, _ = step(world, state, still, h, angles[posture])
            return state, None

        return jax.lax.scan(advance, state, postures)[0].position

    sharded = _on_all_cores(walk, mesh)
    population = genes.shape[1]
    lanes = np.pad(genes, ((0, 0), (0, padding(population, mesh))), mode="edge")
    return lambda: np.asarray(sharded(lanes))[:, :population]


def mujoco_walk(
    experiment: Experiment, genes: np.ndarray, cores: int, steps: int
) -> Callable[[], np.ndarray]:
    """MuJoCo's population taking the same postures with the same motors on the same ground.

    Its contacts have no restitution. The call returns the states ``(n, steps, ...)``.
    """
    simulation = experiment.simulation
    world = simulation.world
    model = mujoco_model(
        experiment.creature,
        options={
            "timestep": simulation.step_length,
            "integrator": "implicitfast",
            "gravity": f"0 0 {-world.gravity}",
        },
        motors=True,
        limits=True,
        ground=world.ground,
        start=simulation.situations[0].start_position,
    )
    angles = np.asarray(simulation.controller.decode(jnp.asarray(genes)), float)
    angles = np.moveaxis(angles, -1, 0)[..., motor_order(model, world.tree)]
    return _mujoco_rollout(model, angles[:, posture_numbers(simulation, steps)], cores)


def posture_numbers(simulation: Simulation, steps: int) -> np.ndarray:
    """Which posture is held in every physics step."""
    return np.asarray(simulation.controller.posture(jnp.arange(steps) // simulation.substeps))


def stopped(states: np.ndarray, seconds: float) -> np.ndarray:
    """Which of MuJoCo's individuals diverged.

    `mujoco.rollout` gives up one that does: it resets it, time included, and repeats that state
    to the end.
    """
    last = states[:, -1]
    return ~(np.isfinite(last).all(-1) & np.isclose(last[:, 0], seconds))


def wave_commands(world: World, steps: int, h: float) -> np.ndarray:
    """Target rates ``(steps, d)`` of the travelling wave, rad/s."""
    tree = world.tree
    depth = [0]
    for parent in tree.parents[1:]:
        depth.append(depth[parent] + 1)
    joint = np.array([depth[body] for body in tree.dof_bodies]) - 1
    bends = np.array([name.endswith(".z") for name in tree.dof_names])
    phase = 2 * np.pi * WAVE_FREQUENCY * h * np.arange(steps)[:, None]
    return WAVE_RATE * bends * np.cos(phase - np.deg2rad(WAVE_LAG) * joint)


def _on_all_cores(function: Callable[[Array], Array], mesh: Mesh) -> Callable[..., Array]:
    """Compiled and sharded over the last of two axes, the individuals."""
    spec = PartitionSpec(None, POPULATION_AXIS)
    return fast_jit(
        jax.shard_map(function, mesh=mesh, in_specs=spec, out_specs=spec, check_vma=False)
    )


def _mujoco_rollout(
    model: mujoco.MjModel, commands: np.ndarray, cores: int
) -> Callable[[], np.ndarray]:
    """All individuals from the model's pose, with commands ``(n, steps, motors)``."""
    data = [mujoco.MjData(model) for _ in range(cores)]
    start = np.zeros(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS))
    mujoco.mj_getState(model, data[0], start, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    states = np.tile(start, (len(commands), 1))
    return lambda: np.asarray(rollout.rollout(model, data, states, commands)[0])


def _row(
    case: str, population: int, rates: dict[str, list[float]], ours: str, peer: str, how: str
) -> dict[str, Any]:
    return {
        "case": case,
        "population": population,
        "ours": statistics.median(rates[ours]),
        "unit": "steps/s",
        "peer": peer,
        "peer_rate": statistics.median(rates[peer]),
        "ratio": median_ratio(rates, ours, peer),
        "how": how,
    }


def _table(rows: list[dict[str, Any]], cores: int) -> Table:
    table = Table(
        title=f"{cores} cores of {_machine(cores)['processor']}",
        caption="n: individuals; k/s: thousand individual physics steps per second",
    )
    for column in ("case", "n", "ours", "beside", "theirs", "ratio"):
        left = column in ("case", "beside")
        table.add_column(column, justify="left" if left else "right", no_wrap=True)
    for row in rows:
        timed = row["unit"] == "s"
        ours = f"{row['ours']:.1f} s" if timed else f"{row['ours'] / 1e3:,.0f} k/s"
        theirs = f"{row['peer_rate'] / 1e3:,.0f} k/s" if row["peer_rate"] else ""
        ratio = f"{row['ratio']:.2f}x" if row["ratio"] else ""
        table.add_row(row["case"], str(row["population"]), ours, row["peer"] or "", theirs, ratio)
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
