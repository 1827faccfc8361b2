"""MJX and Brax at our exercises, each in a process of its own, on the CPU.

Both run a population as in their own examples: `jit(vmap(scan(step)))`, with XLA's threads on all
cores. They load the MuJoCo model of the animal. Run as a program, this module is the worker:
`python -m benchmarks.jax_peers PEER MODEL.mjb SIGNALS.npy`.

A scan covers few steps, whose commands are repeated for the length of a call. So the compile time
does not depend on that length.
"""

import contextlib
import functools
import importlib
import importlib.util
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np

from benchmarks.exercise import Exercise
from benchmarks.mujoco_peer import DRY, Kind, Motion, peer_model
from benchmarks.plan import Plan
from benchmarks.timing import Contender, seconds
from benchmarks.worker import Worker, WorkerError, serve, started

# Number of steps in one scan.
STEPS = 10
# Longest wait for each of a peer's first answers, s. A slower peer would delay every round.
_PATIENCE = 20.0


class JaxPeer(NamedTuple):
    """A peer written in JAX.

    Attributes:
        name: name in the table.
        program: "mjx" or "brax".
        kind: kind of fluid.
        integrator: integrator of the peer for this fluid.
    """

    name: str
    program: str
    kind: Kind
    integrator: str


class Entry(NamedTuple):
    """A peer, with its contender if it takes part.

    Attributes:
        peer: the peer.
        contender: contender in the race, or None if the peer cannot take part.
        compile_seconds: time to import, load the model and compile, s. None without a contender.
        note: reason why the peer cannot take part, or a remark on its motion.
    """

    peer: JaxPeer
    contender: Contender | None
    compile_seconds: float | None
    note: str | None


# MJX has no implicitfast with a fluid, and Brax has only Euler.
WET = (
    JaxPeer("MJX, inertia box", "mjx", Kind("", ""), "Euler"),
    JaxPeer("Brax, inertia box", "brax", Kind("", ""), "Euler"),
    JaxPeer("Brax, no fluid", "brax", Kind("", dense=False), "Euler"),
)
GROUNDED = (JaxPeer("MJX", "mjx", DRY[0], "implicitfast"), JaxPeer("Brax", "brax", DRY[0], "Euler"))
_MODULES = {"mjx": "mujoco.mjx", "brax": "brax"}


@contextlib.contextmanager
def entered(
    peers: tuple[JaxPeer, ...], exercise: Exercise, size: int, plan: Plan
) -> Iterator[list[Entry]]:
    """Yield the peers, compiled and ready to race inside the block.

    Args:
        peers: requested peers.
        exercise: exercise of the animals.
        size: number of individuals.
        plan: length of a call, and longest compile time.
    """
    with contextlib.ExitStack() as stack:
        yield [_enter(stack, peer, exercise, size, plan) for peer in peers]


def _enter(
    stack: contextlib.ExitStack, peer: JaxPeer, exercise: Exercise, size: int, plan: Plan
) -> Entry:
    if importlib.util.find_spec(_MODULES[peer.program]) is None:
        return Entry(peer, None, None, "not installed")
    plan.say(f"{peer.name}, {size} individuals, up to {plan.limit:g} s")
    folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
    model, signals = folder / "model.mjb", folder / "signals.npy"
    mujoco.mj_saveModel(peer_model(exercise, peer.kind, integrator=peer.integrator), str(model))
    np.save(signals, Motion(exercise, peer.kind, exercise.lanes(size), 1).signals(STEPS))
    worker = stack.enter_context(started("jax_peers", peer.program, str(model), str(signals)))
    try:
        compiled = worker.answer(plan.limit)["prepared"]
        repeats = _repeats(worker, plan)
        moved = worker.ask(repeats, _PATIENCE)
    except WorkerError as error:
        worker.stop()
        return Entry(peer, None, None, str(error))
    # The first call was in time. A longer later call must not lose all rows.
    work = functools.partial(worker.ask, repeats, plan.limit)
    contender = Contender(peer.name, size * STEPS * repeats, work)
    lost = size - moved["finite"]
    return Entry(peer, contender, compiled, f"{lost} of {size} diverged" if lost else None)


def _repeats(worker: Worker, plan: Plan) -> int:
    """Return the number of scans that take about the intended time of a call."""
    return max(round(plan.call_seconds / seconds(lambda: worker.ask(1, _PATIENCE))), 1)


def _prepare(program: str, model: mujoco.MjModel, signals: np.ndarray) -> Any:
    """Compile a peer.

    Returns:
        An empty report, and a function that runs a number of scans, one after the other. The
        function returns the number of individuals whose final place is finite.
    """
    import jax

    start, step = {"mjx": _mjx, "brax": _brax}[program](model)

    def one(state: Any, signals: jax.Array) -> Any:
        return jax.lax.scan(lambda state, u: (step(state, u), None), state, signals)[0]

    many = jax.jit(jax.vmap(one))
    first = jax.tree.map(lambda x: np.repeat(np.asarray(x)[None], len(signals), axis=0), start)
    signals_in = signals.astype(np.float32)
    compiled = many.lower(first, signals_in).compile()

    def work(repeats: int) -> dict[str, Any]:
        state = first
        for _ in range(repeats):
            state = compiled(state, signals_in)
        place = np.asarray(jax.block_until_ready(state).qpos if program == "mjx" else state.q)
        return {"finite": int(np.isfinite(place).all(-1).sum())}

    return {}, work


def _mjx(model: mujoco.MjModel) -> tuple[Any, Callable[[Any, Any], Any]]:
    from mujoco import mjx

    moved = mjx.put_model(model)
    return mjx.make_data(moved), lambda data, u: mjx.step(moved, data.replace(ctrl=u))


def _brax(model: mujoco.MjModel) -> tuple[Any, Callable[[Any, Any], Any]]:
    import jax.numpy as jnp

    pipeline: Any = importlib.import_module("brax.generalized.pipeline")
    system = importlib.import_module("brax.io.mjcf").load_model(model)
    start = pipeline.init(system, system.init_q, jnp.zeros(system.qd_size()))
    return start, lambda state, u: pipeline.step(system, state, u)


if __name__ == "__main__":
    _program, _model, _signals = sys.argv[1:]
    serve(lambda: _prepare(_program, mujoco.MjModel.from_binary_path(_model), np.load(_signals)))
