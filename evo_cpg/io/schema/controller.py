"""Sections of the nervous system, made from the settings classes of the controllers."""

import dataclasses
import typing
from typing import Annotated, Any, ClassVar, Literal, TypeAlias

from pydantic import Tag, create_model
from typing_extensions import override

from evo_cpg.control.brain_cpg import BrainCpgSettings, build_brain_cpg
from evo_cpg.control.controller import Controller
from evo_cpg.control.postures import PostureSettings, build_posture_controller
from evo_cpg.creature.algebra.decisions import chosen
from evo_cpg.creature.tree import Tree
from evo_cpg.io.keys import unchecked
from evo_cpg.io.schema.section import RATE, CustomConfig, Section, by_type

# Typical ranges stand here because settings classes do not depend on the configuration.
_TYPICAL = {"max_rate": RATE, "rate_gain": RATE}


class _ControllerSection(Section):
    settings: ClassVar[type]
    uses_senses: ClassVar[bool] = True

    @property
    def genome(self) -> str | None:
        """Type of genetic algorithm for its genomes, ``real`` or ``bits``, or None for either."""
        return "real"

    def _settings(self) -> Any:
        fields = {name: value for name, value in self if name != "type"}
        # Check concrete numbers only: traced numbers cannot be checked.
        chosen(lambda: self.settings(**fields) and None)
        return unchecked(self.settings, fields)


class _BrainCpgSection(_ControllerSection):
    settings = BrainCpgSettings

    def build(
        self,
        tree: Tree,
        light_count: int,
        pressure_count: int,
        control_step: float,
        depth_count: int,
        custom_count: int,
    ) -> Controller:
        """Build the controller (see `build_brain_cpg`)."""
        settings, counts = self._settings(), (depth_count, custom_count)
        return build_brain_cpg(tree, light_count, pressure_count, settings, control_step, *counts)


class _PosturesSection(_ControllerSection):
    settings, uses_senses = PostureSettings, False

    if typing.TYPE_CHECKING:
        graded: bool

    @property
    @override
    def genome(self) -> str | None:
        # Graded genes are numbers, so both genetic algorithms can evolve them.
        return None if self.graded else "bits"

    def build(self, tree: Tree, control_step: float, **_: Any) -> Controller:
        """Build the controller (see `build_posture_controller`)."""
        return build_posture_controller(tree, self._settings(), control_step)


def _section_of(base: type[_ControllerSection], name: str, kind: str) -> type[Section]:
    """Return the configuration section of a settings dataclass, with its keys and defaults."""
    hints = typing.get_type_hints(base.settings)
    fields: dict[str, Any] = {"type": (Literal[kind], kind)}
    for field in dataclasses.fields(base.settings):
        default = field.default
        if default is dataclasses.MISSING:
            assert field.default_factory is not dataclasses.MISSING
            default = field.default_factory()
        hint = hints[field.name]
        if field.name in _TYPICAL:
            hint = Annotated[hint, _TYPICAL[field.name]]
        fields[field.name] = (hint, default)
    return create_model(name, __base__=base, __doc__=base.settings.__doc__, **fields)


BrainCpgConfig = _section_of(_BrainCpgSection, "BrainCpgConfig", "brain_cpg")
PosturesConfig = _section_of(_PosturesSection, "PosturesConfig", "postures")

# Pyright cannot follow the two classes that are created at import.
ControllerConfig: TypeAlias = Annotated[
    Annotated[BrainCpgConfig, Tag("brain_cpg")]  # pyright: ignore[reportInvalidTypeForm]
    | Annotated[PosturesConfig, Tag("postures")]  # pyright: ignore[reportInvalidTypeForm]
    | Annotated[CustomConfig, Tag("custom")],
    by_type("brain_cpg"),
]
