"""Populations in chunks: widths, equal results and bounded memory."""

import dataclasses

import jax
import numpy as np
import pytest

from evo_cpg.native import machine_constants
from evo_cpg.native.machine_constants import LANES
from evo_cpg.simulation.judge import JUDGE
from evo_cpg.simulation.noise import Noise
from evo_cpg.simulation.recording import Recorder
from evo_cpg.training import evaluate as training_evaluate
from evo_cpg.training import train as evolution
from evo_cpg.training.devices import (
    Layout,
    chunk_width,
    layout,
    population_mesh,
    run_in_blocks,
    sharded,
)
from evo_cpg.training.evaluate import compile_trials
from evo_cpg.training.experiment import begin, generation_keys
from trials import experiment, folder_at

COUNTS = [*range(2, 700, 17), 1024, 4096, 16_384, 20_000, 100_000]
SIZE = 25


@pytest.fixture(scope="module")
def large():
    """Return an experiment with two noisy trials of each individual."""
    made = experiment(15, SIZE)._replace(trials=2)
    noisy = dataclasses.replace(made.simulation, noise=Noise(joint_angle=0.1))
    return made._replace(simulation=noisy)


@pytest.fixture
def narrow(monkeypatch):
    """Limit chunks to one vector."""
    monkeypatch.setattr(machine_constants, "WIDEST_CHUNK", 1)


def idle(count, devices):
    """Return the number of places that a layout leaves empty."""
    block = min(devices, -(-count // LANES)) * chunk_width(count, devices)
    return -count % block


@pytest.mark.parametrize("count", [1, 2, 3, 8, 64])
def test_chunks_are_of_full_vectors_and_not_too_wide(count):
    widest = machine_constants.WIDEST_CHUNK * LANES
    for population in COUNTS:
        width = chunk_width(population, count)
        assert width % LANES == 0 and 0 < width <= widest
        # A population that fills all places has an equal layout.
        assert chunk_width(population + idle(population, count), count) == width
        # Fewer vectors on each device could not hold all, unless this saves chunks elsewhere.
        share = -(-population // count)
        if share <= widest:
            assert width <= -(-share // LANES) * LANES + LANES


def test_large_populations_waste_few_places():
    for population in (count for count in COUNTS if count > 4000):
        for count in (1, 2, 4):
            assert idle(population, count) < 0.05 * population


@pytest.mark.parametrize(
    ("backend", "population", "count", "expected"),
    [
        *(("cpu", 15, 2, 16), ("cpu", 17, 2, 16), ("cpu", 200, 2, 112), ("cpu", 96, 1, 96)),
        # Native code of one individual has no vectors, and costs less than a vector of copies.
        *(("cpu", 1, 1, 1), ("cpu", 1, 2, 1), ("cpu", 1, 8, 1)),
        # A GPU computes its whole part at once.
        *(("gpu", 4000, 1, 4000), ("gpu", 4000, 3, 1344)),
    ],
)
def test_widths_of_usual_populations(backend, population, count, expected, monkeypatch):
    monkeypatch.setattr(jax, "default_backend", lambda: backend)
    assert chunk_width(population, count) == expected


def two_devices():
    if jax.local_device_count() < 2:
        pytest.skip("a process with one core has one device")
    return population_mesh(2)


def test_devices_without_a_vector_of_their_own_stay_idle():
    mesh = two_devices()
    assert [layout(count, mesh).mesh.size for count in (1, 16, 17, 200)] == [1, 1, 2, 2]
    assert [layout(count, mesh).block for count in (1, 16, 17)] == [1, 16, 32]


@pytest.mark.parametrize("count", [1, 31, 32, 33, 70, 96])
def test_results_return_in_order_and_once(count):
    """Each individual returns its number. Places after the last individual are cut off."""
    mesh = two_devices()
    blocks = []

    def pick(numbers):
        blocks.append(numbers)
        return np.float32([[0], [100]]) + np.float32(numbers), None, np.array(0.5, np.float32)

    def program(names, nothing, offset):
        assert nothing is None and names.shape == (2, 16)
        return {"sum": names.sum(0), "same": names + offset}

    names = np.arange(count, dtype=np.float32)
    run = sharded(program, mesh, (2, 1, 0))
    found = run_in_blocks(run, Layout(mesh, 16), count, pick)
    np.testing.assert_array_equal(found["sum"], 2 * names + 100)
    np.testing.assert_array_equal(found["same"], [names + 0.5, names + 100.5])
    places = np.concatenate(blocks)
    assert len(places) == -(-count // 32) * 32
    np.testing.assert_array_equal(places[:count], np.arange(count))
    np.testing.assert_array_equal(places[count:], count - 1)


@pytest.mark.slow
def test_chunks_change_no_result(large, narrow):
    """50 trials in two blocks of 32 equal some of the trials, and one alone, to the last bit."""
    genes = np.asarray(begin(large)[0])
    keys = np.asarray(generation_keys(large, np.int32(1)))
    of_each = keys.reshape(-1, SIZE, 2)
    live = compile_trials(large.simulation, population_mesh(2))
    outcome = live(genes, keys, None, 2)
    assert len(np.unique(outcome.terms["distance"])) > 1.9 * SIZE
    for some in (range(9), range(10, 21), range(16, SIZE)):
        own = live(genes[:, some], of_each[:, some].reshape(len(keys), -1), None, 2)
        for name, values in own.terms.items():
            expected = outcome.terms[name].reshape(SIZE, 2)[some]
            np.testing.assert_array_equal(values, expected.reshape(-1))
    width = chunk_width(2 * SIZE, 2)
    watched = JUDGE, Recorder()
    repeat = compile_trials(large.simulation, population_mesh(1), width, observers=watched)
    again, _ = repeat(genes[:, 17:18], of_each[:, 17], None, 2)
    for name, values in again.terms.items():
        np.testing.assert_array_equal(values, outcome.terms[name][34:36])
    # The last individual diverges, also in the empty places. Others keep their results.
    wild = genes.copy()
    wild[:, -1] = np.nan
    disturbed = live(wild, keys, None, 2)
    assert disturbed.alive.tolist() == [True] * (2 * SIZE - 2) + [False] * 2
    for name, values in disturbed.terms.items():
        np.testing.assert_array_equal(values[:-2], outcome.terms[name][:-2])


@pytest.mark.slow
def test_more_generations_and_individuals_take_no_more_memory(monkeypatch, tmp_path):
    """No array stays behind, and all blocks use one program, so memory is constant."""
    programs, functions = [], []

    def noted(*arguments):
        programs.append(sharded(*arguments))
        return programs[-1]

    def kept(*arguments):
        functions.append(compile_trials(*arguments))
        return functions[-1]

    monkeypatch.setattr(training_evaluate, "sharded", noted)
    monkeypatch.setattr(evolution, "compile_trials", kept)
    count = 500 * jax.local_device_count()
    made = experiment(2, count)._replace(generations=6)
    folder = folder_at(tmp_path / "run")
    held = []
    done = evolution.train(made, folder, lambda rows: held.append(len(jax.live_arrays())))
    assert len(held) == 6 and len(set(held[1:])) == 1
    (live,) = functions
    few = live(done.genes)
    many = live(np.tile(done.genes, 20))
    assert len(jax.live_arrays()) <= held[-1]
    assert [program._cache_size() for program in programs] == [1]
    for name, values in few.terms.items():
        assert values.shape == (count,)
        np.testing.assert_array_equal(many.terms[name].reshape(20, count), [values] * 20)
