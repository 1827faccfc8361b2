"""Files of strangers: not larger, deeper or more repetitive than any that is meant."""

from pathlib import Path

import yaml

# What is read at all: the finest mesh that can be a body has a tenth of it.
LARGEST = 32 * 2**20

# Sections of configurations lie at most ten deep.
_DEEPEST = 50

# Values, with aliases written out: seven times those of the largest relief.
_MOST_VALUES = 500_000


def require_small(path: Path) -> None:
    """Check that a file is not larger than any that is meant.

    Raises:
        OSError: it is, or cannot be looked at.
    """
    size = path.stat().st_size
    if size > LARGEST:
        raise OSError(
            None, f"{size / 2**20:.0f} MiB; files of more than {LARGEST // 2**20} MiB are not read"
        )


def require_shallow(text: str, loader: type) -> None:
    """Check that YAML is not nested deeper, and does not hold more, than any that is meant.

    An alias counts as all that it stands for: a few lines of them would fill the memory.

    Raises:
        yaml.YAMLError: it is or does, an alias stands within what it names, or it is no YAML.
    """
    # Of every open collection: its anchor, and values in it so far.
    opened: list[tuple[str | None, int]] = [(None, 0)]
    sizes: dict[str, int | None] = {}
    for event in yaml.parse(text, loader):
        added = 0
        anchor = getattr(event, "anchor", None)
        if isinstance(event, yaml.CollectionStartEvent):
            opened.append((anchor, 1))
            if anchor:
                sizes[anchor] = None
        elif isinstance(event, yaml.CollectionEndEvent):
            anchor, added = opened.pop()
            if anchor:
                sizes[anchor] = added
        elif isinstance(event, yaml.AliasEvent):
            size = sizes.get(event.anchor, 0)
            if size is None:
                raise _refused(event, f"*{event.anchor} stands within what it names")
            added = size
        elif isinstance(event, yaml.ScalarEvent):
            added = 1
            if anchor:
                sizes[anchor] = 1
        opened[-1] = opened[-1][0], opened[-1][1] + added
        if len(opened) > _DEEPEST:
            raise _refused(event, f"nested more than {_DEEPEST} deep")
        if opened[-1][1] > _MOST_VALUES:
            raise _refused(event, f"more than {_MOST_VALUES} values")


def _refused(event: yaml.Event, problem: str) -> yaml.YAMLError:
    return yaml.MarkedYAMLError(problem=problem, problem_mark=event.start_mark)


def read_small(path: Path) -> str:
    """The text of a file that is not larger than any that is meant.

    Raises:
        OSError: it is larger, or cannot be read.
        UnicodeDecodeError: it is not UTF-8.
    """
    require_small(path)
    if not (path.is_file() or path.is_dir()):
        # A pipe or a device need not end.
        raise OSError(None, "is no ordinary file")
    return path.read_text(encoding="utf-8")
