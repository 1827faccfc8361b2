"""Description of the public interface: names of `evo_cpg`, commands, and configuration keys.

    python tests/compatibility/public_interface.py FILE

This writes the description of the version that Python imports. It runs on version 1.0, too, and
made `version_1_0/interface.json` there.
"""

import enum
import inspect
import json
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import typer

import evo_cpg as evo
from evo_cpg.cli.main import app
from evo_cpg.config.schema.experiment import ExperimentConfig


def parameters(function: Any) -> dict[str, str]:
    """Return the parameters of a function in their order: kind, and default if there is one."""
    found = {}
    for each in inspect.signature(function).parameters.values():
        default = "" if each.default is each.empty else f" = {each.default!r}"
        found[each.name] = re.sub(r" at 0x\w+", "", f"{each.kind.name}{default}")
    return found


def names() -> dict[str, dict[str, Any]]:
    """Return the public names with their parameters, and with the members of classes."""
    found = {}
    for name in evo.__all__:
        value = getattr(evo, name)
        if not inspect.isclass(value):
            found[name] = {"parameters": parameters(value)}
            continue
        # Errors take any arguments.
        made = {} if issubclass(value, Exception) else parameters(value)
        own = [vars(each) for each in value.__mro__ if each.__module__.startswith("evo_cpg")]
        members = {}
        for member in sorted({one for each in own for one in (*each, *_fields(each))}):
            if not member.startswith("_"):
                found_as = getattr(value, member, None)
                method = inspect.isfunction(found_as) or inspect.ismethod(found_as)
                members[member] = parameters(found_as) if method else None
        found[name] = {"parameters": made, "members": members}
    return found


def _fields(attributes: Any) -> Any:
    return attributes.get("__annotations__", {})


def commands() -> dict[str, dict[str, dict[str, Any]]]:
    """Return the arguments and options of all commands, by the words that call the command."""
    return dict(_of_command("", typer.main.get_command(app)))


def _of_command(called: str, command: Any) -> Iterator[tuple[str, dict[str, dict[str, Any]]]]:
    found, arguments = {}, 0
    for one in command.params:
        is_option = one.param_type_name == "option"
        arguments += not is_option
        spelled = [*one.opts, *one.secondary_opts] if is_option else [f"argument {arguments}"]
        described = getattr(one, "type_descriptor", None)  # of Typer since 0.26
        kind = described.annotation if described else one.type
        choices = kind if isinstance(kind, enum.EnumMeta) else getattr(kind, "choices", ())
        for each in spelled:
            found[each] = {
                "required": bool(one.required),
                "values": one.nargs,
                "repeated": bool(one.multiple),
                "flag": bool(getattr(one, "is_flag", False)),
                "choices": sorted(str(getattr(choice, "value", choice)) for choice in choices),
            }
    yield called, found
    for name in getattr(command, "commands", ()):
        yield from _of_command(f"{called} {name}".strip(), command.commands[name])


def keys() -> dict[str, dict[str, Any]]:
    """Return all configuration keys by path: defaults, and words or types that are allowed.

    A section of several types has a path for each, such as ``controller[postures].period``.
    """
    schema = ExperimentConfig.model_json_schema()
    found: dict[str, dict[str, Any]] = {}
    _walk(schema, schema.get("$defs", {}), "", found, ())
    return found


def _walk(node: Any, definitions: Any, path: str, found: Any, inside: tuple[str, ...]) -> None:
    if "$ref" in node:
        name = node["$ref"].rpartition("/")[2]
        if name not in inside:
            _walk(definitions[name], definitions, path, found, (*inside, name))
        return
    for each in (*node.get("anyOf", ()), *node.get("oneOf", ())):
        _walk(each, definitions, path, found, inside)
    if "items" in node and isinstance(node["items"], dict):
        _walk(node["items"], definitions, f"{path}[]", found, inside)
    for each in node.get("prefixItems", ()):
        _walk(each, definitions, f"{path}[]", found, inside)
    if isinstance(node.get("additionalProperties"), dict):
        _walk(node["additionalProperties"], definitions, f"{path}.*", found, inside)
    properties = node.get("properties")
    if properties is not None:
        kind = properties.get("type", {}).get("const")
        at = f"{path}[{kind}]" if kind else path
        for name, each in properties.items():
            place = f"{at}.{name}".strip(".")
            own = found.setdefault(place, {"allowed": []})
            own["allowed"] = sorted({*own["allowed"], *_allowed(each, definitions, inside)})
            if "default" in each and not isinstance(each["default"], (dict, list)):
                own["default"] = each["default"]
            _walk(each, definitions, place, found, inside)


def _allowed(node: Any, definitions: Any, inside: tuple[str, ...]) -> set[str]:
    """Return the words and the JSON types that a key allows."""
    if "$ref" in node:
        name = node["$ref"].rpartition("/")[2]
        return _allowed(definitions[name], definitions, inside)
    several = (*node.get("anyOf", ()), *node.get("oneOf", ()))
    if several:
        return set().union(*(_allowed(each, definitions, inside) for each in several))
    if "enum" in node or "const" in node:
        return {f"= {word}" for word in node.get("enum", [node.get("const")])}
    given = node.get("type", "object")
    return {given} if isinstance(given, str) else set(given)


def interface() -> dict[str, Any]:
    """Return the whole description."""
    return {"names": names(), "commands": commands(), "keys": keys()}


if __name__ == "__main__":
    text = json.dumps(interface(), indent=1, sort_keys=False)
    Path(sys.argv[1]).write_text(text + "\n", encoding="utf-8")
