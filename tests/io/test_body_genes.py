"""Genes of the body: factors, the numbers that they scale, and bodies built from genomes."""

import jax
import numpy as np
import pytest

import evo_cpg as evo
from evo_cpg.io.body_genes import config_of, scaling_of
from evo_cpg.io.errors import KeyProblem
from evo_cpg.io.load import dump_config, load_config
from evo_cpg.io.run import open_run
from evo_cpg.simulation.simulation import BodyGenes
from evo_cpg.training.devices import population_mesh
from evo_cpg.training.evaluate import compile_trials
from tiny_run import CONFIG, PAIR, REPOSITORY

WALKER = REPOSITORY / "configs" / "fukui2003_model1.yaml"
SIZES = (
    'evolution.body={"*.length": {range: [0.1, 0.4], genes: one}, '
    '"*.girth": {range: [0.5, 2], genes: one}}'
)
SHORT = (*PAIR, "simulation.seconds=0.1", SIZES)


def scaling(path, body):
    return scaling_of(load_config(path, [f"evolution.body={body}"]), False)


def test_a_gene_covers_its_range_and_is_mirrored_beyond():
    genes = BodyGenes(("a", "b"), (0.5, 1.0), (2.0, 4.0), (True, False), (1.0, 1.0))
    ends = np.array([[-1.0, 0.0, 1.0, 2.0, 3.0, -2.0]] * 2)
    expected = [[0.5, 1.0, 2.0, 1.0, 0.5, 1.0], [1.0, 2.5, 4.0, 2.5, 1.0, 2.5]]
    np.testing.assert_allclose(genes.factors(ends), expected, rtol=1e-12)


def test_bits_give_256_values_and_neighbours_differ_in_one():
    genes = BodyGenes(("a",), (0.0,), (255.0,), (False,), (1.0,), binary=True)
    number = np.arange(256)
    code = number ^ (number >> 1)
    bits = (code >> np.arange(8)[::-1, None]) & 1
    np.testing.assert_allclose(genes.factors(bits.astype(float))[0], number, rtol=1e-12)
    assert (np.abs(np.diff(bits, axis=1)).sum(0) == 1).all()


def test_a_length_moves_joints_and_a_cross_section_strengthens_motors():
    found = scaling(WALKER, '{"*_upper.length": {range: [0.12, 0.48]}, "torso.y": [0.15, 0.6]}')
    assert found.genes.names == ("front_left_upper.length", "hind_left_upper.length", "torso.y")
    assert found.genes.low == (0.5, 0.5, 0.5) and found.genes.high == (2.0, 2.0, 2.0)
    numbers = found.numbers(np.array([2.0, 1.0, 1.5]))
    bodies, joint = "creature.bodies", "creature.bodies.1.joint"
    assert numbers[f"{bodies}.1.shape.size.2"] == pytest.approx(2 * 0.24)
    assert numbers[f"{bodies}.3.shape.size.2"] == pytest.approx(2 * 0.24)
    assert numbers[f"{bodies}.5.shape.size.2"] == pytest.approx(0.24)
    assert numbers[f"{joint}.child_at.2"] == pytest.approx(2 * 0.12)
    assert numbers[f"{bodies}.2.joint.at.2"] == pytest.approx(2 * -0.12)
    assert numbers[f"{joint}.at.1"] == pytest.approx(1.5 * 0.11)
    assert f"{joint}.actuator.torque_limit" not in numbers
    thick = scaling(WALKER, '{"front_*_upper.girth": [0.5, 2], "front_*_upper.strength": [0.5, 2]}')
    torque = thick.numbers(np.array([1.5, 1.2]))[f"{joint}.actuator.torque_limit"]
    assert torque == pytest.approx(40 * 1.5**2 * 1.2)


def test_factors_of_several_genes_are_multiplied():
    body = '{"*.scale": {range: [0.5, 2], genes: one}, "torso.scale": [0.5, 2]}'
    numbers = scaling(WALKER, body).numbers(np.array([1.1, 1.2]))
    assert numbers["creature.bodies.0.shape.size.0"] == pytest.approx(0.6 * 1.1 * 1.2)
    assert numbers["creature.bodies.1.joint.at.0"] == pytest.approx(0.26 * 1.1 * 1.2)
    assert numbers["creature.bodies.1.shape.size.0"] == pytest.approx(0.08 * 1.1)


ANT = REPOSITORY / "configs" / "ant.yaml"
STARFISH = REPOSITORY / "configs" / "starfish_land.yaml"


@pytest.mark.parametrize(
    ("config", "body", "words"),
    [
        (WALKER, '{"*_femur.length": [0.1, 0.3]}', "matches no body: valid here: front_left_lower"),
        (WALKER, '{"torso.lenght": [0.1, 0.3]}', "did you mean 'length'"),
        (WALKER, '{"torso.length": [0.3, 0.1]}', "must rise, got 0.3 to 0.1"),
        (WALKER, '{"torso.length": [-0.3, 0.1]}', "must be positive"),
        (WALKER, '{"torso.length": 3}', "a list of 2 numbers or a section"),
        (WALKER, '{"torso.length": {range: [1, 2], scal: log}}', "did you mean 'scale'"),
        (WALKER, '{"torso.strength": [1, 2]}', "changes nothing"),
        (WALKER, '{"*.length": {range: [0.1, 0.3], genes: one}}', "differ .0.24, 0.6 m."),
        (WALKER, "{creature.bodies.0.shape.siz.0: [0.1, 0.3]}", "did you mean creature.bodies.0"),
        (CONFIG, '{"segment{i}.length": [0.1, 0.3]}', "joint.at .* lies on several bodies"),
        (CONFIG, '{"segment3.length": [0.1, 0.3]}', "not all copies of 'segment{i}'"),
        (CONFIG, "{creature.bodies.0.shape.size.0: {range: [0, 1], scale: log}}", "be positive"),
        (ANT, '{"torso.length": [0.1, 0.3]}', "has the shape sphere. Only scale and"),
        (ANT, '{"torso.x": [0.1, 0.3]}', "Only scale and strength apply"),
        (ANT, '{"torso.girth": [0.5, 2]}', "is a sphere. Use scale"),
        (ANT, '{"aux_1.y": [0.1, 0.3]}', "has one radius"),
        (STARFISH, '{"disc.x": [0.1, 0.3]}', "is copied around its parent"),
        (CONFIG, '{"head.scale": [0.5, 2]}', "joint.at .* lies on several bodies"),
    ],
)
def test_wrong_genes_are_named(config, body, words):
    with pytest.raises(evo.ConfigError, match=rf"evolution\.body\..*{words}"):
        evo.load(config, [f"evolution.body={body}"])


BLOCK = "{type: box, size: [0.3, 0.2, 0.1]}"
SECTIONS = "[{at: [-1, 0, 0], width: 1, height: 1}, {at: [1, 0, 0], width: 1, height: 1}]"
LOFT = f"{{type: loft, sections: {SECTIONS}}}"
MESH = (
    "{type: mesh, vertices: [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], "
    "faces: [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]}"
)


@pytest.mark.parametrize(
    ("shape", "others", "gene", "words"),
    [
        (BLOCK, [], "torso.x", "has turned parts, so use scale"),
        (BLOCK, ["creature.bodies.0.parts=[]"], "torso.x", "inertia in numbers, so use scale"),
        (LOFT, [], "torso.girth", "is a loft, of which only the scale can evolve"),
        (MESH, [], "torso.scale", "is a mesh, whose size cannot evolve"),
    ],
)
def test_what_a_shape_cannot_do_is_named(shape, others, gene, words):
    given = [f"creature.bodies.0.shape={shape}", *others, f"evolution.body={{{gene}: [0.2, 0.4]}}"]
    with pytest.raises(KeyProblem, match=words):
        scaling_of(load_config(ANT, given), False)


@pytest.fixture(scope="module")
def experiment():
    jax.devices()
    return evo.load(CONFIG, SHORT)


@pytest.mark.slow
def test_a_body_has_the_same_bits_in_any_population(experiment):
    bodies, rng = experiment.parts.simulation.bodies, np.random.default_rng(0)
    genes = rng.uniform(-3, 3, (2, 150)).astype(np.float32)
    together, order = bodies.values(genes), rng.permutation(150)
    for some in (slice(7, 8), order, order[:20]):
        for one, every in zip(bodies.values(genes[:, some]), together, strict=True):
            assert np.array_equal(one, every[:, some])


def test_the_program_builds_what_the_configuration_describes(experiment):
    simulation, genes = experiment.parts.simulation, np.array([0.3, -0.6], np.float32)
    genome = np.concatenate([np.zeros(simulation.genome.count - 2, np.float32), genes])
    own = experiment.with_body(genome).parts.simulation.world.tree
    paths = [path for path, _ in simulation.bodies.inputs]
    values = simulation.bodies.values(genes[:, None])
    mass = values[paths.index(".world.tree.mass")][:, 0]
    np.testing.assert_allclose(mass, own.mass, rtol=1e-12)
    sizes = simulation.genome.sizes_of(genome)
    assert sizes["head.length"] == pytest.approx(0.295, rel=1e-6)
    assert sizes["head.girth"] == pytest.approx(0.5 * 4**0.2, rel=1e-6)
    config = config_of(experiment.config, simulation, genome, experiment.source)
    assert (
        config.evolution.body == {}
        and config.creature.bodies[0].shape.size[0] == sizes["head.length"]
    )


def test_other_numbers_of_evolving_bodies_are_refused(experiment):
    genomes, key = experiment.random_genomes(0, 2), "creature.materials.body.density"
    with pytest.raises(ValueError, match="the genomes define the bodies"):
        experiment.evaluate(0, genomes, {key: [900.0, 1000.0]})
    with pytest.raises(ValueError, match="the genome defines the body"):
        experiment.fitness_function(numbers=[key])


@pytest.mark.slow
def test_a_run_is_verified_and_its_body_exported(tmp_path):
    made = evo.load(CONFIG, [*SHORT, "evolution.generations=2"])
    run = evo.train(made, tmp_path / "run")
    assert evo.verify(run.folder).exact
    opened = open_run(run.folder).with_champion()
    sizes = opened.experiment.simulation.genome.sizes_of(opened.champion.genes)
    assert np.isfinite([opened.folder.history()[f"best_{name}"] for name in sizes]).all()
    own = opened.own.config
    (tmp_path / "animal.yaml").write_text(dump_config(own))
    assert load_config(tmp_path / "animal.yaml") == own
    assert own.creature.bodies[0].shape.size[0] == pytest.approx(sizes["head.length"], rel=1e-12)


@pytest.mark.slow
def test_a_body_that_does_not_fit_counts_as_diverged(experiment, monkeypatch):
    simulation = experiment.parts.simulation
    kind, build = type(simulation.bodies), type(simulation.bodies).values

    def some_misfit(self, genes):
        return [np.where(genes[0] > 0, np.nan, value) for value in build(self, genes)]

    monkeypatch.setattr(kind, "values", some_misfit)
    genes = np.asarray(simulation.genome.random(jax.random.key(0), (6,)))
    outcome = compile_trials(simulation, population_mesh(1))(genes)
    assert np.array_equal(outcome.alive, ~(genes[-2] > 0)) and 0 < outcome.alive.sum() < 6


@pytest.mark.slow
def test_an_individual_has_the_same_bits_in_any_batch(experiment):
    simulation = experiment.parts.simulation
    genes = np.asarray(simulation.genome.random(jax.random.key(0), (70,)))
    meshes = population_mesh(1), population_mesh()
    whole = compile_trials(simulation, meshes[0])(genes)
    for mesh in meshes:
        run = compile_trials(simulation, mesh)
        for some in (np.array([33]), np.arange(70)[::-1]):
            found = run(genes[:, some])
            for name, values in whole.terms.items():
                assert np.array_equal(found.terms[name], values[some])


@pytest.mark.slow
@pytest.mark.usefixtures("x64")
def test_an_exported_body_repeats_the_motion(experiment):
    """With float64, numbers that are constants round almost like numbers that are inputs."""
    simulation = experiment.parts.simulation
    genes = np.asarray(simulation.genome.random(jax.random.key(1), (3,)), float)
    evolved = compile_trials(simulation, population_mesh(1))(genes)
    for i in range(3):
        own = experiment.with_body(genes[:, i]).parts.simulation
        alone = compile_trials(own, population_mesh(1))(genes[: own.genome.count, i : i + 1])
        for name, values in evolved.terms.items():
            np.testing.assert_allclose(alone.terms[name][0], values[i], rtol=1e-9)


@pytest.mark.slow
@pytest.mark.usefixtures("x64")
def test_the_gradient_by_genes_of_the_body_equals_differences():
    made = evo.load(CONFIG, SHORT).with_fitness(lambda terms: terms["energy"])
    fitness = jax.jit(jax.value_and_grad(made.fitness_function()))
    genome = np.concatenate([made.random_genomes(0, 1)[0, :-2].astype(float), [0.2, -0.3]])
    _, slope = fitness(genome)
    for gene in (-1, -2):
        shift = np.zeros(len(genome))
        shift[gene] = 1e-4
        difference = (fitness(genome + shift)[0] - fitness(genome - shift)[0]) / 2e-4
        assert float(slope[gene]) == pytest.approx(float(difference), rel=1e-5)


@pytest.mark.slow
def test_the_best_proportions_are_those_of_a_grid():
    """The controller's genes stay, and the configuration's search moves only the body's genes."""
    path = REPOSITORY / "configs" / "evolving_swimmer.yaml"
    body = '{"*.length": {range: [0.1, 0.3], genes: one}, "*.z": {range: [0.05, 0.2], genes: one}}'
    search = ["evolution.population=64", "evolution.elites=8", "evolution.mutation_rate=0.5"]
    made = evo.load(path, ["simulation.seconds=5", f"evolution.body={body}", *search])
    made = made.with_fitness(lambda terms: -terms["distance"])
    many, edge = made.random_genomes(0, 256), np.linspace(-1, 1, 25)
    many[:, -2:] = 0
    genome = many[made.evaluate(0, many).fitness.argmax()]
    grid = np.array(np.meshgrid(edge, edge)).reshape(2, -1).T

    def fitness(proportions):
        genomes = np.tile(genome, (len(proportions), 1))
        genomes[:, -2:] = proportions
        return made.evaluate(0, genomes)

    scanned = fitness(grid).fitness
    assert np.isfinite(scanned).mean() > 0.95
    best, spread = scanned.max(), np.ptp(scanned[np.isfinite(scanned)])
    tried = np.random.default_rng(0).uniform(-1, 1, (64, 2)).astype(np.float32)
    tell = jax.jit(made.parts.strategy.tell)
    for generation in range(15):
        tried = np.asarray(tell(jax.random.key(generation), (), tried.T, fitness(tried))).T
    found = fitness(tried).fitness
    # The neighbours of the grid's best point have at least this fitness.
    assert found.max() >= best - 0.02 * spread
    mirrored = 1 - np.abs((tried[found.argmax()] + 1) % 4 - 2)
    good = grid[scanned >= best - 0.02 * spread]
    assert np.abs(good - mirrored).max(1).min() <= 2 * (edge[1] - edge[0])
