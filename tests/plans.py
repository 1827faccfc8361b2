"""Experiments whose body plans evolve, and random plans, for several tests."""

import functools

import jax
import jax.numpy as jnp
import numpy as np

from evo_cpg.creature.development import Plan
from evo_cpg.creature.graph import GraphLayout, PlanGraph
from evo_cpg.io.build import build_experiment
from evo_cpg.io.load import check_config
from evo_cpg.io.plans import EvolvedPlans
from evo_cpg.native.jax_internals import quick_jit
from evo_cpg.simulation.batched import BatchedSimulation
from evo_cpg.simulation.recording import Recorder
from evo_cpg.simulation.rollout import rollout

WATER = {"water": {"density": 1000, "form_drag": 1.0, "skin_drag": 0.02, "law": "normal"}}
LAND = {"water": None, "ground": {}}


LIGHT = {"type": "reach_light", "light": {"distance": 3.0, "bearing_deg": 50.0}}


def plan_config(
    world: dict,
    bodies: int,
    seconds: float,
    controller: dict | None = None,
    lit: bool = False,
    **plan,
):
    """Return the contents of a configuration of plans with settings of their own."""
    return {
        "name": "plans",
        "world": world,
        "simulation": {"control_rate_hz": 60, "substeps": 2, "seconds": seconds},
        "controller": {"type": "limb_oscillators", **(controller or {})},
        "task": LIGHT if lit else {"type": "distance"},
        "evolution": {
            "type": "plans",
            "population": 4,
            "elites": 1,
            "plan": {"bodies": bodies, **plan},
        },
    }


def plan_experiment(*given, **plan):
    """Return the experiment of `plan_config`."""
    return build_experiment(check_config(plan_config(*given, **plan), "x.yaml"), "x.yaml")


def plans_of(*given, **plan) -> EvolvedPlans:
    """Return the builder of the plans of `plan_config`."""
    found = plan_experiment(*given, **plan).simulation.plans
    assert isinstance(found, EvolvedPlans)
    return found


def random_genes(plans: EvolvedPlans, count: int, seed: int = 0) -> np.ndarray:
    """Return genes of random plans of at least two bodies, ``(g, count)``, in float64."""
    with jax.enable_x64(True):
        genes = np.asarray(_draw(plans, count + count // 4 + 8)(jax.random.key(seed)))
        kept = genes[:, plans.developed(genes)[0] > 1]
    assert kept.shape[1] >= count
    return kept[:, :count]


@functools.cache
def _draw(plans: EvolvedPlans, count: int):
    return quick_jit(lambda key: plans.random(key, (count,), float))


def motion_of(plans: EvolvedPlans, size: int, **options):
    """Compile recorded trials of plans in the program for some bodies, and return its function.

    It takes the result of `EvolvedPlans.developed` and the individuals. The options are those of
    `Recorder`.
    """
    inputs = plans.inputs(size)
    recorder = Recorder(count=None, **options)

    @quick_jit
    def run(values, genes):
        trials = BatchedSimulation(inputs.common, inputs, (values,))
        return rollout(trials, genes, observers=recorder)

    def of(found, individuals):
        genes, values = plans.given(found, individuals, size)
        return jax.tree.map(np.asarray, run(values, genes))

    return of


def own_motion(plans: EvolvedPlans, genes: np.ndarray, **options):
    """Return the recorded trial of a plan's own creature, and the simulation of the trial."""
    config, own = plans.alone(genes)
    simulation = build_experiment(config, "x.yaml").simulation
    recorder = Recorder(count=None, **options)
    run = quick_jit(lambda genes: rollout(simulation, genes, observers=recorder))
    return jax.tree.map(np.asarray, run(own[:, None])), simulation


def plan_graph(layout: GraphLayout, nodes: list[dict], links: list[tuple[int, dict]]) -> PlanGraph:
    """Return a graph of given nodes and connections (their node, their genes)."""
    genes = {name: np.zeros(shape) for name, shape in layout.shapes.items()}
    for i, node in enumerate(nodes):
        for name, value in (
            {"used": 1, "label": i + 1, "recursion": 1, "size": 0.5} | node
        ).items():
            genes[name][i] = value
    for i, link in links:
        place = int(genes["on"][i].sum())
        for name, value in ({"on": 1, "place": (0.5, 0, 0)} | link).items():
            genes[name][i, place] = value
    return PlanGraph(**{name: jnp.asarray(value, float) for name, value in genes.items()})


def hand_plan(*bodies: dict) -> Plan:
    """Return a plan of bodies: boxes of half extents (0.2, 0.1, 0.1), hinges about z."""
    row = {
        "present": True, "parent": 0, "half": (0.2, 0.1, 0.1), "place": (0.2, 0, 0),
        "rotation": np.eye(3), "mirror": 1.0, "axes": (0, 0, 1), "limit": (0, 0, 1.0),
        "strength": 0.5, "label": 1, "copy": 0, "eye": False,
        "control": np.zeros((3, 5)), "slot": -1,
    }  # fmt: skip
    rows = [row | {"label": i} | body for i, body in enumerate(bodies)]
    rows[0] |= {"parent": -1, "place": (0, 0, 0), "axes": (0, 0, 0), "limit": (0, 0, 0)}
    found = {name: np.array([each[name] for each in rows]) for name in row}
    return Plan(**found | {"axes": found["axes"].astype(bool)})


def paired(label: int, place: tuple[float, float, float], **more) -> list[dict]:
    """Return a pair of limbs of `hand_plan`."""
    mirrored = place[0], -place[1], place[2]
    sides = ((place, 1.0), (mirrored, -1.0))
    return [{"label": label, "place": at, "mirror": side} | more for at, side in sides]
