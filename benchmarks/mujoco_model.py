"""A creature as a MuJoCo model: the tests' oracle and the benchmarks' peer."""

from collections.abc import Sequence
from xml.etree.ElementTree import Element

import mujoco

from evo_cpg.creature.creature import Creature
from evo_cpg.io.models.mjcf_export import mjcf_model, mjcf_text
from evo_cpg.physics.contact.contact_model import Ground

GRAVITY = 9.81


def mujoco_model(
    creature: Creature,
    options: dict[str, float | str] | None = None,
    fluid: str = "",
    motors: bool = False,
    limits: bool = False,
    ground: Ground | None = None,
    start: tuple[float, float, float] = (0.0, 0.0, 0.0),
    pairs: Sequence[tuple[str, str]] = (),
) -> mujoco.MjModel:
    """Compile a creature for MuJoCo.

    Args:
        creature: the animal.
        options: attributes of MuJoCo's ``option`` element.
        fluid: the ``fluidshape`` of every geom, or empty for MuJoCo's default, the inertia box.
        motors: whether the motors work (see `evo_cpg.io.models.mujoco_state`).
        limits: whether MuJoCo's soft constraint holds every joint within its limits.
        ground: ground that every body may touch.
        start: initial place of the root's centre, m.
        pairs: names of bodies that may touch each other.
    """
    root = mjcf_model(creature, GRAVITY, ground, start=start, pairs=pairs)
    for key, value in (options or {}).items():
        _part(root, "option").set(key, str(value))
    if fluid:
        _part(root, "default/geom").set("fluidshape", fluid)
    model = mujoco.MjModel.from_xml_string(mjcf_text(root))
    for off, flag in (
        (not motors, mujoco.mjtDisableBit.mjDSBL_ACTUATION),
        (not limits, mujoco.mjtDisableBit.mjDSBL_LIMIT),
        (ground is None and not pairs, mujoco.mjtDisableBit.mjDSBL_CONTACT),
    ):
        if off:
            model.opt.disableflags |= flag
    return model


def _part(root: Element, path: str) -> Element:
    """Return the element at a path that every exported model has."""
    found = root.find(path)
    assert found is not None
    return found
