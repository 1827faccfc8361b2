"""From a checked configuration to an experiment."""

import dataclasses
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from evo_cpg.config.errors import ConfigError, nearest
from evo_cpg.config.lines import with_line
from evo_cpg.config.numbers import unchecked
from evo_cpg.config.own_classes import build_own, require_code
from evo_cpg.config.own_returns import check_own_forces, check_own_returns
from evo_cpg.config.schema.choice import CustomConfig
from evo_cpg.config.schema.evolution import RealEvolutionConfig
from evo_cpg.config.schema.experiment import ExperimentConfig
from evo_cpg.config.schema.world import WaterConfig
from evo_cpg.config.situations import build_situations, require_light
from evo_cpg.config.strategy import build_strategy
from evo_cpg.config.terrain import build_ground
from evo_cpg.config.trust import code_folders
from evo_cpg.control.brain_cpg import BrainCpgSettings, build_brain_cpg
from evo_cpg.control.controller import Controller
from evo_cpg.control.couplings import CouplingError, UnfitError
from evo_cpg.control.postures import PostureSettings, build_posture_controller
from evo_cpg.creature.creature import Creature, CreatureError, length_of
from evo_cpg.creature.self_collision import PlanPairs, SelfCollision
from evo_cpg.creature.shapes import Surface
from evo_cpg.creature.surface import PointLayout, outer_surfaces, random_surfaces
from evo_cpg.creature.tree import Tree, build_tree
from evo_cpg.fusion.engine import Engine, target, using
from evo_cpg.fusion.unsupported import Unsupported
from evo_cpg.physics.added_mass import AddedMass, added_inertia
from evo_cpg.physics.buoyancy import make_cells
from evo_cpg.physics.fluid import Drag, Patch, make_patches
from evo_cpg.physics.footing import make_footing
from evo_cpg.physics.force_law import ForceLaw
from evo_cpg.physics.pairs import make_pairs
from evo_cpg.physics.water import Current, Vortex, Water
from evo_cpg.physics.world import World
from evo_cpg.simulation.measures import GROUND_MEASURES, MEASURES, Measures, measures
from evo_cpg.simulation.noise import Noise
from evo_cpg.simulation.rules import Rules
from evo_cpg.simulation.sensor import Sensor
from evo_cpg.simulation.sensors import place_sensors
from evo_cpg.simulation.simulation import Simulation
from evo_cpg.simulation.task import Task, term_names
from evo_cpg.spatial.choices import chosen
from evo_cpg.spatial.numerics import Triple, xp
from evo_cpg.system import resolved, with_working_folder
from evo_cpg.training.experiment import Experiment, Learning

# Random surface points are drawn from a quadrature this fine.
_DENSE_RESOLUTION = 24

# Elites that learn unless the configuration says how many: a full vector on one core.
_LEARNERS = 16


def build_experiment(
    config: ExperimentConfig,
    source: Path | str,
    folders: Iterable[Path] = (),
    layout: PointLayout = "merged",
    pairs: PlanPairs | None = None,
) -> Experiment:
    """Build what a configuration describes.

    Args:
        config: the configuration.
        source: file it came from, for messages; a user's own classes are looked for beside it,
            where it is trusted (`evo_cpg.config.trust`).
        folders: where else to look for them then, before the working folder.
        layout: of the surface points, in which bodies of a batch agree.
        pairs: of bodies that are looked at in all creatures of a plan; None for what the creature's
            own numbers make of it.

    Raises:
        ConfigError: parts that do not fit together.
    """
    try:
        return _build_experiment(config, source, folders, layout, pairs)
    except ConfigError as error:
        raise with_line(error, config.model_dump(mode="json")) from None


def _build_experiment(
    config: ExperimentConfig,
    source: Path | str,
    folders: Iterable[Path],
    layout: PointLayout,
    pairs: PlanPairs | None,
) -> Experiment:
    folders = (Path(source).parent, *folders)
    for folder in with_working_folder(code_folders(folders)):
        if str(resolved(folder)) not in sys.path:
            sys.path.append(str(resolved(folder)))
    require_code(config, source, folders)
    creature, simulation = build_simulation(config, source, layout, pairs)
    evolution = config.evolution
    learning = None
    if isinstance(evolution, RealEvolutionConfig) and evolution.learning:
        given = evolution.learning
        elites = given.elites or min(_LEARNERS, evolution.elites)
        learning = Learning(given.every, elites, given.steps)
    require_light(config, simulation.task, source)
    trials = config.simulation.trials
    if isinstance(trials, list):
        trials = len(trials)
    elif simulation.noise.silent:
        # One trial is as good as many.
        trials = 1
    check_own_returns(config, simulation, source)
    strategy = build_strategy(config, simulation, trials, source)
    return Experiment(
        name=config.name,
        creature=creature,
        simulation=simulation,
        strategy=strategy,
        generations=evolution.generations,
        seed=config.seed,
        runs=config.runs,
        trials=trials,
        learning=learning,
    )


def require_genes(experiment: Experiment, source: Path | str) -> None:
    """Check that there is something to evolve.

    Args:
        experiment: built from a configuration.
        source: file it came from, for messages.

    Raises:
        ConfigError: the controller has no genes.
    """
    controller = experiment.simulation.controller
    if experiment.simulation.genome.count == 0:
        raise ConfigError(
            source,
            ("controller",),
            f"{type(controller).__name__} has no genes, so there is nothing to evolve; choose a "
            "controller that has some, such as {type: brain_cpg}",
        )


def build_simulation(
    config: ExperimentConfig,
    source: Path | str,
    layout: PointLayout = "merged",
    pairs: PlanPairs | None = None,
) -> tuple[Creature, Simulation]:
    """The creature that a configuration describes, and what its trials are made of.

    The numbers of the configuration may be traced (see `evo_cpg.config.numbers.put_numbers`) where
    what is chosen by them is known (`evo_cpg.spatial.choices.repeating`).

    Args:
        config: the configuration; a user's own classes can be imported.
        source: file it came from, for messages.
        layout: see `build_experiment`.
        pairs: likewise.

    Raises:
        ConfigError: parts that do not fit together.
    """
    engine = _choose_engine(config, source)
    creature = build_creature(config, source)
    tree = build_tree(creature)
    world = _build_world(config, creature, tree, layout, pairs, source)
    check_own_forces(config, world, source)
    extra_sensors = _build_sensors(config, tree, source)
    custom = sum(sensor.count for sensor in extra_sensors)
    controller = _build_controller(config, creature, tree, custom, source)
    noise = Noise(
        joint_angle=xp.deg2rad(config.noise.joint_angle_deg),
        tilt=xp.deg2rad(config.noise.tilt_deg),
        push=config.noise.push,
        friction=config.noise.friction,
    )
    if config.noise.friction and world.footing is None:
        raise ConfigError(source, ("noise", "friction"), "there is no ground to be rough")
    with using(engine):
        situations = build_situations(config, creature, world, source)
    task = _build_task(config, creature, situations[0].light, source)
    simulation = Simulation(
        world=world,
        sensors=place_sensors(creature, tree),
        controller=controller,
        task=task,
        control_rate=config.simulation.control_rate_hz,
        substeps=config.simulation.substeps,
        steps=config.simulation.steps,
        noise=noise,
        situations=situations,
        engine=engine,
        extra_sensors=extra_sensors,
        rules=_build_rules(config, creature, world, pairs, source),
        measures=_build_measures(config, task, world, source),
    )
    return creature, simulation


def _build_measures(
    config: ExperimentConfig, task: Task, world: World, source: Path | str
) -> Measures:
    """What is measured of the gait: what is asked for, and the axes of a map.

    Raises:
        ConfigError: there is no such measure, or not in this world.
    """
    if not config.measures and not config.evolution.axes:
        return Measures()
    try:
        own = term_names(task)
    except Exception:
        # A task of the user's own that fails; `check_own_returns` will say so.
        own = ()
    asked: list[tuple[tuple[str | int, ...], str]] = [
        (("measures", i), name) for i, name in enumerate(config.measures)
    ]
    if config.evolution.axes:
        asked += [
            (("evolution", "axes", i, "name"), axis.name)
            for i, axis in enumerate(config.evolution.axes)
            if axis.name not in own
        ]
    for key, name in asked:
        if name not in MEASURES:
            known = [*MEASURES, *(own if key[0] == "evolution" else ())]
            raise ConfigError(source, key, f"{name!r} is no measure; {nearest(name, known)}")
        if name in own:
            raise ConfigError(source, key, f"{name!r} is a term of the task already")
        if name in GROUND_MEASURES and world.footing is None:
            raise ConfigError(source, key, f"{name!r} means nothing: there is no ground")
        if name == "cost_of_transport" and not chosen(lambda: world.gravity > 0):
            raise ConfigError(source, key, f"{name!r} means nothing: there is no gravity")
    return measures(*dict.fromkeys(name for _, name in asked))


def _build_rules(
    config: ExperimentConfig,
    creature: Creature,
    world: World,
    pairs: PlanPairs | None,
    source: Path | str,
) -> Rules | None:
    """What an individual is out for breaking.

    Raises:
        ConfigError: a rule whose limit is not given, or that cannot be broken.
    """
    names = config.audit.disqualify
    if not names:
        return None
    limits = config.audit.limits().of_length(length_of(creature))
    if "power" in names and limits.power is None:
        raise ConfigError(source, ("audit", "power"), "is missing; disqualify names it")
    if "penetration" in names and world.footing is None:
        raise ConfigError(source, ("audit", "disqualify"), "penetration: there is no ground")
    most = {name: getattr(limits, name) for name in names}
    if "speed" in most:
        most["speed"] = most["speed"] * length_of(creature)
    if "power" in most:
        most["power"] = most["power"] * creature.mass
    if "overlap" not in most:
        return Rules(**most)
    watched = world.watched
    if pairs is not None:
        given = config.creature.build_self_collision(on_ground=world.footing is not None)
        include = given.include if given else ()
        watched = SelfCollision(include=include, only=pairs.watched)
    return Rules(**most, pairs=make_pairs(creature, world.tree, watched))


def _choose_engine(config: ExperimentConfig, source: Path | str) -> Engine:
    """What computes the trials.

    Raises:
        ConfigError: the configuration insists on what this machine does not have.
    """
    engine = Engine(config.engine, config.instruction_set)
    if engine.name == "native":
        try:
            with using(engine):
                target()
        except Unsupported as error:
            key = ("engine",) if config.instruction_set == "host" else ("instruction_set",)
            raise ConfigError(source, key, f"there is no such native code here: {error}") from None
    return engine


def build_creature(config: ExperimentConfig, source: Path | str) -> Creature:
    """The creature alone.

    Raises:
        ConfigError: its bodies do not form one tree.
    """
    try:
        return config.creature.build()
    except CreatureError as error:
        where: list[str | int] = list(error.where)
        if len(where) > 1 and isinstance(where[1], int):
            where[1] = config.creature.entry_of(where[1])
        raise ConfigError(source, ("creature", *where), str(error)) from None


def _build_world(
    config: ExperimentConfig,
    creature: Creature,
    tree: Tree,
    layout: PointLayout,
    pairs: PlanPairs | None,
    source: Path | str,
) -> World:
    water = config.world.water
    ground = config.world.ground and build_ground(config.world.ground)
    wanted = config.creature.build_self_collision(on_ground=ground is not None)
    if wanted:
        wanted = dataclasses.replace(wanted, only=pairs and pairs.kept)
    return World(
        tree=tree,
        gravity=config.world.gravity,
        water=_build_water(water) if water else None,
        forces=(
            *(_water_laws(water, creature, tree, layout) if water else ()),
            *_own_laws(config, creature, tree, source),
        ),
        footing=ground and make_footing(creature, tree, ground),
        cells=make_cells(creature, tree) if water and water.surface is not None else (),
        pairs=wanted and make_pairs(creature, tree, wanted),
    )


def _build_water(water: WaterConfig) -> Water:
    vortices = (Vortex(**dict(vortex)) for vortex in water.vortices)
    current = Current(water.current, water.current_gradient)
    return Water(water.density, water.surface, (current, *vortices))


def _water_laws(
    water: WaterConfig, creature: Creature, tree: Tree, layout: PointLayout
) -> Iterator[ForceLaw]:
    """Force laws of the water, in the order in which they are added up."""
    patches = _surface_points(water, creature, tree, layout)
    yield Drag(water.form_drag, water.skin_drag, patches, water.law)
    if water.added_mass:
        yield AddedMass(added_inertia(creature, tree, water.density))


def _own_laws(
    config: ExperimentConfig, creature: Creature, tree: Tree, source: Path | str
) -> Iterator[ForceLaw]:
    """Force laws of the user's own."""
    for i, given in enumerate(config.world.forces):
        key = "world", "forces", i
        yield build_own(given, ForceLaw, key, source, creature=creature, tree=tree)


def _surface_points(
    water: WaterConfig, creature: Creature, tree: Tree, layout: PointLayout
) -> tuple[Patch, ...]:
    def by_name(surfaces: tuple[Surface, ...]) -> dict[str, Surface]:
        return {body.name: s for body, s in zip(creature.bodies, surfaces, strict=True)}

    surfacing = water.surface is not None
    if water.points == "random":
        rng = np.random.default_rng(water.points_seed)
        dense = outer_surfaces(creature, _DENSE_RESOLUTION, water.sheltered, layout)
        points = by_name(random_surfaces(dense, water.random_points, rng))
        return make_patches(tree, points, points, water.law, surfacing, layout)
    form = by_name(outer_surfaces(creature, water.form_resolution, water.sheltered, layout))
    skin = by_name(outer_surfaces(creature, water.skin_resolution, water.sheltered, layout))
    return make_patches(tree, form, skin, water.law, surfacing, layout)


def _build_sensors(config: ExperimentConfig, tree: Tree, source: Path | str) -> tuple[Sensor, ...]:
    step = 1.0 / config.simulation.control_rate_hz
    return tuple(
        build_own(given, Sensor, ("creature", "sensors", i), source, tree=tree, control_step=step)
        if isinstance(given, CustomConfig)
        else given.build()
        for i, given in enumerate(config.creature.sensors)
    )


def _build_controller(
    config: ExperimentConfig, creature: Creature, tree: Tree, custom: int, source: Path | str
) -> Controller:
    given = config.controller
    eyes, pressure = len(creature.light_sensors), len(creature.pressure_sensors)
    depth = len(creature.depth_sensors)
    step = 1.0 / config.simulation.control_rate_hz
    if isinstance(given, CustomConfig):
        return build_own(
            given,
            Controller,
            ("controller",),
            source,
            tree=tree,
            light_count=eyes,
            pressure_count=pressure,
            control_step=step,
            depth_count=depth,
            custom_count=custom,
        )
    options = {name: getattr(given, name) for name in type(given).model_fields if name != "type"}
    kind = PostureSettings if given.type == "postures" else BrainCpgSettings
    try:
        chosen(lambda: kind(**options) and None)
        if given.type == "postures":
            settings = unchecked(PostureSettings, options)
            return build_posture_controller(tree, settings, step)
        settings = unchecked(BrainCpgSettings, options)
        return build_brain_cpg(tree, eyes, pressure, settings, step, depth, custom)
    except UnfitError as error:
        inner = ("cpg",) if isinstance(error, CouplingError) else ()
        problem = f"{error}; the controller must name parts of creature {creature.name!r}"
        raise ConfigError(source, ("controller", *inner, *error.where), problem) from None
    except ValueError as error:
        raise ConfigError(source, ("controller",), str(error)) from None


def _build_task(
    config: ExperimentConfig, creature: Creature, light: Triple | None, source: Path | str
) -> Task:
    given = config.task
    if isinstance(given, CustomConfig):
        return build_own(given, Task, ("task",), source)
    return given.build(creature, light, config.simulation.control_rate_hz)
