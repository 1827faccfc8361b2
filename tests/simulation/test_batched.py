"""Different bodies in one program move like each of them alone."""

import functools

import jax
import numpy as np
import pytest

from evo_cpg.creature.algebra.numerics import is_number
from evo_cpg.io.batched import BodyPlan, build_batch
from evo_cpg.io.build import build_experiment
from evo_cpg.io.errors import ConfigError
from evo_cpg.io.load import load_config
from evo_cpg.io.numbers import number_at, with_numbers
from evo_cpg.simulation.batched import Inputs
from evo_cpg.simulation.rollout import rollout
from tiny_run import REPOSITORY, TINY, VISCOUS

SWIMMER = REPOSITORY / "configs" / "iwadate2010_swimmer.yaml"
WALKER = REPOSITORY / "configs" / "fukui2003_model1.yaml"


def varied(material: str, side: int, actuator: str, last: str) -> tuple[str, ...]:
    """Return the keys of the numbers that differ."""
    limb = "creature.bodies.1"
    return (
        *(f"creature.materials.{material}.density", "creature.bodies.0.shape.size.0"),
        *(f"{limb}.shape.size.{side}", f"{limb}.joint.at.0", f"{limb}.joint.actuator.{actuator}"),
        last,
    )


SWIMMERS = varied("body", 1, "gain", "world.water.form_drag")
WALKERS = varied("leg", 2, "stiffness", "world.gravity")
# The trials last a second in water, and a tenth of a second on the ground.
# The hopper is the walker's torso with the upper half of one leg: two bodies to compile, not nine.
HOPPER = "simulation.seconds=0.1", "evolution.mutated_genes=[2,20]"
HILLS = "world.ground.floor={type: hills, seed: 1, height: 0.2, length: 1, clearing: 0.2}"
CASES = {
    "swimmer": (SWIMMER, TINY, SWIMMERS),
    "viscous swimmer": (SWIMMER, (*TINY, *VISCOUS), (*SWIMMERS, "world.water.viscosity")),
    "walker": (WALKER, HOPPER[:1], WALKERS),
    "hopper": (WALKER, HOPPER, WALKERS),
    "hopper on hills": (WALKER, (*HOPPER, HILLS), (*WALKERS, "world.ground.floor.height")),
}
BODIES = 3


def configured(case):
    """Return a case's configuration, the path of its file, and the keys that differ."""
    path, overrides, keys = CASES[case]
    config = load_config(path, list(overrides))
    if case.startswith("hopper"):
        creature = config.creature.model_copy(update={"bodies": config.creature.bodies[:2]})
        config = config.model_copy(update={"creature": creature})
    return config, path, keys


def numbers(config, keys, seed=0):
    """Return numbers within a quarter of the configuration's numbers."""
    rng = np.random.default_rng(seed)
    return {key: number_at(config, key) * rng.uniform(0.75, 1.25, BODIES) for key in keys}


def compiled(batched):
    """Return a compiled trial for any values of the numbers that differ."""
    return jax.jit(lambda values, genes: rollout(batched._replace(values=values), genes))


def genes_of(simulation, dtype):
    return simulation.genome.random(jax.random.key(1), (BODIES,), dtype)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("case", "dtype", "error"),
    [
        ("swimmer", np.float32, 1e-5),
        ("hopper", np.float64, 1e-10),
        ("hopper on hills", np.float64, 1e-10),
        ("walker", np.float64, 1e-10),
        ("viscous swimmer", np.float32, 1e-5),
        ("swimmer", np.float64, 1e-10),
        ("walker", np.float32, 1e-5),
    ],
)
def test_batched_bodies_equal_single_bodies(case, dtype, error, request):
    if dtype == np.float64:
        request.getfixturevalue("x64")
    config, path, keys = configured(case)
    batched = build_batch(config, path, numbers(config, keys))
    genes = genes_of(batched.common, dtype)
    # All individuals have the genes of the last one, so that only their bodies differ.
    genes = np.repeat(genes[:, -1:], BODIES, axis=1)
    together = compiled(batched)(batched.values, genes)
    same = together.terms
    assert together.alive.all()
    last = BODIES - 1
    found = {name: term[last] for name, term in together.terms.items()}
    alone = jax.jit(functools.partial(rollout, batched[last]))(genes[:, last:]).terms
    for name, term in found.items():
        np.testing.assert_allclose(term, alone[name][0], rtol=error, atol=error)
    # The bodies differ in their motion.
    assert max(abs(same[name][0] - term) for name, term in found.items()) > 5 * error


@pytest.mark.parametrize(
    ("name", "overrides"),
    [
        ("turtle", []),
        *(
            pytest.param(name, overrides, marks=pytest.mark.slow)
            for name, overrides in (
                ("two_eyed_swimmer", []),
                ("fukui2003_model1", []),
                ("iwadate2010_swimmer", ["creature.bodies.1.joint.actuator.torque_limit=5"]),
                ("hexapod", ["controller.graded=true"]),
                ("starfish", []),
                ("starfish_land", []),
                ("iwadate2010_salamander_land", []),
                ("salamander_amphibious", []),
                ("salamander_boulders", []),
            )
        ),
    ],
)
def test_a_part_of_every_array_may_be_traced(name, overrides):
    path = REPOSITORY / "configs" / f"{name}.yaml"
    config = load_config(path, ["simulation.seconds=0.0333", *overrides])
    simulation = build_experiment(config, path).simulation
    leaves = jax.tree_util.tree_leaves_with_path(simulation)
    places = [i for i, (_, leaf) in enumerate(leaves) if is_number(leaf) and np.size(leaf) > 1]
    # `build_batch` always traces whole floors.
    floors = [".floor." in jax.tree_util.keystr(leaves[i][0]) for i in places]
    sizes = [np.size(leaves[i][1]) if floor else 1 for i, floor in zip(places, floors, strict=True)]
    inputs = Inputs(tuple(places), tuple(map(np.arange, sizes)))

    def trial(values, genes, keys, situation):
        return rollout(inputs.put(simulation, values), genes, keys, situation).terms

    key = jax.random.key_data(jax.random.key(0))
    found = jax.eval_shape(
        trial,
        [jax.ShapeDtypeStruct((size,), np.float32) for size in sizes],
        jax.ShapeDtypeStruct((simulation.controller.gene_count,), np.float32),
        jax.ShapeDtypeStruct(key.shape, key.dtype),
        jax.ShapeDtypeStruct((), np.int32),
    )
    assert {term.shape for term in found.values()} == {()}


@pytest.mark.parametrize(
    "case", ["hopper", *(pytest.param(x, marks=pytest.mark.slow) for x in ("swimmer", "walker"))]
)
def test_a_traced_build_equals_a_numpy_build(case):
    config, path, keys = configured(case)
    given = numbers(config, keys)
    plan = BodyPlan(config, path, {key: values[:1] for key, values in given.items()})
    found, fits = plan.build(given)
    assert fits.sum() >= 2 and not plan.hindrance
    built = build_batch(config, path, {k: v[fits] for k, v in given.items()}, like=plan.batched)
    for values, own in zip(found, built.values, strict=True):
        atol = 1e-14 * np.abs(own).max()
        np.testing.assert_allclose(values[:, fits], own, rtol=1e-12, atol=atol)
    if not fits.all():
        # Limbs of one walker can touch that cannot touch in the others.
        with pytest.raises(ConfigError, match="cannot touch in the other bodies"):
            build_batch(config, path, {k: v[~fits] for k, v in given.items()}, like=plan.batched)


@pytest.mark.slow
def test_a_compiled_program_serves_other_bodies():
    path, overrides, keys = CASES["swimmer"]
    config = load_config(path, [*overrides, "simulation.seconds=0.0833"])
    batched = build_batch(config, path, numbers(config, keys))
    others = build_batch(config, path, numbers(config, keys, seed=1), like=batched)
    genes = genes_of(batched.common, np.float32)
    run = compiled(batched)
    run(batched.values, genes)
    found = run(others.values, genes)
    assert run._cache_size() == 1
    alone = rollout(others[2], genes[:, 2:3])
    for name, term in found.terms.items():
        np.testing.assert_allclose(term[2], alone.terms[name][0], rtol=1e-5, atol=1e-5)


@pytest.mark.slow
def test_bodies_with_different_pairs_check_all_pairs():
    """One body has legs that cannot meet, one has legs that overlap from the start."""
    path, overrides, _ = CASES["walker"]
    config = load_config(path, list(overrides))
    names = [body.name for body in config.creature.bodies]
    hips = [f"creature.bodies.{i}.joint.at.0" for i, name in enumerate(names) if "front" in name]
    hips = [key for key in hips if number_at(config, key) > 0]
    thickness = f"creature.bodies.{names.index('front_left_lower')}.shape.size.0"

    def pairs(simulation):
        found, of = simulation.world.pairs, simulation.world.tree.names
        return {frozenset((of[i], of[j])) for i, j in zip(found.first, found.second, strict=True)}

    given = {key: np.array([0.26, 1.2, 0.26]) for key in hips} | {
        thickness: np.array([0.08, 0.08, 1.1])
    }
    alone = [
        pairs(
            build_experiment(
                with_numbers(config, {k: v[i] for k, v in given.items()}, path), path
            ).simulation
        )
        for i in range(3)
    ]
    batched = build_batch(config, path, given)
    overlaps = alone[0] - alone[2]
    assert alone[1] < alone[0] and overlaps - alone[1]
    assert pairs(batched.common) == alone[0] | alone[1] | alone[2]
    plan = BodyPlan(config, path, given)
    values, fits = plan.build(given)
    assert fits.all()
    for each in (batched, batched._replace(values=tuple(values))):
        for i in range(3):
            simulation = each[i]
            assert pairs(simulation) == pairs(batched.common)
            # Pairs that overlap from the start exert no force.
            found = simulation.world.pairs
            idle = np.array(found.owners).T[found.stiffness == 0]
            of = simulation.world.tree.names
            assert {frozenset((of[a], of[b])) for a, b in idle} == (overlaps if i == 2 else set())
    apart = with_numbers(config, {k: v[1] for k, v in given.items()}, path)
    wider = BodyPlan(apart, path, {k: v[1:2] * 1.1 for k, v in given.items()})
    assert wider.build(given)[1].tolist() == [False, True, False]
    with pytest.raises(ConfigError, match="limbs can touch that cannot touch in the other bodies"):
        build_batch(apart, path, {k: v[:1] for k, v in given.items()}, like=wider.batched)


def test_a_number_that_must_not_differ_is_named():
    path, overrides, keys = CASES["swimmer"]
    config = load_config(path, list(overrides))
    density = build_batch(config, path, numbers(config, keys[:1]))
    for given, like, words in (
        (numbers(config, keys[-1:]), density, "form_drag differs, but is not an input"),
        ({"world.water.from_drag": np.ones(2)}, None, "does not exist"),
        ({keys[0]: np.array([1000.0, -1.0])}, None, "greater than 0"),
        ({keys[0]: np.full(2, 1000.0)}, None, "all simulations equal"),
    ):
        with pytest.raises(ConfigError, match=words):
            build_batch(config, path, given, like=like)
