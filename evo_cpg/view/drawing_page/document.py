"""A creature's configuration as a document that can be edited, undone, saved and recovered.

The document is the text of the configuration, and of the creature's own file if it has one. An edit
is a function that changes the data. `yaml_edit` carries the change into the texts. Undo restores
the texts, so it is exact.
"""

import contextlib
import copy
import hashlib
import json
import os
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from evo_cpg.errors import UserError
from evo_cpg.files import OutputError, read_json, require_place, write_text
from evo_cpg.io.errors import ConfigError, KeyProblem
from evo_cpg.io.load import read_yaml
from evo_cpg.io.trust import beside, require_small
from evo_cpg.io.yaml_text import parse_yaml
from evo_cpg.view.drawing_page.yaml_edit import lost_comments, with_data

_BLANK = """\
# Drawn with `evo-cpg model`. Lengths are in m, angles in degrees. x is ahead, y left, z up.
name: {name}
creature:
  name: {name}
  materials:
    flesh: {{density: 1000}}
  bodies:
    - name: body
      shape: {{type: box, size: [0.2, 0.1, 0.1]}}
      material: flesh
world:
  gravity: 9.81
  water: {{density: 1000}}
  ground: null
"""


Data = dict[str, Any]
Edit = Callable[[Data], None]

# Most states that undo can return to.
_MOST = 1000


class EditError(UserError):
    """Raised for an edit that is not possible, with a message for the user."""


class Texts(NamedTuple):
    """The texts of a document, with line feeds as ends of lines.

    Attributes:
        main: text of the configuration.
        creature: text of the creature's own file, or None without one.
    """

    main: str
    creature: str | None = None


class ProposedEdit(NamedTuple):
    """An edit that is worked out but not yet made.

    Attributes:
        texts: texts after the edit.
        lost: comments that the edit removes.
    """

    texts: Texts
    lost: tuple[str, ...]


class Document:
    """A configuration that is being edited.

    Attributes:
        path: file that `save` writes.
        texts: current texts.
        recovered: whether an autosave replaced the texts of the files.
        unsafe: problem with the autosave, such as a full disk, or None.
    """

    def __init__(self, path: Path, texts: Texts, on_disk: Texts | None):
        self.path, self.texts = path, texts
        self.recovered = False
        self.unsafe: str | None = None
        self._on_disk = on_disk
        self._undo: list[Texts] = []
        self._redo: list[Texts] = []
        self._autosave = Autosave(path)
        self._bytes: dict[Path, tuple[str, str]] = {}

    @classmethod
    def new(cls, path: Path) -> "Document":
        """Start with one body, in a file that does not exist yet."""
        document = cls(path, Texts(blank(path.stem)), None)
        document._recover()
        return document

    @classmethod
    def open(cls, path: Path) -> "Document":
        """Open a configuration.

        Raises:
            ConfigError: it cannot be read.
        """
        document = cls(path, Texts(""), None)
        document.texts = document._on_disk = document._read()
        document._recover()
        return document

    @classmethod
    def copy_of(cls, source: Path, path: Path) -> "Document":
        """Open a copy of a configuration, with its creature inside, that will be saved elsewhere.

        Raises:
            ConfigError: it cannot be read.
        """
        original = cls(source, Texts(""), None)
        original.texts = original._read()
        document = cls(path, Texts(with_data(original.texts.main, original.data)), None)
        document._recover()
        return document

    @property
    def data(self) -> Data:
        """A copy of the whole data, with the creature's own file in place of its name."""
        data = parse_yaml(self.texts.main)
        if self.texts.creature is not None:
            given = data["creature"]
            changes = dict(given) if isinstance(given, dict) else {}
            changes.pop("file", None)
            data["creature"] = parse_yaml(self.texts.creature) | changes
        # Aliases are shared objects, and an edit must change one place only.
        return _unshared(data)

    @property
    def is_changed(self) -> bool:
        """Whether the texts differ from the files."""
        return self.texts != self._on_disk

    def propose(self, edit: Edit) -> ProposedEdit:
        """Work out an edit without making it.

        Raises:
            EditError: the edit is not possible.
        """
        data = self.data
        edit(data)
        main, whole = parse_yaml(self.texts.main), {}
        if self.texts.creature is not None:
            given, whole = main.get("creature"), dict(data["creature"])
            if isinstance(given, dict):
                own = {k: whole.pop(k) for k in list(whole) if k in given and k != "file"}
                data["creature"] = {"file": given["file"], **own}
            else:
                data["creature"] = given
        try:
            own = self.texts.creature
            own = own if own is None else with_data(own, whole)
            texts = Texts(with_data(self.texts.main, data), own)
        except ValueError as error:
            raise EditError(str(error)) from None
        pairs = zip(self.texts, texts, strict=True)
        lost = [each for old, new in pairs if old and new for each in lost_comments(old, new)]
        return ProposedEdit(texts, tuple(lost))

    def accept(self, change: ProposedEdit) -> None:
        """Make an edit."""
        if change.texts == self.texts:
            return
        self._undo = [*self._undo[1 - _MOST :], self.texts]
        self._redo = []
        self._show(change.texts)

    def apply(self, edit: Edit) -> ProposedEdit:
        """Make an edit, and return what it changed."""
        change = self.propose(edit)
        self.accept(change)
        return change

    @property
    def can_undo(self) -> bool:
        """Whether there is an edit to undo."""
        return bool(self._undo)

    @property
    def can_redo(self) -> bool:
        """Whether there is an undone edit."""
        return bool(self._redo)

    def undo(self) -> None:
        """Return to the texts before the newest edit, if there is one."""
        if self._undo:
            self._redo.append(self.texts)
            self._show(self._undo.pop())

    def redo(self) -> None:
        """Make the newest undone edit again, if there is one."""
        if self._redo:
            self._undo.append(self.texts)
            self._show(self._redo.pop())

    def save(self) -> None:
        """Write the files that differ, each whole or not at all, and drop the autosave.

        A configuration that was deleted since it was opened is written again.

        Raises:
            EditError: a file has changed since it was opened.
            OutputError: a file cannot be written.
        """
        require_place(self.path)
        if self._on_disk is None:
            if self.path.exists():
                raise EditError(f"{self.path} exists. Save under another name")
            write_text(self.path, self.texts.main)
            self._bytes[self.path] = "", "\n"
        else:
            if not os.path.lexists(self.path):
                mark, end = self._bytes[self.path]
                write_text(self.path, mark + self._on_disk.main.replace("\n", end))
            if self._read() != self._on_disk:
                raise EditError(
                    f"{self.path} has changed on the disk since it was opened. Save under another "
                    "name, or open it again"
                )
            name = _creature_name(parse_yaml(self.texts.main))
            own = None if name is None else beside(self.path, name)
            changed = []
            pairs = zip(self._on_disk, self.texts, strict=True)
            for name, file, (old, new) in zip(Texts._fields, (self.path, own), pairs, strict=True):
                if file is not None and new is not None and old != new:
                    changed.append((name, require_place(file), new))
            for name, file, new in changed:
                mark, end = self._bytes[file]
                write_text(file, mark + new.replace("\n", end))
                # If the next file cannot be written, this one is saved all the same.
                self._on_disk = self._on_disk._replace(**{name: new})
        self._on_disk, self.recovered, self.unsafe = self.texts, False, None
        self._autosave.drop()

    def save_as(self, path: Path) -> None:
        """Write one new file, with the creature inside, and go on with it.

        Raises:
            EditError: the file exists.
            OutputError: the file cannot be written.
        """
        require_place(path)
        if path.exists():
            raise EditError(f"{path} exists. Save under another name")
        text = with_data(self.texts.main, self.data)
        write_text(path, text)
        self._autosave.drop()
        self.path, self.texts, self._autosave = path, Texts(text), Autosave(path)
        self._bytes, self._on_disk = {path: ("", "\n")}, self.texts
        self.recovered, self.unsafe = False, None

    def discard(self) -> None:
        """Return to the texts before the recovery, as an edit that can be undone."""
        if self.recovered:
            self.recovered = False
            # Undo may have returned to them already.
            self.accept(ProposedEdit([*self._undo, self.texts][0], ()))

    def _show(self, texts: Texts) -> None:
        self.texts = texts
        if self.is_changed:
            self.unsafe = self._autosave.write(texts, self._on_disk)
        else:
            self.unsafe = None
            self._autosave.drop()

    def _recover(self) -> None:
        """Continue with the autosave of a program that ended without saving."""
        found = self._autosave.read(self._on_disk)
        if found is None:
            return
        texts = Texts(*found)
        if texts != self.texts:
            self._undo, self.texts, self.recovered = [self.texts], texts, True

    def _read(self) -> Texts:
        name = _creature_name(read_yaml(self.path))
        main = self._text(self.path)
        if name is None:
            return Texts(main)
        try:
            file = beside(self.path, name)
        except KeyProblem as error:
            raise ConfigError(self.path, ("creature",), error.problem) from None
        read_yaml(file)
        return Texts(main, self._text(file))

    def _text(self, file: Path) -> str:
        """Return the text of a file, and note its byte order mark and its ends of lines."""
        require_small(file)
        text = file.read_bytes().decode("utf-8")
        mark = "\ufeff" if text.startswith("\ufeff") else ""
        crlf = text.count("\r\n")
        end = "\r\n" if crlf and crlf == text.count("\n") and crlf == text.count("\r") else "\n"
        self._bytes[file] = mark, end
        return text.removeprefix(mark).replace(end, "\n")


def _creature_name(data: Data) -> str | None:
    """Return the name of the creature's own file, or None without one."""
    given = data.get("creature")
    name = given.get("file") if isinstance(given, dict) else given
    return name if isinstance(name, str) else None


def _unshared(value: Any) -> Any:
    """Return a copy of data in which no two places share an object."""
    if isinstance(value, dict):
        return {key: _unshared(each) for key, each in value.items()}
    if isinstance(value, list):
        return [_unshared(each) for each in value]
    return copy.copy(value)


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


def blank(stem: str) -> str:
    """Return the text of a new document.

    Args:
        stem: name of its file without the suffix, which names the animal, too.
    """
    return _BLANK.format(name=re.sub(r"[^A-Za-z0-9_]+", "_", stem).strip("_") or "animal")


def _digests(texts: Sequence[str | None] | None) -> list[str]:
    return [hashlib.sha256(repr(text).encode()).hexdigest() for text in texts or ()]
