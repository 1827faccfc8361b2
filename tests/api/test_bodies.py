"""Individuals with different bodies, and the fitness as a function of a body's numbers."""

import jax
import numpy as np
import pytest

import evo_cpg as evo
from evo_cpg.io.numbers import number_at
from tiny_run import CONFIG, REPOSITORY, TINY

WALKER = REPOSITORY / "configs" / "fukui2003_model1.yaml"

DENSITY, LENGTH = "creature.materials.body.density", "creature.bodies.1.shape.size.0"


@pytest.fixture(scope="module")
def experiment():
    jax.devices()
    loaded = evo.load(CONFIG, [*TINY, "simulation.seconds=0.5"])
    return loaded.with_fitness(lambda terms: terms["energy"])


@pytest.fixture(scope="module")
def genomes(experiment):
    return experiment.random_genomes(0, 3)


@pytest.fixture(scope="module")
def numbers(experiment):
    """Return the numbers of three bodies. The second has the configuration's numbers."""
    own = {DENSITY: 1000.0, LENGTH: experiment.config.creature.bodies[1].shape.size[0]}
    return {key: value * np.array([0.8, 1.0, 1.3]) for key, value in own.items()}


def assert_as_alone(experiment, genomes, numbers, together):
    """Check that each individual has the fitness of an experiment with its numbers."""
    for i in range(len(genomes)):
        body = experiment.with_numbers({key: values[i] for key, values in numbers.items()})
        alone = body.evaluate(0, genomes[i : i + 1])
        np.testing.assert_allclose(together.fitness[i], alone.fitness[0], rtol=1e-4)


@pytest.mark.slow
def test_each_body_equals_an_experiment_with_its_numbers(experiment, genomes, numbers):
    together = experiment.evaluate(0, genomes, numbers)
    assert_as_alone(experiment, genomes, numbers, together)
    same = experiment.evaluate(0, genomes)
    np.testing.assert_allclose(together.fitness[1], same.fitness[1], rtol=1e-4)
    assert np.abs(together.fitness / same.fitness - 1)[[0, 2]].min() > 1e-2


def test_one_program_serves_all_populations(experiment, genomes, numbers):
    first, _ = experiment._bodies.trials(numbers, 3)
    others = {key: values[::-1] * 1.01 for key, values in numbers.items()}
    again, _ = experiment._bodies.trials(others, 3)
    assert again is first
    assert experiment._bodies.trials({DENSITY: np.full(3, 1000.0)}, 3) is None


@pytest.mark.slow
def test_a_longer_limb_shelters_other_surface_points(genomes):
    """Other points are sheltered in each body. They have no area, even at the surface."""
    loaded = evo.load(CONFIG, [*TINY, "simulation.seconds=0.5", "world.water.surface=0.02"])
    loaded = loaded.with_fitness(lambda terms: terms["energy"])
    lengths = number_at(loaded.config, LENGTH) * np.array([1.0, 1.3, 2.5])
    together = loaded.evaluate(0, genomes, {LENGTH: lengths})
    plan, _ = loaded._bodies._made[frozenset([LENGTH])]
    assert plan.build({LENGTH: lengths})[1].all()
    dry = [
        [(patch.normal_area == 0).sum() for patch in plan.batched[i].world.forces[0].patches]
        for i in range(len(plan.batched.values[0][0]))
    ]
    assert len({*map(tuple, dry)}) > 1
    assert_as_alone(loaded, genomes, {LENGTH: lengths}, together)


@pytest.mark.slow
def test_bodies_that_do_not_fit_the_plan_are_built_one_by_one(experiment, genomes):
    """Two limits of one joint are checked together, which no compiled program can do."""
    middle = experiment.config.creature.bodies[1].joint.limits_deg
    keys = [f"creature.bodies.1.joint.limits_deg.{i}" for i in range(2)]
    numbers = {key: middle[i] * np.array([0.5, 0.8, 1.1]) for i, key in enumerate(keys)}
    together = experiment.evaluate(0, genomes, numbers)
    plan, _ = experiment._bodies._made[frozenset(keys)]
    assert plan.hindrance == "numbers are checked together"
    assert_as_alone(experiment, genomes, numbers, together)


@pytest.mark.slow
def test_a_new_pair_of_colliding_limbs_makes_a_new_plan():
    hips = [f"creature.bodies.{i}.joint.at.0" for i in (1, 3)]
    loaded = evo.load(WALKER, ["simulation.seconds=0.05"]).with_numbers(dict.fromkeys(hips, 1.2))
    genomes = loaded.random_genomes(0, 2)
    apart = {key: np.array([1.2, 1.3]) for key in hips}
    assert np.isfinite(loaded.evaluate(0, genomes, apart).fitness).all()
    first, _ = loaded._bodies._made[frozenset(hips)]
    mixed = {key: np.array([1.2, 0.25]) for key in hips}
    together = loaded.evaluate(0, genomes, mixed)
    assert loaded._bodies._made[frozenset(hips)][0] is not first
    assert_as_alone(loaded, genomes, mixed, together)


@pytest.mark.slow
def test_a_kink_refuses_the_derivative_but_not_the_value():
    """The initial height follows the longest lower leg."""
    loaded = evo.load(WALKER, ["simulation.seconds=0.0333"])
    key = "creature.bodies.2.shape.size.2"
    genome, length = loaded.random_genomes(0, 1)[0], np.array([number_at(loaded.config, key)])
    fitness = loaded.fitness_function(numbers=[key])
    assert np.isfinite(jax.jit(fitness)(genome, length * 1.1))
    with pytest.raises(evo.ConfigError, match=r"size\.2: 0\.24 is at a kink of .*no derivative"):
        jax.eval_shape(jax.grad(fitness, 1), genome, length)


def test_wrong_numbers_are_named(experiment, genomes, numbers):
    with pytest.raises(ValueError, match=r"each of the 3 individuals, got the shape \(2,\)"):
        experiment.evaluate(0, genomes, {DENSITY: [1000.0, 900.0]})
    with pytest.raises(evo.ConfigError, match=r"did you mean creature\.materials\.body\.density"):
        experiment.evaluate(0, genomes, {"creature.materials.body.densty": [1.0, 2.0, 3.0]})
    with pytest.raises(evo.ConfigError, match="greater than 0"):
        experiment.evaluate(0, genomes, {DENSITY: [1000.0, 900.0, -1.0]})
    with pytest.raises(evo.ConfigError, match=r"did you mean"):
        experiment.with_numbers({"creature.materials.body.densty": 1.0})
    fitness = experiment.fitness_function(numbers=[DENSITY])
    with pytest.raises(ValueError, match=r"values must have the shape \(1,\), got none"):
        fitness(genomes[0])
    with pytest.raises(evo.ConfigError, match="greater than 0"):
        fitness(genomes[0], np.array([-1.0]))


@pytest.mark.slow
def test_values_that_change_the_layout_are_refused(experiment, genomes):
    fitness = experiment.fitness_function(numbers=["controller.cpg.time_scale"])
    words = r"another layout at controller\.cpg\.time_scale=0\.1"
    with pytest.raises(evo.ConfigError, match=words):
        fitness(genomes[0], np.array([0.1]))
    compiled = jax.jit(jax.grad(fitness, 1))
    with pytest.raises(RuntimeError, match=words):
        compiled(genomes[0], np.array([0.1])).block_until_ready()


@pytest.mark.slow
@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize(
    "overrides", [["creature.bodies.1.repeat=1"], []], ids=["two bodies", "three bodies"]
)
def test_the_gradient_by_body_numbers_equals_finite_differences(overrides):
    loaded = evo.load(CONFIG, [*TINY, *overrides, "simulation.seconds=0.1333"])
    experiment = loaded.with_fitness(lambda terms: terms["energy"])
    genome = experiment.random_genomes(0, 1)[0].astype(np.float64)
    values = np.array([900.0, 0.2])
    fitness = experiment.fitness_function(numbers=[DENSITY, LENGTH])
    value, slope = jax.jit(jax.value_and_grad(fitness, 1))(genome, values)

    def rebuilt(density, length):
        body = experiment.with_numbers({DENSITY: density, LENGTH: length})
        return float(jax.jit(body.fitness_function())(genome))

    assert float(value) == pytest.approx(rebuilt(*values), rel=1e-9)
    shift = np.array([1.0, -3e-4])
    difference = (rebuilt(*(values + shift)) - rebuilt(*(values - shift))) / 2
    assert float(slope @ shift) == pytest.approx(difference, rel=1e-5)
