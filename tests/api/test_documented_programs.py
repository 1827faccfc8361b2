"""Programs of README and docs run unchanged, except for shorter trials of a smaller animal."""

import re
import shutil
import sys
from pathlib import Path

import jax
import numpy as np
import pytest
import yaml

import evo_cpg as evo
from evo_cpg.analysis.limit_cycle import limit_cycle, resting
from evo_cpg.control.brain_cpg import BrainCpg
from evo_cpg.control.couplings import uncoupled
from evo_cpg.training.run_folder import RunFolder
from evo_cpg.training.train import train

ROOT = Path(__file__).parents[2]


def programs(page: str) -> list[str]:
    """Return the Python blocks of a page, with shorter trials and fewer individuals."""
    found = re.findall(r"```python\n(.+?)```", (ROOT / page).read_text(), re.S)
    short = [
        one.replace('"simulation.seconds": 5', '"simulation.seconds": 0.1667') for one in found
    ]
    # The smaller animal is a file of the working folder.
    name, path = '"iwadate2010_swimmer"', '"configs/iwadate2010_swimmer.yaml"'
    short = [one.replace(f"load({name}", f"load({path}") for one in short]
    return [re.sub(r"\b(32|64)\b", "8", one) for one in short]


def configs(page: str) -> list[str]:
    """Return the YAML blocks of a page."""
    return re.findall(r"```yaml\n(.+?)```", (ROOT / page).read_text(), re.S)


def run(program: str, names: dict) -> None:
    exec(compile(program, "documented", "exec"), names)


@pytest.fixture
def here(tmp_path, monkeypatch):
    """Return a working folder with the configurations. The swimmer has two bodies and one axis."""
    shutil.copytree(ROOT / "configs", tmp_path / "configs")
    for name, old, new in (
        ("creatures/swimmer10.yaml", "repeat: 9 ", "repeat: 1 "),
        ("creatures/swimmer10.yaml", "axes: [x, y, z] ", "axes: [z] "),
        ("iwadate2010_swimmer.yaml", "points: quadrature ", "form_resolution: 1 "),
        ("iwadate2010_swimmer.yaml", "hidden: [16] ", "hidden: [4] "),
    ):
        path = tmp_path / "configs" / name
        text = path.read_text()
        assert text.count(old) == 1
        path.write_text(text.replace(old, new))
    monkeypatch.chdir(tmp_path)
    # The reader of a page trusts only the working folder.
    monkeypatch.delenv("EVO_CPG_TRUST")
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.setenv("MPLBACKEND", "Agg")
    jax.devices()
    return tmp_path


@pytest.fixture
def module(here, monkeypatch):
    """Return a function that writes a module of the reader, which is imported anew."""

    def write(name: str, text: str) -> None:
        (here / f"{name}.py").write_text(text)
        monkeypatch.delitem(sys.modules, name, raising=False)

    return write


@pytest.mark.slow
def test_the_notebook_runs_in_order(here, capsys):
    first, search, *others = programs("docs/notebook.md")
    assert len(first.strip().splitlines()) <= 8 and len(search.strip().splitlines()) <= 12
    names: dict = {}
    run(first, names)
    # evosax needs rank promotion.
    with jax.numpy_rank_promotion("allow"):
        run(search, {})
    for program in others:
        run(program, names)
    assert (here / "motion.csv").is_file()
    assert np.isfinite(names["gradient"]).all()
    assert capsys.readouterr().out.count("\n") >= 1 + 10 + 1 + 1


def test_the_readme_runs(here, capsys):
    (program,) = programs("README.md")
    run(program, {})
    assert len(capsys.readouterr().out.split()) == 2


@pytest.mark.slow
def test_the_animals_of_gymnasium_run(here):
    names: dict = {}
    for program in programs("docs/gymnasium.md"):
        # `test_stable_baselines.py` runs the last one.
        if "stable_baselines3" not in program:
            run(program, names)
    assert len(names["terms"]) == 0 and names["many"].num_envs == 200


@pytest.mark.slow
def test_a_custom_animal_trains(here, module):
    classes, program, *_ = programs("docs/own.md")
    config, *_ = configs("docs/own.md")
    module("wriggler", classes)
    (here / "wriggler.yaml").write_text(config)
    names: dict = {}
    run(program, names)
    trained = names["trained"]
    displacement, cost = trained.terms["displacement"], trained.terms["cost"]
    assert cost == pytest.approx(0.01 * trained.terms["energy"], rel=1e-5) and cost > 0
    # It must beat standing still, which has the fitness 0.
    assert trained.fitness == pytest.approx(displacement - cost, rel=1e-4) and trained.fitness > 0
    assert set(names["experiment"].evaluate(0, trained.genome[None]).descriptors) == {"energy"}
    assert evo.load(trained.folder).gene_count == 3


def test_the_documented_sensor_measures_the_motor(here, module):
    classes, _, _, sensor = programs("docs/own.md")
    config, *_ = configs("docs/own.md")
    # The reading that the controller uses moves by one place.
    module("wriggler", classes.replace("custom[1]", "custom[2]"))
    module("tension", sensor)
    line = '{type: "tension:Tension", options: {dofs: [tail1.z], full_scale: 0.5}}'
    assert line in (ROOT / "docs/own.md").read_text()
    (here / "wriggler.yaml").write_text(config.replace("sensors: [", f"sensors: [{line}, "))
    experiment = evo.load("wriggler.yaml")
    record = experiment.record(0, experiment.random_genomes(0, 1)[0])
    felt, torque = record["sense.custom.0"], record["tail1.z.torque"]
    assert felt[0] == 0 and np.abs(felt).max() > 0
    np.testing.assert_allclose(felt[1:], np.clip(torque[:-1] / 0.5, -1, 1), rtol=1e-6)


@pytest.mark.slow
def test_the_documented_rower_has_no_resting_oscillator(here):
    """All oscillators swing: the couplings of the page are sufficient."""
    *_, config = configs("docs/own.md")
    (here / "rower.yaml").write_text(config)
    # The run is short, and the body is the body of the page.
    short = {"simulation.seconds": 0.5, "evolution.generations": 1, "evolution.population": 8}
    experiment = evo.load("rower.yaml", short | {"evolution.elites": 2})
    controller = experiment.parts.simulation.controller
    assert isinstance(controller, BrainCpg)
    assert uncoupled(controller.network.matrix) == []
    assert resting(controller.network, 1.0, 1.0, 10.0) == []
    assert np.isfinite(evo.train(experiment, "runs/rower").fitness)


@pytest.fixture
def lizard(here):
    """Return the path of the walker of `docs/tutorials/walker.md`."""
    (config,) = configs("docs/tutorials/walker.md")
    (here / "lizard.yaml").write_text(config)
    return "lizard.yaml"


def test_the_documented_walker_steps_with_diagonal_legs(lizard):
    page = (ROOT / "docs/tutorials/walker.md").read_text()
    experiment = evo.load(lizard)
    tree = experiment.parts.simulation.world.tree
    controller = experiment.parts.simulation.controller
    assert isinstance(controller, BrainCpg)
    network, count = controller.network, tree.dof_count
    assert uncoupled(network.matrix) == []
    cycle = limit_cycle(network, np.ones((2, count)), np.full(count, 5.5), tuple(range(count)))
    rows = re.findall(r"\| (fore|hind)leg, (swing|lift) \| (-?\d+) \| (-?\d+) \|", page)
    assert len(rows) == 4
    lags = {}
    for leg, motion, *printed in rows:
        for side, number in zip(("left", "right"), printed, strict=True):
            axis = {"swing": "z", "lift": "x"}[motion]
            own = tree.dof_names.index(f"{side}_{leg}.{axis}")
            lags[side, leg, motion] = lag = cycle.lags((0, own))[1]
            assert round(lag) == int(number)
    for (side, leg, motion), lag in lags.items():
        other = {"left": "right", "right": "left"}[side], {"fore": "hind", "hind": "fore"}[leg]
        assert abs(lag - lags[*other, motion]) < 50
        assert abs(lag - lags[side, leg, "lift"]) < 5


@pytest.mark.slow
def test_the_documented_walker_walks(lizard):
    trained = evo.train(evo.load(lizard), "runs/lizard")
    assert trained.terms["forward"] > 0.7
    assert trained.terms["airborne"] < 0.1 and trained.terms["tilt"] < 0.05


@pytest.mark.slow
def test_the_task_of_the_tutorial_trains(here, module):
    (task,) = programs("docs/tutorials/task.md")
    (sections,) = configs("docs/tutorials/task.md")
    module("dive", task)
    config = yaml.safe_load((here / "configs" / "turtle.yaml").read_text())
    config |= yaml.safe_load(sections) | {"creature": "configs/creatures/turtle.yaml"}
    (here / "turtle.yaml").write_text(yaml.safe_dump(config))
    short = {"simulation.seconds": 2, "evolution.generations": 3, "evolution.population": 16}
    trained = evo.train(evo.load("turtle.yaml", short | {"evolution.elites": 4}), "runs/diver")
    depth, energy = trained.terms["depth"], trained.terms["energy"]
    # An animal at rest has the fitness 0.
    assert trained.fitness == pytest.approx(depth - 0.002 * energy, rel=1e-4) and depth > 0


@pytest.mark.slow
def test_a_custom_optimiser_trains(module):
    strategy, program, *_ = programs("docs/searches.md")
    module("climber", strategy)
    names: dict = {}
    run(program, names)
    assert type(names["experiment"].parts.strategy).__name__ == "Climber"
    assert len(names["trained"].history) == 3


def test_pyribs_resumes_to_the_same_genomes(here, module):
    """The bytes of the state may differ, because pyribs leaves empty cells uninitialised."""
    pytest.importorskip("ribs")
    module("cma_mae", programs("docs/searches.md")[2])
    section = next(yaml.safe_load(one) for one in configs("docs/searches.md") if "CmaMae" in one)
    path = "configs/iwadate2010_swimmer.yaml"
    found = []
    for name, stops in (("whole", [4]), ("resumed", [2, 4])):
        folder = RunFolder(here / name)
        folder.create("", {})
        for generations in stops:
            search = section["evolution"] | {"population": 8, "generations": generations}
            settings = {"evolution": search, "runs": 2, "simulation.seconds": 0.5}
            train(evo.load(path, settings).parts, folder)
        found.append(folder.load())
    whole, resumed = found
    assert whole is not None and resumed is not None and resumed.generation == 4
    np.testing.assert_array_equal(whole.genes, resumed.genes)
    assert not np.array_equal(whole.genes[:, :8], whole.genes[:, 8:])


def test_the_api_page_names_every_public_name():
    text = (ROOT / "docs/api.md").read_text()
    for name in evo.__all__:
        assert f"evo.{name}" in text, name
    for kind in (evo.Experiment, evo.Environment):
        for name in vars(kind):
            if not name.startswith("_"):
                assert re.search(rf"\b{name}\b", text), f"{kind.__name__}.{name}"
