"""Files of strangers: not larger than any that is meant."""

from pathlib import Path

# What is read at all: the finest mesh that can be a body has a tenth of it.
LARGEST = 32 * 2**20


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
