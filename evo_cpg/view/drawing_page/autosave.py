"""The autosave of a document: a file beside the original, while there are unsaved edits."""

import contextlib
import hashlib
import json
import os
from collections.abc import Sequence
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

    def write(self, texts: Sequence[str | None], saved: Sequence[str | None] | None) -> str | None:
        """Replace the autosave.

        Args:
            texts: texts of the document.
            saved: texts of its files, without which the autosave means nothing, or None without
                files.

        Returns:
            The problem if it cannot be written, such as a full disk, or None.
        """
        try:
            write_text(self.path, json.dumps({"base": _digests(saved), "texts": texts}))
        except OutputError as error:
            return str(error)
        return None

    def read(self, saved: Sequence[str | None] | None) -> list[Any] | None:
        """Return the texts, or None if there are none for these files.

        Each file must have the text with which the edits began, or the text of the autosave if the
        program ended while it saved. The autosave of other texts is kept beside this one, as
        ``.fish.yaml.autosave.old``, because the next edit replaces this one.

        Args:
            saved: texts of the files, or None without files.
        """
        try:
            found = read_json(self.path, dict[str, Any])
        except (OSError, ValueError):
            return None
        base, texts = found.get("base"), found.get("texts")
        if not (isinstance(texts, list) and len(texts) == 2 and isinstance(texts[0], str)):
            return None
        now, new = _digests(saved), _digests(texts)
        same = isinstance(base, list) and len(base) == len(now)
        if same and all(x in (base[i], new[i]) for i, x in enumerate(now)):
            return texts
        with contextlib.suppress(OSError):
            os.replace(self.path, self.path.with_name(f"{self.path.name}.old"))
        return None

    def drop(self) -> None:
        """Delete the autosave."""
        with contextlib.suppress(OSError):
            self.path.unlink(missing_ok=True)


def _digests(texts: Sequence[str | None] | None) -> list[str]:
    return [hashlib.sha256(repr(text).encode()).hexdigest() for text in texts or ()]
