"""Values of the wrong kind: what the place takes, how to write it, and in which line it stands."""

import copy
from collections.abc import Iterator
from pathlib import Path

import pytest

from evo_cpg.config.build import build_experiment
from evo_cpg.config.errors import ConfigError
from evo_cpg.config.load import check_config, dump_config, load_config
from evo_cpg.config.yaml_text import parse_yaml, to_yaml
from tiny_run import CONFIG, REPOSITORY

BOX = {"shape": {"type": "box", "size": [0.2, 0.1, 0.1]}, "material": "flesh"}
JOINT = {"parent": "head", "at": [-0.11, 0, 0], "child_at": [0.11, 0, 0], "axes": ["z"]}
SMALL = {
    "name": "small",
    "creature": {
        "name": "pair",
        "materials": {"flesh": {"density": 1000}},
        "bodies": [{"name": "head", **BOX}, {"name": "tail", **BOX, "joint": JOINT}],
        "light_sensors": [{"body": "head"}],
    },
}
TRUTHS = "YAML reads yes, no, on, off, true and false as truth values; in quotes they are text"


def changed(key: str, value: object) -> dict:
    """The small configuration with one value changed, as YAML would have it."""
    data = copy.deepcopy(SMALL)
    *parents, last = (int(part) if part.isdigit() else part for part in key.split("."))
    place: dict = data
    for part in parents:
        place = place[part] if isinstance(part, int) else place.setdefault(part, {})
    place[last] = value
    return data


def problem(data: dict) -> str:
    """What is said about a configuration that comes from no file."""
    with pytest.raises(ConfigError) as caught:
        check_config(data, "x.yaml")
    assert "\n" not in str(caught.value)
    return str(caught.value).removeprefix("x.yaml: ")


@pytest.mark.parametrize(
    ("key", "value", "expected"),
    [
        # One value where a list is expected, and the other way round.
        (
            "creature.bodies.1.joint.axes",
            "x",
            "'x': must be a list of entries, each 'x', 'y', 'z', '-x', '-y', '-z' or a list of 3 "
            "numbers; write [x]",
        ),
        ("creature.bodies.1.joint.axes", "x, y", "write [x, y]"),
        ("creature.bodies.1.joint.axes", [0, 0, 1], "write [[0, 0, 1]]"),
        (
            "creature.bodies.1.joint.limits_deg",
            60,
            "must be a list of 2 numbers or a list of lists",
        ),
        ("creature.bodies.1.joint.limits_deg", [[-60, "a"]], "must be a number"),
        ("creature.bodies.1.joint.at", 3, "3: must be a list of 3 numbers"),
        ("creature.pressure_sensors", "tail", "must be 'all' or a list of texts; write [tail]"),
        ("creature.self_collision", {"exclude": ["head", "tail"]}, "write [[head, tail]]"),
        ("controller.groups", {"legs": "x*"}, "must be a list of texts; write ['x*']"),
        ("controller.cpg.opposite", "tail", "must be a list of texts; write [tail]"),
        ("controller.brain.hidden", 3, "must be a list of whole numbers; write [3]"),
        ("measures", "speed", "must be a list of texts; write [speed]"),
        ("audit.disqualify", "speed", "'penetration' or 'overlap'; write [speed]"),
        ("simulation.steps", [10], "[10]: must be a whole number; write 10"),
        # A section and a list, or a single value.
        ("creature.light_sensors", {"body": "head"}, "write [{body: head}]"),
        ("creature.light_sensors", ["head"], "write {body: head}"),
        ("creature.materials.flesh", 1000, "write {density: 1000}"),
        ("creature.bodies.1.shape", "box", "must be a section whose type is 'box', 'sphere', "),
        ("creature.bodies.1.shape", "box", "write {type: box}"),
        ("creature.bodies", {"head": 1}, "begin each entry with '- '"),
        ("task", "walk", "'walk' or module:Class; write {type: walk}"),
        ("evolution", "random", "write {type: random}"),
        ("world.ground", True, "must be null or a section with the keys restitution, "),
        ("world.ground", True, "write {}"),
        ("world.water", False, "write null"),
        ("world.water", "None", "write null"),
        ("controller.cpg", None, "null: must be a section with the keys constants, "),
        ("controller.cpg", None, "the key has no value: leave it out, or give it one"),
        # Text, numbers and truth values.
        ("creature.bodies.1.name", True, f"True: must be text; {TRUTHS}"),
        ("creature.bodies.1.name", 12, "12: must be text; write '12'"),
        ("creature.bodies.1.name", {"side": None}, "must be text; write '{side}'"),
        ("creature.bodies.1.joint.damping", "1.5 N m s", "must be a number; write 1.5"),
        ("creature.bodies.1.joint.damping", "0,5", "must be a number; write 0.5"),
        ("creature.bodies.1.joint.at.0", "\N{MINUS SIGN}0.11", "must be a number; write -0.11"),
        (
            "world.water.law",
            "isotropc",
            "must be 'normal' or 'isotropic'; did you mean 'isotropic'?",
        ),
        # Keys.
        ("world.ground", {True: 1}, f"the key True must be text; {TRUTHS}"),
        ("creature.materials", {False: {"density": 1}}, f"the key False must be text; {TRUTHS}"),
        (
            "creature.materials",
            {1: {"density": 1}},
            "the key 1 must be text; write it in quotes: '1'",
        ),
        ("world.water", {"density": 1, 5: None}, "if it follows a decimal comma, write a point"),
    ],
)
def test_a_value_of_the_wrong_kind_is_answered_with_the_right_one(key, value, expected):
    said = problem(changed(key, value))
    assert said.startswith(key)
    assert expected in said


WRONG = ("x", 3, 0.5, True, None, [], ["x"], [1, 2], {}, {"x": 1})


def places(data: object, key: tuple = ()) -> Iterator[tuple]:
    """The keys of all values; of lists of the first two entries."""
    pairs = data.items() if isinstance(data, dict) else ()
    for name, value in pairs or (enumerate(data[:2]) if isinstance(data, list) else ()):
        yield (*key, name)
        yield from places(value, (*key, name))


@pytest.mark.parametrize(
    ("name", "every"), [("salamander_amphibious", 8), ("fukui2003_model1", 4), ("swimmer_gaits", 4)]
)
def test_no_message_is_in_the_words_of_a_library(name, every):
    data = parse_yaml(dump_config(load_config(REPOSITORY / "configs" / f"{name}.yaml")))
    refused = 0
    for number, key in enumerate(places(data)):
        # Enough for every kind of section.
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


def test_two_bodies_of_one_name_are_answered_with_both_places():
    data = changed("creature.bodies.1.name", "head")
    assert problem(data) == (
        "creature.bodies.1.name: two bodies are called 'head', the other one in creature.bodies.0; "
        "every body needs a name of its own"
    )
    # Two entries that stand for a body of one name.
    row = {"name": "tail{i}", "repeat": 2, **BOX, "joint": JOINT | {"parent": "tail"}}
    data = copy.deepcopy(SMALL)
    data["creature"]["bodies"] += [row, {"name": "tail2", **BOX, "joint": JOINT}]
    assert problem(data).startswith("creature.bodies.3.name: two bodies are called 'tail2', the")


def test_a_name_that_takes_no_stars_says_so():
    data = changed("creature.pressure_sensors", ["*ail"])
    assert problem(data).endswith("a name here may have placeholders such as {i}, but no *")


def line_of(path: Path, words: str) -> int:
    """The number of the line of a file that has these words."""
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
def test_the_line_of_a_wrong_value_is_named(tmp_path, key, value, words):
    path = tmp_path / "x.yaml"
    path.write_text(to_yaml(changed(key, value)))
    with pytest.raises(ConfigError) as caught:
        build_experiment(load_config(path), path)
    expected = max(i + 1 for i, line in enumerate(path.read_text().splitlines()) if words in line)
    assert caught.value.line == expected
    assert str(caught.value).startswith(f"{path}: line {expected}: {key}")


def test_the_line_of_a_creature_is_that_of_its_own_file(tmp_path):
    creature, path = tmp_path / "pair.yaml", tmp_path / "x.yaml"
    creature.write_text(to_yaml(changed("creature.bodies.1.joint.axes", "x")["creature"]))
    path.write_text("name: small\ncreature: pair.yaml\n")
    with pytest.raises(ConfigError) as caught:
        load_config(path)
    line = line_of(creature, "axes: x")
    assert str(caught.value).startswith(f"{creature}: line {line}: creature.bodies.1.joint.axes: ")
    path.write_text("name: small\ncreature: {file: pair.yaml, light_sensors: 3}\n")
    with pytest.raises(ConfigError) as caught:
        load_config(path)
    assert caught.value.line in (2, line)


def test_what_is_set_on_the_command_line_has_no_line():
    with pytest.raises(ConfigError) as caught:
        load_config(CONFIG, ["seed=-1"])
    assert caught.value.line is None
    assert str(caught.value).startswith(f"{CONFIG}: seed: -1: ")


def test_a_controller_that_names_parts_of_another_creature_is_answered_with_both(tmp_path):
    starfish = REPOSITORY / "configs" / "starfish.yaml"
    config = load_config(starfish, [f"creature={REPOSITORY}/configs/creatures/hexapod.yaml"])
    with pytest.raises(
        ConfigError, match=r"controller\.groups\.arm1\.0: 'arm1_\*' matches no"
    ) as e:
        build_experiment(config, starfish)
    assert str(e.value).endswith("the controller must name parts of creature 'hexapod'")
