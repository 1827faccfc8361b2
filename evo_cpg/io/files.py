"""Size limits for files of strangers."""

from pathlib import Path

# Largest file that is read. The finest mesh of a body has a tenth of this size.
LARGEST = 32 * 2**20


def require_small(path: Path) -> None:
    """Check that a file does not exceed the size limit.

    Raises:
        OSError: the file is larger, or its size cannot be read.
    """
    size = path.stat().st_size
    if size > LARGEST:
        raise OSError(
            None, f"{size / 2**20:.0f} MiB, more than the limit of {LARGEST // 2**20} MiB"
        )


def read_small(path: Path) -> str:
    """Return the text of a file that does not exceed the size limit.

    Raises:
        OSError: it is larger, or cannot be read.
        UnicodeDecodeError: it is not UTF-8.
    """
    require_small(path)
    if not (path.is_file() or path.is_dir()):
        # A pipe or a device may be endless.
        raise OSError(None, "is not a regular file")
    return path.read_text(encoding="utf-8")
