"""The estimate of a trial's operations against the operations in its native code."""

import jax
import pytest

from evo_cpg.config.build import build_experiment
from evo_cpg.config.load import load_config
from evo_cpg.fusion.compile import optimize
from evo_cpg.fusion.frontend.primitives import fused_p
from evo_cpg.simulation.operations import estimate_operations
from evo_cpg.simulation.rollout import rollout
from evo_cpg.simulation.simulation import Simulation
from tiny_run import CONFIG, PAIR, REPOSITORY, VISCOUS

# Largest relative error of the estimate.
_ERROR = 0.4

_LAND = (*PAIR, "world.water=null", "world.ground={}")
_LIFT = ("creature.bodies.1.shape.size.1=0.02", "world.water.lift=true")
_APART = "creature.self_collision=false"


def simulation_of(*overrides: str, config: str = CONFIG.stem) -> Simulation:
    path = REPOSITORY / "configs" / f"{config}.yaml"
    return build_experiment(load_config(path, overrides), path).simulation


def true_operations(simulation: Simulation) -> int:
    """Count the operations of the programs that are compiled to native code."""
    genes = jax.ShapeDtypeStruct((simulation.controller.gene_count, 16), "float32")
    keys = jax.eval_shape(lambda: jax.random.key_data(jax.random.split(jax.random.key(0), 16)).T)
    trial = jax.ShapeDtypeStruct((16,), "int32")
    jaxpr = jax.make_jaxpr(lambda *given: rollout(simulation, *given))(genes, keys, trial)
    programs = [each.params["program"] for each in jaxpr.eqns if each.primitive is fused_p]
    return sum(optimize(each).operations for each in programs)


def assert_about(simulation: Simulation) -> None:
    true = true_operations(simulation)
    assert estimate_operations(simulation).total == pytest.approx(true, rel=_ERROR)


@pytest.mark.parametrize(
    "overrides",
    [
        PAIR,
        _LAND,
        pytest.param((*PAIR, *VISCOUS), marks=pytest.mark.slow),
        pytest.param((*PAIR, *VISCOUS, *_LIFT), marks=pytest.mark.slow),
    ],
    ids=["in water", "on land", "in water with a viscosity", "with lift"],
)
def test_estimate_is_near_the_true_number(overrides):
    assert_about(simulation_of(*overrides))


@pytest.mark.slow
@pytest.mark.parametrize(
    "config",
    ["hexapod", "turtle", "iwadate2010_swimmer", "iwadate2010_salamander_water",
     "salamander_amphibious", "salamander_boulders", "starfish_land", "fukui2003_model1"],
)  # fmt: skip
def test_estimate_is_near_the_true_number_of_shipped_animals(config):
    assert_about(simulation_of(config=config))


@pytest.mark.slow
@pytest.mark.parametrize("segments", [14, 30])
def test_estimate_is_near_the_true_number_of_long_animals(segments):
    """One animal has its pairs written out. The other has loops over pairs."""
    many = f"creature.bodies.1.repeat={segments}"
    assert_about(simulation_of(*_LAND, many))


def test_absent_parts_cost_nothing():
    swimmer, walker = (estimate_operations(simulation_of(*x)) for x in (PAIR, _LAND))
    assert swimmer.water > 0 and swimmer.ground == swimmer.obstacles == swimmer.noise == 0
    assert walker.water == 0 and walker.ground > 0
    blocks = "world.ground.obstacles=[{type: boulder, centre: [3, 0, 0], radius: 0.3}]"
    among = estimate_operations(simulation_of(*_LAND, blocks))
    assert among.obstacles > 0 and among.ground == walker.ground
    noisy = estimate_operations(simulation_of(*_LAND, "noise.joint_angle_deg=1"))
    assert noisy.noise > 0 and noisy.total - noisy.noise == walker.total
    assert estimate_operations(simulation_of(*_LAND, "simulation.substeps=8")) == walker


def test_pairs_cost_nothing_without_self_collision():
    many = (*_LAND, "creature.bodies.1.repeat=6")
    touching, apart = (estimate_operations(simulation_of(*x)) for x in (many, (*many, _APART)))
    assert touching.pairs > 0 and apart.pairs == 0
    assert touching.total - touching.pairs == apart.total


@pytest.mark.slow
def test_muscles_add_less_than_a_fifth_of_the_operations():
    motors = [f"creature.bodies.{i}.joint.actuator={{gain: 0.01}}" for i in (1, 2, 3)]
    of_motors, of_muscles = (
        true_operations(simulation_of(*given, config="eel")) for given in (motors, ())
    )
    assert of_motors < of_muscles < 1.2 * of_motors
