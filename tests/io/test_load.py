"""Loading of configuration files: accepted values, and messages for all others."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from evo_cpg.creature.creature import NO_LIMIT, neutral_pose
from evo_cpg.evolution.genetics import BitGenetics
from evo_cpg.io.build import build_experiment
from evo_cpg.io.errors import ConfigError
from evo_cpg.io.load import check_config, dump_config, load_config
from evo_cpg.io.schema.joint import JointConfig
from evo_cpg.physics.water.added_mass import AddedMass
from evo_cpg.physics.water.fluid import Drag
from evo_cpg.physics.water.reactive_thrust import ReactiveThrust
from evo_cpg.physics.water.viscous_drag import ViscousDrag
from evo_cpg.simulation.tasks import Distance, ReachLight, Walk
from shipped_configs import PATHS, some_configs
from tiny_run import CONFIG, REPOSITORY
from wrong_values import SMALL, built, small


def test_noise_is_in_radians_and_trials_require_noise():
    noise = {"joint_angle_deg": 90, "tilt_deg": 18, "push": 0.5}
    noisy = built({"runs": 3, "simulation.trials": 4, "noise": noise})
    assert (noisy.runs, noisy.trials) == (3, 4)
    made = noisy.simulation.noise
    expected = pytest.approx((np.pi / 2, np.pi / 10, 0.5))
    assert (made.joint_angle, made.tilt, made.push) == expected
    silent = built({"simulation.trials": 4})
    assert silent.simulation.noise.silent and (silent.runs, silent.trials) == (1, 1)


JOINT = "creature.bodies.1.joint."


@pytest.mark.parametrize(
    "path",
    [
        # The search for a start among boulders takes six seconds.
        pytest.param(path, id=path.stem, marks=[pytest.mark.slow] * path.stem.endswith("boulders"))
        for path in PATHS
    ],
)
def test_shipped_configs_build(path):
    config = load_config(path)
    experiment = build_experiment(config, path)
    assert len(experiment.creature.bodies) == len(config.creature.build().bodies)
    assert experiment.simulation.steps == config.simulation.steps


@some_configs
def test_shipped_configs_are_read_back_unchanged(path, tmp_path):
    config = load_config(path)
    copy = tmp_path / "copy.yaml"
    copy.write_text(dump_config(config))
    assert load_config(copy) == config
    assert dump_config(load_config(copy)) == dump_config(config)


def test_slides_and_axes_at_their_places_are_built():
    axes = [{"slide": "x", "limits_m": [-0.1, 0.2], "rest_m": 0.05}, {"turn": "z", "at": [1, 0, 0]}]
    changes = {"axes": [*axes, "z"], "limits_deg": [None, [-30, 30], None], "stiffness": 2}
    tree = built({JOINT + key: value for key, value in changes.items()}).simulation.world.tree
    assert tree.dof_names == ("tail.slide_x", "tail.z", "tail.z_2")
    np.testing.assert_allclose(tree.upper, [0.2, np.pi / 6, NO_LIMIT])
    np.testing.assert_allclose(tree.rest, [0.05, 0, 0])
    np.testing.assert_allclose(tree.joint_places, [[0, 1 - 0.11, 0], [0, 0, 0], [0, 0, 0]])


def test_equal_rotations_mirror_the_pose_of_a_mirrored_ball():
    joint = {**small({})["creature"]["bodies"][1]["joint"], "axes": "ball"}
    image = JointConfig.model_validate(joint).mirrored("y").build("head", *np.zeros((2, 3)))
    np.testing.assert_array_equal(image.axes, np.diag([-1.0, 1.0, -1.0]))
    assert image.kind == "ball"


POSTURES = {
    "controller.type": "postures",
    "evolution.type": "bits",
    "evolution.mutated_genes": [2, 10],
}


def test_postures_evolve_with_the_bit_algorithm():
    experiment = built({**POSTURES, "evolution.elites": 5})
    assert experiment.simulation.controller.gene_count == 8 * 1 * 3
    assert (experiment.strategy.population, experiment.strategy.elites) == (15, 5)
    assert experiment.generations == 500


PULLING = {f"{JOINT}actuator": {"gain": 1, "stiffness": 5}}


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {f"{JOINT}axes": [{"slide": "x"}]},
        {**PULLING, f"{JOINT}limits_deg": [-70, 70]},
        {**PULLING, "controller.lowest_angle": 130, "controller.angle_step": 14},
    ],
)
def test_postures_within_limits_are_accepted(changes):
    built({**POSTURES, **changes})


GROUND = {"world.water": None, "world.ground": {}}


def test_creature_starts_on_the_ground():
    """A tail that hangs 0.3 m down starts at the clearance. The light moves with the creature."""
    hanging = {
        f"{JOINT}at": [0, 0, -0.1],
        f"{JOINT}child_at": [0.1, 0, 0],
        f"{JOINT}rotation_deg": [0, -90, 0],
        "task.light": {"distance": 2, "bearing_deg": 0, "elevation_deg": 30},
    }
    for changes, height in (
        ({}, 0.0),
        ({"simulation.start_clearance": 0.5}, 0.0),
        (GROUND, 0.3),
        ({**GROUND, "simulation.start_clearance": 0.5}, 0.8),
    ):
        simulation = built({**hanging, **changes}).simulation
        assert simulation.situations[0].start_position[2] == pytest.approx(height)
        assert isinstance(simulation.task, ReachLight)
        assert simulation.task.light == pytest.approx((np.sqrt(3), 0, 1 + height))


def test_tasks_without_a_light():
    far, ahead, walk, priced = (
        built({"task": task}).simulation.task
        for task in (
            {"type": "distance"},
            {"type": "distance", "heading": "forward"},
            {"type": "walk", "tilt_weight": 3, "bounce_weight": 4, "distance_weight": 2},
            {"type": "walk", "slip_weight": 6, "cost_weight": 7},
        )
    )
    assert isinstance(far, Distance) and isinstance(ahead, Distance)
    assert (far.light, far.heading, ahead.heading) == (None, "any", "forward")
    assert isinstance(walk, Walk) and isinstance(priced, Walk)
    assert (walk.distance_weight, walk.tilt_weight, walk.bounce_weight) == (2, 3, 4)
    assert (walk.slip_weight, walk.cost_weight) == (None, None)
    assert (priced.slip_weight, priced.cost_weight) == (6, 7)
    # The head is a box 0.2 m long.
    assert (walk.light, walk.heading, walk.torso_length) == (None, "any", pytest.approx(0.2))


def test_a_root_without_a_shape_is_as_long_as_its_longest_part():
    """Without parts it is as long as the whole animal, here its tail."""
    ball, rod = {"type": "sphere", "radius": 0.1}, {"type": "box", "size": [0.1, 0.1, 0.7]}
    for parts, length in (([], 0.2), ([ball, rod], 0.7)):
        changes = {"shape": None, "mass": 1.0, "inertia": [1, 1, 1, 0, 0, 0]}
        changes["parts"] = [{"shape": shape, "at": [0, 0, 0]} for shape in parts]
        root = {f"creature.bodies.0.{key}": value for key, value in changes.items()}
        walk = built({"task.type": "walk", "world.ground": {}, **root}).simulation.task
        assert isinstance(walk, Walk) and walk.torso_length == pytest.approx(length)


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
    } == {(0.6, True), (0.3, False)}
    centres, rotations = neutral_pose(experiment.creature)
    feet = [
        centre[2] - body.shape.half_extents[2] + simulation.situations[0].start_position[2]
        for body, centre in zip(experiment.creature.bodies, centres, strict=True)
        if body.name.endswith("lower")
    ]
    assert len(feet) == bits / 48
    np.testing.assert_allclose(feet, 0, atol=1e-12)
    np.testing.assert_array_equal(rotations, np.broadcast_to(np.eye(3), rotations.shape))


def test_depth_gauges_add_inputs_to_the_brain():
    gauge = {"body": "head", "position": [0.1, 0, 0], "full_scale": 3}
    plain = built({}).simulation
    deep = built({"creature.depth_sensors": [gauge, {"body": "tail"}]}).simulation
    assert deep.sensors.depth_scales.tolist() == [3, 1]
    assert deep.controller.brain.sizes[0] == plain.controller.brain.sizes[0] + 2


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("", "empty"),
        ("- a\n- b\n", "mapping"),
        ("a: [1, 2\nb: 3\n", "line 2, column 2: not valid YAML"),
        ("a: 1\n\tb: 2\n", "only spaces"),
        ("a: 1\nb:\n  c: 1\n  d: 2\n  c: 3\n", "line 5, column 3: not valid YAML: the key 'c'"),
        ("a: {[1]: 2}", "line 1, column 5"),
        ("a: \x01", "line 1, column 4"),
        ("a: {side}_fin", "{side}_fin"),
        ("a: !!python/object:os.system {}", "line 1, column 4"),
        ("a:\n- {b: !!timestamp nope}", "not valid YAML"),
        ("a: !!int foo", "'foo'"),
        ("a: " + "7" * 5000, "5000 digits"),
        ("creature:\n  color: #ffffff\n", "line 2: color"),
    ],
)
def test_text_that_is_no_yaml_mapping_is_rejected(tmp_path, text, word):
    path = tmp_path / "x.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError) as caught:
        load_config(path)
    assert str(caught.value).startswith(f"{path}: ") and word in str(caught.value)
    assert "\n" not in str(caught.value)


def test_unreadable_files_are_rejected(tmp_path):
    (tmp_path / "swimmer.yaml").write_bytes(b"name: caf\xe9\n")
    (tmp_path / "wide.yaml").write_bytes("name: x".encode("utf-16"))
    (tmp_path / "refers.yaml").write_text("name: x\ncreature: animals/fish.yaml\n")
    for name, word in (
        ("swimmer.yaml", "byte 9, in line 1"),
        ("wide.yaml", "byte 0, in line 1"),
        ("", "cannot be read"),
        ("swimer.yaml", "'swimmer.yaml'"),
        ("nowhere/swimmer.yaml", "no such file$"),
        ("refers.yaml", "animals/fish.yaml: no such file"),
    ):
        with pytest.raises(ConfigError, match=word):
            load_config(tmp_path / name)


@pytest.mark.parametrize(
    "change", [lambda t: b"\xef\xbb\xbf" + t, lambda t: t.replace(b"\n", b"\r\n")]
)
def test_other_line_ends_and_a_byte_order_mark_are_accepted(tmp_path, change):
    path = tmp_path / "x.yaml"
    path.write_bytes(change(SMALL.encode()))
    assert load_config(path).creature.bodies[1].joint is not None


@pytest.mark.parametrize(
    ("override", "word"),
    [
        ("seed", "key.path=value"),
        ("seed=[1", "seed: '[1' is not YAML"),
        ("name=!!int x", "name: '!!int x' is not YAML"),
        ("creature.bodies.1.name={side}_fin", "not YAML"),
        ("creature.bodies.7.repeat=2", "no 7"),
        ("creature.bodies.head.repeat=2", "0 to 1"),
        ("name.first=x", "no first"),
        ("world.watter=null", "'water'"),
        ("creature=nobody.yaml", "no such file"),
    ],
)
def test_invalid_overrides_are_rejected(override, word):
    with pytest.raises(ConfigError) as caught:
        load_config(CONFIG, [override])
    assert word in str(caught.value) and "\n" not in str(caught.value)


def test_viscosity_chooses_the_drag_law():
    world = built({"world.water": {"viscosity": 0.002, "form_drag": 0.5}}).simulation.world
    (law,) = world.forces
    assert isinstance(law, ViscousDrag)
    assert (law.viscosity, law.form_drag) == (0.002, 0.5)


def test_water_with_a_surface():
    water = {
        "surface": 0.5,
        "added_mass": True,
        "current_gradient": [[0, 0, 0.5], [0, 0, 0], [0, 0, 0]],
        "vortices": [{"centre": [1, 2], "circulation": 3, "core": 0.2}],
    }
    world = built({"world.water": water}).simulation.world
    assert world.water.surface == 0.5
    current, vortex = world.water.streams
    assert current.gradient[0] == (0, 0, 0.5) and vortex.core == 0.2
    assert [type(law) for law in world.forces] == [Drag, AddedMass]
    assert world.law(AddedMass).carried.shape == (6, 6, 2)
    assert [cells.bodies for cells in world.cells] == [(0, 1)]
    everywhere = built({}).simulation.world
    assert everywhere.cells == () and everywhere.law(AddedMass) is None


def test_water_with_reactive_thrust_is_built():
    tail = {"creature.bodies.1.name": "tail{i}", "creature.bodies.1.repeat": 3}
    world = built({**tail, "world.water.reactive_thrust": True}).simulation.world
    assert [type(law) for law in world.forces] == [Drag, AddedMass, ReactiveThrust]
    assert world.law(ReactiveThrust).bodies[:2] == (0, 3)


def test_null_leaves_skin_drag_and_law_to_the_viscosity():
    water = {"viscosity": 0.001, "skin_drag": None, "law": None}
    config = check_config(small({"world.water": water}), "mine.yaml")
    again = check_config(config.model_dump(mode="json"), "again.yaml")
    assert again == config == check_config(small({"world.water": {"viscosity": 0.001}}), "")
    plain = check_config(small({"world.water": water | {"viscosity": None}}), "").world.water
    assert plain is not None and (plain.skin_drag, plain.law) == (0.02, "normal")


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


JUNK = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: (
        st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=3)
    ),
    max_leaves=6,
)
PLACES = [
    *("name", "seed", "creature", "world", "simulation", "controller", "task", "evolution"),
    *("creature.bodies", "creature.bodies.0", "creature.bodies.1.joint"),
    *("creature.bodies.1.joint.axes", "creature.bodies.1.joint.limits_deg"),
    *("creature.bodies.0.shape", "creature.materials", "creature.light_sensors"),
    *("creature.pressure_sensors", "world.water", "controller.cpg", "controller.brain"),
    *("controller.brain.hidden", "controller.axes", "controller.groups", "controller.type"),
    *("task.light", "task.type", "evolution.population"),
]


@given(st.sampled_from(PLACES), JUNK)
def test_any_value_is_accepted_or_rejected_without_a_crash(place, junk):
    data = small({place: junk})
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
        ("{lags: {0: 1.0}}", "lags .* 0"),
        ("{a: [{true: 1}]}", "a.0 .* True"),
        ("{a: !!binary aGk=}", "a .* bytes"),
        ("{a: !!set {x}}", "a .* set"),
    ):
        with pytest.raises(ConfigError, match=f"options: {words}"):
            read(wrong)
