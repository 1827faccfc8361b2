"""Differences between a configuration, the shipped one of its name, and the paper.

Comments in the shipped files mark every value as the paper's or ours: "# paper: 2000 steps",
"# ours". This module reads these comments, so that nothing is recorded twice.
"""

import re
from typing import Any

from evo_cpg.io.load import load_config
from evo_cpg.io.schema.experiment import ExperimentConfig
from evo_cpg.io.shipped import shipped, shipped_names
from evo_cpg.view.run_page.subject import Difference, Note, PaperDifferences

# Matches a line such as ` steps: 2000 # paper`: indent, key, value and comment.
_LINE = re.compile(r"^( *)([A-Za-z_]\w*):\s*(.*?)\s*(?:# ?(.*))?$")
# These comments all mark a value as ours: "paper: not said", "paper: 200; ours: 400" and "ours:
# half the paper's times".
_WHOSE = re.compile(r"\bours\b|\bpaper\b(?!')")
_CONTINUED = re.compile(r"^\s+# ?(.*)$")


def paper_differences(config: ExperimentConfig) -> PaperDifferences | None:
    """Return the differences, or None if no configuration of this name is shipped."""
    if config.name not in shipped_names():
        return None
    ours = shipped(config.name)
    path = ours.path
    text = path.read_text(encoding="utf-8")
    found = list(notes(text))
    for note in found:
        if note.key == "creature" and (path.parent / note.value).is_file():
            creature = (path.parent / note.value).read_text(encoding="utf-8")
            found += [n._replace(key=f"creature.{n.key}") for n in notes(creature)]
    listed = [note for note in found if note.text]
    differ = tuple(differences(config, load_config(path)))
    return PaperDifferences(ours.about, differ, tuple(listed))


def differences(config: ExperimentConfig, shipped: ExperimentConfig) -> list[Difference]:
    """Return the values that differ, by key, in the order of the shipped configuration."""
    own, other = (_flat(each.model_dump(mode="json")) for each in (config, shipped))
    keys = [*other, *(key for key in own if key not in other)]
    return [
        Difference(key, other.get(key), own.get(key))
        for key in keys
        if own.get(key) != other.get(key) or (key in own) != (key in other)
    ]


def notes(text: str) -> list[Note]:
    """Return values whose comments name their origin, and ``creature`` even without one."""
    found: list[Note] = []
    above: list[tuple[int, str]] = []
    # Whether the next line may continue the comment.
    open_note = False
    for line in text.splitlines():
        more = _CONTINUED.match(line)
        if more and open_note:
            found[-1] = found[-1]._replace(text=f"{found[-1].text} {more[1]}")
            continue
        match = _LINE.match(line)
        open_note = False
        if not match:
            continue
        indent, name, value, comment = len(match[1]), match[2], match[3], match[4] or ""
        above = [(depth, key) for depth, key in above if depth < indent]
        key = ".".join([*(key for _, key in above), name])
        if not value:
            above.append((indent, name))
        whose = _WHOSE.search(comment)
        if whose or key == "creature":
            value = re.sub(r"^&\w+ ?", "", value)
            ours = whose is None or "ours" in _WHOSE.findall(comment) or "not sa" in comment
            found.append(Note(key, value, comment, ours))
            open_note = whose is not None
    return found


def _flat(value: Any, key: str = "") -> dict[str, Any]:
    """Return values by dotted key. Empty lists and dictionaries are values."""
    inner = {}
    if isinstance(value, dict):
        inner = value
    elif isinstance(value, list):
        inner = dict(enumerate(value))
    if not inner:
        return {key: value}
    found: dict[str, Any] = {}
    for name, each in inner.items():
        found |= _flat(each, f"{key}.{name}" if key else str(name))
    return found
