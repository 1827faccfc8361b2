"""Sections of which there are several kinds, told apart by their ``type``."""

import importlib
import inspect
from typing import Annotated, Any, ClassVar

from pydantic import AfterValidator, Discriminator, Field

from evo_cpg.config.errors import KeyProblem
from evo_cpg.config.schema.section import Section, pattern


def _as_read_again(options: dict[str, Any]) -> dict[str, Any]:
    """As a run folder's ``config.yaml`` gives them: a run that goes on gets what it began with.

    Raises:
        ValueError: there is something that comes back as something else.
    """

    def plain(value: Any, place: str) -> Any:
        if value is None or isinstance(value, bool):
            return value
        for kind in (str, int, float):
            if isinstance(value, kind):
                return kind(value)
        if isinstance(value, (list, tuple)):
            return [plain(each, f"{place}.{i}") for i, each in enumerate(value)]
        if isinstance(value, dict):
            for key in value:
                if not isinstance(key, str):
                    raise ValueError(
                        f"{place} has the key {key!r}; allowed: keys that are text, such as '{key}'"
                    )
            return {str(key): plain(each, f"{place}.{key}") for key, each in value.items()}
        raise ValueError(
            f"{place} is a {type(value).__name__}; allowed: text, numbers, true, false, null, and "
            "lists and mappings of them"
        )

    return {key: plain(value, key) for key, value in options.items()}


# Of the constructor of a class of the user's own.
Options = Annotated[dict[str, Any], AfterValidator(_as_read_again)]


class CustomConfig(Section):
    """A class of your own.

    Attributes:
        type: ``my_module:MyClass``.
        options: of its constructor.
    """

    type: Annotated[
        str, *pattern(r"^[\w.]+:\w+$", "must be a module and a class, such as my_module:MyClass")
    ]
    options: Options = Field(default_factory=dict)

    # A configuration cannot tell what a class of one's own needs.
    goal: ClassVar[None] = None
    needs_ground: ClassVar[bool] = False
    body_keys: ClassVar[tuple[str, ...]] = ()
    uses_senses: ClassVar[bool] = True
    genome: ClassVar[None] = None

    def instance(self, kind: Any, **about: Any) -> Any:
        """Import the class, and build it from its options and what its constructor takes.

        Args:
            kind: the class that it must derive from.
            about: keyword arguments, of which the constructor gets those that it names.

        Raises:
            KeyProblem: there is no such class, or it cannot be built.
        """
        module, _, name = self.type.partition(":")
        try:
            made = getattr(importlib.import_module(module), name)
        except Exception as error:
            # Whatever the user's module raises is about the user's module.
            problem = f"{self.type!r} cannot be imported ({type(error).__name__}: {error})"
            raise KeyProblem(("type",), problem) from None
        if not (isinstance(made, type) and issubclass(made, kind)):
            problem = f"{self.type!r} is not a subclass of {kind.__module__}:{kind.__name__}"
            raise KeyProblem(("type",), problem)
        taken = inspect.signature(made).parameters
        try:
            return made(**self.options, **{name: about[name] for name in about if name in taken})
        except Exception as error:
            # Whatever the user's class raises is about the user's class; some messages are a key.
            known = isinstance(error, (TypeError, ValueError))
            words = f"{error}" if known else f"{type(error).__name__}: {error}"
            problem = f"{self.type} cannot be built with them ({words})"
            raise KeyProblem(("options",), problem) from None


def by_type(default: str | None) -> Discriminator:
    """What tells the kinds apart: the tag is ``type``, or ``custom`` for a class of your own.

    Args:
        default: the kind where no ``type`` is given; None where it has to be.
    """

    def kind(value: Any) -> str | None:
        written = value.get("type", default) if isinstance(value, dict) else None
        given = getattr(value, "type", default) if written is None else written
        if given is None:
            return None
        return "custom" if isinstance(given, str) and ":" in given else str(given)

    return Discriminator(kind)
