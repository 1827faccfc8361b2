"""Completions for a shell: shipped configurations, files, folders."""

from collections.abc import Iterator
from pathlib import Path

_CONFIGS = (".yaml", ".yml")


def complete_config(incomplete: str) -> list[str]:
    """Return names of shipped configurations, configuration files and folders that match."""
    names = complete_shipped(incomplete)
    found = [path for path in _matching(incomplete) if path.suffix in _CONFIGS or path.is_dir()]
    return [*names, *map(_shown, found)]


def complete_shipped(incomplete: str) -> list[str]:
    """Return names of shipped configurations that match."""
    from evo_cpg.io.shipped import shipped_names

    return [name for name in shipped_names() if name.startswith(incomplete)]


def complete_folder(incomplete: str) -> list[str]:
    """Return run folders and other folders that match."""
    return [_shown(path) for path in _matching(incomplete) if path.is_dir()]


def _matching(incomplete: str) -> Iterator[Path]:
    """Yield paths that begin with the typed text. A hidden path needs a typed point."""
    folder, slash, start = incomplete.rpartition("/")
    try:
        found = sorted(Path(folder + slash or ".").iterdir())
    except OSError:
        return
    for path in found:
        if path.name.startswith(start) and (start or not path.name.startswith(".")):
            yield path


def _shown(path: Path) -> str:
    """Return a path as text. A folder that is not a run ends with a slash, to continue typing."""
    onward = path.is_dir() and not (path / "config.yaml").is_file()
    return f"{path}/" if onward else str(path)
