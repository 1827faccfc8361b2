"""One person's work on a document: requests of the page, one at a time, and their answers."""

import threading
import traceback
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from evo_cpg.creature.creature import CreatureError
from evo_cpg.errors import UserError
from evo_cpg.io.errors import KeyProblem
from evo_cpg.io.trust import is_trusted, trusting
from evo_cpg.io.wording import short
from evo_cpg.view.drawing_page.arguments import checked_arguments
from evo_cpg.view.drawing_page.commands import edit
from evo_cpg.view.drawing_page.document import Document, DrawingError
from evo_cpg.view.drawing_page.lookup import bodies
from evo_cpg.view.drawing_page.mesh_file import add_mesh_file
from evo_cpg.view.drawing_page.problems import Advice, Problem, no_advice, problems
from evo_cpg.view.drawing_page.scene import scene
from evo_cpg.view.drawing_page.training_run import TrainingRun
from evo_cpg.view.drawing_page.trying import How, simulate

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


class Session:
    """A document, its newest drawing, a try and a run.

    Args:
        document: the document.
        advice: further warnings about an animal, for its messages.
    """

    def __init__(self, document: Document, advice: Advice = no_advice):
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
            "open": self._open,
            "edit": self._edit,
            "undo": document.undo,
            "redo": document.redo,
            "discard": document.discard,
            "save": self._save,
            "try": self._start_try,
            "train": self._train,
            "stop": self._stop,
            "champion": self._champion,
            "watch": self._watch,
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
                    raise DrawingError(f"there is no request {request!r}")
                if seen not in (None, self._revision):
                    # The page may lack shapes that another page has received.
                    self._sent = set()
                    if request not in _ALWAYS:
                        raise DrawingError(_STALE)
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
            return self._state() | extra

    def check(self) -> Answer:
        """Return all messages of `validate`, for which the experiment is built.

        Edits do not wait for them. ``revision`` tells which state they are about.
        """
        with self._lock:
            data, source, revision = self.document.data, self.document.path, self._revision
        with trusting(self._trusted):
            found = problems(data, source, advice=self._advice)
        return {"problems": _listed(found), "revision": revision}

    def live_page(self) -> Answer:
        """Return the address of the run's live page as soon as it has one, or an ``error``.

        The program of the page takes seconds to start. Edits do not wait for it.
        """
        run = self._run
        try:
            if run is None:
                raise DrawingError("there is no run")
            return {"address": run.live_page()}
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

    def _open(self) -> None:
        """Forget what was sent, because the page is new."""
        self._sent = set()

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
        except DrawingError:
            return []

    def _save(self, name: str | None = None) -> Answer:
        if name is None:
            self.document.save()
        else:
            is_plain = name.isprintable() and len(name.encode(errors="replace")) <= _LONGEST
            if not is_plain or Path(name).name != name or not name.endswith((".yaml", ".yml")):
                raise DrawingError(
                    f"{short(name)}: must be the name of a .yaml file, without a folder"
                )
            self.document.save_as(self.document.path.parent / name)
        return {"saved": str(self.document.path)}

    def _start_try(self, how: How) -> None:
        if self._try["state"] == "running":
            raise DrawingError("the last try has not ended yet")
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
            raise DrawingError("a run is going on. Stop it first")
        if self.document.is_changed:
            raise DrawingError("save first: a run reads the file")
        found = problems(self.document.data, self.document.path)
        wrong = next((each.words for each in found if each.kind == "error"), None)
        if wrong:
            raise DrawingError(wrong)
        self.close()
        name = str(self.document.data.get("name"))
        self._run = TrainingRun(self.document.path, name, generations)

    def _stop(self) -> None:
        if self._run:
            self._run.stop()

    def _champion(self) -> Answer:
        if self._run is None:
            raise DrawingError("there is no run")
        return {"motion": self._run.champion()}

    def _watch(self) -> None:
        if self._run is None:
            raise DrawingError("there is no run")
        self._run.watch()

    def _state(self) -> Answer:
        document = self.document
        data = document.data
        drawn: Answer | None = None
        error = None
        shapes: frozenset[str] = frozenset()
        try:
            drawn = scene(data, document.path)
            shapes = frozenset(drawn["arrays"])
            drawn["arrays"] = {k: v for k, v in drawn["arrays"].items() if k not in self._sent}
            self._sent |= drawn["arrays"].keys()
        except (KeyProblem, CreatureError) as problem:
            error = str(problem)
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
            "undrawn": error,
            "problems": _listed(problems(data, document.path, thorough=False)),
        }


def _listed(found: list[Problem]) -> list[Answer]:
    return [each._asdict() | {"key": list(each.key)} for each in found]
