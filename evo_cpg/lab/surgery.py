"""The nervous system of each setting, as genes of a `Preparation`."""

from typing import Any

import numpy as np
from jaxtyping import Float

from evo_cpg.control.brain_cpg import BrainCpg
from evo_cpg.control.controller import Controller
from evo_cpg.control.preparation import SENSES, Preparation, Surgery, couplings_within
from evo_cpg.creature.tree import Tree
from evo_cpg.errors import nearest
from evo_cpg.lab.bodies import joints_of
from evo_cpg.lab.settings import NERVES, NOTHING, OPEN_LOOP, LabError, Setting


def prepare(controller: Controller, settings: list[Setting], brain: bool) -> Controller:
    """Return the controller that runs all settings.

    Args:
        controller: controller of the animal.
        settings: the settings.
        brain: whether the animal has a trained brain.

    Raises:
        LabError: the settings need a spinal cord, or a brain, that the animal lacks.
    """
    names = {name for setting in settings for name in setting}
    if not isinstance(controller, BrainCpg):
        wrong = sorted(names & set(NERVES))
        if wrong or not brain:
            needs = ", ".join(wrong) or "a creature without a champion"
            raise LabError(
                f"{needs}: needs the controller brain_cpg, not {type(controller).__name__}"
            )
        return controller
    return Preparation(controller, awake=brain and not names & set(OPEN_LOOP))


def genes_of(
    controller: Controller, tree: Tree, setting: Setting, brain: Float[np.ndarray, " g"] | None
) -> Float[np.ndarray, " g"]:
    """Return the genes of one setting.

    Raises:
        LabError: the setting does not fit the animal.
    """
    if not isinstance(controller, Preparation):
        assert brain is not None
        return brain
    own = surgery_of(controller, tree, setting).flat()
    return np.concatenate([brain, own]) if controller.awake and brain is not None else own


def surgery_of(controller: Preparation, tree: Tree, setting: Setting) -> Surgery:
    """Return the changes of one setting.

    Raises:
        LabError: the setting does not fit the animal.
    """
    animal, surgery = controller.animal, controller.intact()
    middle = 0.5 * (animal.min_adaptation_gain + animal.max_adaptation_gain)
    b = float(setting.get("b", middle))
    if not controller.awake:
        tonic = _tonic(animal, setting.get("u", 1.0), setting.get("turn", 0.0))
        surgery = surgery._replace(
            kept=0 * surgery.kept, tonic=surgery.tonic + tonic, gain=surgery.gain + b
        )
    cut = setting.get("cut", NOTHING)
    if cut != NOTHING:
        surgery = _transected(controller, tree, surgery, setting, cut, b)
    return surgery._replace(heard=_heard(setting.get("silence", NOTHING)))


def _tonic(animal: BrainCpg, u: float, turn: float) -> Float[np.ndarray, "2 1"]:
    """Return the tonic inputs of extensors and flexors."""
    return animal.max_tonic_input * u * np.array([[1 + turn], [1 - turn]])


def _transected(
    controller: Preparation, tree: Tree, surgery: Surgery, setting: Setting, cut: str, b: float
) -> Surgery:
    """Return the surgery with the cord cut in front of the joints of some bodies."""
    side = np.zeros(tree.body_count, int)
    for number, body in enumerate(sorted(joints_of(tree, "cut", cut)), 1):
        for other in _carried(tree, body):
            side[other] = number
    sides = side[np.array(tree.dof_bodies)]
    behind = sides > 0
    network = controller.animal.network
    coupled, own_coupled = couplings_within(network, sides)
    tonic = _tonic(controller.animal, setting.get("behind", 0.0), 0.0)
    return surgery._replace(
        kept=np.where(behind, 0.0, surgery.kept),
        tonic=np.where(behind, tonic, surgery.tonic),
        gain=np.where(behind, b, surgery.gain),
        coupled=coupled,
        own_coupled=own_coupled,
    )


def _carried(tree: Tree, body: int) -> list[int]:
    """Return a body and all bodies behind it."""
    found = [body]
    for other, parent in enumerate(tree.parents):
        if parent in found:
            found.append(other)
    return found


def _heard(silence: Any) -> Float[np.ndarray, " s"]:
    """Return a factor for each sense: 0 if it is silenced."""
    silenced = set(SENSES) if silence == "all" else set(silence.split("+")) - {NOTHING}
    for name in sorted(silenced):
        if name not in SENSES:
            raise LabError(f"silence={silence}: {nearest(name, [*SENSES, 'all', NOTHING])}")
    return np.array([0.0 if name in silenced else 1.0 for name in SENSES])
