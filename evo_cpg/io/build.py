"""Experiments built from checked configurations."""

import contextlib
import dataclasses
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from evo_cpg.control.controller import Controller
from evo_cpg.control.couplings import CouplingError, UnfitError
from evo_cpg.creature.algebra.decisions import chosen
from evo_cpg.creature.algebra.numerics import Triple, xp
from evo_cpg.creature.creature import Creature, CreatureError, length_of
from evo_cpg.creature.limbs import limbs
from evo_cpg.creature.self_collision import PlanPairs, SelfCollision
from evo_cpg.creature.shapes import Surface
from evo_cpg.creature.slender import LEAST_BODIES
from evo_cpg.creature.surface import PointLayout, outer_surfaces, random_surfaces
from evo_cpg.creature.tree import Tree, build_tree
from evo_cpg.evolution.islands import Islands
from evo_cpg.evolution.map_elites import METRICS, Mapped
from evo_cpg.evolution.strategy import Strategy
from evo_cpg.io.errors import ConfigError, Key, KeyProblem, nearest, under
from evo_cpg.io.lines import located
from evo_cpg.io.own_checks import check_own_forces, check_own_returns, check_own_strategy
from evo_cpg.io.own_classes import require_code
from evo_cpg.io.schema.choice import CustomConfig
from evo_cpg.io.schema.experiment import ExperimentConfig
from evo_cpg.io.schema.world import WaterConfig
from evo_cpg.io.situations import build_situations, require_light
from evo_cpg.io.trust import code_folders
from evo_cpg.native.engine import Engine, target, using
from evo_cpg.native.ir import Unsupported
from evo_cpg.physics.contact.contact_model import make_contact_model
from evo_cpg.physics.contact.pairs import make_pairs
from evo_cpg.physics.step.world import World
from evo_cpg.physics.water.added_mass import AddedMass, added_inertia
from evo_cpg.physics.water.buoyancy import make_cells
from evo_cpg.physics.water.fluid import Drag, make_patches
from evo_cpg.physics.water.force_law import ForceLaw
from evo_cpg.physics.water.lift import make_plate_lift
from evo_cpg.physics.water.reactive_thrust import reactive_water
from evo_cpg.physics.water.viscous_bodies import make_viscous_drag
from evo_cpg.physics.water.viscous_drag import ViscousDrag
from evo_cpg.simulation.measures import GROUND_MEASURES, MEASURES, Measures, measures
from evo_cpg.simulation.noise import Noise
from evo_cpg.simulation.sensors import Sensor, place_sensors
from evo_cpg.simulation.simulation import Rules, Simulation
from evo_cpg.simulation.task import Task, term_names
from evo_cpg.simulation.tasks import Walk
from evo_cpg.system import resolved, with_working_folder
from evo_cpg.training.experiment import ExperimentParts

# Resolution of the dense surface points among which random points are drawn.
_DENSE_RESOLUTION = 24


def build_experiment(
    config: ExperimentConfig,
    source: Path | str,
    folders: Iterable[Path] = (),
    layout: PointLayout = "merged",
    pairs: PlanPairs | None = None,
) -> ExperimentParts:
    """Build the experiment that a configuration describes.

    Args:
        config: the configuration.
        source: file of the configuration, for messages. If it is trusted
            (`evo_cpg.io.trust`), its folder is searched for a user's own classes.
        folders: further folders to search for these classes if trusted, before the working folder.
        layout: layout of the surface points, common to the bodies of a batch.
        pairs: pairs of bodies to check in all creatures of a plan, or None to derive the pairs from
            the creature's own numbers.

    Raises:
        ConfigError: parts of the configuration do not fit together.
    """
    with located(source, config.model_dump(mode="json")):
        return _build_experiment(config, (Path(source).parent, *folders), layout, pairs)


def _build_experiment(
    config: ExperimentConfig,
    folders: tuple[Path, ...],
    layout: PointLayout,
    pairs: PlanPairs | None,
) -> ExperimentParts:
    for folder in with_working_folder(code_folders(folders)):
        if str(resolved(folder)) not in sys.path:
            sys.path.append(str(resolved(folder)))
    require_code(config, folders)
    creature, simulation = build_simulation(config, layout, pairs)
    evolution = config.evolution
    require_light(config, simulation.task)
    check_own_returns(config, simulation)
    with under("evolution"):
        strategy = _build_strategy(config, simulation)
    return ExperimentParts(
        name=config.name,
        creature=creature,
        simulation=simulation,
        strategy=strategy,
        generations=evolution.generations,
        seed=config.seed,
        runs=config.runs,
        trials=config.trial_count,
        learning=evolution.build_learning(),
    )


def _build_strategy(config: ExperimentConfig, simulation: Simulation) -> Strategy:
    """Build the search, on its islands and with its map."""
    given = config.evolution
    islands = getattr(given, "islands", None)
    population = given.population // (islands.count if islands else 1)
    strategy = given.build(simulation.genome, population)
    mapped = bool(given.axes and (islands or not strategy.map_axes))
    if isinstance(given, CustomConfig):
        where, metrics = " on each island" if islands else "", METRICS if mapped else ()
        check_own_strategy(strategy, population, simulation, config.trial_count, metrics, where)
    if islands:
        strategy = Islands(
            given.population, strategy, islands.count, islands.every, islands.migrants
        )
    return Mapped(given.population, given.build_axes(), strategy) if mapped else strategy


def require_genes(experiment: ExperimentParts, source: Path | str) -> None:
    """Check that the controller has genes.

    Args:
        experiment: experiment built from a configuration.
        source: file of the configuration, for messages.

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
    config: ExperimentConfig, layout: PointLayout = "merged", pairs: PlanPairs | None = None
) -> tuple[Creature, Simulation]:
    """Build the creature of a configuration, and the simulation of its trials.

    The numbers may be traced (see `evo_cpg.io.keys.put`) if the decisions that depend on them
    are known (`evo_cpg.creature.algebra.decisions.replaying_decisions`).

    Args:
        config: the configuration, whose own classes can be imported.
        layout: layout of the surface points, see `build_experiment`.
        pairs: pairs of bodies to check, see `build_experiment`.

    Raises:
        KeyProblem: parts of the configuration do not fit together.
    """
    engine = _choose_engine(config)
    creature = _build_creature(config)
    tree = _build_tree(config, creature)
    world = _build_world(config, creature, tree, layout, pairs)
    check_own_forces(config, world)
    step = 1.0 / config.simulation.control_rate_hz
    extra_sensors = tuple(
        _build_part(given, Sensor, ("creature", "sensors", i), tree=tree, control_step=step)
        for i, given in enumerate(config.creature.sensors)
    )
    controller = _build_controller(config, creature, tree, extra_sensors, step)
    noise = Noise(
        joint_angle=xp.deg2rad(config.noise.joint_angle_deg),
        tilt=xp.deg2rad(config.noise.tilt_deg),
        push=config.noise.push,
        friction=config.noise.friction,
    )
    if config.noise.friction and world.contact_model is None:
        raise KeyProblem(
            ("noise", "friction"), "there is no ground whose friction could vary (world.ground)"
        )
    _check_noise_of_a_root(config, tree)
    with using(engine):
        situations = build_situations(config, creature, world)
    task = _build_task(config, creature, situations[0].light)
    priced = isinstance(task, Walk) and task.cost_weight is not None
    if priced and not chosen(lambda: world.gravity > 0):
        raise KeyProblem(
            ("task", "cost_weight"), "the cost is undefined without gravity (world.gravity)"
        )
    simulation = Simulation(
        world=world,
        sensors=place_sensors(creature, tree),
        controller=controller,
        task=task,
        control_rate=config.simulation.control_rate_hz,
        substeps=config.simulation.substeps,
        steps=chosen(lambda: config.simulation.steps),
        noise=noise,
        situations=situations,
        engine=engine,
        extra_sensors=extra_sensors,
        rules=_build_rules(config, creature, world, pairs),
        measures=_build_measures(config, task, creature, world),
    )
    return creature, simulation


def _check_noise_of_a_root(config: ExperimentConfig, tree: Tree) -> None:
    """Check that noise can move a root that hangs on the world.

    Raises:
        KeyProblem: it cannot.
    """
    if tree.hanging is None:
        return
    name = tree.names[0]
    if config.noise.tilt_deg:
        problem = (
            f"{name!r} hangs on the world and cannot tilt. Use joint_angle_deg, or leave it out"
        )
        raise KeyProblem(("noise", "tilt_deg"), problem)
    if config.noise.push and not tree.root_slides:
        problem = f"{name!r} hangs on the world without a slide, so no push moves it. Leave it out"
        raise KeyProblem(("noise", "push"), problem)


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


def _build_rules(
    config: ExperimentConfig, creature: Creature, world: World, pairs: PlanPairs | None
) -> Rules | None:
    """Build the rules that disqualify an individual, or None if there are none.

    Raises:
        KeyProblem: the limit of a rule is missing, or the rule cannot be broken.
    """
    names = config.audit.disqualify
    if not names:
        return None
    limits = config.audit.limits().of_length(length_of(creature))
    if "power" in names and limits.power is None:
        raise KeyProblem(("audit", "power"), "is missing, but audit.disqualify contains 'power'")
    if "penetration" in names and world.contact_model is None:
        raise KeyProblem(("audit", "disqualify"), "'penetration' needs ground (world.ground)")
    most = {name: getattr(limits, name) for name in names}
    if "speed" in most:
        most["speed"] = most["speed"] * length_of(creature)
    if "power" in most:
        most["power"] = most["power"] * creature.mass
    if "overlap" not in most:
        return Rules(**most)
    watched = world.watched
    if pairs is not None:
        given = config.creature.build_self_collision(on_ground=world.contact_model is not None)
        include = given.include if given else ()
        watched = SelfCollision(include=include, only=pairs.watched)
    return Rules(**most, pairs=make_pairs(creature, world.tree, watched))


def _choose_engine(config: ExperimentConfig) -> Engine:
    """Return the engine that computes the trials.

    Raises:
        KeyProblem: the configuration requires an engine that this machine does not have.
    """
    engine = Engine(config.engine, config.instruction_set)
    if engine.name == "native":
        try:
            with using(engine):
                target()
        except Unsupported as error:
            key = ("engine",) if config.instruction_set == "host" else ("instruction_set",)
            raise KeyProblem(key, f"this machine has no such native code: {error}") from None
    return engine


def build_creature(config: ExperimentConfig, source: Path | str) -> Creature:
    """Build the creature alone.

    Raises:
        ConfigError: its bodies do not form one tree.
    """
    with located(source, config.model_dump(mode="json")):
        return _build_creature(config)


def _build_creature(config: ExperimentConfig) -> Creature:
    with _refused(config):
        return config.creature.build()


def _build_tree(config: ExperimentConfig, creature: Creature) -> Tree:
    with _refused(config):
        return build_tree(creature)


@contextlib.contextmanager
def _refused(config: ExperimentConfig) -> Iterator[None]:
    """Convert a `CreatureError` into a `KeyProblem` with its key."""
    try:
        yield
    except CreatureError as error:
        where: list[str | int] = list(error.where)
        if len(where) > 1 and isinstance(where[1], int):
            entry_of = {
                "bodies": config.creature.entry_of,
                "tendons": config.creature.entry_of_tendon,
            }
            where[1] = entry_of[str(where[0])](where[1])
        raise KeyProblem(("creature", *where), str(error)) from None


def _build_world(
    config: ExperimentConfig,
    creature: Creature,
    tree: Tree,
    layout: PointLayout,
    pairs: PlanPairs | None,
) -> World:
    water, forces = config.world.water, list[ForceLaw]()
    if water:
        forces.append(_drag(water, creature, tree, layout))
        forces += _moved_water(water, creature, tree, layout)
        if water.lift:
            # The moment of ideal fluid is that of lift ahead of the centre.
            plates = make_plate_lift(creature, tree, not water.added_mass, layout)
            forces += [plates] if plates else []
    for i, given in enumerate(config.world.forces):
        own = _build_part(given, ForceLaw, ("world", "forces", i), creature=creature, tree=tree)
        forces.append(own)
    ground = config.world.ground and config.world.ground.build()
    watched = config.creature.build_self_collision(on_ground=ground is not None)
    if watched:
        watched = dataclasses.replace(watched, only=pairs and pairs.kept)
    return World(
        tree=tree,
        gravity=config.world.gravity,
        water=water and water.build(),
        forces=tuple(forces),
        contact_model=ground and make_contact_model(creature, tree, ground),
        cells=make_cells(creature, tree) if water and water.surface is not None else (),
        pairs=watched and make_pairs(creature, tree, watched),
    )


def _moved_water(
    water: WaterConfig, creature: Creature, tree: Tree, layout: PointLayout
) -> list[ForceLaw]:
    """Build added mass and reactive thrust. Slender chains have the added mass of their sections.

    Raises:
        KeyProblem: there is no slender chain.
    """
    own = np.zeros((6, 6, tree.body_count))
    if water.added_mass:
        own = added_inertia(creature, tree, water.density)
    if not water.reactive_thrust:
        return [AddedMass(own)] if water.added_mass else []
    found = reactive_water(creature, tree, water.density, own, layout == "complete")
    if found is None:
        raise KeyProblem(
            ("world", "water", "reactive_thrust"),
            f"means nothing: no chain has {LEAST_BODIES} bodies joined end to end",
        )
    inertia, law = found
    return [AddedMass(inertia), law]


def _drag(
    water: WaterConfig, creature: Creature, tree: Tree, layout: PointLayout
) -> Drag | ViscousDrag:
    form, skin = _surface_points(water, creature, layout)
    surfacing = water.surface is not None
    if water.viscosity is None:
        assert water.law is not None and water.skin_drag is not None
        patches = make_patches(tree, form, skin, water.law, surfacing, layout)
        return Drag(water.form_drag, water.skin_drag, patches, water.law)
    return make_viscous_drag(
        creature, tree, form, skin, water.viscosity, water.form_drag, surfacing, layout
    )


def _surface_points(
    water: WaterConfig, creature: Creature, layout: PointLayout
) -> tuple[dict[str, Surface], dict[str, Surface]]:
    """Return the points for form drag and for skin friction, by body."""

    def by_name(surfaces: tuple[Surface, ...]) -> dict[str, Surface]:
        return {body.name: s for body, s in zip(creature.bodies, surfaces, strict=True)}

    def surfaces(resolution: int) -> tuple[Surface, ...]:
        return outer_surfaces(creature, resolution, water.sheltered, layout)

    if water.points == "random":
        rng = np.random.default_rng(water.points_seed)
        dense = surfaces(_DENSE_RESOLUTION)
        points = by_name(random_surfaces(dense, water.random_points, rng))
        return points, points
    return by_name(surfaces(water.form_resolution)), by_name(surfaces(water.skin_resolution))


def _build_part(given: Any, kind: type, key: Key, **about: Any) -> Any:
    """Build a part, possibly of a user's own class.

    Args:
        given: section of the part.
        kind: base class of such parts.
        key: key of the section.
        about: keyword arguments that the part may use.
    """
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


def _build_task(config: ExperimentConfig, creature: Creature, light: Triple | None) -> Task:
    if isinstance(config.task, CustomConfig):
        return _build_part(config.task, Task, ("task",))
    return config.task.build(creature, light, config.simulation.control_rate_hz)
