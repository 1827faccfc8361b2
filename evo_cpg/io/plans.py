"""Evolving body plans: their simulations, and a plan as a creature of its own.

All plans of an experiment run in a few programs, which differ in the number of bodies only. In
water a plan may run in any program with more bodies than the plan has, with the same result to the
last bit. One absent body remains, because sums over bodies are ordered by another body that
follows.
"""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, UInt8
from typing_extensions import override

from evo_cpg.control.body_brain import CHARACTER
from evo_cpg.creature.algebra.numerics import xp
from evo_cpg.creature.algebra.rotation import matrix_to_euler
from evo_cpg.creature.creature import Creature
from evo_cpg.creature.development import Plan, developed
from evo_cpg.creature.graph import GraphLayout
from evo_cpg.creature.tree import build_tree
from evo_cpg.creature.walk import slot_count
from evo_cpg.evolution.graphs import descended, random_graph, with_random_brain
from evo_cpg.io.ancestor import graph_of_creature
from evo_cpg.io.build import CommonPlan, build_simulation
from evo_cpg.io.errors import Key, KeyProblem
from evo_cpg.io.schema.creature import CreatureConfig
from evo_cpg.io.schema.evolution import PlanEvolutionConfig
from evo_cpg.io.schema.experiment import ExperimentConfig
from evo_cpg.io.schema.ground import PlaneConfig
from evo_cpg.io.schema.plans import PLANS, PlanConfig, actuator_section
from evo_cpg.physics.contact.contact_model import CORNERS
from evo_cpg.simulation.limits import rules_of
from evo_cpg.simulation.planned import (
    SINK,
    PlanBuilder,
    PlanInputs,
    PlanNumbers,
    leverage,
    numbers_of,
)
from evo_cpg.simulation.recording import NERVE
from evo_cpg.simulation.simulation import Simulation
from evo_cpg.training.devices import Layout, population_mesh, run_on, sharded

# Fraction of the audit's limits that the rules allow. Evolved plans go up to the rules, and other
# conditions of an audit change their motion a little.
_RULES = 0.9

# Recorded arrays of bodies, contact points and joint axes.
_OF_BODIES = ("position", "rotation", "velocity", "angular_velocity")
_OF_POINTS = ("contact_force", "contact_velocity")
_OF_AXES = (
    "joint_angle", "joint_rate", "target_rate", "cpg_output", "torque", "activation",
    "commanded_torque",
)  # fmt: skip

# Controllers that fit any plan, with the rhythm of bodies that evolve alone: genes of an axis,
# from -1 to 1. Limb oscillators then have the largest amplitude and make a wave along each limb.
_CONTROL = {
    "limb_oscillators": (127 / 128, 0.0, 0.5, 0.0, 0.5),
    "body_brain": (0.0,) * len(CHARACTER),
}

# Plans that are developed at a time. A fixed number gives each plan the same bits in any
# population.
_WIDTH = 64


class EvolvedPlans(PlanBuilder):
    """Plans of one experiment.

    Args:
        config: configuration whose search evolves plans.
    """

    inputs_type: type[PlanInputs] = PlanInputs

    def __init__(self, config: ExperimentConfig):
        assert isinstance(config.evolution, PlanEvolutionConfig)
        self.config = config
        self._search, self.section = config.evolution, config.evolution.plan
        self.layout, self.bounds = layout_of(config), self.section.bounds
        most = self.section.bodies + 1
        # More programs would waste fewer bodies, but each takes long to compile.
        self.sizes = tuple(sorted({max(most // 3 + 1, 3), max(2 * most // 3 + 1, 3), most}))
        clearance = config.simulation.start_clearance
        on_ground = config.world.ground is not None
        meet = on_ground or "overlap" in config.audit.disqualify
        self.physics = self.section.physics(config.world.water, clearance, meet)
        # On land sums over contacts of limbs are ordered differently in larger programs.
        self.joins_vectors = not on_ground
        self._ancestor = None
        if config.creature.name != PLANS:
            drawn = config.creature.build()
            self._ancestor = graph_of_creature(drawn, self.layout, self.bounds)
        self._inputs: dict[int, PlanInputs] = {}
        self._mesh = population_mesh()
        self._develop = sharded(jax.vmap(self._one, -1, -1), self._mesh, (2,))
        self._pull_back: Callable[..., Any] | None = None
        self._grow = jax.jit(lambda x: developed(self.layout.unpack(x), self.layout, self.bounds))
        grow = jax.vmap(lambda stored: self._grow(self.layout.from_bytes(stored)), -1, -1)
        self._grow_kept = sharded(grow, self._mesh, (2,))

    @override
    def random(self, key: Array, batch: tuple[int, ...], dtype: Any) -> Float[Array, "g *n"]:
        ancestor, rate = self._ancestor, self._search.alterations

        def draw(key: Array, own: Array) -> Array:
            graph = random_graph(key, self.layout)
            if ancestor:
                graph = descended(key, ancestor, self.layout, rate)
            if self._search.founders:
                graph = with_random_brain(own, graph, self.layout)
            return self.layout.pack(graph).astype(dtype)

        own = keys = jax.random.split(key, batch)
        if self._search.founders:
            keys = keys[..., jnp.arange(batch[-1]) % self._search.founders]
        return functools.reduce(lambda draw, _: jax.vmap(draw, out_axes=-1), batch, draw)(keys, own)

    @override
    def inputs(self, size: int) -> PlanInputs:
        if size in self._inputs:
            return self._inputs[size]
        config = with_star(self.config, size)
        _, simulation = build_simulation(config, CommonPlan("complete"))
        audit = self.config.audit
        given = audit.disqualify, audit.limits()
        rules = functools.partial(rules_of, *given, fraction=_RULES)
        self._inputs[size] = self.inputs_type(simulation, self.physics, rules)
        return self._inputs[size]

    @override
    def developed(self, genes: Float[np.ndarray, "g n"]) -> tuple[Any, ...]:
        with jax.enable_x64(True):
            return run_on(self._develop, Layout(self._mesh, _WIDTH), (genes.astype(float),))

    @override
    def given(
        self, found: tuple[Any, ...], individuals: Int[np.ndarray, " k"], size: int
    ) -> tuple[Float[np.ndarray, "c k"], Float[np.ndarray, "v k"]]:
        _, control, numbers = found
        axes, one = len(self.section.axes), (-1, len(individuals))
        genes = control[:, : (size - 1) * axes, individuals].reshape(one)
        cut = _cut(numbers, size, axes)
        return genes, xp.concatenate(
            [x[..., individuals].reshape(one) for x in jax.tree.leaves(cut)]
        )

    @override
    def pulled_back(
        self, genes: Float[np.ndarray, "g n"], slopes: tuple[Any, ...]
    ) -> Float[np.ndarray, "g n"]:
        given = genes.astype(float), slopes
        if self._pull_back is None:
            ranks = jax.tree.map(np.ndim, given)
            self._pull_back = sharded(jax.vmap(self._slope, -1, -1), self._mesh, ranks)
        with jax.enable_x64(True):
            return run_on(self._pull_back, Layout(self._mesh, _WIDTH), given)

    def plan(self, genes: Float[np.ndarray, " g"]) -> Plan:
        """Return the plan of one genome, in float64."""
        with jax.enable_x64(True):
            return jax.tree.map(np.asarray, self._grow(jnp.asarray(genes, float)))

    def kept(self, genomes: UInt8[np.ndarray, "n b"]) -> list[Plan]:
        """Return the plans of genomes of a family tree, without places for absent bodies."""
        if not len(genomes):
            return []
        with jax.enable_x64(True):
            found = run_on(self._grow_kept, Layout(self._mesh, _WIDTH), (genomes.T,))
        plans = (Plan(*(x[..., i] for x in found)) for i in range(len(genomes)))
        return [Plan(*(x[plan.present] for x in plan)) for plan in plans]

    def creature(self, plan: Plan) -> Creature:
        """Return a plan as a creature."""
        return CreatureConfig.model_validate(creature_of(plan, self.section)).build()

    @override
    def own(self, genes: Float[np.ndarray, " g"]) -> Simulation:
        return build_simulation(self.alone(genes)[0])[1]

    def alone(
        self, genes: Float[np.ndarray, " g"]
    ) -> tuple[ExperimentConfig, Float[np.ndarray, " c"]]:
        """Return the configuration of a plan's own creature, and the genes of its controller."""
        plan, data = self.plan(genes), self.config.model_dump(mode="json")
        data["creature"] = creature_of(plan, self.section)
        if self.config.world.ground is not None:
            data["creature"]["self_collision"] = {"looped": True}
        given = self._search
        kept = {"generations": given.generations, "population": given.population}
        data["evolution"] = {"type": "real", "elites": given.elites, **kept}
        if self.section.eyes:
            data["controller"]["eyes"] = [f"part{i}" for i in np.flatnonzero(plan.eye)]
        if plan.present.sum() < 2:
            # Without joints there are no oscillators.
            data["controller"] = {"type": "evo_cpg.control.commanded:Commanded"}
        config = ExperimentConfig.model_validate(data)
        names = build_tree(config.creature.build()).dof_names
        return config, genes_of(plan, names).astype(genes.dtype)

    @override
    def frames_of(self, own: Simulation, frames: dict[str, Any]) -> dict[str, Any]:
        tree, axes = own.world.tree, self.section.axes
        slots = np.array([int(name.removeprefix("part")) for name in tree.names])
        bodies, turns = _dofs_of(tree.dof_names)
        dofs = (bodies - 1) * len(axes) + np.searchsorted(axes, turns)
        points = (slots[:, None] * CORNERS + np.arange(CORNERS)).reshape(-1)
        kept = {**dict.fromkeys(_OF_BODIES, slots), **dict.fromkeys(_OF_POINTS, points)}
        kept |= dict.fromkeys(_OF_AXES, dofs)
        found = {}
        for name, values in frames.items():
            if values.shape[-2:-1] > (1,) and (name in kept or name.startswith(NERVE)):
                values = values[..., kept.get(name, dofs), :]
            elif name == "pair_force":
                # The own creature has other pairs.
                count = len(own.world.pairs.owners[0]) if own.world.pairs else 0
                values = np.zeros((len(values), count, values.shape[-1]), values.dtype)
            found[name] = values
        return found

    def _one(self, genes: Float[Array, " g"]) -> tuple[Array, Array, PlanNumbers]:
        """Return the number of bodies, the controller's genes and the numbers of one plan."""
        plan = developed(self.layout.unpack(genes), self.layout, self.bounds)
        own = plan.control[1:, np.array(self.section.axes)]
        control = jnp.moveaxis(0.5 + 0.5 * own, -1, 0).reshape(own.shape[-1], -1)
        # One absent body follows the largest plan.
        plan = _with_absent_body(plan)
        padded = jnp.pad(control, ((0, 0), (0, len(self.section.axes))))
        count, numbers = plan.present.sum(), numbers_of(plan, self.physics)
        # A plan of one body cannot move, and counts as diverged.
        mass = jnp.where(count > 1, numbers.mass, jnp.nan)
        return count, padded, numbers._replace(mass=mass)

    def _slope(self, genes: Float[Array, " g"], slopes: tuple[Any, ...]) -> Float[Array, " g"]:
        """Return the derivative by the genes of one plan, see `pulled_back`."""
        _, pull_back = jax.vjp(lambda genes: self._one(genes)[1:], genes)
        return pull_back(slopes)[0]


def layout_of(config: ExperimentConfig) -> GraphLayout:
    """Return the layout of the genome of plans with the configuration's controller."""
    assert isinstance(config.evolution, PlanEvolutionConfig)
    controller, rhythm = config.controller, _CONTROL[config.controller.type]
    fixed = config.evolution.evolve == "body"
    return dataclasses.replace(
        config.evolution.plan.layout,
        control=len(rhythm),
        centre=rhythm if fixed else (),
        spread=0.0 if fixed else getattr(controller, "spread", 1.0),
    )


def with_star(config: ExperimentConfig, bodies: int | None = None) -> ExperimentConfig:
    """Return a configuration of plans with the creature that stands for all (`PlanConfig.star`)."""
    assert isinstance(config.evolution, PlanEvolutionConfig)
    star = CreatureConfig.model_validate(config.evolution.plan.star(bodies))
    return config.model_copy(update={"creature": star})


@functools.lru_cache(maxsize=4)
def _made(text: str) -> EvolvedPlans:
    return EvolvedPlans(ExperimentConfig.model_validate_json(text))


def plans_of(config: ExperimentConfig) -> EvolvedPlans:
    """Return the plans of a configuration whose search evolves plans.

    Raises:
        KeyProblem: the configuration has a part that plans cannot have.
    """
    assert isinstance(config.evolution, PlanEvolutionConfig)
    world, ground, controller = config.world, config.world.ground, config.controller
    blind = config.evolution.plan.eyes and controller.type != "body_brain"
    uneven = ground and (ground.obstacles or ground.floor != PlaneConfig())
    water = world.water
    refused: list[tuple[Key, Any, str]] = [
        (("controller", "type"), controller.type not in _CONTROL, ", ".join(_CONTROL)),
        (("evolution", "plan", "eyes"), blind, "true with the controller body_brain"),
        (("controller", "eyes"), getattr(controller, "eyes", None), "null"),
        (("world", "water", "law"), water and water.law is None, "normal, isotropic"),
        (("world", "water", "surface"), water and water.surface is not None, "null"),
        (("world", "forces"), world.forces, "none"),
        (("world", "ground", "floor"), uneven, "level ground without obstacles"),
        (("simulation", "start_pose"), config.simulation.start_pose != "neutral", "neutral"),
    ]
    for key, wrong, allowed in refused:
        if wrong:
            raise KeyProblem(key, f"is not for a search of type 'plans'. Allowed: {allowed}")
    return _made(config.model_dump_json())


def _with_absent_body(plan: Plan) -> Plan:
    """Return a plan with one more slot, which no body uses."""
    more = jax.tree.map(lambda x: jnp.concatenate([x, jnp.zeros_like(x[:1])]), plan)
    eye = more.rotation.at[-1].set(jnp.eye(3))
    parent, slot = (x.at[-1].set(-1) for x in (more.parent, more.slot))
    return more._replace(rotation=eye, parent=parent, slot=slot, mirror=more.mirror.at[-1].set(1))


def _cut(numbers: PlanNumbers, size: int, axes: int) -> PlanNumbers:
    """Return the numbers of the first bodies of some plans, individuals on the last axis."""
    walk, dofs, slots = numbers.walk, (size - 1) * axes, slot_count(size)
    first, second = np.triu_indices(numbers.mass.shape[0], 1)
    return numbers._replace(
        half=numbers.half[:, :size],
        reach=numbers.reach[:size],
        offset=numbers.offset[:, :size],
        orientation=numbers.orientation[:, :, :size],
        mass=numbers.mass[:size],
        form=numbers.form[:, :size],
        skin=numbers.skin[:, :size],
        sight=numbers.sight[:size],
        laws=numbers.laws[:, :dofs],
        pairs=numbers.pairs[((first < size) & (second < size))[: len(numbers.pairs)]],
        walk=type(walk)(
            walk.follows[:size],
            walk.opens[:slots, :size],
            walk.reads[:slots, :size],
            walk.above[:size, :size],
            walk.turns[:dofs],
        ),
    )


def creature_of(plan: Plan, section: PlanConfig) -> dict[str, Any]:
    """Return a plan as the creature of a configuration.

    Bodies have the names of their places in the plan: part0, part1 and so on.
    """
    physics, half, rotation = section.physics(None, 0.0), plan.half, np.asarray(plan.rotation)
    size = leverage(half)
    bodies = []
    for i in np.flatnonzero(plan.present):
        edges = [float(2 * edge) for edge in half[i]]
        body: dict[str, Any] = {
            "name": f"part{i}",
            "shape": {"type": "box", "size": edges},
            "material": "body",
        }
        parent = plan.parent[i]
        if parent >= 0:
            least = min(size[i], size[parent])
            motor = physics.actuator(plan.strength[i], half[i], least)
            limits = np.degrees(plan.limit[i])
            turns = [k for k in range(3) if plan.axes[i, k]]
            # Mirrored bodies turn about x and z the other way round.
            sign = (plan.mirror[i], 1.0, plan.mirror[i])
            body["joint"] = {
                "parent": f"part{parent}",
                "at": [float(SINK * x) for x in plan.place[i]],
                "child_at": [float(-SINK * half[i, 0]), 0.0, 0.0],
                "axes": [f"{'-' if sign[k] < 0 else ''}{'xyz'[k]}" for k in turns],
                "limits_deg": [[-float(limits[k]), float(limits[k])] for k in turns],
                "rotation_deg": [float(np.degrees(x)) for x in matrix_to_euler(rotation[i])],
                "actuator": actuator_section(motor),
            }
        bodies.append(body)
    return {"name": "evolved", "materials": section.materials, "bodies": bodies}


def genes_of(plan: Plan, dof_names: tuple[str, ...]) -> Float[np.ndarray, " c"]:
    """Return the controller's genes for the creature of a plan, by its degrees of freedom."""
    return (0.5 + 0.5 * np.asarray(plan.control)[_dofs_of(dof_names)].T).reshape(-1)


def _dofs_of(dof_names: tuple[str, ...]) -> tuple[Int[np.ndarray, " d"], Int[np.ndarray, " d"]]:
    """Return the bodies and the axes of a creature's degrees of freedom in its plan."""
    named = [name.removeprefix("part").rsplit(".", 1) for name in dof_names]
    bodies, axes = [int(body) for body, _ in named], ["xyz".index(axis[-1]) for _, axis in named]
    return np.array(bodies, int), np.array(axes, int)
