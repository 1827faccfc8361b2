"""The JSON Schema of a configuration file, for editors and for the reference in the docs.

The schema gives the type, range, default and meaning of every key. Constraints between several
values are not in the schema. They are checked when a file is read. A test requires a description
of every key.
"""

import copy
import inspect
import re
from typing import Any

from evo_cpg.io.schema.evolution import MapSection
from evo_cpg.io.schema.experiment import ExperimentConfig
from evo_cpg.io.schema.ground import ReliefFileConfig
from evo_cpg.io.schema.shape import MeshFileConfig
from evo_cpg.simulation.limits import Limits

Schema = dict[str, Any]

_DIALECT = "https://json-schema.org/draft/2020-12/schema"

# Classes whose docstrings describe inherited keys.
_INHERITED = (MapSection, Limits)

_CREATURE_FILE = {
    "type": "string",
    "description": "path of the creature's own file, relative to this file.",
}


def file_schema() -> Schema:
    """Return the schema of a whole configuration file, as JSON Schema (draft 2020-12)."""
    # Copied, because pydantic may return parts of its own cache.
    schema = copy.deepcopy(ExperimentConfig.model_json_schema())
    kinds = schema["$defs"]
    for kind in (schema, *kinds.values()):
        _describe(kind)
    for value in (
        each for kind in (schema, *kinds.values()) for each in kind["properties"].values()
    ):
        # The key ``type`` is required in the schemas of all kinds except the default kind.
        meant = value.get("default")
        for option in value.get("oneOf") or value.get("items", {}).get("oneOf", ()):
            if "$ref" in option:
                kind = kinds[option["$ref"].rsplit("/", 1)[-1]]
                own = kind["properties"]["type"].get("const")
                if not isinstance(meant, dict) or own != meant["type"]:
                    kind["required"] = list(dict.fromkeys(("type", *kind.get("required", ()))))
    # The key ``file`` may replace the keys whose values are read from that file.
    for name, file, instead_of in (
        ("MeshConfig", MeshFileConfig, ["vertices", "faces"]),
        ("ReliefConfig", ReliefFileConfig, ["heights"]),
    ):
        kind, named = kinds[name], file.model_json_schema()
        _describe(named)
        kind["properties"] = named["properties"] | kind["properties"]
        kind["required"] = [key for key in kind["required"] if key not in instead_of]
        kind["anyOf"] = [{"required": ["file"]}, {"required": instead_of}]
    # Plans evolve their creatures.
    schema["required"] = [key for key in schema["required"] if key != "creature"]
    whole = kinds["CreatureConfig"]
    kinds["CreatureFile"] = {
        **whole,
        "description": "A creature's own file, and keys that replace keys of the file.",
        "properties": {"file": _CREATURE_FILE, **whole["properties"]},
        "required": ["file"],
    }
    schema["properties"]["creature"] = {
        "description": schema["properties"]["creature"]["description"],
        "anyOf": [
            _CREATURE_FILE,
            {"$ref": "#/$defs/CreatureConfig"},
            {"$ref": "#/$defs/CreatureFile"},
        ],
    }
    return {"$schema": _DIALECT, **schema, "title": "An experiment of evo_cpg"}


def documented_attributes(text: str) -> tuple[str, dict[str, str]]:
    """Return the text before the first section of a Google-style docstring, and its attributes."""
    about, *sections = re.split(r"^(?=\w+:$)", inspect.cleandoc(text), flags=re.MULTILINE)
    attributes: dict[str, str] = {}
    for section in sections:
        if section.startswith("Attributes:\n"):
            entries = re.findall(r"^ {4}(\w+): (.+(?:\n {5,}.+)*)", section, re.MULTILINE)
            attributes |= {name: " ".join(words.split()) for name, words in entries}
    return " ".join(about.split()), attributes


def _describe(kind: Schema) -> None:
    """Move the descriptions of attributes from a docstring to the properties."""
    about, own = documented_attributes(kind.get("description", ""))
    inherited: dict[str, str] = {}
    for other in _INHERITED:
        inherited |= documented_attributes(other.__doc__ or "")[1]
    kind["description"] = about
    for name, value in kind.get("properties", {}).items():
        # Pydantic's title only repeats the key in words.
        value.pop("title", None)
        if name in own or name in inherited:
            value["description"] = own.get(name) or inherited[name]
        elif "const" in value:
            value["description"] = f"``{value['const']}``."
