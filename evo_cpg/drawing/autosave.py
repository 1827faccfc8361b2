"""The autosave of a document: a file beside the original, while there are unsaved edits."""

import contextlib
import json
from pathlib import Path
from typing import Any

from evo_cpg.files import OutputError, read_json, write_text


class Autosave:
    """Texts of a document that are not saved yet.

    Args:
        path: file of the document. The autosave of ``fish.yaml`` is ``.fish.yaml.autosave``.
    """

    def __init__(self, path: Path):
        self.path = path.parent / f".{path.name}.autosave"

    def write(self, texts: tuple[str | None, ...], base: str) -> None:
        """Replace the autosave.

        Args:
            texts: texts of the document.
            base: digest of the saved texts, without which the autosave means nothing.
        """
        # A folder without write permission has no autosave. Saving reports it.
        with contextlib.suppress(OutputError):
            write_text(self.path, json.dumps({"base": base, "texts": texts}))

    def read(self, base: str) -> list[Any] | None:
        """Return the texts, or None if there are none for the saved texts with this digest."""
        try:
            found = read_json(self.path, dict[str, Any])
        except (OSError, ValueError):
            return None
        texts = found.get("texts")
        good = isinstance(texts, list) and len(texts) == 2 and isinstance(texts[0], str)
        return texts if good and found.get("base") == base else None

    def drop(self) -> None:
        """Delete the autosave."""
        with contextlib.suppress(OSError):
            self.path.unlink(missing_ok=True)
