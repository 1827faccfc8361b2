"""`evo-cpg fit`: estimates from a recorded motion, and errors."""

import csv
import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import yaml

from creatures import quick_jit
from evo_cpg.api.fit import MeasuredMotion, commanded, read_motion
from evo_cpg.io.load import check_config, load_config
from evo_cpg.io.numbers import number_at
from evo_cpg.io.parameters import parametrise
from evo_cpg.simulation.rollout import rollout
from evo_cpg.simulation.track import track
from evo_cpg.training.run_folder import RunFolder
from pictures import ink
from tiny_run import CONFIG, REPOSITORY

FALL = yaml.safe_load("""
name: dropped
creature:
  name: pair
  materials: {a: {density: 1200.0}}
  bodies:
    - {name: head, shape: {type: sphere, radius: 0.1}, material: a}
    - name: tail
      shape: {type: box, size: [0.2, 0.1, 0.02]}
      material: a
      joint: {parent: head, at: [-0.1, 0.0, 0.0], child_at: [0.11, 0.0, 0.0], axes: [y],
              actuator: {gain: 1.0}}
world: {water: {form_drag: 0.8}}
simulation: {seconds: 0.3333333333333333, substeps: 1}
controller: {type: "evo_cpg.control.commanded:Commanded"}
task: {type: distance}
""")


def write(path, columns, rows):
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows(rows)


@pytest.fixture
def config(tmp_path):
    path = tmp_path / "dropped.yaml"
    path.write_text(yaml.safe_dump(FALL))
    return path


def test_a_body_without_joints_runs_in_native_code(tmp_path):
    """On plain JAX, a warning would fail this test."""
    creature = FALL["creature"] | {"bodies": FALL["creature"]["bodies"][:1]}
    path = tmp_path / "ball.yaml"
    path.write_text(yaml.safe_dump(FALL | {"creature": creature}))
    simulation = parametrise(load_config(path), path, ()).experiment.simulation
    recording = MeasuredMotion(np.arange(20) / 60, ("x",), np.zeros((20, 1)), {})
    driven = dataclasses.replace(simulation, controller=commanded(recording, simulation)[0])
    fell = quick_jit(lambda genes: rollout(driven, genes).terms["distance"])(jnp.zeros((0, 2)))
    np.testing.assert_array_equal(fell[0], fell[1])


@pytest.mark.parametrize("form", ["{:.15g}", "{:.9g}", "{:.6f}", "{:.3f}"])
def test_rounded_time_stamps_belong_to_their_control_steps(config, tmp_path, form):
    simulation = parametrise(load_config(config), config, ()).experiment.simulation
    table, steps = tmp_path / "data.csv", np.arange(20)
    rates = np.arange(20) + 1.0
    stamps = [form.format(step / 60) for step in steps]
    write(table, ["time", "x", "tail.y.target_rate"], zip(stamps, rates, rates, strict=True))
    recording = read_motion(table)
    driver, late = commanded(recording, simulation)
    np.testing.assert_allclose(driver.rates[:, 0], rates)
    assert late == 0
    assert commanded(recording._replace(time=recording.time + 0.3 / 60), simulation)[1] == 20


@pytest.mark.slow
def test_drag_and_initial_speed_are_recovered(cli, config, tmp_path):
    """The tail follows recorded commands, and the data have a noise of 0.1 mm."""
    with jax.enable_x64(True):
        parameters = parametrise(check_config(FALL, config), config, ["world.water.form_drag"])
        simulation = parameters.experiment.simulation
        times = np.linspace(0.0, 20 / 60, 21)
        rates = 3.0 * np.sin(12.0 * times)
        columns = ("x", "z", "pitch", "tail.y")
        table = tmp_path / "driven.csv"
        header = ["time", *columns, "tail.y.target_rate"]
        write(table, header, [[t, 0, 0, 0, 0, r] for t, r in zip(times, rates, strict=True)])
        driver, _ = commanded(read_motion(table), simulation)
        driven = eqx.tree_at(lambda s: s.controller, simulation, driver)
        start = {"velocity.x": jnp.asarray(1.3)}
        exact = quick_jit(lambda: track(driven, jnp.zeros(0), times, columns, start))()
    data = np.asarray(exact) + 1e-4 * np.random.default_rng(1).normal(size=exact.shape)
    cells = [[f"{value:.9f}" for value in row] for row in data]
    cells[4][1] = ""
    cells[5][0] = "nan"
    rows = [[t, *row, r] for t, row, r in zip(times, cells, rates, strict=True)]
    write(table, header, rows)
    fitted, picture = tmp_path / "fitted.yaml", tmp_path / "fitted.png"
    keys = ("world.water.form_drag=0.5", "initial.velocity.x=1.0")
    out, _ = cli.passes("fit", config, table, *keys, "-o", fitted, "--plot", picture)
    assert "warning" not in out
    after, whole = (load_config(path).model_dump() for path in (fitted, config))
    assert after["world"]["water"].pop("form_drag") == pytest.approx(0.8, rel=0.02)
    # Nothing else of the configuration changed.
    del whole["world"]["water"]["form_drag"]
    assert after == whole
    assert 0.01 < ink(picture) < 0.5
    line = next(line for line in out.splitlines() if "initial.velocity.x" in line)
    low, high = (float(line.split()[i]) for i in (-3, -1))
    assert low < 1.3 < high and high - low < 0.02
    complaint = cli.refuses("fit", config, table, *keys, "-o", fitted)
    assert "or replace it with --overwrite" in complaint


@pytest.mark.slow
def test_a_constant_of_the_cpg_is_recovered(finished_run, cli, tmp_path):
    key, truth = "controller.cpg.time_scale", 0.8
    folder = RunFolder(finished_run)
    config = load_config(folder.config)
    value = number_at(config, key)
    with jax.enable_x64(True):
        simulation = parametrise(config, folder.config, [key]).simulation
        times, columns = np.linspace(0.1, 2.0, 40), ("x", "y", "z")
        genes = jnp.asarray(folder.load_champion()[0].genes, float)
        exact = quick_jit(
            lambda: track(simulation(jnp.array([truth * value])), genes, times, columns, {})
        )()
    data = np.asarray(exact) + 1e-4 * np.random.default_rng(1).normal(size=exact.shape)
    table = tmp_path / "data.csv"
    write(table, ("time", *columns), np.column_stack([times, data]))
    out, _ = cli.passes("fit", folder.config, table, key, "--run", folder.path)
    line = next(line for line in out.splitlines() if key in line)
    low, high = (float(line.split()[i]) for i in (-3, -1))
    assert low < truth * value < high and high - low < 0.02 * value


@pytest.mark.slow
def test_a_forbidden_estimate_is_an_error(cli, config, tmp_path):
    """A joint that speeds up without a motor needs a negative damping."""
    times = np.linspace(0.0, 0.3, 19)
    table = tmp_path / "data.csv"
    write(table, ["time", "tail.y"], np.column_stack([times, 0.5 * np.expm1(4.0 * times)]))
    key = "creature.bodies.1.joint.damping"
    settings = ("--set", "initial.rate.tail.y=2", "--set", "creature.bodies.1.joint.actuator=null")
    complaint = cli.refuses("fit", config, table, key, *settings)
    assert f"the best fit is {key}=-" in complaint and "not allowed" in complaint


@pytest.mark.parametrize(
    ("header", "rows", "word"),
    [
        (["x"], [[1]], "time"),
        (["time", "x"], [], "rows"),
        (["time"], [[0.1]], "measured column"),
        (["time", "x", "x"], [[0, 1, 2]], "different columns"),
        (["time", "x"], [[0, 1], [], [1, "inf"]], "finite"),
        (["time", "x"], [[0, "x" * 200_000]], "cannot be read"),
        (["time", "x"], [[0, 1], [0, 2]], "increase"),
        (["time", "x", "tail.y.target_rate"], [[0.1, 1, ""]], "target_rate"),
        (["time", "w"], [[0.1, 1]], "unknown column w"),
        (["time", "x", "tail.z.target_rate"], [[0.1, 1, 1]], "unknown command tail.z"),
        (["time", "x"], [[0.1, 1]], "too few"),
        (["time", "head.rotation_xx"], [[0, 1]], "'head.x'"),
        (["time [ms]", "x [m]"], [[0, 1]], "'time [ms]'"),
    ],
)
def test_wrong_recordings_are_refused(cli, config, tmp_path, header, rows, word):
    table = tmp_path / "data.csv"
    write(table, header, rows)
    complaint = cli.refuses("fit", config, table, "world.water.form_drag")
    assert str(table) in complaint and word in complaint


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["world.watr.form_drag=1"], "world.watr.form_drag"),
        (["world.ground.restitution=0.5"], "world.ground.restitution"),
        (["initial.velocity.x", "initial.velocity.x=1"], "twice"),
        (["controller.cpg.time_scale"], "controller.cpg.time_scale"),
        (["world.water.form_drag", "--out", "nowhere/fit.yaml"], "nowhere"),
        (["world.water.form_drag", "--plot", "fit.txt"], ".txt"),
        (["initial.velocity.w"], "velocity.w"),
        (["world.water.form_drag=2", "--set", "world.water.form_drag=1"], "twice"),
    ],
)
def test_wrong_keys_and_options_are_refused(cli, config, tmp_path, arguments, word):
    table = tmp_path / "data.csv"
    write(table, ["time", "x"], [[0.1, 1], [0.2, 1], [0.3, 1]])
    assert word in cli.refuses("fit", config, table, *arguments)


@pytest.mark.parametrize("champion", [False, True])
def test_numbers_of_the_controller_need_a_fitting_champion(cli, tmp_path, finished_run, champion):
    table, key = tmp_path / "data.csv", "controller.cpg.time_scale"
    write(table, ["time", "x"], [[0.1, 1], [0.2, 1], [0.3, 1]])
    animal = REPOSITORY / "configs" / "iwadate2010_salamander_land.yaml" if champion else CONFIG
    run = ["--run", finished_run] if champion else []
    complaint = cli.refuses("fit", animal, table, key, *run)
    assert ("does not fit" if champion else "--run RUN") in complaint
