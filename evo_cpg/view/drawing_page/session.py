"""One person's work on a document: requests of the page, one at a time, and their answers."""

import re
import threading
import traceback
import unicodedata
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import Field

from evo_cpg.creature.creature import CreatureError
from evo_cpg.errors import UserError
from evo_cpg.files import write_whole
from evo_cpg.io.build import build_experiment, require_genes
from evo_cpg.io.errors import Key, KeyProblem
from evo_cpg.io.keys import value_at
from evo_cpg.io.lint import lint
from evo_cpg.io.load import complete_config
from evo_cpg.io.named_files import MESH_SUFFIXES, read_mesh
from evo_cpg.io.trust import LARGEST, is_trusted, trusting
from evo_cpg.io.wording import short
from evo_cpg.simulation.simulation import Simulation
from evo_cpg.view.drawing_page.commands import checked_arguments, edit
from evo_cpg.view.drawing_page.document import Data, Document, EditError
from evo_cpg.view.drawing_page.lookup import bodies
from evo_cpg.view.drawing_page.runs import How, TrainingRun, simulate
from evo_cpg.view.drawing_page.scene import scene
from evo_cpg.view.drawing_page.swim import prepare

Answer = dict[str, Any]
Generations = Annotated[int, Field(ge=1, le=1_000_000)]

# Requests that mean the same on a page that shows a former state of the document.
_ALWAYS = ("open", "stop", "champion", "watch")
_STALE = (
    "another page or window has changed the animal. This page shows it now. Look at it, and repeat "
    "your last step"
)
# Longest name of a file, bytes. The names of its autosave and of temporary files are longer.
_LONGEST = 200
# Longest name of a mesh file before the suffix, bytes.
_LONGEST_STEM = 100


class Finding(NamedTuple):
    """A message about a document.

    Attributes:
        kind: an error, with which it cannot run, or a warning of an unlikely value.
        part: name of the entry of a body that the message is about, or None.
        key: key of the value.
        words: the message.
    """

    kind: Literal["error", "warning"]
    part: str | None
    key: Key
    words: str


Advice = Callable[[Simulation], Sequence[str]]
"""Warnings about a simulation, one sentence or more each."""


class DrawingSession:
    """A document, its newest drawing, a try and a run.

    Args:
        document: the document.
        advice: further warnings about an animal, for its messages.
    """

    def __init__(self, document: Document, advice: Advice = lambda simulation: ()):
        self.document, self._advice = document, advice
        self._lock = threading.Lock()
        # Requests run in threads of their own, which do not inherit it.
        self._trusted = is_trusted()
        # Number of the state that a page shows. It grows with what is drawn and written.
        self._revision = 0
        self._last: tuple[Any, ...] = ()
        self._sent: set[str] = set()
        self._try: Answer = {"state": "none"}
        self._run: TrainingRun | None = None
        self._requests: Mapping[str, Callable[..., Any]] = {
            # A new page has received no shapes.
            "open": lambda: self._sent.clear(),
            "edit": self._edit,
            "undo": document.undo,
            "redo": document.redo,
            "discard": document.discard,
            "save": self._save,
            "try": self._start_try,
            "train": self._train,
            "stop": self._stop,
            "champion": lambda: {"motion": self._present_run().champion()},
            "watch": lambda: self._present_run().watch(),
        }

    def answer(self, request: str, given: Mapping[str, Any]) -> Answer:
        """Answer a request that may change the document.

        Args:
            request: name of the request.
            given: its arguments. ``seen`` is the revision that the page shows. If another page has
                changed the document since, the request is refused, because it may mean another
                part.

        Returns:
            The state of the document, with ``error`` for a refused request, or with ``lost`` for an
            edit that waits for consent.
        """
        arguments = dict(given)
        seen = arguments.pop("seen", None)
        with self._lock, trusting(self._trusted):
            extra: Answer = {}
            try:
                if request not in self._requests:
                    raise EditError(f"there is no request {request!r}")
                if seen not in (None, self._revision):
                    # The page may lack shapes that another page has received.
                    self._sent.clear()
                    if request not in _ALWAYS:
                        raise EditError(_STALE)
                work = self._requests[request]
                extra = work(**checked_arguments(request, work, arguments)) or {}
            except UserError as error:
                extra = {"error": str(error)}
            except RecursionError:
                extra = {"error": f"{request}: the values are nested too deeply"}
            except Exception as error:
                # A fault of this program must not end the page, and the document is unchanged.
                traceback.print_exc()
                extra = {"error": f"{request} met a fault of the program: {error!r}"}
            document = self.document
            data = document.data
            drawn: Answer | None = None
            undrawn = None
            shapes: frozenset[str] = frozenset()
            try:
                drawn = scene(data, document.path)
                shapes = frozenset(drawn["arrays"])
                drawn["arrays"] = {k: v for k, v in drawn["arrays"].items() if k not in self._sent}
                self._sent |= drawn["arrays"].keys()
            except (KeyProblem, CreatureError) as problem:
                undrawn = str(problem)
            found = problems(data, document.path, thorough=False)
            now = document.path, document.texts, shapes
            if now != self._last:
                self._revision, self._last = self._revision + 1, now
            return {
                "revision": self._revision,
                "path": str(document.path),
                "changed": document.is_changed,
                "recovered": document.recovered,
                "unsafe": document.unsafe,
                "undo": document.can_undo,
                "redo": document.can_redo,
                "data": data,
                "text": document.texts,
                "scene": drawn,
                "undrawn": undrawn,
                "problems": [each._asdict() for each in found],
                **extra,
            }

    def check(self) -> Answer:
        """Return all messages of `validate`, for which the experiment is built.

        Edits do not wait for them. ``revision`` tells which state they are about.
        """
        with self._lock:
            data, source, revision = self.document.data, self.document.path, self._revision
        with trusting(self._trusted):
            found = problems(data, source, advice=self._advice)
        return {"problems": [each._asdict() for each in found], "revision": revision}

    def prepare(self) -> Answer:
        """Begin to compile what a drive needs, unless this process has done so already."""
        threading.Thread(target=prepare, daemon=True).start()
        return {}

    def live_page(self) -> Answer:
        """Return the address of the run's live page as soon as it has one, or an ``error``.

        The program of the page takes seconds to start. Edits do not wait for it.
        """
        try:
            return {"address": self._present_run().live_page()}
        except UserError as error:
            return {"error": str(error)}

    def poll(self) -> Answer:
        """Return the state of the try and of the run."""
        run = self._run
        return {"try": self._try, "run": run.state() if run else None}

    def upload(self, name: str, content: bytes) -> Answer:
        """Take a mesh file, see `add_mesh_file`. Return an ``error`` if it is refused."""
        with self._lock:
            try:
                return dict(add_mesh_file(self.document.path, name, content))
            except UserError as error:
                return {"error": str(error)}

    def close(self) -> None:
        """End the run, if one is going on."""
        if self._run:
            self._run.close()
            self._run = None

    def _edit(self, command: str, given: dict[str, Any], accept: bool = False) -> Answer:
        change = self.document.propose(edit(command, self.document.path, given))
        if change.lost and not accept:
            return {"lost": change.lost}
        names = set(self._names())
        self.document.accept(change)
        new = [name for name in self._names() if name not in names]
        return {"new": new[0] if len(new) == 1 else None}

    def _names(self) -> list[str]:
        try:
            return [str(each.get("name")) for each in bodies(self.document.data)]
        except EditError:
            return []

    def _save(self, name: str | None = None) -> Answer:
        if name is None:
            self.document.save()
        else:
            is_plain = name.isprintable() and len(name.encode(errors="replace")) <= _LONGEST
            if not is_plain or Path(name).name != name or not name.endswith((".yaml", ".yml")):
                raise EditError(
                    f"{short(name)}: must be the name of a .yaml file, without a folder"
                )
            self.document.save_as(self.document.path.parent / name)
        return {"saved": str(self.document.path)}

    def _start_try(self, how: How) -> None:
        if self._try["state"] == "running":
            raise EditError("the last try has not ended yet")
        data, source = self.document.data, self.document.path
        self._try = {"state": "running"}

        def work() -> None:
            try:
                with trusting(self._trusted):
                    motion = simulate(data, source, how)
                self._try = {"state": "done", **motion}
            except (UserError, ValueError) as error:
                self._try = {"state": "failed", "error": str(error)}
            except Exception as error:
                # The page shows what a terminal would.
                self._try = {"state": "failed", "error": f"{type(error).__name__}: {error}"}
                raise

        threading.Thread(target=work, daemon=True).start()

    def _train(self, generations: Generations | None = None) -> None:
        if self._run and self._run.is_running:
            raise EditError("a run is going on. Stop it first")
        if self.document.is_changed:
            raise EditError("save first: a run reads the file")
        found = problems(self.document.data, self.document.path)
        wrong = next((each.words for each in found if each.kind == "error"), None)
        if wrong:
            raise EditError(wrong)
        self.close()
        name = str(self.document.data.get("name"))
        self._run = TrainingRun(self.document.path, name, generations)

    def _stop(self) -> None:
        if self._run:
            self._run.stop()

    def _present_run(self) -> TrainingRun:
        if self._run is None:
            raise EditError("there is no run")
        return self._run


def problems(
    data: Data, source: Path, thorough: bool = True, advice: Advice = lambda simulation: ()
) -> list[Finding]:
    """Return the messages of `validate` about a document.

    Args:
        data: data of the document.
        source: file of the document, to whose folder other files are relative.
        thorough: whether to build the whole experiment, which takes longer.
        advice: further warnings about the experiment.
    """
    try:
        config = complete_config(data, source)
        found = [
            Finding("warning", _part(data, each.key), each.key, each.problem)
            for each in lint(config, source)
        ]
        if thorough:
            experiment = build_experiment(config, source)
            require_genes(experiment, source)
            lines = advice(experiment.simulation)
            found += [Finding("warning", None, ("controller",), line) for line in lines]
        return found
    except KeyProblem as error:
        return [Finding("error", _part(data, error.key), error.key, error.problem)]
    except CreatureError as error:
        return [Finding("error", None, ("creature",), str(error))]
    except UserError as error:
        return [Finding("error", None, (), str(error))]


def _part(data: Data, key: Key) -> str | None:
    """Return the name of the entry that a key is about."""
    name = None
    match tuple(key):
        case ("creature", "bodies", int() as i, *_):
            name = value_at(data, ("creature", "bodies", i, "name"))
        case ("creature", str() as kind, int() as i, *_) if kind.endswith("sensors"):
            name = value_at(data, ("creature", kind, i, "body"))
    return name if isinstance(name, str) else None


def add_mesh_file(document: Path, name: str, content: bytes) -> dict[str, str]:
    """Write a mesh file beside a document.

    Args:
        document: file of the document.
        name: name of the file on the user's side, of which only the last part is kept.
        content: content of the file.

    Returns:
        The name of the ``file``, and ``problem`` if only its convex hull can be a body.

    Raises:
        EditError: it is no mesh that a body can have, or another file has its name.
    """
    # Some systems write an accent apart from its letter, so one name would have two forms.
    given_name = unicodedata.normalize("NFC", re.split(r"[/\\]", name)[-1])
    stem, dot, suffix = given_name.rpartition(".")
    if f"{dot}{suffix}".lower() not in MESH_SUFFIXES:
        raise EditError(f"{name[:80]}: a mesh is a file {', '.join(MESH_SUFFIXES)}")
    stem = (
        re.sub(r"[^\w.-]+", "_", stem).lstrip("._").encode()[:_LONGEST_STEM].decode(errors="ignore")
    )
    bare = f"{stem or 'mesh'}.{suffix}"
    place = document.parent / bare
    if len(content) > LARGEST:
        raise EditError(f"{bare}: more than the limit of {LARGEST // 2**20} MiB")
    is_new = not place.exists()
    if is_new:
        write_whole(place, lambda file: file.write(content))
    elif not place.is_file() or place.read_bytes() != content:
        raise EditError(f"{place} exists with other content. Rename your file")
    given = {"type": "mesh", "file": bare}
    try:
        read_mesh(document, given)
    except KeyProblem as error:
        try:
            read_mesh(document, given | {"hull": True})
        except KeyProblem:
            if is_new:
                place.unlink(missing_ok=True)
            raise EditError(f"{bare}: {error.problem}") from None
        return {"file": bare, "problem": error.problem}
    return {"file": bare}
