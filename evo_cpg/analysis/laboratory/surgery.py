"""The nervous system of each setting, as genes of a `Preparation`."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from evo_cpg.analysis.laboratory.bodies import joints_of
from evo_cpg.analysis.laboratory.settings import NERVES, NOTHING, OPEN_LOOP, LabError, Setting
from evo_cpg.control.brain_cpg import BrainCpg
from evo_cpg.control.controller import Controller
from evo_cpg.control.preparation import SENSES, Preparation
from evo_cpg.creature.tree import Tree
from evo_cpg.errors import nearest


def prepare(controller: Controller, settings: list[Setting], brain: bool, kind: str) -> Controller:
    """Return the controller that runs all settings.

    Args:
        controller: controller of the animal.
        settings: the settings.
        brain: whether the animal has a trained brain.
        kind: type of the controller in the configuration, for messages.

    Raises:
        LabError: the settings need a spinal cord, or a brain, that the animal lacks.
    """
    names = {name for setting in settings for name in setting}
    if not isinstance(controller, BrainCpg):
        wrong = sorted(names & set(NERVES))
        if wrong or not brain:
            needs = ", ".join(wrong)
            if not wrong:
                needs = "an animal without a champion (ask a run folder)"
            raise LabError(f"{needs}: needs the controller brain_cpg, not {kind}")
        return controller
    feedback = controller.feedback
    if feedback is not None and feedback.gene_count and not brain:
        raise LabError("weights of the feedback evolve. Ask a run folder, or set the weights")
    awake = brain and not names & set(OPEN_LOOP)
    return Preparation(animal=controller, trained=brain, awake=awake)  # pyright: ignore[reportCallIssue]


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
    animal, surgery = controller.animal, controller.intact()
    middle = 0.5 * (animal.min_adaptation_gain + animal.max_adaptation_gain)
    b = float(setting.get("b", middle))
    if not controller.awake:
        # The tonic inputs of extensors and flexors.
        turn = setting.get("turn", 0.0)
        tonic = animal.max_tonic_input * setting.get("u", 1.0) * np.array([[1 + turn], [1 - turn]])
        surgery = surgery._replace(
            kept=0 * surgery.kept, tonic=surgery.tonic + tonic, gain=surgery.gain + b
        )
    if setting.get("cut", NOTHING) != NOTHING:
        # The cord is cut in front of the joints of some bodies.
        sides = sides_of(tree, setting)
        behind = sides > 0
        tonic = animal.max_tonic_input * setting.get("behind", 0.0) * np.ones((2, 1))
        surgery = controller.within(surgery, sides)._replace(
            kept=np.where(behind, 0.0, surgery.kept),
            tonic=np.where(behind, tonic, surgery.tonic),
            gain=np.where(behind, b, surgery.gain),
        )
    if setting.get("undriven", NOTHING) != NOTHING:
        bodies = joints_of(tree, "undriven", setting["undriven"])
        driven = ~np.isin(tree.dof_bodies, list(bodies))
        surgery = surgery._replace(kept=surgery.kept * driven, tonic=surgery.tonic * driven)
    silenced = silenced_by(setting.get("silence", NOTHING))
    heard = np.array([0.0 if name in silenced else 1.0 for name in SENSES])
    heard[SENSES.index("feedback")] *= setting.get("feedback", 1.0)
    own = surgery._replace(heard=heard).flat()
    return own if brain is None else np.concatenate([brain, own])


def sides_of(tree: Tree, setting: Setting) -> Int[np.ndarray, " d"]:
    """Return the number of each oscillator's side of the cuts, 0 for the side of the root.

    Raises:
        LabError: no body with a joint has the name of a cut.
    """
    side, cut = np.zeros(tree.body_count, int), setting.get("cut", NOTHING)
    cuts = [] if cut == NOTHING else sorted(joints_of(tree, "cut", cut))
    for number, body in enumerate(cuts, 1):
        # A body and all bodies behind it.
        found = [body]
        for other, parent in enumerate(tree.parents):
            if parent in found:
                found.append(other)
        side[found] = number
    return side[np.array(tree.dof_bodies)]


def silenced_by(silence: str) -> set[str]:
    """Return the senses that a value of the knob ``silence`` silences.

    Raises:
        LabError: there is no such sense.
    """
    silenced: set[str] = {*SENSES} if silence == "all" else {*silence.split("+")} - {NOTHING}
    for name in sorted(silenced):
        if name not in SENSES:
            raise LabError(f"silence={silence}: {nearest(name, [*SENSES, 'all', NOTHING])}")
    return silenced


_ADVICE = "Set controller.cpg.feedback in the configuration"


def require_effects(controller: Controller, values: Mapping[str, Sequence[Any]]) -> None:
    """Check that the nervous system has everything that the knobs change.

    Raises:
        LabError: a knob would have no effect under any setting.
    """
    if not isinstance(controller, Preparation):
        return
    if "behind" in values and set(values.get("cut", ())) <= {NOTHING}:
        raise LabError("behind: needs cut=BODY")
    feels = controller.animal.feedback is not None
    if "feedback" in values and not feels:
        raise LabError(f"feedback: the spinal cord senses nothing. {_ADVICE}")
    for silence in values.get("silence", ()):
        silenced = silenced_by(silence)
        if silenced == {"feedback"} and not feels:
            raise LabError(f"silence={silence}: the spinal cord senses nothing. {_ADVICE}")
        if silenced and not controller.awake and not (feels and "feedback" in silenced):
            raise LabError(
                f"silence={silence}: no effect, because no brain drives the cord. Ask a run "
                "folder, without u, b and turn"
            )
