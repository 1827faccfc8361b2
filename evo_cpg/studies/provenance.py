"""Provenance of a study's tables and pictures, in `provenance.json` of their folder."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from evo_cpg.files import write_text
from evo_cpg.training.run_folder import read_checked

FILE = "provenance.json"


def digest(path: Path) -> str:
    """Return the SHA-256 of a file, in hexadecimal digits."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def read(folder: Path) -> dict[str, Any]:
    """Return the provenance of each part of a folder, by name, or {} without a file.

    Raises:
        RunFolderError: the file is damaged.
    """
    found = read_checked(folder / FILE, _is_sound)
    return found["parts"] if found else {}


def _is_sound(content: Any) -> bool:
    return all(isinstance(part["files"], dict) for part in content["parts"].values())


def note(folder: Path, part: str, record: Mapping[str, Any]) -> None:
    """Write the provenance of a part to the file of a folder."""
    parts = read(folder) | {part: dict(record)}
    text = json.dumps({"parts": parts}, indent=1, allow_nan=False) + "\n"
    write_text(folder / FILE, text)


def problems(folder: Path) -> list[str]:
    """Return messages about tables and pictures that differ from the provenance of a folder."""
    parts, found, known = read(folder), [], set()
    for name, part in parts.items():
        for file, sha256 in part["files"].items():
            known.add(file)
            if not (folder / file).is_file():
                found.append(f"{folder / file} of part {name} is missing")
            elif digest(folder / file) != sha256:
                found.append(f"{folder / file} was changed after part {name} was made")
    for path in sorted(folder.iterdir()) if folder.is_dir() else ():
        if path.suffix in (".md", ".png") and path.name not in known:
            found.append(f"{path} belongs to no part in {FILE}")
    return found


def caption(study: str, part: str, record: Mapping[str, Any]) -> str:
    """Return the line of provenance for the end of every table."""
    words = (
        f"*Made by `evo-cpg reproduce {study} {part}` with evo-cpg {record['versions']['evo-cpg']}"
    )
    if record["commit"]:
        words += f" at commit {record['commit']}"
    cores = "1 core" if record["devices"] == 1 else f"{record['devices']} cores"
    words += f" on {record['date'][:10]}, {record['processor']}, {cores}"
    elsewhere = sorted(
        {each or "unknown" for each in record["run_commits"]} - {record["commit"] or "unknown"}
    )
    if elsewhere:
        words += f", of runs evolved at {', '.join(elsewhere)}"
    words += ".*"
    if record["quick"]:
        words = f"**Quick: a small test of the program, not a result.** {words}"
    return words
