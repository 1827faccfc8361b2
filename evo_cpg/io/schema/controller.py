"""Sections of the nervous system, made from the settings classes of the controllers."""

from typing import Annotated, Any, ClassVar, Literal, TypeAlias

from pydantic import Tag

from evo_cpg.control.body_brain import BodyBrainSettings, build_body_brain
from evo_cpg.control.brain_cpg import BrainCpgSettings, build_brain_cpg
from evo_cpg.control.controller import Controller
from evo_cpg.control.limb_oscillators import LimbOscillatorSettings, build_limb_oscillators
from evo_cpg.control.postures import PostureSettings, build_posture_controller
from evo_cpg.creature.algebra.decisions import chosen
from evo_cpg.creature.tree import Tree
from evo_cpg.io.keys import unchecked
from evo_cpg.io.schema.section import RATE, CustomConfig, Section, by_type, section_of


class _ControllerSection(Section):
    described: ClassVar[type]
    uses_senses: ClassVar[bool] = True
    # Type of genetic algorithm for its genomes, unless they are graded.
    genome: ClassVar[Literal["real", "bits"]] = "real"

    def _settings(self) -> Any:
        fields = {name: value for name, value in self if name != "type"}
        # Check concrete numbers only: traced numbers cannot be checked.
        chosen(lambda: self.described(**fields) and None)
        return unchecked(self.described, fields)


class _BrainCpgSection(_ControllerSection):
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
    uses_senses: ClassVar[bool] = False
    genome: ClassVar[Literal["real", "bits"]] = "bits"

    def build(self, tree: Tree, control_step: float, **_: Any) -> Controller:
        """Build the controller (see `build_posture_controller`)."""
        return build_posture_controller(tree, self._settings(), control_step)


class _LimbOscillatorsSection(_ControllerSection):
    uses_senses: ClassVar[bool] = False

    def build(self, tree: Tree, control_step: float, **_: Any) -> Controller:
        """Build the controller (see `build_limb_oscillators`)."""
        return build_limb_oscillators(tree, self._settings(), control_step)


class _BodyBrainSection(_ControllerSection):
    def build(self, tree: Tree, control_step: float, **_: Any) -> Controller:
        """Build the controller (see `build_body_brain`)."""
        return build_body_brain(tree, self._settings(), control_step)


BrainCpgConfig = section_of(
    BrainCpgSettings,
    "BrainCpgConfig",
    __name__,
    "brain_cpg",
    default=True,
    base=_BrainCpgSection,
    # Typical ranges stand here because settings classes do not depend on the configuration.
    max_rate=Annotated[float, RATE],
    rate_gain=Annotated[float, RATE],
)
PosturesConfig = section_of(
    PostureSettings, "PosturesConfig", __name__, "postures", default=True, base=_PosturesSection
)
LimbOscillatorsConfig = section_of(
    LimbOscillatorSettings,
    "LimbOscillatorsConfig",
    __name__,
    "limb_oscillators",
    default=True,
    base=_LimbOscillatorsSection,
    max_rate=Annotated[float, RATE],
    rate_gain=Annotated[float, RATE],
)
BodyBrainConfig = section_of(
    BodyBrainSettings,
    "BodyBrainConfig",
    __name__,
    "body_brain",
    default=True,
    base=_BodyBrainSection,
    max_rate=Annotated[float, RATE],
)

# Pyright cannot follow the two classes that are created at import.
ControllerConfig: TypeAlias = Annotated[
    Annotated[BrainCpgConfig, Tag("brain_cpg")]  # pyright: ignore[reportInvalidTypeForm]
    | Annotated[PosturesConfig, Tag("postures")]  # pyright: ignore[reportInvalidTypeForm]
    | Annotated[LimbOscillatorsConfig, Tag("limb_oscillators")]  # pyright: ignore[reportInvalidTypeForm]
    | Annotated[BodyBrainConfig, Tag("body_brain")]  # pyright: ignore[reportInvalidTypeForm]
    | Annotated[CustomConfig, Tag("custom")],
    by_type("brain_cpg"),
]
