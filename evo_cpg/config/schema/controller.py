"""The nervous system; its sections are the settings of the controllers themselves."""

import dataclasses
import typing
from typing import Annotated, Any, Literal, TypeAlias

from pydantic import Tag, create_model

from evo_cpg.config.schema.choice import CustomConfig, by_type
from evo_cpg.config.schema.plausible import RATE
from evo_cpg.config.schema.section import Section
from evo_cpg.control.brain_cpg import BrainCpgSettings
from evo_cpg.control.postures import PostureSettings

# Plausible values of settings, which know of no configuration.
_PLAUSIBLE = {"max_rate": RATE, "rate_gain": RATE}


def _section_of(settings: type, name: str, kind: str) -> type[Section]:
    """The configuration section of a settings dataclass, which keeps keys and defaults."""
    hints = typing.get_type_hints(settings)
    fields: dict[str, Any] = {"type": (Literal[kind], kind)}
    for field in dataclasses.fields(settings):
        default = field.default
        if default is dataclasses.MISSING:
            assert field.default_factory is not dataclasses.MISSING
            default = field.default_factory()
        hint = hints[field.name]
        if field.name in _PLAUSIBLE:
            hint = Annotated[hint, _PLAUSIBLE[field.name]]
        fields[field.name] = (hint, default)
    return create_model(name, __base__=Section, __doc__=settings.__doc__, **fields)


BrainCpgConfig = _section_of(BrainCpgSettings, "BrainCpgConfig", "brain_cpg")
PosturesConfig = _section_of(PostureSettings, "PosturesConfig", "postures")

# Two of them are classes made while this file runs, which pyright cannot follow.
ControllerConfig: TypeAlias = Annotated[
    Annotated[BrainCpgConfig, Tag("brain_cpg")]  # pyright: ignore[reportInvalidTypeForm]
    | Annotated[PosturesConfig, Tag("postures")]  # pyright: ignore[reportInvalidTypeForm]
    | Annotated[CustomConfig, Tag("custom")],
    by_type("brain_cpg"),
]
