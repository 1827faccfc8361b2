"""How every table and picture of a study was made, in `provenance.json` beside them."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from evo_cpg.files import write_text
from evo_cpg.training.run_folder import read_checked

FILE = "provenance.json"


def digest(path: Path) -> str:
    """SHA-256 of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def read(folder: Path) -> dict[str, Any]:
    """Read how the parts of a folder were made, by name; empty without a file.

    Raises:
        RunFolderError: the file is damaged.
    """
    found = read_checked(folder / FILE, _is_sound)
    return found["parts"] if found else {}


def _is_sound(content: Any) -> bool:
    return all(isinstance(part["files"], dict) for part in content["parts"].values())


def note(folder: Path, part: str, record: Mapping[str, Any]) -> None:
    """Write down how a part was made."""
    parts = read(folder) | {part: dict(record)}
    text = json.dumps({"parts": parts}, indent=1, allow_nan=False) + "\n"
    write_text(folder / FILE, text)


def problems(folder: Path) -> list[str]:
    """Return tables and pictures of a folder that differ from its provenance."""
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
            found.append(f"{path} is of no part in {FILE}")
    return found


def caption(study: str, part: str, record: Mapping[str, Any]) -> str:
    """The line under every table that says how it was made."""
    words = (
        f"*Made by `evo-cpg reproduce {study} {part}` with evo-cpg {record['versions']['evo-cpg']}"
    )
    commits = record["run_commits"]
    if record["commit"]:
        words += f" at commit {record['commit']}"
    elsewhere = sorted({each or "unknown" for each in commits} - {record["commit"] or "unknown"})
    if elsewhere:
        words += f" of runs evolved at {', '.join(elsewhere)}"
    cores = "1 core" if record["devices"] == 1 else f"{record['devices']} cores"
    words += f" on {record['date'][:10]}, {record['processor']}, {cores}.*"
    if record["quick"]:
        words = f"**Quick: scaled down, a test of the program and no result.** {words}"
    return words
