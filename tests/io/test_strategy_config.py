"""The section ``evolution``: strategies, islands and maps, and their errors."""

import importlib.util
import sys

import pytest

from evo_cpg.evolution.islands import Islands
from evo_cpg.evolution.map_elites import AlongTheLine, MapElites, Mapped, OfBits
from evo_cpg.io.build import build_experiment
from evo_cpg.io.errors import ConfigError
from evo_cpg.io.load import load_config
from evo_cpg.training.experiment import Learning
from tiny_run import CONFIG

WALKER = CONFIG.with_name("fukui2003_model1.yaml")
AXES = "[{name: speed, range: [0, 1]}, {name: duty_factor, range: [0, 1], cells: 4}]"

OWN = """
import equinox as eqx
import jax
import jax.numpy as jnp

import evo_cpg as evo


class Climber(evo.Strategy):
    population: int = {population}
    gene_count: int = eqx.field(static=True)
    sigma: float = 0.1

    def init(self, key, genes):
        return {init}

    def ask(self, key, state):
        noise = jax.random.normal(key, (self.gene_count, self.population))
        return {ask}

    def tell(self, key, state, genes, evaluation):
        return {tell}

    @property
    def metric_names(self):
        return {names}

    def metrics(self, state):
        return {metrics}
"""
GOOD = {
    "population": "eqx.field(static=True)",
    "init": "genes[:, 0]",
    "ask": "state[:, None] + self.sigma * noise, state",
    "tell": "genes[:, jnp.argmax(evaluation.fitness)]",
    "names": '("spread",)',
    "metrics": '{"spread": state.std()}',
}


def build(path, *settings):
    return build_experiment(load_config(path, settings), path)


def test_islands_divide_the_population():
    strategy = build(CONFIG, "evolution.islands={count: 5}").strategy
    assert isinstance(strategy, Islands)
    assert (strategy.population, strategy.strategy.population) == (200, 40)
    assert (strategy.count, strategy.every, strategy.migrants) == (5, 10, 1)
    bits = "evolution={type: bits, population: 30, islands: {count: 2, every: 3, migrants: 2}}"
    strategy = build(WALKER, bits).strategy
    assert isinstance(strategy, Islands) and strategy.strategy.population == 15


def test_lexicase_selection():
    assert build(CONFIG).strategy.selection == "rank"
    assert build(CONFIG, "evolution.selection=lexicase").strategy.selection == "lexicase"


def test_axes_of_a_map_are_measured():
    made = build(WALKER, f"evolution={{type: map_elites, axes: {AXES}}}")
    assert isinstance(made.strategy, MapElites)
    assert [axis.cells for axis in made.strategy.axes] == [10, 4] and made.strategy.vary == OfBits()
    assert made.simulation.measures.names == ("speed", "duty_factor")
    swimmer = build(CONFIG, "evolution={type: map_elites, axes: [{name: energy, range: [0, 9]}]}")
    # A term of the task needs no measure.
    assert not swimmer.simulation.measures.names and swimmer.strategy.vary == AlongTheLine()
    assert swimmer.strategy.gene_bound == 8.0
    mapped = build(WALKER, f"evolution.axes={AXES}")
    assert isinstance(mapped.strategy, Mapped) and [
        axis.cells for axis in mapped.strategy.axes
    ] == [10, 4]
    assert mapped.simulation.measures.names == ("speed", "duty_factor")
    with pytest.raises(ConfigError, match=r"evolution: axes: at least one is needed"):
        build(CONFIG, "evolution={type: map_elites, axes: []}")


def test_variation_of_bits_on_a_map():
    given = f"type: map_elites, axes: {AXES}, crossover: 0.5, mutation_probability: 1"
    flips = f"evolution={{{given}, mutated_genes: [1, 10], mutation: flip}}"
    assert build(WALKER, flips).strategy.vary == OfBits(0.5, 1.0, (1, 10), "flip")
    with pytest.raises(ConfigError, match=r"mutated_genes: at most 192, the bits in a genome"):
        build(WALKER, f"evolution={{{given}, mutated_genes: [1, 193]}}")
    with pytest.raises(ConfigError, match="mutated_genes must be fewest and most, got 3 and 2"):
        build(WALKER, f"evolution={{{given}, mutated_genes: [3, 2]}}")


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("evosax") is None, reason="evosax is an extra")
def test_an_algorithm_of_evosax():
    given = "{type: evosax, algorithm: Sep_CMA_ES, sigma: 0.3, params: {c_mean: 0.9}}"
    strategy = build(CONFIG, f"evolution={given}").strategy
    assert (strategy.algorithm, strategy.sigma) == ("Sep_CMA_ES", 0.3)
    assert not strategy.binary and strategy.gene_bound == 8.0
    strategy = build(WALKER, f"evolution={given}").strategy
    assert strategy.binary and strategy.gene_bound is None
    given = "{type: evosax, algorithm: LM_MA_ES, islands: {count: 4}}"
    assert build(CONFIG, f"evolution={given}").strategy.strategy.population == 50
    for bad, words in (
        ("{type: evosax, algorithm: Sep_CMA}", "evosax has no 'Sep_CMA': did you mean 'Sep_CMA_ES"),
        ("{type: evosax, algorithm: Open_ES, population: 7}", "Open_ES of 7 individuals can.*even"),
        (
            "{type: evosax, algorithm: Open_ES, population: 30, islands: {count: 2}}",
            "Open_ES of 15 individuals on each island cannot be built .*even",
        ),
        ("{type: evosax, algorithm: Open_ES, options: {lr: 1}}", "Open_ES of .* cannot be .*'lr'"),
    ):
        with pytest.raises(ConfigError, match=words):
            build(CONFIG, f"evolution={bad}")


def test_missing_evosax_is_reported_with_its_installation(monkeypatch):
    monkeypatch.setitem(sys.modules, "evosax", None)
    monkeypatch.setitem(sys.modules, "evosax.algorithms", None)
    with pytest.raises(ConfigError, match=r"'evosax' is not installed here.*\[evosax\]"):
        build(CONFIG, "evolution={type: evosax, algorithm: Sep_CMA_ES}")


REAL = ["evolution={type: real, generations: 2, population: 6, elites: 2, learning: {every: 3}}"]
MAP = "evolution={type: map_elites, axes: [{name: speed, range: [0, 1]%s"


@pytest.mark.parametrize(
    ("path", "settings", "words"),
    [
        (CONFIG, ["evolution.islands={count: 3}"], "200 .* 3 islands"),
        (CONFIG, ["evolution.islands={count: 10}"], "20 individuals.* 21"),
        (CONFIG, ["evolution.islands={count: 5, migrants: 40}"], "migrants: .* 40"),
        (CONFIG, ["evolution.islands={count: 5}", "evolution.learning={every: 2}"], "learning: "),
        (WALKER, ["evolution={type: bits, islands: {count: 3}}"], "count: .* 5 .* 8"),
        (CONFIG, [MAP.replace("speed", "sped") % "}]}"], r"axes\.0\.name: 'sped' .* 'speed'\?"),
        (CONFIG, [f"evolution={{type: map_elites, axes: {AXES}}}"], r"axes\.1\.name: .* ground"),
        (CONFIG, [MAP % ", cells: 1000}, {name: power, range: [0, 1], cells: 1000}]}"], "1000000"),
        (CONFIG, [MAP % "}, {name: speed, range: [0, 1]}]}"], "axes: .* speed, speed"),
        (CONFIG, ["measures=[speed, power, gait]"], r"measures\.2: 'gait'"),
        (CONFIG, ["measures=[energy]"], "'energy'"),
        (WALKER, ["measures=[airborne]", "task={type: walk}"], "'airborne' .* term"),
        (WALKER, ["measures=[cost_of_transport]", "world.gravity=0"], "without gravity"),
        (CONFIG, ["evolution.learning.learners=201"], "all 200 individuals can learn, got 201"),
        (CONFIG, ["evolution.learning.every=2", "evolution.elites=0"], "from 1 to all"),
        (CONFIG, ["evolution.learning.stepps=2"], "steps"),
        (CONFIG, ["evolution.learning.every=0"], "every"),
        (WALKER, REAL, "or controller.graded to true"),
    ],
)
def test_invalid_evolution_and_measures_are_rejected(path, settings, words):
    with pytest.raises(ConfigError, match=words):
        build(path, *settings)


def own(tmp_path, monkeypatch, *settings, **changes):
    name = f"climbers_{abs(hash(str(changes)))}"
    (tmp_path / f"{name}.py").write_text(OWN.format(**GOOD | changes))
    monkeypatch.chdir(tmp_path)
    given = f"evolution={{type: '{name}:Climber', population: 9, options: {{sigma: 0.2}}}}"
    return build(CONFIG, given, *settings)


def test_a_strategy_of_ones_own(tmp_path, monkeypatch):
    strategy = own(tmp_path, monkeypatch).strategy
    assert (strategy.population, strategy.sigma) == (9, 0.2)


def test_own_strategy_may_use_terms_measures_and_trials(tmp_path, monkeypatch):
    tell = (
        "genes[:, jnp.argmax(evaluation.trial_fitness[2] + evaluation.descriptors['speed']"
        " + evaluation.terms['power'])]"
    )
    settings = "measures=[speed, power]", "simulation.trials=3", "noise.push=0.01"
    strategy = own(tmp_path, monkeypatch, *settings, tell=tell).strategy
    assert strategy.population == 9


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"init": "1 / 0"}, r"evolution\.type: Climber\.init fails at .*\(ZeroDivisionError"),
        ({"ask": "noise"}, "Climber.ask .* pair"),
        ({"tell": "genes"}, "Climber.ask (fails|must)"),
        ({"tell": "evaluation.fitnes"}, r"Climber\.tell fails at .*\(AttributeError"),
        ({"init": '"x"', "ask": "noise, state"}, "Climber.ask must return arrays"),
        ({"names": "1 / 0"}, r"Climber\.metric_names fails at .*\(ZeroDivisionError"),
        ({"names": '"spread"'}, "metric_names must be a tuple"),
        ({"names": '("best_energy",)'}, "'best_energy' again"),
        ({"names": '("spread", "m")'}, "Climber.metrics must return {m: .*got {spread: "),
        ({"names": "()"}, "Climber.metrics must return {}, got {spread: "),
        ({"metrics": "1 / 0"}, r"Climber\.metrics fails at .*\(ZeroDivisionError"),
        ({"metrics": '{"spread": state[:3]}'}, r"got {spread: float32\[3\]}"),
        ({"population": "eqx.field(default=5, init=False)"}, "population: 9: Climber"),
    ],
)
def test_return_values_of_an_own_strategy_are_checked(tmp_path, monkeypatch, changes, words):
    with pytest.raises(ConfigError, match=words):
        own(tmp_path, monkeypatch, **changes)


def test_elites_learn_only_if_configured():
    assert build(CONFIG).learning is None
    assert build(CONFIG, "evolution.learning.every=3").learning == Learning(3, 16, 5)
    few = ("evolution.elites=4", "evolution.learning.steps=2")
    assert build(CONFIG, *few).learning == Learning(5, 4, 2)
    # Postures learn only with graded genes.
    assert build(WALKER, *REAL, "controller.graded=true").learning == Learning(3, 2, 5)
