"""Random body plans at a distance from a light, any of which any brain may drive.

An individual is a *visit*, a column of numbers (`VISIT`): a plan, the place of its light, how well
the brain sees, and the brain's weights. All visits run in the few programs of the plans.
"""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from typing_extensions import override

from evo_cpg.control.body_brain import WEIGHTS, BodyBrain
from evo_cpg.control.controller import Command, Observation
from evo_cpg.control.limb_oscillators import LimbState
from evo_cpg.creature.algebra.linear import expand_dims_like
from evo_cpg.creature.algebra.numerics import xp
from evo_cpg.creature.graph import GraphLayout, PlanGraph
from evo_cpg.io.load import complete_config, read_yaml
from evo_cpg.io.plans import EvolvedPlans
from evo_cpg.io.shipped import shipped
from evo_cpg.simulation.planned import PlanInputs
from evo_cpg.simulation.simulation import Simulation
from evo_cpg.training.devices import population_mesh
from evo_cpg.training.evaluate import compile_trials
from evo_cpg.training.plan_ascent import compile_slopes

VISIT = {"plan": 1, "light": 3, "sight": 1, "weights": sum(WEIGHTS)}
"""Rows of a visit: the number of the plan, the place of the light (m), and the brain's numbers."""

AWAY = 5.0
"""Distance of the light from the start, in body lengths."""

# Least numbers of bodies and of joint axes of a plan, as in the published comparison.
_BODIES, _AXES = 4, 3
# Random plans that are drawn for each plan that is kept.
_DRAWN = 2
# Fractions of the chains that have a second kind of part, and fins.
_LONGER, _FINNED = 0.6, 0.7
# Physics steps in a control step. Trainings exploit the error of longer steps.
_SUBSTEPS = 4


class Visits(PlanInputs):
    """Inputs of plans, followed by the rows of a visit after the plan's number."""

    @override
    def put(self, common: Simulation, values: list[Array]) -> Simulation:
        (flat,), more = values, sum(VISIT.values()) - VISIT["plan"]
        numbers, light, sight, weights = jnp.split(flat, [len(flat) - more + i for i in (0, 3, 4)])
        own = super().put(common, [numbers])
        controller = dataclasses.replace(own.controller, weights=weights, sight=sight[0])
        situation = own.situations[0]._replace(light=tuple(light))
        return dataclasses.replace(own, controller=controller, situations=(situation,))


class AllAlike(BodyBrain):
    """The brain whose axes all get the same command, the mean of their commands."""

    @override
    def act(
        self, decoded: Any, state: LimbState, observation: Observation
    ) -> tuple[LimbState, Command]:
        moved, command = super().act(decoded, state, observation)
        assert self.tree.walk is not None
        present = jnp.abs(expand_dims_like(self.tree.walk.turns, command.target_rate))
        mean = (present * command.target_rate).sum(0) / present.sum(0)
        return moved, command._replace(target_rate=jnp.broadcast_to(mean, present.shape))


class Nursery(EvolvedPlans):
    """Random plans of a seed.

    Args:
        seed: seed of the plans.
        count: number of plans.
        seconds: duration of a trial, s.
        brain: class of the brain.
        chains: fraction of the plans that become chains with fins (`chained`).

    Attributes:
        genes: genomes of the plans.
        chain: whether each plan is such a chain.
        lengths: longest extent of each plan at rest, m.
    """

    inputs_type = Visits

    def __init__(
        self,
        seed: int,
        count: int,
        seconds: float = 20.0,
        brain: type[BodyBrain] = BodyBrain,
        chains: float = 0.0,
    ):
        source = shipped("virtual_creatures_water").path
        changes = {
            "controller": {"type": "body_brain", "brain": "untrained"},
            "task": {"type": "reach_light"},
            "audit": {"disqualify": []},
        }
        data = read_yaml(source) | changes
        data["simulation"] |= {"seconds": seconds, "substeps": _SUBSTEPS}
        super().__init__(complete_config(data, source))
        self._brain = brain
        self.genes, self.chain, self._drawn = self._draw(seed, count, chains)
        self.lengths = self._drawn[2].length
        simulation = dataclasses.replace(self.inputs(self.sizes[-1]).common, plans=self)
        self._run = compile_trials(simulation, population_mesh())
        self._slopes = compile_slopes(self, population_mesh())

    def _draw(
        self, seed: int, count: int, chains: float
    ) -> tuple[Float[np.ndarray, "g n"], Bool[np.ndarray, " n"], tuple[Any, ...]]:
        """Return plans with enough bodies and axes, which are chains, and their arrays."""
        draw = jax.jit(lambda key: self.random(key, (_DRAWN * count,), float))
        genes = np.array(draw(jax.random.key(seed)))
        chance = np.random.default_rng(seed)
        chain = chance.random(_DRAWN * count) < chains
        genes[:, chain] = chained(self.layout, genes[:, chain], chance)
        found = super().developed(genes)
        axes = (np.abs(found[2].walk.turns) > 0).sum(0)
        kept = np.flatnonzero((found[0] >= _BODIES) & (axes >= _AXES))[:count]
        drawn = jax.tree.map(lambda x: np.asarray(x)[..., kept], found)
        return genes[:, kept], chain[kept], drawn

    @override
    def inputs(self, size: int) -> PlanInputs:
        found = super().inputs(size)
        own = found.common.controller
        fields = {field.name: getattr(own, field.name) for field in dataclasses.fields(own)}
        task = dataclasses.replace(found.common.task, energy_weight=0.0, light_weight=0.0)
        brain = self._brain(**fields)
        found.common = dataclasses.replace(found.common, controller=brain, task=task)
        return found

    @override
    def developed(self, genes: Float[np.ndarray, "v n"]) -> tuple[Any, ...]:
        plans = genes[0].astype(int)
        return *jax.tree.map(lambda x: x[..., plans], self._drawn), genes[1:]

    @override
    def given(
        self, found: tuple[Any, ...], individuals: Int[np.ndarray, " k"], size: int
    ) -> tuple[Float[np.ndarray, "c k"], Float[np.ndarray, "v k"]]:
        genes, values = super().given(found[:3], individuals, size)
        # The brain is the network's, without changes by genes.
        return xp.full_like(genes, 0.5), xp.concatenate([values, found[3][:, individuals]])

    def visits(
        self,
        plans: Int[np.ndarray, " n"],
        bearings: Float[np.ndarray, "3 n"],
        weights: Float[np.ndarray, "w #n"],
        sight: float = 1.0,
    ) -> Float[np.ndarray, "v n"]:
        """Return visits of plans, with lights `AWAY` in the direction of unit vectors."""
        light, count = AWAY * self.lengths[plans] * bearings, len(plans)
        weights = np.broadcast_to(weights, (len(weights), count))
        rows = plans[None], light, np.full((1, count), sight), weights
        return np.concatenate(rows).astype(np.float32)

    def lights(
        self, draw: np.random.Generator, plans: Int[np.ndarray, " n"]
    ) -> Float[np.ndarray, "3 n"]:
        """Return random bearings. Those of chains are level, because no chain rises."""
        found = bearings(draw, len(plans))
        found[2, self.chain[plans]] = 0.0
        return found / np.linalg.norm(found, axis=0)

    def covered(self, visits: Float[np.ndarray, "v n"]) -> Float[np.ndarray, " n"]:
        """Return the fraction of the distance to the light that each plan covers.

        It is -1/2 at least, also for a plan that diverged.
        """
        outcome = self._run(visits)
        covered = 1.0 - np.nan_to_num(outcome.terms["distance"], nan=np.inf)
        return np.maximum(np.where(outcome.alive, covered, -np.inf), -0.5)

    def gradients(
        self, visits: Float[np.ndarray, "v n"]
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "w n"]]:
        """Return the fraction that each plan covers, and its derivative by the weights."""
        ones = np.ones(visits.shape[1], np.float32)
        value, slopes = self._slopes(visits, ones, {"energy": ones}, None)
        return 1.0 + value, slopes[-1][-sum(WEIGHTS) :]


def bearings(draw: np.random.Generator, count: int) -> Float[np.ndarray, "3 n"]:
    """Return directions that are spread evenly over the sphere."""
    found = draw.normal(size=(3, count))
    return found / np.linalg.norm(found, axis=0)


def chained(
    layout: GraphLayout, genes: Float[np.ndarray, "g n"], draw: np.random.Generator
) -> Float[np.ndarray, "g n"]:
    """Return plans of the same parts as chains with fins, which users draw more than chance does.

    Node 0 is the trunk, 1 and 3 are the tail, which bends to the sides, and 2 is a pair of fins.
    """
    graph = jax.tree.map(np.array, layout.unpack(genes)._asdict())
    count, ahead = genes.shape[1], np.array([[127 / 128], [0], [0]])
    for name in ("on", "to", "reflect", "scale", "terminal", "used"):
        graph[name][:] = 0
    graph["used"][:4], graph["kind"][[1, 3]], graph["recursion"][0] = 1, 0, 1
    graph["recursion"][1:4] = draw.integers(1, [[5], [3], [5]], (3, count))
    for node, link, part in ((0, 0, 1), (1, 0, 1), (1, 1, 3), (3, 0, 3), (0, 1, 2), (2, 0, 2)):
        graph["on"][node, link], graph["to"][node, link] = 1, part
        graph["place"][node, link] = ahead if node else -ahead
        graph["turn"][node, link] *= node == 2 or part == 2
    graph["terminal"][1, 1] = graph["reflect"][0, 1] = 1
    graph["on"][[1, 0], 1] = draw.random((2, count)) < [[_LONGER], [_FINNED]]
    along, up = np.round(draw.uniform([[-100], [-60]], [[100], [60]], (2, count))) / 128
    graph["place"][0, 1] = along, np.full(count, 127 / 128), up
    return np.asarray(layout.pack(PlanGraph(**graph)))
