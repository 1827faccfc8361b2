"""Loading of configuration files: accepted values, and messages for all others."""

import re
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from evo_cpg.creature.creature import NO_LIMIT, neutral_pose
from evo_cpg.evolution.genetics import BitGenetics
from evo_cpg.io.build import build_experiment
from evo_cpg.io.errors import ConfigError, nearest
from evo_cpg.io.load import check_config, dump_config, load_config
from evo_cpg.io.schema.joint import JointConfig
from evo_cpg.physics.water.added_mass import AddedMass
from evo_cpg.physics.water.fluid import Drag
from evo_cpg.physics.water.reactive_thrust import ReactiveThrust
from evo_cpg.physics.water.viscous_drag import ViscousDrag
from evo_cpg.simulation.tasks import Distance, ReachLight, Walk
from tiny_run import CONFIG, REPOSITORY

BOX = "shape: {type: box, size: [0.2, 0.1, 0.1]}, material: flesh"
JOINT = "at: [-0.11, 0, 0], child_at: [0.11, 0, 0]"
SMALL = f"""
name: small
creature:
  name: pair
  materials: {{flesh: {{density: 1000}}}}
  bodies:
    - {{name: head, {BOX}}}
    - {{name: tail, {BOX}, joint: {{parent: head, {JOINT}, axes: [z]}}}}
  light_sensors: [{{body: head}}]
"""


def small(**changes: object) -> dict:
    """Return the small configuration with changed values at keys (``__`` separates parts)."""
    data = yaml.safe_load(SMALL)
    for key, value in changes.items():
        *parents, last = (int(part) if part.isdigit() else part for part in key.split("__"))
        place = data
        for part in parents:
            place = place[part] if isinstance(part, int) else place.setdefault(part, {})
        place[last] = value
    return data


def problem(data: dict) -> str:
    """Return the error message for a configuration, which must fit on two lines."""
    with pytest.raises(ConfigError) as caught:
        build_experiment(check_config(data, "x.yaml"), "x.yaml")
    message = str(caught.value)
    assert message.startswith("x.yaml: ") and message.count("\n") <= 1
    return message.removeprefix("x.yaml: ")


def test_noise_is_in_radians_and_trials_require_noise():
    noise = {"joint_angle_deg": 90, "tilt_deg": 18, "push": 0.5}
    data = small(runs=3, simulation__trials=4, noise=noise)
    noisy = build_experiment(check_config(data, "x.yaml"), "x.yaml")
    assert (noisy.runs, noisy.trials) == (3, 4)
    built = noisy.simulation.noise
    expected = pytest.approx((np.pi / 2, np.pi / 10, 0.5))
    assert (built.joint_angle, built.tilt, built.push) == expected
    silent = build_experiment(check_config(small(simulation__trials=4), "x.yaml"), "x.yaml")
    assert silent.simulation.noise.silent and (silent.runs, silent.trials) == (1, 1)


def test_roots_that_hang_on_the_world_have_clear_limits():
    joint = {"parent": "world", "at": [0, 0, 0], "child_at": [0, 0, 0], "axes": ["z"]}
    first = small()["creature"]["bodies"][0]["name"]
    for key, value, words in (
        ("noise__tilt_deg", 5, f"noise.tilt_deg: {first!r} hangs on the world and cannot tilt"),
        ("noise__push", 0.1, "hangs on the world without a slide, so no push moves it"),
        ("creature__bodies__1__name", "world", "is the name of the fixed world"),
        ("creature__bodies__1__joint__parent", "word", "did you mean 'world'?"),
        ("creature__bodies__1__joint", joint, "are both roots"),
    ):
        assert words in problem(small(creature__bodies__0__joint=joint, **{key: value}))


def test_seed_of_the_last_run_must_be_valid():
    last = 2**31 - 1
    build_experiment(check_config(small(seed=last - 1, runs=2), "x.yaml"), "x.yaml")
    assert f"the seed of the last of 2 runs must be less than {last + 1}, got {last + 1}" in (
        problem(small(seed=last, runs=2))
    )


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"runs": 0}, "runs: 0: must be greater than or equal to 1"),
        ({"simulation__trials": 0}, "simulation.trials: 0: must be greater than or equal"),
        ({"noise__push": -1}, "noise.push: -1: must be greater than or equal to 0"),
        ({"noise__tilt": 1}, "noise.tilt: unknown key: did you mean 'tilt_deg'?"),
        ({"noise__joint_angle_deg": 181}, "noise.joint_angle_deg: 181: must be less than"),
    ],
)
def test_invalid_noise_trials_and_runs_are_rejected(changes, expected):
    assert expected in problem(small(**changes))


SHIPPED = sorted((REPOSITORY / "configs").glob("*.yaml"))


@pytest.mark.parametrize(
    "path",
    [
        # The search for a start among boulders takes six seconds.
        pytest.param(path, id=path.stem, marks=[pytest.mark.slow] * path.stem.endswith("boulders"))
        for path in SHIPPED
    ],
)
def test_shipped_configs_build(path):
    config = load_config(path)
    experiment = build_experiment(config, path)
    assert len(experiment.creature.bodies) == len(config.creature.build().bodies)
    assert experiment.simulation.steps == config.simulation.steps


@pytest.mark.parametrize("path", SHIPPED, ids=lambda p: p.stem)
def test_shipped_configs_are_read_back_unchanged(path, tmp_path):
    config = load_config(path)
    copy = tmp_path / "copy.yaml"
    copy.write_text(dump_config(config))
    assert load_config(copy) == config
    assert dump_config(load_config(copy)) == dump_config(config)


@pytest.mark.parametrize(
    ("key", "value", "expected"),
    [
        ("evolutoin", {}, "evolutoin: unknown key: did you mean 'evolution'?"),
        ("generations", 3, "generations: unknown key: did you mean evolution.generations?"),
        ("evolution__elite", 3, "evolution.elite: unknown key: did you mean 'elites'?"),
        ("world__water__densty", 1, "world.water.densty: unknown key: did you mean 'density'?"),
        (
            "evolution",
            {"type": "random", "population": 8, "islands": {"count": 2}},
            "evolution.islands: unknown key: 'islands' is a key of type ",
        ),
        (
            "evolution__sigm",
            0.5,
            "evolution.sigm: unknown key: 'sigma' is a key of type evosax. "
            "Valid here: axes, crossover_probability, elites, gene_bound, generations, islands, "
            "learning, mutation_rate, mutation_sigma, parent_fraction, population, selection, type",
        ),
        (
            "task__slip_wieght",
            1.0,
            "task.slip_wieght: unknown key: 'slip_weight' is a key of type walk. Valid here: dist",
        ),
        (
            "task__nonsense",
            1.0,
            "task.nonsense: unknown key: valid here: distance_weight, energy_max, energy_weight, ",
        ),
        (
            "controller__cpg__time_scal",
            1,
            "controller.cpg.time_scal: unknown key: did you mean 'time_scale'?",
        ),
        (
            "controller__brain__hiden",
            [4],
            "controller.brain.hiden: unknown key: did you mean 'hidden'?",
        ),
        ("simulation__steps", 300, "simulation.steps: unknown key"),
        ("controller__cpg__sensory_feedback", 0.5, "controller.cpg.sensory_feedback: unknown"),
        ("controller__drives", 1, "controller.drives: unknown key: did you mean 'drive'?"),
        (
            "creature__self_collision",
            {"exclude": [["head", "tial"]]},
            "creature.self_collision.exclude.0.1: 'tial' does not exist",
        ),
        ("task__light__bearing", 1, "task.light.bearing: unknown key: did you mean 'bearing_deg'?"),
        (
            "creature__bodies__1__shape__sise",
            1,
            "creature.bodies.1.shape.sise: unknown key: did you mean 'size'?",
        ),
        (
            "creature__bodies__1__joint__actuator",
            {"gian": 2},
            "creature.bodies.1.joint.actuator.gian: unknown key: did you mean 'gain'?",
        ),
        (
            "creature__bodies__1__joint__actuator",
            {"type": "muscle", "area": 1e-4, "arm": 0.01, "fiber_length": 0.05},
            "creature.bodies.1.joint.actuator.fiber_length: unknown key: did you mean "
            "'fibre_length'?",
        ),
        (
            "creature__bodies__1__joint__stiffness",
            [1.0, 2.0, 3.0, 4.0],
            "creature.bodies.1.joint: stiffness gives 4 values for 1 axes. Give one value for all",
        ),
        (
            "creature__bodies__1__joint__damping",
            [-1.0],
            "creature.bodies.1.joint.damping.0: -1.0: must be greater than or equal to 0",
        ),
        (
            "creature__bodies__1__joint__actuator",
            [{"gian": 2}],
            "creature.bodies.1.joint.actuator.0.gian: unknown key: did you mean 'gain'?",
        ),
        (
            "creature__bodies__1__joint__actuator",
            {"type": "torque", "gear": 0},
            "creature.bodies.1.joint.actuator: gear: must not be 0",
        ),
        (
            "creature__bodies__1__joint__actuator",
            {"type": "musle"},
            "creature.bodies.1.joint.actuator.type: 'musle' is not known",
        ),
        (
            "creature__materials__flesh__densiti",
            1,
            "creature.materials.flesh.densiti: unknown key: did you mean 'density'?",
        ),
        (
            "creature__light_sensors__0__bodie",
            1,
            "creature.light_sensors.0.bodie: unknown key: did you mean 'body'?",
        ),
    ],
)
def test_unknown_key_gets_the_nearest_valid_key(key, value, expected):
    assert problem(small(**{key: value})).startswith(expected)


@pytest.mark.parametrize(
    ("key", "value", "expected"),
    [
        ("creature__materials__flesh__density", -1, "-1: must be greater than 0"),
        ("creature__materials__flesh__density", "heavy", "'heavy': must be a number"),
        ("creature__materials__flesh__density", "1000", "'1000': must be a number"),
        ("creature__materials__flesh__density", True, "True: must be a number"),
        ("creature__materials__flesh__density", float("nan"), "nan: must be a finite"),
        ("creature__materials__flesh__density", float("inf"), "inf: must be a finite"),
        ("creature__materials__flesh__restitution", float("nan"), "nan: "),
        ("creature__bodies", [], "[]: must have at least 1, has 0"),
        ("creature__bodies__0__shape__size", [0.2, 0, 0.1], "0: must be greater than 0"),
        ("creature__bodies__0__shape__type", "cube", "'cube' is not known. Allowed: 'box'"),
        ("creature__bodies__0__color", "red", "'red': must be '#' and six hexadecimal digits"),
        ("creature__bodies__1__repeat", 100_000, "100000: must be less than or equal"),
        ("creature__bodies__1__repeat", 3, "name: a repeated body needs {i} in its name"),
        ("creature__bodies__0__repeat", 3, "name: a repeated body needs {i} in its name"),
        ("creature__light_sensors__0__axis", [0, 0, 0], "axis: must not be the zero vector"),
        ("creature__bodies__1__joint__axes", ["z", "z"], "axes: must be linearly independent"),
        ("creature__bodies__1__joint__axes", [[0, 0, 0]], "axes: must be linearly independent"),
        (
            "creature__bodies__1__joint__limits_deg",
            [30, -30],
            "limits_deg: 30 is not below -30",
        ),
        (
            "creature__bodies__1__joint__limits_deg",
            [[-30, 30], [-30, 30]],
            "limits_deg gives 2 pairs for 1 axes",
        ),
        ("world__gravity", -9.81, "-9.81: must be greater than or equal to 0"),
        ("world__gravity", False, "False: must be a number"),
        ("world__water__sheltered", 1, "1: must be true or false"),
        ("world__water__law", "newton", "'newton': must be 'normal', 'isotropic' or null"),
        ("world__water__viscosity", 0, "0: must be greater than 0"),
        ("simulation__seconds", 0, "0: must be greater than 0"),
        ("simulation__seconds", 1e6, "1e+06 s have 60000000 control steps. Allowed: 1000000"),
        ("simulation__control_rate_hz", 1e6, "33.3333 s have 33333333 control steps"),
        ("simulation__control_rate_hz", "fast", "'fast': must be a number"),
        ("seed", -1, "-1: must be greater than or equal to 0"),
        ("seed", True, "True: must be a number"),
        ("name", "../elsewhere", "'../elsewhere': must be the name of a folder"),
        ("evolution__mutation_rate", 1.5, "1.5: must be less than or equal to 1"),
        ("evolution__population", 8, "population of 8, but the default is 20"),
        ("controller__rate_gain", float("inf"), "inf: must be a finite number"),
        ("controller__rate_gain", True, "True: must be a number"),
        ("controller__cpg__time_scale", 0, "time_scale must be positive, got 0"),
        ("controller__cpg__pair_weight", float("nan"), "nan"),
        ("controller__brain__hidden", [0], "hidden layers need at least one unit each"),
        ("controller__type", "spline", "'spline' is not known. Allowed: 'brain_cpg'"),
        (
            "task__type",
            "win",
            "'win' is not known. Allowed: 'reach_light', 'distance', 'walk', or module:Class",
        ),
        ("task", {"type": "distance", "heading": "up"}, "'up': must be 'any' or 'forward'"),
        ("task", {"type": "walk", "tilt_weight": -1}, "-1: must be greater than or equal"),
        ("simulation__start_clearance", -0.1, "-0.1: must be greater than or equal to 0"),
        ("task__light__distance", 0, "0: must be greater than 0"),
        ("task__energy_weight", 0.7, "eq. 10 requires distance_weight > light_weight > energy"),
    ],
)
def test_invalid_value_gets_the_allowed_values(key, value, expected):
    message = problem(small(**{key: value}))
    section, _, _ = key.partition("__")
    assert message.startswith(section)
    assert expected in message


JOINT = "creature__bodies__1__joint__"


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"axes": "ball", "limits_deg": [-10, 60]}, "a ball has one largest angle"),
        ({"axes": "ball", "limits_deg": [[0, 60]] * 3}, "a ball has one pair"),
        ({"axes": "ball", "rest_deg": 5}, "rest_deg: must be 0 for a ball"),
        ({"axes": "ball", "damping": [1, 1, 1]}, "damping: a ball has one value"),
        ({"axes": [{"slide": "x", "limits_m": [0.1, 0]}]}, "limits_m: 0.1 is not below 0"),
        ({"axes": [{"slide": "x"}], "limits_deg": [[-9, 9]]}, "limits_deg: axis 0 slides"),
        ({"axes": [{"slide": "x"}], "rest_deg": [3]}, "rest_deg: axis 0 slides"),
        ({"axes": [{"slide": "x"}, {"slide": "-x"}]}, "axes: must be linearly independent"),
        ({"axes": ["x", {"turn": "x"}]}, "axes: must be linearly independent"),
        (
            {
                "axes": [{"slide": "x"}],
                "actuator": {"type": "muscle", "area": 1, "arm": 1, "fibre_length": 1},
            },
            "muscles turn one axis, and axis 0 slides",
        ),
        ({"axes": [{"slid": "x"}]}, "slid"),
    ],
)
def test_joints_with_unfit_values_are_rejected(changes, expected):
    data = {JOINT + key: value for key, value in {"actuator": None, **changes}.items()}
    assert expected in problem(small(**data))


def test_slides_and_axes_at_their_places_are_built():
    axes = [{"slide": "x", "limits_m": [-0.1, 0.2], "rest_m": 0.05}, {"turn": "z", "at": [1, 0, 0]}]
    changes = {"axes": [*axes, "z"], "limits_deg": [None, [-30, 30], None], "stiffness": 2}
    data = small(**{JOINT + key: value for key, value in changes.items()})
    tree = build_experiment(check_config(data, "x.yaml"), "x.yaml").simulation.world.tree
    assert tree.dof_names == ("tail.slide_x", "tail.z", "tail.z_2")
    np.testing.assert_allclose(tree.upper, [0.2, np.pi / 6, NO_LIMIT])
    np.testing.assert_allclose(tree.rest, [0.05, 0, 0])
    place = 1 - data["creature"]["bodies"][1]["joint"]["child_at"][0]
    np.testing.assert_allclose(tree.joint_places, [[0, place, 0], [0, 0, 0], [0, 0, 0]])


def test_equal_rotations_mirror_the_pose_of_a_mirrored_ball():
    joint = {**small()["creature"]["bodies"][1]["joint"], "axes": "ball"}
    image = JointConfig.model_validate(joint).mirrored("y").build("head", *np.zeros((2, 3)))
    np.testing.assert_array_equal(image.axes, np.diag([-1.0, 1.0, -1.0]))
    assert image.kind == "ball"


POSTURES = {"controller__type": "postures", "evolution__type": "bits"}


def test_postures_evolve_with_the_bit_algorithm():
    data = small(**POSTURES, evolution__mutated_genes=[2, 10], evolution__elites=5)
    experiment = build_experiment(check_config(data, "x.yaml"), "x.yaml")
    assert experiment.simulation.controller.gene_count == 8 * 1 * 3
    assert experiment.strategy.population == 15
    assert experiment.strategy.elites == 5
    assert experiment.generations == 500


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"controller__type": "postures"}, "set evolution.type to 'bits', not 'real'"),
        ({"evolution__type": "bits"}, "set evolution.type to 'real', not 'bits'"),
        ({**POSTURES, "evolution__elites": 15}, "elites must be"),
        ({**POSTURES, "evolution__rank_probabilities": [0.5, 0.2]}, "must add up to 1"),
        (POSTURES, "evolution.mutated_genes: at most 24, the bits in a genome"),
        ({**POSTURES, "evolution__mutation": "swap"}, "evolution.mutation"),
        ({**POSTURES, "controller__postures": 0}, "postures must be from 1 to 1000"),
        ({**POSTURES, "controller__postuers": 8}, "did you mean 'postures'?"),
    ],
)
def test_invalid_postures_and_bits_are_rejected(changes, expected):
    assert expected in problem(small(**changes))


PULLING = {"creature__bodies__1__joint__actuator": {"gain": 1, "stiffness": 5}}


def test_postures_beyond_a_joints_limits_are_rejected():
    """Postures from 110 to 250 degrees exceed limits of -60 to 60 only with a motor spring."""
    changes = {**POSTURES, "evolution__mutated_genes": [2, 10]}
    message = problem(small(**changes, **PULLING))
    assert message.startswith("controller: the postures turn joint tail.z from -70 to 70 degrees")
    assert message.endswith("its limits_deg allow -60 to 60")
    data = small(**changes, **PULLING, creature__bodies__1__joint__limits_deg=[-75, 69])
    assert "allow -75 to 69" in problem(data)
    assert "from -60 to 80" in problem(small(**changes, **PULLING, controller__lowest_angle=120))
    slide = {"creature__bodies__1__joint__axes": [{"slide": "x"}]}
    assert "postures command angles, but joint tail.slide_x slides" in problem(
        small(**changes, **PULLING, **slide)
    )
    for accepted in (
        small(**changes),
        small(**changes, **slide),
        small(**changes, **PULLING, creature__bodies__1__joint__limits_deg=[-70, 70]),
        small(**changes, **PULLING, controller__lowest_angle=130, controller__angle_step=14),
    ):
        build_experiment(check_config(accepted, "x.yaml"), "x.yaml")


GROUND = {"world__water": None, "world__ground": {}}


def test_creature_starts_on_the_ground():
    """A tail that hangs 0.3 m down starts at the clearance. The light moves with the creature."""

    def start(**changes):
        simulation = build_experiment(check_config(small(**changes), "x.yaml"), "x.yaml").simulation
        assert isinstance(simulation.task, ReachLight)
        return simulation.situations[0].start_position[2], simulation.task.light

    hanging = {
        "creature__bodies__1__joint__at": [0, 0, -0.1],
        "creature__bodies__1__joint__child_at": [0.1, 0, 0],
        "creature__bodies__1__joint__rotation_deg": [0, -90, 0],
        "task__light": {"distance": 2, "bearing_deg": 0, "elevation_deg": 30},
    }
    light = pytest.approx((np.sqrt(3), 0, 1))
    assert start(**hanging) == (0.0, light)
    assert start(**hanging, simulation__start_clearance=0.5) == (0.0, light)
    raised = pytest.approx((np.sqrt(3), 0, 1.3))
    assert start(**hanging, **GROUND) == (pytest.approx(0.3), raised)
    height, _ = start(**hanging, **GROUND, simulation__start_clearance=0.5)
    assert height == pytest.approx(0.8)


def test_tasks_without_a_light():
    def task(**settings):
        return build_experiment(
            check_config(small(task=settings), "x.yaml"), "x.yaml"
        ).simulation.task

    far, ahead = task(type="distance"), task(type="distance", heading="forward")
    assert isinstance(far, Distance) and isinstance(ahead, Distance)
    assert (far.light, far.heading, ahead.heading) == (None, "any", "forward")
    walk = task(type="walk", tilt_weight=3, bounce_weight=4, airborne_weight=5, distance_weight=2)
    assert isinstance(walk, Walk)
    weights = (walk.distance_weight, walk.tilt_weight, walk.bounce_weight, walk.airborne_weight)
    assert weights == (2, 3, 4, 5)
    assert (walk.slip_weight, walk.cost_weight) == (None, None)
    priced = task(type="walk", slip_weight=6, cost_weight=7)
    assert isinstance(priced, Walk)
    assert (priced.slip_weight, priced.cost_weight) == (6, 7)
    # The head is a box 0.2 m long.
    assert (walk.light, walk.heading, walk.torso_length) == (None, "any", pytest.approx(0.2))


def test_a_root_without_a_shape_is_as_long_as_its_longest_part():
    """Without parts it is as long as the whole animal, here its tail."""
    data = small(task__type="walk", world__ground={})
    root = data["creature"]["bodies"][0]
    root |= {"shape": None, "mass": 1.0, "inertia": [1, 1, 1, 0, 0, 0]}
    alone = build_experiment(check_config(data, "x.yaml"), "x.yaml").simulation.task
    assert isinstance(alone, Walk) and alone.torso_length == pytest.approx(0.2)
    ball, rod = {"type": "sphere", "radius": 0.1}, {"type": "box", "size": [0.1, 0.1, 0.7]}
    root["parts"] = [{"shape": shape, "at": [0, 0, 0]} for shape in (ball, rod)]
    walk = build_experiment(check_config(data, "x.yaml"), "x.yaml").simulation.task
    assert isinstance(walk, Walk) and walk.torso_length == pytest.approx(0.7)


@pytest.mark.parametrize(
    ("model", "bits", "height"), [(1, 192, 0.56), (2, 192, 0.48), (3, 144, 0.48)]
)
def test_the_walkers_of_fukui_2003(model, bits, height):
    """The numbers are those of the thesis, and straight legs end on the ground."""
    path = REPOSITORY / "configs" / f"fukui2003_model{model}.yaml"
    experiment = build_experiment(load_config(path), path)
    simulation = experiment.simulation
    assert simulation.controller.gene_count == bits
    assert simulation.steps / simulation.control_rate == 20
    assert simulation.situations[0].start_position[2] == pytest.approx(height)
    assert experiment.strategy == BitGenetics()
    assert {
        (body.material.restitution, body.joint is None) for body in experiment.creature.bodies
    } == {
        (0.6, True),
        (0.3, False),
    }
    centres, rotations = neutral_pose(experiment.creature)
    feet = [
        centre[2] - body.shape.half_extents[2] + simulation.situations[0].start_position[2]
        for body, centre in zip(experiment.creature.bodies, centres, strict=True)
        if body.name.endswith("lower")
    ]
    assert len(feet) == bits / 48
    np.testing.assert_allclose(feet, 0, atol=1e-12)
    np.testing.assert_array_equal(rotations, np.broadcast_to(np.eye(3), rotations.shape))


def test_names_of_bodies_and_materials_must_exist():
    key = "creature.bodies.1.joint.parent"
    message = problem(small(creature__bodies__1__joint__parent="haed"))
    assert message.startswith(f"{key}: 'haed' does not exist: did you mean 'head'?")
    message = problem(small(creature__light_sensors__0__body="tial"))
    assert message.startswith("creature.light_sensors.0.body: 'tial' does not exist: did you mean")
    message = problem(small(creature__pressure_sensors=["fin"]))
    assert message.startswith("creature.pressure_sensors.0: 'fin' does not exist: valid here: head")
    message = problem(small(creature__depth_sensors=[{"body": "fin"}]))
    assert message.startswith("creature.depth_sensors.0.body: 'fin' does not exist: valid here")
    message = problem(small(creature__bodies__0__material="bone"))
    assert message.startswith("creature.bodies.0.material: 'bone' does not exist")


def test_depth_gauges_add_inputs_to_the_brain():
    gauge = {"body": "head", "position": [0.1, 0, 0], "full_scale": 3}
    plain, deep = (
        build_experiment(check_config(small(**changes), "x.yaml"), "x.yaml").simulation
        for changes in ({}, {"creature__depth_sensors": [gauge, {"body": "tail"}]})
    )
    assert deep.sensors.depth_scales.tolist() == [3, 1]
    assert deep.controller.brain.sizes[0] == plain.controller.brain.sizes[0] + 2


def test_axes_may_be_negative():
    axes, reverse = (
        build_experiment(
            check_config(small(creature__bodies__1__joint__axes=axes), "x.yaml"), "x.yaml"
        ).simulation.world.tree
        for axes in (["y", "z"], ["-y", "-z"])
    )
    np.testing.assert_array_equal(reverse.joint_axes, -axes.joint_axes)
    assert reverse.dof_names == axes.dof_names


def test_unknown_bodies_and_axes_of_the_controller_are_named():
    message = problem(small(controller__groups={"fins": ["fin*"]}))
    assert message.startswith(
        "controller.groups.fins.0: 'fin*' matches no body (valid here: head, tail)"
    )
    message = problem(small(controller__axes={"q": {"gain": 2}}))
    assert message.startswith("controller.axes.q: no joint turns about 'q' (valid here: z)")
    message = problem(small(controller__cpg={"opposite": ["fin"]}))
    assert message.startswith(
        "controller.cpg.opposite.0: 'fin' matches no body (valid here: head, tail)"
    )
    message = problem(small(controller__axes={"z": {"gian": 2}}))
    assert message.startswith("controller.axes.z.gian: unknown key: did you mean 'gain'?")


def test_invalid_couplings_are_reported_with_their_key():
    coupling = {"source": "tail.y", "target": "tail.z"}
    message = problem(small(controller__cpg={"couplings": [coupling]}))
    assert message == (
        "controller.cpg.couplings.0.source: 'tail.y' is no degree of freedom (did you mean "
        "'tail.z'? valid here: tail.z). The controller must name parts of creature 'pair'"
    )
    message = problem(small(controller__cpg={"couplings": [coupling | {"wieght": 1}]}))
    assert message.startswith("controller.cpg.couplings.0.wieght: unknown key: did you mean")
    message = problem(small(controller__cpg={"rings": [{"oscillators": ["tail.z"], "lag_deg": 0}]}))
    assert message.startswith("controller.cpg.rings.0.oscillators: a ring needs at least two")
    message = problem(small(controller__cpg={"rings": [{"oscillators": ["tail.z"]}]}))
    assert message == "controller.cpg.rings.0.lag_deg: is missing and has no default"
    ring = {"oscillators": ["tail.z"], "lag_deg": 0, "weight": -1}
    message = problem(small(controller__cpg={"rings": [ring]}))
    assert message.startswith("controller.cpg.rings.0: weight is the strength with which a lag is")


def test_bodies_must_form_one_tree():
    data = small()
    del data["creature"]["bodies"][1]["joint"]
    assert "'head' and 'tail' are both roots. Allowed: one body" in problem(data)
    data = small()
    data["creature"]["bodies"][0]["joint"] = data["creature"]["bodies"][1]["joint"] | {
        "parent": "tail"
    }
    assert "the joints of head, tail form a ring" in problem(data)
    message = problem(small(creature__bodies__1__name="head"))
    assert message.startswith("creature.bodies.1.name: two bodies are called 'head'")


def test_error_about_a_repeated_body_names_its_entry():
    data = small(creature__bodies__1__name="tail{i}", creature__bodies__1__repeat=3)
    extra = data["creature"]["bodies"][1] | {"name": "tail2", "repeat": 1}
    data["creature"]["bodies"].append(extra)
    assert problem(data).startswith("creature.bodies.2.name: two bodies are called 'tail2'")


def test_missing_keys_are_named():
    data = small()
    del data["creature"]["bodies"][0]["shape"]
    assert problem(data) == "creature.bodies.0.shape: is missing and has no default"
    assert problem({"name": "x"}) == "creature: is missing and has no default"
    assert "creature" in problem({"name": "x", "creature": None})


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "is empty. It must be a YAML mapping"),
        ("- a\n- b\n", "must be a YAML mapping of keys to values"),
        ("just words", "must be a YAML mapping of keys to values"),
        ("a: [1, 2\nb: 3\n", "line 2, column 2: not valid YAML"),
        ("a: 1\n\tb: 2\n", "line 2, column 1: not valid YAML"),
        ("a: 1\nb:\n  c: 1\n  d: 2\n  c: 3\n", "line 5, column 3: not valid YAML: the key 'c' is"),
        ("a: {[1]: 2}", "line 1, column 5: not valid YAML: found unhashable key"),
        ("a: \x01", "line 1, column 4: not valid YAML: control characters are not allowed"),
        (
            "a: !!python/object:os.system {}",
            "line 1, column 4: not valid YAML: could not determine",
        ),
        (
            "a:\n- {b: !!timestamp nope}",
            "line 2, column 7: not valid YAML: 'nope' cannot be read as timestamp",
        ),
        ("a: !!int foo", "line 1, column 4: not valid YAML: 'foo' cannot be read as int"),
        ("a: !!int ''", "line 1, column 4: not valid YAML: '' cannot be read as int"),
        ("a: !!bool foo", "line 1, column 4: not valid YAML: 'foo' cannot be read as bool"),
        ("a: " + "7" * 5000, f"line 1, column 4: not valid YAML: '{'7' * 56}... cannot be read"),
    ],
)
def test_text_that_is_no_yaml_mapping_is_rejected(tmp_path, text, expected):
    path = tmp_path / "x.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError) as caught:
        load_config(path)
    assert str(caught.value).startswith(f"{path}: {expected}")
    assert "\n" not in str(caught.value)


def test_unreadable_files_are_rejected(tmp_path):
    (tmp_path / "swimmer.yaml").write_bytes(b"name: caf\xe9\n")
    with pytest.raises(ConfigError, match=r"swimmer.yaml: is not UTF-8 text \(byte 9"):
        load_config(tmp_path / "swimmer.yaml")
    with pytest.raises(ConfigError, match="cannot be read"):
        load_config(tmp_path)
    with pytest.raises(ConfigError, match=r"no such file: did you mean 'swimmer.yaml'\?"):
        load_config(tmp_path / "swimer.yaml")
    with pytest.raises(ConfigError, match=r"no such file$"):
        load_config(tmp_path / "nowhere" / "swimmer.yaml")
    (tmp_path / "refers.yaml").write_text("name: x\ncreature: animals/fish.yaml\n")
    with pytest.raises(ConfigError, match=r"animals/fish.yaml: no such file"):
        load_config(tmp_path / "refers.yaml")


@pytest.mark.parametrize("text", ["1e-3", "1E-3", "1.e-3", ".1e-2", "+1e-3", "0.001"])
def test_numbers_may_be_written_with_an_exponent(tmp_path, text):
    path = tmp_path / "x.yaml"
    path.write_text(f"{SMALL}\nworld: {{gravity: {text}}}\nsimulation: {{seconds: 1e3}}\n")
    config = load_config(path)
    assert config.world.gravity == 0.001
    assert config.simulation.seconds == 1000


@pytest.mark.parametrize(
    ("override", "expected"),
    [
        ("seed", "'seed' is not of the form key.path=value"),
        ("=3", "'=3' is not of the form key.path=value"),
        ("seed=[1", "seed: '[1' is not YAML"),
        ("name=!!int x", "name: '!!int x' is not YAML"),
        ("creature.bodies.7.repeat=2", "creature.bodies.7.repeat: creature.bodies has no 7"),
        ("creature.bodies.head.repeat=2", "has no head. Its entries are numbered from 0 to 1"),
        ("creature.bodies.-1.repeat=2", "has no -1. Its entries are numbered from 0 to 1"),
        ("creature.bodies.2=x", "creature.bodies has no 2. Its entries are numbered from 0 to 1"),
        ("name.first=x", "name.first: name has no first"),
        ("world.watter=null", "world.watter: unknown key: did you mean 'water'?"),
        ("creature=nobody.yaml", "nobody.yaml: no such file"),
    ],
)
def test_invalid_overrides_are_rejected(override, expected):
    with pytest.raises(ConfigError) as caught:
        load_config(CONFIG, [override])
    assert expected in str(caught.value) and "\n" not in str(caught.value)


def test_viscosity_chooses_the_drag_law():
    water = {"viscosity": 0.002, "form_drag": 0.5}
    world = build_experiment(check_config(small(world={"water": water}), "x.yaml"), "x.yaml")
    (law,) = world.simulation.world.forces
    assert isinstance(law, ViscousDrag)
    assert (law.viscosity, law.form_drag) == (0.002, 0.5)


def test_water_with_a_surface():
    water = {
        "surface": 0.5,
        "added_mass": True,
        "current_gradient": [[0, 0, 0.5], [0, 0, 0], [0, 0, 0]],
        "vortices": [{"centre": [1, 2], "circulation": 3, "core": 0.2}],
    }
    world = build_experiment(check_config(small(world={"water": water}), "x.yaml"), "x.yaml")
    world = world.simulation.world
    assert world.water.surface == 0.5
    current, vortex = world.water.streams
    assert current.gradient[0] == (0, 0, 0.5) and vortex.core == 0.2
    assert [type(law) for law in world.forces] == [Drag, AddedMass]
    assert world.law(AddedMass).carried.shape == (6, 6, 2)
    assert [cells.bodies for cells in world.cells] == [(0, 1)]
    everywhere = build_experiment(check_config(small(), "x.yaml"), "x.yaml").simulation.world
    assert everywhere.cells == () and everywhere.law(AddedMass) is None


def test_water_with_reactive_thrust_is_built():
    tail = {"name": "tail{i}", "repeat": 3}
    data = small(world={"water": {"reactive_thrust": True}})
    data["creature"]["bodies"][1] |= tail
    world = build_experiment(check_config(data, "x.yaml"), "x.yaml").simulation.world
    assert [type(law) for law in world.forces] == [Drag, AddedMass, ReactiveThrust]
    assert world.law(ReactiveThrust).bodies[:2] == (0, 3)


@pytest.mark.parametrize(
    ("water", "expected"),
    [
        (
            {"reactive_thrust": True},
            "world.water.reactive_thrust: means nothing: no chain has 3 bodies joined end to end",
        ),
        ({"surfce": 0}, "world.water.surfce: unknown key: did you mean 'surface'?"),
        (
            {"viscosity": 0.001, "skin_drag": 0.1},
            "viscosity determines skin friction; leave out skin_drag (0.1) or set it to null",
        ),
        (
            {"viscosity": 0.001, "skin_drag": 0.02},
            "viscosity determines skin friction; leave out skin_drag (0.02) or set it to null",
        ),
        (
            {"viscosity": 0.001, "law": "normal"},
            "viscosity has a drag law of its own; leave out law ('normal') or set it to null",
        ),
        (
            {"viscosity": 0.001, "law": "isotropic"},
            "viscosity has a drag law of its own; leave out law ('isotropic') or set it to null",
        ),
        (
            {"current_gradient": [[0.2, 0, 0], [0, 0.1, 0], [0, 0, 0]]},
            "water keeps its volume, so the diagonal must add up to 0",
        ),
        (
            {"vortices": [{"circulation": 1, "core": 0}]},
            "world.water.vortices.0.core: 0: must be greater than 0",
        ),
    ],
)
def test_invalid_water_is_rejected(water, expected):
    assert expected in problem(small(world={"water": water}))


def test_null_leaves_skin_drag_and_law_to_the_viscosity():
    water = {"viscosity": 0.001, "skin_drag": None, "law": None}
    config = check_config(small(world={"water": water}), "mine.yaml")
    again = check_config(config.model_dump(mode="json"), "again.yaml")
    assert again == config == check_config(small(world={"water": {"viscosity": 0.001}}), "")
    plain = check_config(small(world={"water": water | {"viscosity": None}}), "").world.water
    assert plain is not None and (plain.skin_drag, plain.law) == (0.02, "normal")


def test_overrides_apply_in_order_and_reach_everything():
    config = load_config(
        CONFIG,
        [
            "creature.bodies.1.repeat=2",
            "world.water=null",
            "task.light.distance=3",
            "seed=1",
            "seed=2",
        ],
    )
    assert [entry.repeat for entry in config.creature.bodies] == [1, 2]
    assert config.world.water is None
    assert config.task.light.distance == 3
    assert config.seed == 2


def test_an_override_may_replace_the_creature(tmp_path):
    animal = yaml.safe_load((REPOSITORY / "configs/creatures/swimmer10.yaml").read_text())
    (tmp_path / "other.yaml").write_text(yaml.safe_dump(animal | {"name": "other"}))
    path = f"creature={tmp_path / 'other.yaml'}"
    config = load_config(CONFIG, [path, "creature.bodies.1.repeat=3"])
    assert config.creature.name == "other"
    assert config.creature.bodies[1].repeat == 3


def test_a_config_may_change_keys_of_a_creature_file(tmp_path):
    path = tmp_path / "changed.yaml"
    data = yaml.safe_load(CONFIG.read_text())
    file = str(CONFIG.parent / data["creature"])

    def changed(**creature):
        path.write_text(yaml.safe_dump(data | {"creature": creature}))
        return load_config(path)

    gauge = {"body": "head", "position": [0, 0, 0], "full_scale": 0.2}
    config, plain = changed(file=file, depth_sensors=[gauge]), load_config(CONFIG)
    assert config.creature.depth_sensors[0].full_scale == 0.2
    assert config.creature.bodies == plain.creature.bodies
    with pytest.raises(ConfigError, match=r"creature\.file: must be the path"):
        changed(file=3)
    with pytest.raises(ConfigError, match=r"other\.yaml"):
        changed(file="other.yaml")
    with pytest.raises(ConfigError, match="depth_sensors"):
        changed(file=file, depth_sensor=[gauge])
    for name in ("\0", "a" * 300):
        with pytest.raises(ConfigError):
            changed(file=name)


@given(st.text(max_size=12), st.lists(st.text(min_size=1, max_size=12), min_size=1, max_size=6))
def test_hint_lists_all_valid_words(word, valid):
    assert nearest(word, valid).endswith(f"valid here: {', '.join(sorted(valid))}")


JUNK = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: (
        st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=3)
    ),
    max_leaves=6,
)
PLACES = (
    "name",
    "seed",
    "creature",
    "world",
    "simulation",
    "controller",
    "task",
    "evolution",
    "creature__bodies",
    "creature__bodies__0",
    "creature__bodies__1__joint",
    "creature__bodies__1__joint__axes",
    "creature__bodies__1__joint__limits_deg",
    "creature__bodies__0__shape",
    "creature__materials",
    "creature__light_sensors",
    "creature__pressure_sensors",
    "world__water",
    "controller__cpg",
    "controller__brain",
    "controller__brain__hidden",
    "controller__axes",
    "controller__groups",
    "controller__type",
    "task__light",
    "task__type",
    "evolution__population",
)


@given(st.sampled_from(PLACES), JUNK)
def test_any_value_is_accepted_or_rejected_without_a_crash(place, junk):
    data = small(**{place: junk})
    try:
        check_config(data, Path("x.yaml"))
    except ConfigError as error:
        assert str(error).startswith("x.yaml: ")


def test_own_class_options_equal_those_of_a_resumed_run(tmp_path):
    def read(options: str):
        path = tmp_path / "x.yaml"
        path.write_text(f"{SMALL}\ntask: {{type: 'mine:Task', options: {options}}}\n")
        return load_config(path)

    config = read("{lags: {a: 1.0}, when: 2026-11-26, name: '1e3', list: [1, [true, null]]}")
    options = config.task.options
    assert options["when"] == "2026-11-26"
    copy = tmp_path / "config.yaml"
    copy.write_text(dump_config(config))
    assert load_config(copy).task.options == options
    given = {"type": "mine:Task", "options": {"pair": (1, 2)}}
    assert check_config(yaml.safe_load(SMALL) | {"task": given}, "x").task.options == {
        "pair": [1, 2]
    }
    for wrong, words in (
        ("{lags: {0: 1.0}}", "lags has the key 0. Allowed: text, such as '0'"),
        ("{a: [{true: 1}]}", "a.0 has the key True"),
        ("{a: !!binary aGk=}", "a is a bytes. Allowed: text, numbers"),
        ("{a: !!set {x}}", "a is a set"),
    ):
        with pytest.raises(ConfigError, match=re.escape(f"options: {words}")):
            read(wrong)


def test_a_cost_needs_gravity():
    path = REPOSITORY / "configs/hexapod_tripod.yaml"
    config = load_config(path, ["world.gravity=0"])
    with pytest.raises(ConfigError, match="cost_weight: the cost is undefined without gravity"):
        build_experiment(config, path)
