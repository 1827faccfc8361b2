"""Completions for a shell: shipped configurations, files, folders."""

from collections.abc import Iterator
from pathlib import Path

_CONFIGS = (".yaml", ".yml")


def complete_config(incomplete: str) -> list[str]:
    """Names of shipped configurations, configuration files, and folders on the way to some."""
    names = complete_shipped(incomplete)
    found = [path for path in _matching(incomplete) if path.suffix in _CONFIGS or path.is_dir()]
    return [*names, *map(_shown, found)]


def complete_shipped(incomplete: str) -> list[str]:
    """Names of shipped configurations."""
    from evo_cpg.config.shipped import shipped_names

    return [name for name in shipped_names() if name.startswith(incomplete)]


def complete_folder(incomplete: str) -> list[str]:
    """Run folders, and folders on the way to some."""
    return [_shown(path) for path in _matching(incomplete) if path.is_dir()]


def _matching(incomplete: str) -> Iterator[Path]:
    """Yield paths that begin as typed; hidden ones only if a point is typed."""
    folder, slash, start = incomplete.rpartition("/")
    try:
        found = sorted(Path(folder + slash or ".").iterdir())
    except OSError:
        return
    for path in found:
        if path.name.startswith(start) and (start or not path.name.startswith(".")):
            yield path


def _shown(path: Path) -> str:
    """Return the name of a run, or of another folder with a slash, to type on."""
    onward = path.is_dir() and not (path / "config.yaml").is_file()
    return f"{path}/" if onward else str(path)
