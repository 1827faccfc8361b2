"""Experiments built from checked configurations."""

import contextlib
import dataclasses
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

from evo_cpg.control.controller import Controller
from evo_cpg.control.couplings import CouplingError, UnfitError
from evo_cpg.creature.algebra.decisions import chosen
from evo_cpg.creature.algebra.numerics import xp
from evo_cpg.creature.creature import Creature, CreatureError, length_of
from evo_cpg.creature.limbs import limbs
from evo_cpg.creature.self_collision import PlanPairs, SelfCollision
from evo_cpg.creature.surface import PointLayout
from evo_cpg.creature.tree import Tree, build_tree
from evo_cpg.evolution.islands import Islands
from evo_cpg.evolution.map_elites import Mapped
from evo_cpg.io.errors import ConfigError, Key, KeyProblem, nearest, under
from evo_cpg.io.load import located
from evo_cpg.io.own_checks import check_own_forces, check_own_returns, check_own_strategy
from evo_cpg.io.schema.evolution import PlanEvolutionConfig, RealEvolutionConfig
from evo_cpg.io.schema.experiment import ExperimentConfig
from evo_cpg.io.schema.section import CustomConfig
from evo_cpg.io.senses import build_imperfections
from evo_cpg.io.situations import build_situations
from evo_cpg.io.trust import code_folders, require_code
from evo_cpg.native.engine import Engine, target, using
from evo_cpg.native.ir import Unsupported
from evo_cpg.physics.contact.contact_model import make_contact_model
from evo_cpg.physics.contact.pairs import make_pairs
from evo_cpg.physics.step.world import World
from evo_cpg.physics.water.buoyancy import make_cells
from evo_cpg.physics.water.force_law import ForceLaw
from evo_cpg.simulation.limits import rules_of
from evo_cpg.simulation.measures import GROUND_MEASURES, MEASURES, Measures, measures
from evo_cpg.simulation.noise import Noise
from evo_cpg.simulation.sensors import Sensor, place_sensors
from evo_cpg.simulation.simulation import Rules, Simulation
from evo_cpg.simulation.task import Task, term_names
from evo_cpg.system import resolved
from evo_cpg.training.experiment import ExperimentParts, Learning

# Default number of individuals that learn: a full vector on one core.
_LEARNERS = 16


class CommonPlan(NamedTuple):
    """Decisions that the bodies of a batch have in common.

    Attributes:
        layout: layout of the surface points.
        pairs: pairs of bodies to check, or None to derive them from the creature's own numbers.
    """

    layout: PointLayout = "merged"
    pairs: PlanPairs | None = None


# Plan of an experiment that has nothing in common with others.
OWN_PLAN = CommonPlan()


def build_experiment(
    config: ExperimentConfig,
    source: Path | str,
    folders: Iterable[Path] = (),
    plan: CommonPlan = OWN_PLAN,
) -> ExperimentParts:
    """Build the experiment that a configuration describes.

    Args:
        config: the configuration.
        source: file of the configuration, for messages. If it is trusted
            (`evo_cpg.io.trust`), its folder is searched for a user's own classes.
        folders: further folders to search for these classes if trusted, before the working folder.
        plan: decisions that it has in common with other bodies.

    Raises:
        ConfigError: parts of the configuration do not fit together.
    """
    with located(source, config.model_dump(mode="json")):
        folders = (Path(source).parent, *folders)
        for folder in code_folders(folders):
            if str(resolved(folder)) not in sys.path:
                sys.path.append(str(resolved(folder)))
        require_code(config, folders)
        creature, simulation = _build_any(config, plan)
        trials = config.simulation.trials
        for i, entry in enumerate(trials if isinstance(trials, list) else ()):
            if entry.light is not None and simulation.task.light is None:
                problem = f"a task of type {config.task.type!r} has no light"
                raise KeyProblem(("simulation", "trials", i, "light"), problem)
        check_own_returns(config, simulation)
        given = config.evolution
        if given.body:
            # This import would be circular at the top: a plan builds experiments.
            from evo_cpg.io.body_genes import evolved

            simulation = evolved(config, source, simulation)
        if config.courses.draw:
            # This import would be circular at the top, too.
            from evo_cpg.io.courses import drawn

            simulation = drawn(config, source)
        islands = getattr(given, "islands", None)
        population = given.population // (islands.count if islands else 1)
        with under("evolution"):
            strategy = given.build(simulation.genome, population)
            mapped = bool(given.axes and (islands or not strategy.map_axes))
            if isinstance(given, CustomConfig):
                check_own_strategy(config, strategy, population, simulation, mapped)
            if islands:
                about = islands.count, islands.every, islands.migrants
                strategy = Islands(given.population, strategy, *about)
            if mapped:
                strategy = Mapped(given.population, given.build_axes(), strategy)
        learning = None
        if isinstance(given, (RealEvolutionConfig, PlanEvolutionConfig)) and given.learning:
            learners = given.learning.learners or min(_LEARNERS, given.elites)
            learning = given.learning.into(Learning, learners=learners)
        return ExperimentParts(
            name=config.name,
            creature=creature,
            simulation=simulation,
            strategy=strategy,
            generations=config.evolution.generations,
            seed=config.seed,
            runs=config.runs,
            trials=config.trial_count,
            learning=learning,
            new_courses=config.courses.every,
            quantile=config.courses.quantile,
        )


def require_genes(experiment: ExperimentParts, source: Path | str) -> None:
    """Check that the controller has genes.

    Raises:
        ConfigError: the controller has no genes.
    """
    controller = experiment.simulation.controller
    if experiment.simulation.genome.count == 0:
        raise ConfigError(
            source,
            ("controller",),
            f"{type(controller).__name__} has no genes, so there is nothing to evolve. Choose a "
            "controller with genes, such as {type: brain_cpg}",
        )


def build_simulation(
    config: ExperimentConfig, plan: CommonPlan = OWN_PLAN
) -> tuple[Creature, Simulation]:
    """Build the creature of a configuration, and the simulation of its trials.

    The numbers may be traced (see `evo_cpg.io.keys.put`) if the decisions that depend on them
    are known (`evo_cpg.creature.algebra.decisions.replaying_decisions`).

    Args:
        config: the configuration, whose own classes can be imported.
        plan: decisions that it has in common with other bodies.

    Raises:
        KeyProblem: parts of the configuration do not fit together.
    """
    engine = Engine(config.engine, config.instruction_set)
    if engine.name == "native":
        try:
            with using(engine):
                target()
        except Unsupported as error:
            key = ("engine",) if config.instruction_set == "host" else ("instruction_set",)
            raise KeyProblem(key, f"this machine has no such native code: {error}") from None
    with _refused(config):
        creature = config.creature.build()
        tree = build_tree(creature)
    world = _build_world(config, creature, tree, plan)
    check_own_forces(config, world)
    step = 1.0 / config.simulation.control_rate_hz
    extra_sensors = tuple(
        _build_part(given, Sensor, ("creature", "sensors", i), tree=tree, control_step=step)
        for i, given in enumerate(config.creature.sensors)
    )
    controller = _build_controller(config, creature, tree, extra_sensors, step)
    noise, hangs = config.noise, f"{tree.names[0]!r} hangs on the world"
    problem = None
    if noise.friction and world.contact_model is None:
        problem = "friction", "there is no ground whose friction could vary (world.ground)"
    elif noise.tilt_deg and tree.hanging is not None:
        problem = "tilt_deg", f"{hangs} and cannot tilt. Use joint_angle_deg, or leave it out"
    elif noise.push and tree.hanging is not None and not tree.root_slides:
        problem = "push", f"{hangs} without a slide, so no push moves it. Leave it out"
    if problem:
        raise KeyProblem(("noise", problem[0]), problem[1])
    with using(engine):
        situations = build_situations(config, creature, world)
    with under("task"):
        if isinstance(config.task, CustomConfig):
            task = config.task.instance(Task)
        else:
            task = config.task.build(
                creature=creature,
                world=world,
                light=situations[0].light,
                control_rate=config.simulation.control_rate_hz,
                seconds=config.simulation.seconds,
            )
    simulation = Simulation(
        world=world,
        sensors=place_sensors(creature, tree),
        controller=controller,
        task=task,
        control_rate=config.simulation.control_rate_hz,
        substeps=config.simulation.substeps,
        steps=chosen(lambda: config.simulation.steps),
        noise=Noise(
            joint_angle=xp.deg2rad(noise.joint_angle_deg),
            tilt=xp.deg2rad(noise.tilt_deg),
            push=noise.push,
            friction=noise.friction,
            senses=config.creature.senses.noisy,
        ),
        situations=situations,
        engine=engine,
        extra_sensors=extra_sensors,
        imperfections=build_imperfections(config, creature, tree, extra_sensors, controller),
        rules=_build_rules(config, creature, world, plan),
        measures=_build_measures(config, task, creature, world),
    )
    return creature, simulation


def _build_measures(
    config: ExperimentConfig, task: Task, creature: Creature, world: World
) -> Measures:
    """Build the measures of gait: the requested measures, and the axes of a map.

    Raises:
        KeyProblem: a measure does not exist, or not in this world.
    """
    if not config.measures and not config.evolution.axes:
        return Measures()
    try:
        own = term_names(task)
    except Exception:
        # The user's own task fails here. `check_own_returns` reports the error later.
        own = ()
    axes = [axis.name for axis in config.evolution.axes]
    requested: list[tuple[Key, str]] = [
        *((("measures", i), name) for i, name in enumerate(config.measures)),
        *((("evolution", "axes", i, "name"), x) for i, x in enumerate(axes) if x not in own),
    ]
    for key, name in requested:
        problem = None
        if name not in MEASURES:
            known = [*MEASURES, *(own if key[0] == "evolution" else ())]
            problem = f"is not a measure: {nearest(name, known)}"
        elif name in own:
            problem = "is already a term of the task"
        elif name in GROUND_MEASURES and world.contact_model is None:
            problem = "is undefined without ground (world.ground)"
        elif name == "cost_of_transport" and not chosen(lambda: world.gravity > 0):
            problem = "is undefined without gravity (world.gravity)"
        elif name == "limb_duty_factor" and not _limb_bodies(creature, world):
            problem = "is undefined for a creature without limbs that can touch the ground"
        if problem:
            raise KeyProblem(key, f"{name!r} {problem}")
    names = dict.fromkeys(name for _, name in requested)
    bodies = _limb_bodies(creature, world) if "limb_duty_factor" in names else ()
    return measures(*names, limbs=bodies)


def _limb_bodies(creature: Creature, world: World) -> tuple[tuple[int, ...], ...]:
    """Return the indices in the tree of the bodies of each limb that can touch the ground."""
    if world.contact_model is None:
        return ()
    names, touching = world.tree.names, set(world.contact_model.bodies)
    found = chosen(
        lambda: tuple(
            tuple(names.index(creature.bodies[i].name) for i in limb.bodies)
            for limb in limbs(creature)
        ),
        lambda _: True,
    )
    return tuple(limb for limb in found if touching & set(limb))


def _build_any(config: ExperimentConfig, plan: CommonPlan) -> tuple[Creature, Simulation]:
    """Build the creature and the simulation. If plans evolve, one creature stands for all."""
    if not isinstance(config.evolution, PlanEvolutionConfig):
        return build_simulation(config, plan)
    # This import would be circular at the top: plans build simulations.
    from evo_cpg.io.plans import plans_of, with_star

    plans = plans_of(config)
    creature, simulation = build_simulation(with_star(config), plan)
    return creature, dataclasses.replace(simulation, plans=plans)


def _build_rules(
    config: ExperimentConfig, creature: Creature, world: World, plan: CommonPlan
) -> Rules | None:
    """Build the rules that disqualify an individual, or None if there are none.

    Raises:
        KeyProblem: the limit of a rule is missing, or the rule cannot be broken.
    """
    names = config.audit.disqualify
    if not names:
        return None
    limits = config.audit.limits()
    if "power" in names and limits.power is None:
        raise KeyProblem(("audit", "power"), "is missing, but audit.disqualify contains 'power'")
    if "penetration" in names and world.contact_model is None:
        raise KeyProblem(("audit", "disqualify"), "'penetration' needs ground (world.ground)")
    pairs = None
    if "overlap" in names:
        watched = world.watched
        if plan.pairs is not None:
            given = config.creature.build_self_collision(on_ground=world.contact_model is not None)
            include = given.include if given else ()
            watched = SelfCollision(include=include, only=plan.pairs.watched)
        pairs = make_pairs(creature, world.tree, watched)
    return rules_of(names, limits, length_of(creature), creature.mass, pairs)


def build_creature(config: ExperimentConfig, source: Path | str) -> Creature:
    """Build the creature alone.

    Raises:
        ConfigError: its bodies do not form one tree.
    """
    with located(source, config.model_dump(mode="json")), _refused(config):
        return config.creature.build()


@contextlib.contextmanager
def _refused(config: ExperimentConfig) -> Iterator[None]:
    """Convert a `CreatureError` into a `KeyProblem` with its key."""
    try:
        yield
    except CreatureError as error:
        where: list[str | int] = list(error.where)
        if len(where) > 1 and where[0] in ("bodies", "tendons") and isinstance(where[1], int):
            # An entry may stand for several bodies or tendons of the creature.
            given = config.creature
            everything = given.copies()
            owners = [copy.entry for copy in everything for _ in given.names_of(copy)]
            if where[0] == "tendons":
                owners = [i for i, x in enumerate(given.tendons) for _ in x.build(everything)]
            where[1] = owners[where[1]]
        raise KeyProblem(("creature", *where), str(error)) from None


def _build_world(
    config: ExperimentConfig, creature: Creature, tree: Tree, plan: CommonPlan
) -> World:
    water, forces = config.world.water, list[ForceLaw]()
    if water:
        with under("world", "water"):
            forces = water.build_forces(creature, tree, plan.layout)
    for i, given in enumerate(config.world.forces):
        own = _build_part(given, ForceLaw, ("world", "forces", i), creature=creature, tree=tree)
        forces.append(own)
    ground = config.world.ground and config.world.ground.build()
    watched = config.creature.build_self_collision(on_ground=ground is not None)
    if watched:
        watched = dataclasses.replace(watched, only=plan.pairs and plan.pairs.kept)
    return World(
        tree=tree,
        gravity=config.world.gravity,
        water=water and water.build(),
        forces=tuple(forces),
        contact_model=ground and make_contact_model(creature, tree, ground),
        cells=make_cells(creature, tree) if water and water.surface is not None else (),
        pairs=watched and make_pairs(creature, tree, watched),
    )


def _build_part(given: Any, kind: type, key: Key, **about: Any) -> Any:
    """Build the part of a section, possibly of a user's own class, with ``about`` as arguments."""
    with under(*key):
        if isinstance(given, CustomConfig):
            return given.instance(kind, **about)
        return given.build(**about)


def _build_controller(
    config: ExperimentConfig,
    creature: Creature,
    tree: Tree,
    extra_sensors: tuple[Sensor, ...],
    step: float,
) -> Controller:
    try:
        return _build_part(
            config.controller,
            Controller,
            ("controller",),
            tree=tree,
            light_count=len(creature.light_sensors),
            pressure_count=len(creature.pressure_sensors),
            control_step=step,
            depth_count=len(creature.depth_sensors),
            custom_count=sum(sensor.count for sensor in extra_sensors),
        )
    except UnfitError as error:
        inner = ("cpg",) if isinstance(error, CouplingError) else ()
        hint = f". The controller must name parts of creature {creature.name!r}"
        problem = f"{error}{hint if error.unknown_name else ''}"
        raise KeyProblem(("controller", *inner, *error.where), problem) from None
    except ValueError as error:
        raise KeyProblem(("controller",), str(error)) from None
