"""Sections of which there are several kinds, told apart by their ``type``."""

from typing import Annotated, Any

from pydantic import Discriminator, Field

from evo_cpg.config.schema.section import Section


class CustomConfig(Section):
    """A class of your own.

    Attributes:
        type: ``my_module:MyClass``.
        options: of its constructor.
    """

    type: Annotated[str, Field(pattern=r"^[\w.]+:\w+$")]
    options: dict[str, Any] = Field(default_factory=dict)


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
