"""`import evo_cpg as evo` gives the results of the commands and of the library."""

import copy
import csv
import math
import pickle
import re
import subprocess
import sys
import textwrap

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import evo_cpg as evo
from evo_cpg.api import fitness
from evo_cpg.cli.main import main
from evo_cpg.native.engine import EngineWarning
from evo_cpg.training.run_folder import RunFolder, RunFolderError
from shared_programs import programs_of_its_own, remember_programs
from tiny_run import CONFIG, PAIR, REPOSITORY, TINY, environment

__all__ = ["programs_of_its_own", "remember_programs"]

COUNT = 5


@pytest.fixture(scope="module")
def experiment():
    # JAX keeps the devices of this process.
    jax.devices()
    return evo.load(CONFIG, TINY)


@pytest.fixture(scope="module")
def genomes(experiment):
    return experiment.random_genomes(0, COUNT)


@pytest.fixture(scope="module")
def evaluation(experiment, genomes):
    return experiment.evaluate(0, genomes)


def test_import_loads_neither_jax_nor_submodules(tmp_path):
    code = (
        "import sys, evo_cpg as evo; ours = [m for m in sys.modules if m.startswith('evo_cpg.')]\n"
        "assert not ours and 'jax' not in sys.modules and 'numpy' not in sys.modules, ours\n"
        "assert 'load' in dir(evo) and evo.load.__name__ == 'load' and 'jax' in sys.modules\n"
        # JAX refuses this after it has run anything.
        "import jax; jax.config.update('jax_num_cpu_devices', 3)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment(tmp_path), capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr


def test_every_public_name_exists_and_others_raise():
    assert all(getattr(evo, name) is not None for name in evo.__all__)
    with pytest.raises(AttributeError, match="module 'evo_cpg' has no attribute 'lode'"):
        evo.lode  # noqa: B018  # pyright: ignore


@pytest.mark.slow
def test_fitness_in_a_population_equals_fitness_alone(experiment, genomes, evaluation):
    assert evaluation.fitness.shape == (COUNT,)
    np.testing.assert_array_equal(evaluation.trial_fitness, evaluation.fitness[None])
    assert np.ptp(evaluation.fitness) > 0.01
    assert evaluation.descriptors == {}
    alone = experiment.evaluate(0, jnp.asarray(genomes[3:4]))
    np.testing.assert_array_equal(alone.fitness, evaluation.fitness[3:4])
    trials = experiment.rollout(0, genomes)
    assert trials.alive.shape == (COUNT, 1) and trials.alive.all()
    for name, values in trials.terms.items():
        np.testing.assert_array_equal(values[:, 0], evaluation.terms[name])
    weights = experiment.config.task
    expected = (
        -weights.distance_weight * np.minimum(evaluation.terms["distance"], 1.5)
        - weights.energy_weight
        * np.minimum(evaluation.terms["energy"] / float(experiment.scales["energy"]), 1)
        + weights.light_weight * evaluation.terms["light"]
    )
    np.testing.assert_allclose(evaluation.fitness, expected, rtol=1e-6)


@pytest.mark.parametrize("copied", [lambda x: pickle.loads(pickle.dumps(x)), copy.deepcopy])
def test_a_used_experiment_can_be_pickled(experiment, genomes, evaluation, copied):
    experiment.record(0, genomes[0])
    again = copied(experiment)
    assert again.scales == experiment.scales
    assert not callable(vars(again).get("_run_trials"))
    found = again.evaluate(0, genomes)
    np.testing.assert_array_equal(found.fitness, evaluation.fitness)
    assert again.name == experiment.name and again.config == experiment.config


def test_results_can_be_pickled(experiment, genomes, evaluation):
    environment = experiment.environment()
    state = environment.reset(jax.random.key(0))
    record, trials = experiment.record(0, genomes[0]), experiment.rollout(0, genomes)
    given = (evaluation, trials, record, environment, state, experiment.task)
    again = [pickle.loads(pickle.dumps(each)) for each in given]
    np.testing.assert_array_equal(again[0].fitness, evaluation.fitness)
    np.testing.assert_array_equal(again[1].terms["light"], trials.terms["light"])
    np.testing.assert_array_equal(again[2]["energy"], record["energy"])
    np.testing.assert_array_equal(again[3].reset(jax.random.key(0)).obs, state.obs)
    np.testing.assert_array_equal(again[4].obs, state.obs)
    assert again[5] == experiment.task
    with pytest.raises(evo.ConfigError, match="nam: unknown key") as refused:
        evo.load({"nam": "x"})
    assert str(pickle.loads(pickle.dumps(refused.value))) == str(refused.value)


def shell(*arguments: object) -> object:
    """Call `evo-cpg` on the devices of this process, and return its exit code.

    The replaced functions belong to no program, so programs of other tests can be shared.
    """
    devices = len(jax.devices())
    with pytest.MonkeyPatch.context() as patch, pytest.raises(SystemExit) as stopped:
        patch.setattr("evo_cpg.training.devices.use_cores", lambda count=None: devices)
        patch.setattr(sys, "argv", ["evo-cpg", *map(str, arguments)])
        main()
    return stopped.value.code


@pytest.mark.slow
def test_train_equals_the_command(experiment, tmp_path):
    seen = []
    trained = evo.train(experiment, tmp_path / "python", seen.extend)
    assert shell("train", CONFIG, *TINY, "--out", tmp_path / "shell") == 0
    champion, motion, digests = RunFolder(tmp_path / "shell").load_champion()
    np.testing.assert_array_equal(trained.genome, champion.genes)
    assert (trained.fitness, trained.terms) == (champion.fitness, champion.terms)
    assert motion is not None and seen == trained.history and len(seen) == 4
    assert RunFolder(trained.folder).load_champion()[2] == digests
    # Scales are as in training, so the fitness is, too.
    again = evo.load(trained.folder).evaluate(0, trained.genome[None])
    assert float(again.fitness[0]) == pytest.approx(trained.fitness, rel=1e-5)


@pytest.mark.slow
def test_commands_refuse_a_run_with_a_fitness_from_python(tmp_path, capsys, monkeypatch):
    mine = evo.load(CONFIG, (*TINY, "evolution.generations=1"))
    mine = mine.with_fitness(lambda terms: terms["energy"])
    trained = evo.train(mine, tmp_path / "mine")
    assert trained.fitness == pytest.approx(trained.terms["energy"])
    for command in ("resume", "verify", "refine"):
        assert shell(command, trained.folder) == 2
        assert "began in Python with a task" in capsys.readouterr().err
    # Do this as the message and the API page say.
    again = mine.evaluate(0, trained.genome[None]).fitness
    assert float(again[0]) == pytest.approx(trained.fitness, rel=1e-5)
    with pytest.raises(RunFolderError, match="It began in Python"):
        evo.train(mine, trained.folder)
    (program,) = re.findall(
        r"  ```python\n(.+?)  ```", (REPOSITORY / "docs/api.md").read_text(), re.S
    )
    monkeypatch.chdir(tmp_path)
    exec(textwrap.dedent(program), {"evo": evo, "experiment": mine, "trained": trained})
    start, newest = RunFolder("runs/more").load_start(), RunFolder(trained.folder).load()
    assert newest is not None and start is not None
    np.testing.assert_array_equal(start, newest.genes)


def test_a_wrong_fitness_is_refused_at_once(experiment):
    known = r"the task has no term 'distanse': did you mean 'distance'\? valid here: .*, light"
    for wrong, words in (
        (lambda terms: -terms["distanse"], known),
        (lambda terms: terms["distance"].sum(), r"shape \(7,\), got float32\[\]"),
        (lambda terms: jnp.stack([*terms.values()]), r"shape \(7,\), got float32\[3, 7\]"),
        (lambda terms: terms["distance"] * 1j, r"shape \(7,\), got complex64\[7\]"),
        (lambda terms: jnp.atleast_1d(terms["distance"]), r"shape \(\), got float32\[1\]"),
    ):
        with pytest.raises((KeyError, ValueError), match=words):
            experiment.with_fitness(wrong)


def test_a_fitness_may_use_measures():
    measured = evo.load(CONFIG, (*PAIR, "measures=[speed]", "engine=jax"))
    measured = measured.with_fitness(lambda terms: terms["speed"] - terms["energy"])
    assert measured.scales == {}
    environment = measured.environment()
    state = jax.eval_shape(environment.reset, jax.random.key(0))
    state = jax.eval_shape(environment.step, state, jnp.zeros(environment.action_size))
    assert set(state.metrics) == {"distance", "energy", "light", "speed"}


def test_a_record_has_named_columns_and_becomes_a_table(experiment, genomes, tmp_path):
    record = experiment.record(0, genomes[0])
    assert set(record.units) == set(record) and record.units["segment1.x.torque"] == "N m"
    steps, recording = len(record["time"]), record.recording
    names = [body.name for body in experiment.creature.bodies]
    for k, axis in enumerate("xyz"):
        np.testing.assert_array_equal(
            record[f"segment2.{axis}"], recording.position[:, names.index("segment2"), k]
        )
    np.testing.assert_array_equal(
        record["head.rotation_xy"], recording.rotation[:, names.index("head"), 0, 1]
    )
    assert record["energy"].sum() == pytest.approx(
        float(experiment.rollout(0, genomes[:1]).terms["energy"][0, 0]), rel=1e-5
    )
    record.to_csv(tmp_path / "motion.csv")
    with (tmp_path / "motion.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == steps
    assert list(rows[0]) == [f"{name} [{record.units[name]}]" for name in record]
    assert float(rows[7]["head.z [m]"]) == pytest.approx(float(record["head.z"][7]))


def test_a_record_holds_motion_senses_and_controller_state(experiment, genomes, tmp_path):
    record = experiment.record(0, genomes[0])
    record.to_npz(tmp_path / "motion.npz")
    with np.load(tmp_path / "motion.npz", allow_pickle=False) as file:
        arrays = dict(file)
    units = dict(zip(arrays.pop("columns"), arrays.pop("units"), strict=True))
    assert units == record.units and set(arrays) == set(record)
    for name, values in record.items():
        np.testing.assert_array_equal(arrays[name], values)
    # Compare rates with central differences of positions and angles.
    dt = record["time"][1] - record["time"][0]
    for place, rate in (
        *(
            (f"{body}.{axis}", f"{body}.velocity_{axis}")
            for body in ("head", "segment2")
            for axis in "xyz"
        ),
        ("segment1.z.angle", "segment1.z.rate"),
    ):
        found, slope = record[rate][1:-1], (record[place][2:] - record[place][:-2]) / (2 * dt)
        assert np.abs(found - slope).max() < 0.25 * np.abs(found).max()
    # An oscillator's signal is the difference of the outputs of its two neurons.
    assert record["head.angular_velocity_z"].std() > 0
    pairs = len([name for name in record if name.endswith(".signal")])
    potential = np.stack([record[f"nerve.potential.{k}"] for k in range(2 * pairs)])
    output = np.maximum(potential, 0)
    signal = np.stack([record[n] for n in record if n.endswith(".signal")])
    np.testing.assert_allclose(output[:pairs] - output[pairs:], signal, atol=1e-6)
    assert 0 < record["sense.light.0"].max() <= 1


def test_the_fitness_function_has_the_value_and_its_gradient():
    pair = evo.load(CONFIG, PAIR)
    (genome,) = pair.random_genomes(0, 1)
    value, slope = jax.jit(jax.value_and_grad(pair.fitness_function()))(genome)
    direction = slope / np.linalg.norm(slope)
    steps = np.array([-0.01, 0.0, 0.01])[:, None]
    ends = pair.evaluate(0, genome + steps * np.asarray(direction)).fitness
    assert float(value) == pytest.approx(float(ends[1]), rel=1e-5)
    assert (ends[2] - ends[0]) / 0.02 == pytest.approx(float(np.linalg.norm(slope)), rel=0.1)


@pytest.mark.parametrize(
    ("config", "horizon", "retention", "rough"),
    [
        ("iwadate2010_swimmer", None, None, False),
        ("iwadate2010_swimmer", 1.0, math.exp(-1 / 60), False),
        ("hexapod", None, None, True),
        ("hexapod", 1.0, math.exp(-1 / 60), True),
        ("hexapod", math.inf, None, False),
    ],
)
def test_the_horizon_selects_decaying_cut_or_exact_gradients(
    monkeypatch, config, horizon, retention, rough
):
    """`simulation/test_fitness_gradients.py` compares exact gradients with finite differences."""
    experiment, budgets = evo.load(REPOSITORY / "configs" / f"{config}.yaml"), []
    monkeypatch.setattr(fitness, "rollout", lambda *_, backward: budgets.append(backward))
    monkeypatch.setattr(fitness, "mean_of_trials", lambda _: jnp.zeros(()))
    of_genome = fitness.fitness_function(experiment.parts, {}, None, horizon, None, None)
    of_genome(np.zeros(experiment.gene_count))
    (backward,) = budgets
    assert backward.rough is rough
    assert backward.retention == (retention and pytest.approx(retention))


@pytest.mark.slow
def test_rewards_of_an_episode_add_up_to_the_fitness(experiment, genomes):
    """The commands of a trial, given as actions, reproduce its fitness, terms and joint angles."""
    environment = experiment.environment()
    record, outcome = experiment.record(0, genomes[1]), experiment.evaluate(0, genomes[1:2])
    actions = np.stack([record[f"{name}.target_rate"] for name in environment.action_names], 1)
    state = environment.reset(jax.random.key(0))
    assert state.obs.shape == (environment.observation_size,) == (18,)
    assert not state.done

    def step(state, action):
        state = environment.step(state, action)
        return state, (state.reward, state.done, state.obs)

    end, (rewards, done, seen) = jax.jit(lambda s: jax.lax.scan(step, s, actions))(state)
    assert float(rewards.sum()) == pytest.approx(float(outcome.fitness[0]), rel=1e-4)
    for name, values in outcome.terms.items():
        assert float(end.metrics[name]) == pytest.approx(float(values[0]), rel=1e-3)
    assert done[-1] and not done[:-1].any()
    places = np.cumsum([0, *environment.observation_sizes.values()])
    first = places[list(environment.observation_sizes).index("joint_angle")]
    for i, name in enumerate(environment.action_names):
        angles = record[f"{name}.angle"]
        np.testing.assert_allclose(seen[:-1, first + i], angles[1:], rtol=1e-3, atol=1e-4)
    many = jax.vmap(environment.reset)(jax.random.split(jax.random.key(0), 3))
    many = jax.jit(jax.vmap(environment.step))(many, jnp.stack([actions[0]] * 3))
    np.testing.assert_allclose(many.obs, jnp.stack([seen[0]] * 3), rtol=1e-5, atol=1e-6)


def test_session_repeats_the_steps_of_its_environment(experiment):
    environment = experiment.environment()
    session, state = environment.session(), environment.reset(jax.random.key(3))
    seen, _ = session.reset(seed=3)
    np.testing.assert_array_equal(seen, state.obs)
    step = jax.jit(environment.step)
    for action in np.random.default_rng(0).uniform(-1, 1, (4, environment.action_size)):
        state, (seen, reward, diverged, over, _) = step(state, action), session.step(action)
        np.testing.assert_array_equal(seen, state.obs)
        assert (reward, diverged or over) == (state.reward, state.done)
        assert session.metrics == state.metrics
    with pytest.raises(ValueError, match="must have the shape"):
        session.step(action[1:])
    again, _ = session.reset(seed=3)
    assert (again != seen).any()


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda e, g: e.evaluate(0, g.T), r"shape \(n, 135\)"),
        (lambda e, g: e.rollout(0, g.T), "Transpose them"),
        (lambda e, g: e.evaluate(0, np.full((2, 135), "x")), "must be numbers"),
        (lambda e, g: e.fitness_function()(g[0, 1:]), r"shape \(135,\)"),
        (lambda e, g: e.record(0, g[0], 1), "from 0 to 0, got 1"),
        (lambda e, g: e.environment(trial=1), "from 0 to 0, got 1"),
        (
            lambda e, g: e.environment().step(
                e.environment().reset(jax.random.key(0)), np.zeros(5)
            ),
            r"action must have the shape \(6,\), got \(5,\)",
        ),
        (lambda e, g: e.environment("powers"), "'activations' or 'torques', got"),
        (lambda e, g: e.environment("torques"), "no joint has one"),
        (lambda e, g: e.environment("activations"), "no joint has muscles"),
        (lambda e, g: e.environment("angles"), "no motor has one"),
        (lambda e, g: evo.load(CONFIG, "seed=3"), "list of settings"),
        (lambda e, g: evo.load(CONFIG, {"world.gravty": 1.6}), "did you mean 'gravity'"),
    ],
)
def test_wrong_arguments_are_named(experiment, genomes, call, words):
    with pytest.raises((ValueError, TypeError, evo.ConfigError), match=words):
        call(experiment, genomes)


def test_overrides_work_as_on_the_command_line():
    given = evo.load(REPOSITORY / "configs" / "hexapod.yaml", {"world.gravity": 1.6, "seed": 4})
    assert (given.world.gravity, given.config.seed) == (1.6, 4)
    contents = given.config.model_dump(mode="json")
    assert evo.load(contents).config == given.config
    assert evo.load(contents, ["world.gravity=2"]).world.gravity == 2.0


def test_compiling_warns_if_jax_runs_on_a_gpu(monkeypatch):
    loaded = evo.load(CONFIG)
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    with pytest.warns(EngineWarning, match="set the environment variable JAX_PLATFORMS=cpu"):
        loaded._compiling("trials", "one individual", ("trials", 1))


@pytest.mark.slow
def test_the_last_loading_sets_the_number_of_cores(tmp_path):
    """Loading does not start JAX, after which the number would be fixed."""
    program = (
        "import evo_cpg, jax; evo_cpg.load('iwadate2010_swimmer', cores=2); "
        "evo_cpg.load('iwadate2010_swimmer', cores=3); assert jax.local_device_count() == 3"
    )
    own = {k: v for k, v in environment(tmp_path).items() if k != "XLA_FLAGS"}
    subprocess.run([sys.executable, "-c", program], env=own, check=True)
