"""Messages for values of the wrong type: the allowed values, the fix, and the line."""

import copy
from collections.abc import Iterator
from pathlib import Path

import pytest

from evo_cpg.io.build import build_experiment
from evo_cpg.io.errors import ConfigError
from evo_cpg.io.load import check_config, dump_config, load_config
from evo_cpg.io.yaml_text import parse_yaml, to_yaml
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
TRUTHS = "YAML reads yes, no, on, off, true and false as booleans. Put text in quotes"


def changed(key: str, value: object) -> dict:
    """Return the small configuration with one value changed, as if read from YAML."""
    data = copy.deepcopy(SMALL)
    *parents, last = (int(part) if part.isdigit() else part for part in key.split("."))
    place: dict = data
    for part in parents:
        place = place[part] if isinstance(part, int) else place.setdefault(part, {})
    place[last] = value
    return data


def problem(data: dict) -> str:
    """Return the error message for a configuration without a file."""
    with pytest.raises(ConfigError) as caught:
        check_config(data, "x.yaml")
    assert "\n" not in str(caught.value)
    return str(caught.value).removeprefix("x.yaml: ")


@pytest.mark.parametrize(
    ("key", "value", "expected"),
    [
        # One value in place of a list, and the reverse.
        (
            "creature.bodies.1.joint.axes",
            "x",
            "'x': must be 'ball' or a list of entries, each 'x', 'y', 'z', '-x', '-y', '-z', a "
            "list of 3 numbers, a section with the keys turn, at or a section with the keys slide, "
            "limits_m, rest_m. Write [x]",
        ),
        ("creature.bodies.1.joint.axes", "x, y", "Write [x, y]"),
        ("creature.bodies.1.joint.axes", [0, 0, 1], "Write [[0, 0, 1]]"),
        (
            "creature.bodies.1.joint.limits_deg",
            60,
            "null, a list of 2 numbers or a list of entries, each null or a list of 2 numbers",
        ),
        ("creature.bodies.1.joint.limits_deg", [[-60, "a"]], "must be a number"),
        ("creature.bodies.1.joint.at", 3, "3: must be a list of 3 numbers"),
        ("creature.pressure_sensors", "tail", "must be 'all' or a list of texts. Write [tail]"),
        ("creature.self_collision", {"exclude": ["head", "tail"]}, "Write [[head, tail]]"),
        ("controller.groups", {"legs": "x*"}, "must be a list of texts. Write ['x*']"),
        ("controller.cpg.opposite", "tail", "must be a list of texts. Write [tail]"),
        ("controller.brain.hidden", 3, "must be a list of whole numbers. Write [3]"),
        ("measures", "speed", "must be a list of texts. Write [speed]"),
        ("audit.disqualify", "speed", "'penetration' or 'overlap'. Write [speed]"),
        ("simulation.seconds", [10], "[10]: must be a number. Write 10"),
        ("simulation.seconds", "12 s", "'12 s': must be a number. Write 12"),
        ("simulation.substeps", [10], "[10]: must be a whole number. Write 10"),
        # A section in place of a list, and a single value in place of a section.
        ("creature.light_sensors", {"body": "head"}, "Write [{body: head}]"),
        ("creature.light_sensors", ["head"], "Write {body: head}"),
        ("creature.materials.flesh", 1000, "Write {density: 1000}"),
        ("creature.bodies.1.shape", "box", "a section whose type is 'box', 'sphere', "),
        ("creature.bodies.1.shape", "box", "Write {type: box}"),
        ("creature.bodies", {"head": 1}, "Begin each entry with '- '"),
        ("task", "walk", "'walk' or module:Class. Write {type: walk}"),
        ("evolution", "random", "Write {type: random}"),
        ("world.ground", True, "must be null or a section with the keys restitution, "),
        ("world.ground", True, "Write {}"),
        ("world.water", False, "Write null"),
        ("world.water", "None", "Write null"),
        ("controller.cpg", None, "null: must be a section with the keys constants, "),
        ("controller.cpg", None, "The key has no value. Leave it out, or give it one"),
        ("controller.cpg.couplings", None, "Leave it out, write [] for none, or give it one"),
        # Text, numbers and booleans.
        ("creature.bodies.1.name", True, f"True: must be text. {TRUTHS}"),
        ("creature.bodies.1.name", 12, "12: must be text. Write '12'"),
        ("creature.bodies.1.name", {"side": None}, "must be text. Write '{side}'"),
        (
            "creature.bodies.1.joint.damping",
            "1.5 N m s",
            "a number or a list of numbers. Write 1.5",
        ),
        (
            "creature.bodies.1.joint.damping",
            "0,5",
            "must be a number or a list of numbers. Write 0.5",
        ),
        ("creature.bodies.1.joint.damping", "1, 2", "a list of numbers. Write [1, 2]"),
        ("creature.bodies.1.joint.at.0", "\N{MINUS SIGN}0.11", "must be a number. Write -0.11"),
        (
            "world.water.law",
            "isotropc",
            "must be 'normal', 'isotropic' or null. Did you mean 'isotropic'?",
        ),
        # Keys.
        ("world.ground", {True: 1}, f"the key True must be text. {TRUTHS}"),
        ("creature.materials", {False: {"density": 1}}, f"the key False must be text. {TRUTHS}"),
        (
            "creature.materials",
            {1: {"density": 1}},
            "the key 1 must be text. Write it in quotes: '1'",
        ),
        ("world.water", {"density": 1, 5: None}, "If it follows a decimal comma, write a point"),
    ],
)
def test_message_names_the_allowed_type_and_a_fix(key, value, expected):
    message = problem(changed(key, value))
    assert message.startswith(key)
    assert expected in message


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


def test_duplicate_body_name_reports_both_entries():
    data = changed("creature.bodies.1.name", "head")
    assert problem(data) == (
        "creature.bodies.1.name: two bodies are called 'head', the other one in creature.bodies.0. "
        "Every body needs a unique name"
    )
    # A row whose second body has the name of another entry.
    row = {"name": "tail{i}", "repeat": 2, **BOX, "joint": JOINT | {"parent": "tail"}}
    data = copy.deepcopy(SMALL)
    data["creature"]["bodies"] += [row, {"name": "tail2", **BOX, "joint": JOINT}]
    assert problem(data).startswith("creature.bodies.3.name: two bodies are called 'tail2', the")


def test_star_in_a_body_name_is_rejected_with_a_hint():
    data = changed("creature.pressure_sensors", ["*ail"])
    assert problem(data).endswith("A name here may contain placeholders such as {i}, but no *")


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
    path.write_text(to_yaml(changed(key, value)))
    with pytest.raises(ConfigError) as caught:
        build_experiment(load_config(path), path)
    expected = max(i + 1 for i, line in enumerate(path.read_text().splitlines()) if words in line)
    assert caught.value.line == expected
    assert str(caught.value).startswith(f"{path}: line {expected}: {key}")


def test_error_in_a_creature_file_names_its_line(tmp_path):
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


def test_error_in_a_section_with_defaults_names_its_line(tmp_path):
    path = tmp_path / "x.yaml"
    text = CONFIG.read_text().replace("creatures/", f"{CONFIG.parent}/creatures/")
    section = "    couplings:\n      - {source: segment1.z, target: '*.z'}\n"
    path.write_text(text.replace("  cpg:\n", f"  cpg:\n{section}"))
    with pytest.raises(ConfigError) as caught:
        build_experiment(load_config(path), path)
    line = line_of(path, "source: segment1.z")
    words = f"{path}: line {line}: controller.cpg.couplings.0: couples 'segment1.z' to itself"
    assert str(caught.value) == words


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
    with pytest.raises(
        ConfigError, match=r"controller\.groups\.arm1\.0: 'arm1_\*' matches no"
    ) as e:
        build_experiment(config, starfish)
    assert str(e.value).endswith("The controller must name parts of creature 'hexapod'")
