"""Sections of several kinds, selected by the key ``type``."""

import importlib
import inspect
from typing import Annotated, Any, ClassVar

from pydantic import AfterValidator, Discriminator, Field

from evo_cpg.io.errors import KeyProblem
from evo_cpg.io.schema.section import Section, pattern


def _as_read_again(options: dict[str, Any]) -> dict[str, Any]:
    """Return options as a run folder's ``config.yaml`` stores them, so that a run can resume.

    Raises:
        ValueError: a value would not be read back unchanged.
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
                    raise ValueError(f"{place} has the key {key!r}. Allowed: text, such as '{key}'")
            return {str(key): plain(each, f"{place}.{key}") for key, each in value.items()}
        raise ValueError(
            f"{place} is a {type(value).__name__}. Allowed: text, numbers, true, false, null, and "
            "lists and mappings of these"
        )

    return {key: plain(value, key) for key, value in options.items()}


# Constructor options of a user's own class.
Options = Annotated[dict[str, Any], AfterValidator(_as_read_again)]


class CustomConfig(Section):
    """A class of your own.

    Attributes:
        type: ``my_module:MyClass``.
        options: keyword arguments of its constructor.
    """

    type: Annotated[
        str, *pattern(r"^[\w.]+:\w+$", "must be a module and a class, such as my_module:MyClass")
    ]
    options: Options = Field(default_factory=dict)

    # Nothing is known about the needs of a user's own class. These values pass every check.
    goal: ClassVar[None] = None
    needs_ground: ClassVar[bool] = False
    body_keys: ClassVar[tuple[str, ...]] = ()
    uses_senses: ClassVar[bool] = True
    genome: ClassVar[None] = None

    def instance(self, kind: Any, **about: Any) -> Any:
        """Import the class and build an instance from its options.

        Args:
            kind: required base class.
            about: further keyword arguments. The constructor gets those that are its parameters.

        Raises:
            KeyProblem: the class does not exist, or cannot be built.
        """
        module, _, name = self.type.partition(":")
        try:
            made = getattr(importlib.import_module(module), name)
        except Exception as error:
            # Any error raised here comes from the user's module.
            problem = f"{self.type!r} cannot be imported ({type(error).__name__}: {error})"
            raise KeyProblem(("type",), problem) from None
        if not (isinstance(made, type) and issubclass(made, kind)):
            problem = f"{self.type!r} is not a subclass of {kind.__module__}:{kind.__name__}"
            raise KeyProblem(("type",), problem)
        taken = inspect.signature(made).parameters
        try:
            return made(**self.options, **{name: about[name] for name in about if name in taken})
        except Exception as error:
            # Any error comes from the user's class. The message of a KeyError is only the key.
            known = isinstance(error, (TypeError, ValueError))
            words = f"{error}" if known else f"{type(error).__name__}: {error}"
            problem = f"{self.type} cannot be built with these options ({words})"
            raise KeyProblem(("options",), problem) from None


def by_type(default: str | None) -> Discriminator:
    """Return a discriminator by ``type``, with the tag ``custom`` for a class of your own.

    Args:
        default: kind of a section without ``type``, or None if ``type`` is required.
    """

    def kind(value: Any) -> str | None:
        written = value.get("type", default) if isinstance(value, dict) else None
        given = getattr(value, "type", default) if written is None else written
        if given is None:
            return None
        return "custom" if isinstance(given, str) and ":" in given else str(given)

    return Discriminator(kind)
