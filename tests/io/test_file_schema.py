"""The JSON Schema of configuration files, and the reference in the docs."""

import copy
import re
import sys

import jsonschema
import pytest
import yaml

from evo_cpg.io.file_schema import file_schema
from evo_cpg.io.load import dump_config, load_config
from evo_cpg.io.shipped import shipped
from tiny_run import REPOSITORY

sys.path.insert(0, str(REPOSITORY / "docs" / "tools"))
import configuration_tables

from shipped_configs import some_configs

SCHEMA = file_schema()
CHECK = jsonschema.Draft202012Validator(SCHEMA)

UNITS = {"m", "s", "kg", "N", "Nm", "Pa", "J", "W", "Hz", "rad", "deg"}


def mistakes(data) -> list[str]:
    return [f"{mistake.json_path}: {mistake.message}" for mistake in CHECK.iter_errors(data)]


def written(name: str) -> dict:
    return yaml.safe_load(shipped(name).path.read_text())


def test_schema_is_valid():
    jsonschema.Draft202012Validator.check_schema(SCHEMA)


@some_configs
def test_schema_accepts_shipped_configurations(path):
    data = written(path.stem)
    assert mistakes(data) == []
    # Also with the creature included, and with all defaults.
    given = data.get("creature")
    if given is not None:
        file = given if isinstance(given, str) else given["file"]
        data["creature"] = yaml.safe_load((path.parent / file).read_text())
    assert mistakes(data) == []
    assert mistakes(yaml.safe_load(dump_config(load_config(path)))) == []


def test_schema_accepts_names_of_other_files():
    data = written("hexapod")
    data["creature"] = {"file": "creatures/hexapod.yaml", "pressure_sensors": "all"}
    data["world"]["ground"] = {"floor": {"type": "relief", "file": "hills.png", "highest": 0.5}}
    assert mistakes(data) == []
    part = {"name": "a", "material": "b", "shape": {"type": "mesh", "file": "a.stl", "scale": 0.1}}
    data["creature"] = {"name": "c", "materials": {"b": {"density": 1}}, "bodies": [part]}
    assert mistakes(data) == []
    del part["shape"]["file"]
    assert "shape" in mistakes(data)[0]


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("sead", 1, r"\$: .*'sead' was unexpected"),
        ("seed", -1, r"\$\.seed: -1 is less than the minimum of 0"),
        ("task", {"type": "walk", "light": {}}, r"\$\.task: .*is not valid under any"),
        ("creature", {"name": "no bodies"}, r"\$\.creature: .*is not valid under any"),
    ],
)
def test_schema_rejects_invalid_configurations(key, value, words):
    data = copy.deepcopy(written("hexapod")) | {key: value}
    (mistake,) = mistakes(data)
    assert re.search(words, mistake)


def definitions():
    yield "", SCHEMA
    yield from SCHEMA["$defs"].items()


def is_described(text: str) -> bool:
    """Return whether a description is one sentence with more in it than units."""
    words = set(re.findall(r"[A-Za-z]+", text)) - UNITS
    return bool(words) and text.endswith(".") and "\n" not in text


def test_every_part_and_key_is_described():
    assert not any(map(is_described, ("", "m/s.", "N m s.", "the light", "The light\nahead.")))
    texts = {
        f"{name}.{key}": value.get("description", "")
        for name, part in definitions()
        for key, value in part["properties"].items()
    }
    texts |= {name: part["description"] for name, part in definitions() if name}
    assert [name for name, text in texts.items() if not is_described(text)] == []


def test_reference_lists_every_key_of_every_section():
    text = configuration_tables.every_key()
    for part in configuration_tables.parts(SCHEMA):
        table = text.partition(f"{configuration_tables.heading(part)}\n")[2].partition("\n##")[0]
        definition = SCHEMA["$defs"][part.name] if part.name else SCHEMA
        for key in definition["properties"]:
            assert f"\n| `{key}` |" in table, f"{part.paths[0]}.{key}"
