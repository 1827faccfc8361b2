"""Wrong values of a configuration: the key, the allowed type, the nearest key, and the line."""

import copy
from collections.abc import Iterator
from pathlib import Path

import pytest

from evo_cpg.io.build import build_experiment
from evo_cpg.io.errors import ConfigError
from evo_cpg.io.load import check_config, dump_config, load_config
from evo_cpg.io.yaml_text import parse_yaml, to_yaml
from tiny_run import CONFIG, REPOSITORY
from wrong_values import problem, small

BALL = {"type": "sphere", "radius": 0.1}
# Key, value, and a word of the message.
VALUES = [
    ("evolutoin", {}, "evolution"),
    ("generations", 3, "evolution.generations"),
    ("evolution.elite", 3, "elites"),
    ("evolution", {"type": "random", "population": 8, "islands": {"count": 2}}, ".islands"),
    ("evolution.population", 8, "default"),
    ("evolution", "random", "'random', module:Class"),
    ("world.water.densty", 1, "'density'"),
    ("world.water.sheltered", 1, "true or false"),
    ("world.water.law", "newton", "'isotropic' or null"),
    ("world.water.viscosity", 0, "greater"),
    ("world.water.current_gradient", [[0.2, 0, 0], [0, 0.1, 0], [0, 0, 0]], "diagonal"),
    ("world.water.vortices", [{"circulation": 1, "core": 0}], ".0.core: 0"),
    ("world.water.oscillations", [{"velocity": [0, 1, 0], "period": 0}], ".0.period: 0"),
    ("world.water.street", {"spacing": 1, "width": -1}, "street.width: -1"),
    ("world.water.reactive_thrust", True, "no chain"),
    ("world.water", {"viscosity": 0.001, "skin_drag": 0.1}, "skin_drag (0.1)"),
    ("world.water", {"viscosity": 0.001, "law": "normal"}, "law ('normal')"),
    ("world.water", False, "a section"),
    ("world.ground", {True: 1}, "True must be text"),
    ("task.slip_wieght", 1.0, "valid here"),
    ("task.type", "win", "'follow', or module:Class"),
    ("task", "walk", "'follow', module:Class"),
    ("task", {"type": "distance", "heading": "up"}, "'forward'"),
    ("task", {"type": "walk", "tilt_weight": -1}, "tilt_weight: -1"),
    ("task.energy_weight", 0.7, "distance_weight > light_weight"),
    ("controller.cpg.time_scal", 1, "'time_scale'"),
    ("controller.cpg.time_scale", 0, "positive"),
    ("controller.cpg.pair_weight", float("nan"), "nan"),
    ("controller.cpg.opposite", ["fin"], "opposite.0: 'fin'"),
    ("controller.cpg", {"couplings": [{"source": "tail.y", "target": "tail.z"}]}, "'tail.z'"),
    ("controller.cpg", {"couplings": [{"source": "tail.z", "wieght": 1}]}, ".wieght"),
    ("controller.cpg", {"rings": [{"oscillators": ["tail.z"], "lag_deg": 0}]}, "two"),
    ("controller.cpg.rings", [{"oscillators": ["tail.z"], "lag_deg": 0, "weight": -1}], "weight"),
    ("controller.brain.hidden", [0], "one unit"),
    ("controller.type", "spline", "'brain_cpg'"),
    ("controller.rate_gain", float("inf"), "finite"),
    ("controller.groups", {"legs": "x*"}, "legs: 'x*': must be a list of texts"),
    ("controller.axes", {"q": {"gain": 2}}, "z"),
    ("creature.self_collision", {"exclude": [["head", "tial"]]}, "exclude.0.1: 'tial'"),
    ("creature.pressure_sensors", ["fin"], ".0: 'fin'"),
    ("creature.pressure_sensors", ["*ail"], "*"),
    ("creature.depth_sensors", [{"body": "fin"}], ".0.body: 'fin'"),
    ("creature.light_sensors", {"body": "head"}, "a list of sections"),
    ("creature.light_sensors.0.body", "tial", "'tail'"),
    ("creature.light_sensors.0.axis", [0, 0, 0], "zero"),
    ("creature.materials", {False: {"density": 1}}, "False must be text"),
    ("creature.materials.flesh.density", -1, "greater"),
    ("creature.materials.flesh.density", "1000", "a number"),
    ("creature.materials.flesh.density", float("nan"), "finite"),
    ("creature.bodies", [], "at least 1"),
    ("creature.bodies.0.material", "bone", "'bone'"),
    ("creature.bodies.0.parts", [{"shape": BALL, "at": [0, 0, 0], "material": "wood"}], "'wood'"),
    ("creature.bodies.0.color", "red", "hexadecimal"),
    ("creature.bodies.0.shape.type", "cube", "'box'"),
    ("creature.bodies.1.name", True, "text"),
    ("creature.bodies.1.name", {"side": None}, "text"),
    ("creature.bodies.1.name", "head", "creature.bodies.0"),
    ("creature.bodies.1.repeat", 100_000, "less"),
    ("creature.bodies.1.repeat", 3, "{i}"),
    ("creature.bodies.1.joint.parent", "haed", "'head'"),
    ("creature.bodies.1.joint.at", 3, "a list of 3 numbers"),
    ("creature.bodies.1.joint.at.0", "-0,11", "a number"),
    ("creature.bodies.1.joint.axes", "x", "'ball' or a list"),
    ("creature.bodies.1.joint.axes", ["z", "z"], "independent"),
    ("creature.bodies.1.joint.axes", [[0, 0, 0]], "independent"),
    ("creature.bodies.1.joint.axes", [{"slide": "x"}, {"slide": "-x"}], "independent"),
    ("creature.bodies.1.joint.axes", [{"slid": "x"}], "slid"),
    ("creature.bodies.1.joint.axes", [{"slide": "x", "limits_m": [0.1, 0]}], "limits_m"),
    ("creature.bodies.1.joint.axes", [{"slide": "x", "rest_m": "far"}], ".rest_m: 'far'"),
    ("creature.bodies.1.joint.axes", [{"turn": "x", "at": "far"}], ".at: 'far'"),
    ("creature.bodies.1.joint.limits_deg", 60, "a list of 2 numbers"),
    ("creature.bodies.1.joint.limits_deg", [[-60, "a"]], "'a'"),
    ("creature.bodies.1.joint.limits_deg", [30, -30], "below"),
    ("creature.bodies.1.joint.limits_deg", [[-30, 30], [-30, 30]], "2 pairs"),
    ("creature.bodies.1.joint.damping", "1.5 N m s", "a number or a list of numbers"),
    ("creature.bodies.1.joint.damping", [-1.0], ".0: -1.0"),
    ("creature.bodies.1.joint.stiffness", [1.0, 2.0, 3.0, 4.0], "4 values"),
    ("creature.bodies.1.joint.actuator", {"gian": 2}, "'gain'"),
    ("creature.bodies.1.joint.actuator", {"type": "musle"}, "'musle'"),
    ("creature.bodies.1.joint.actuator", {"type": "torque", "gear": 0}, "gear"),
    ("simulation.steps", 300, "valid here"),
    ("simulation.seconds", 0, "greater"),
    ("simulation.seconds", 1e6, "60000000"),
    ("simulation.control_rate_hz", 1e6, "33333333"),
    ("simulation.trials", 0, "greater"),
    ("noise.joint_angle_deg", 181, "less"),
    ("measures", "speed", "a list of texts"),
    ("audit.disqualify", "speed", "'penetration'"),
    ("seed", -1, "greater"),
    ("name", "../elsewhere", "folder"),
]


@pytest.mark.parametrize(("key", "value", "word"), VALUES)
def test_a_wrong_value_gets_its_key_and_the_allowed_values(key, value, word):
    message = problem(small({key: value}))
    assert message.partition(".")[0].partition(":")[0] == key.partition(".")[0]
    assert word in message


def jointed(**changes: object) -> dict[str, object]:
    return {f"creature.bodies.1.joint.{key}": x for key, x in {"actuator": None, **changes}.items()}


MUSCLE = {"type": "muscle", "area": 1, "arm": 1, "fibre_length": 1}
POSTURES = {"controller.type": "postures", "evolution.type": "bits"}
FEW = {**POSTURES, "evolution.mutated_genes": [2, 10]}
HUNG = {"parent": "world", "at": [0, 0, 0], "child_at": [0, 0, 0], "axes": ["z"]}
HANGING = {"creature.bodies.0.joint": HUNG}
SPRING = {"creature.bodies.1.joint.actuator": {"gain": 1, "stiffness": 5}}
LIMITS = "creature.bodies.1.joint.limits_deg"
SLIDE = {"creature.bodies.1.joint.axes": [{"slide": "x"}]}


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"controller.type": "postures"}, "'bits', not 'real'"),
        ({"evolution.type": "bits"}, "'real', not 'bits'"),
        ({**POSTURES, "evolution.elites": 15}, "elites"),
        ({**POSTURES, "evolution.rank_probabilities": [0.5, 0.2]}, "add up to 1"),
        (POSTURES, "24"),
        ({**POSTURES, "evolution.mutation": "swap"}, "evolution.mutation"),
        ({**POSTURES, "controller.postures": 0}, "1000"),
        ({**POSTURES, "controller.postuers": 8}, "'postures'"),
        # Postures from 110 to 250 degrees exceed limits of -60 to 60 only with a motor spring.
        ({**FEW, **SPRING}, "-70 to 70"),
        ({**FEW, **SPRING, LIMITS: [-75, 69]}, "-75 to 69"),
        ({**FEW, **SPRING, "controller.lowest_angle": 120}, "-60 to 80"),
        ({**FEW, **SPRING, **SLIDE}, "slides"),
        ({**HANGING, "noise.tilt_deg": 5}, "tilt_deg: 'head'"),
        ({**HANGING, "noise.push": 0.1}, "push: 'head'"),
        ({**HANGING, "creature.bodies.1.name": "world"}, "fixed world"),
        ({**HANGING, "creature.bodies.1.joint.parent": "word"}, "'world'"),
        ({**HANGING, "creature.bodies.1.joint": HUNG}, "roots"),
        ({"creature.bodies.1.joint": None}, "roots"),
        ({"creature.bodies.0.joint": {**HUNG, "parent": "tail"}}, "ring"),
        ({"seed": 2**31 - 1, "runs": 2}, "last"),
        (jointed(axes="ball", limits_deg=[-10, 60]), "joint: limits_deg"),
        (jointed(axes="ball", limits_deg=[[0, 60]] * 3), "joint: limits_deg"),
        (jointed(axes="ball", rest_deg=5), "joint: rest_deg"),
        (jointed(axes="ball", damping=[1, 1, 1]), "joint: damping"),
        (jointed(axes=[{"slide": "x"}], limits_deg=[[-9, 9]]), "joint: limits_deg"),
        (jointed(axes=[{"slide": "x"}], rest_deg=[3]), "joint: rest_deg"),
        (jointed(axes=[{"slide": "x"}], actuator=MUSCLE), "slides"),
        ({"task.type": "walk", "task.cost_weight": 1, "world.gravity": 0}, "task.cost_weight"),
    ],
)
def test_values_that_do_not_fit_together_are_rejected(changes, word):
    assert word in problem(small(changes))


def test_missing_keys_are_named():
    data = small({})
    del data["creature"]["bodies"][0]["shape"]
    assert problem(data).startswith("creature.bodies.0.shape: is missing")
    assert problem({"name": "x"}).startswith("creature: is missing")
    assert "creature" in problem({"name": "x", "creature": None})


def test_error_about_a_repeated_body_names_its_entry():
    data = small({"creature.bodies.1.name": "tail{i}", "creature.bodies.1.repeat": 3})
    data["creature"]["bodies"].append(
        data["creature"]["bodies"][1] | {"name": "tail2", "repeat": 1}
    )
    assert problem(data).startswith("creature.bodies.2.name: ")


WRONG = ("x", 3, 0.5, True, None, [], ["x"], [1, 2], {}, {"x": 1})


def places(data: object, key: tuple = ()) -> Iterator[tuple]:
    """Yield the keys of all values, and of the first two entries of each list."""
    pairs = data.items() if isinstance(data, dict) else ()
    for name, value in pairs or (enumerate(data[:2]) if isinstance(data, list) else ()):
        yield (*key, name)
        yield from places(value, (*key, name))


@pytest.mark.parametrize(
    ("name", "every"),
    [
        pytest.param("salamander_amphibious", 16, marks=pytest.mark.slow),
        ("fukui2003_model1", 4),
        ("swimmer_gaits", 4),
    ],
)
def test_messages_contain_no_pydantic_terms(name, every):
    data = parse_yaml(dump_config(load_config(REPOSITORY / "configs" / f"{name}.yaml")))
    refused = 0
    for number, key in enumerate(places(data)):
        # This subset covers every kind of section.
        for wrong in WRONG[number % every :: every]:
            given = copy.deepcopy(data)
            place = given
            for part in key[:-1]:
                place = place[part]
            place[key[-1]] = wrong
            try:
                check_config(given, "x.yaml")
            except ConfigError as error:
                refused += 1
                words = str(error)
                assert "\n" not in words
                for foreign in ("valid", "tuple", "dict", "pars", "pattern", "keys should"):
                    assert foreign not in words.replace("valid here", ""), words
    assert refused > 100


def line_of(path: Path, words: str) -> int:
    """Return the number of the first line of a file that contains a text."""
    return 1 + next(i for i, line in enumerate(path.read_text().splitlines()) if words in line)


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("creature.bodies.1.joint.axes", "x", "axes: x"),
        ("creature.bodies.0.shape.sise", 1, "sise: 1"),
        ("creature.light_sensors", [{"body": "haed"}], "body: haed"),
        ("creature.bodies.1.name", "head", "name: head"),
        ("controller.groups", {"legs": ["leg*"]}, "leg*"),
        ("seed", -1, "seed: -1"),
    ],
)
def test_error_names_the_line_of_the_value(tmp_path, key, value, words):
    path = tmp_path / "x.yaml"
    path.write_text(to_yaml(small({key: value})))
    with pytest.raises(ConfigError) as caught:
        build_experiment(load_config(path), path)
    expected = max(i + 1 for i, line in enumerate(path.read_text().splitlines()) if words in line)
    assert caught.value.line == expected
    assert str(caught.value).startswith(f"{path}: line {expected}: {key}")


def test_error_in_a_creature_file_names_its_line(tmp_path):
    creature, path = tmp_path / "pair.yaml", tmp_path / "x.yaml"
    creature.write_text(to_yaml(small({"creature.bodies.1.joint.axes": "x"})["creature"]))
    path.write_text("name: small\ncreature: pair.yaml\n")
    with pytest.raises(ConfigError) as caught:
        load_config(path)
    line = line_of(creature, "axes: x")
    assert str(caught.value).startswith(f"{creature}: line {line}: creature.bodies.1.joint.axes: ")
    path.write_text("name: small\ncreature: {file: pair.yaml, light_sensors: 3}\n")
    with pytest.raises(ConfigError) as caught:
        load_config(path)
    assert caught.value.line in (2, line)


def test_error_in_a_section_with_defaults_names_its_line(tmp_path):
    path = tmp_path / "x.yaml"
    text = CONFIG.read_text().replace("creatures/", f"{CONFIG.parent}/creatures/")
    section = "    couplings:\n      - {source: segment1.z, target: '*.z'}\n"
    path.write_text(text.replace("  cpg:\n", f"  cpg:\n{section}"))
    with pytest.raises(ConfigError) as caught:
        build_experiment(load_config(path), path)
    line = line_of(path, "source: segment1.z")
    assert str(caught.value).startswith(f"{path}: line {line}: controller.cpg.couplings.0: ")


def test_file_of_a_creature_is_no_configuration():
    path = REPOSITORY / "configs" / "creatures" / "hexapod.yaml"
    with pytest.raises(ConfigError, match="describes a creature, and not an experiment"):
        load_config(path)


def test_error_in_an_override_has_no_line():
    with pytest.raises(ConfigError) as caught:
        load_config(CONFIG, ["seed=-1"])
    assert caught.value.line is None
    assert str(caught.value).startswith(f"{CONFIG}: seed: -1: ")


def test_controller_for_another_creature_reports_the_creature(tmp_path):
    starfish = REPOSITORY / "configs" / "starfish.yaml"
    config = load_config(starfish, [f"creature={REPOSITORY}/configs/creatures/hexapod.yaml"])
    with pytest.raises(ConfigError, match=r"controller\.groups\.arm1\.0: .*'hexapod'"):
        build_experiment(config, starfish)
