"""Import all MJCF files in a folder, and compare their numbers with those that MuJoCo compiled.

    python -m benchmarks.imported_mjcf FOLDER...

Every file of at least two moving bodies is imported, with ``--drop`` if it is refused without. Each
creature is compared with MuJoCo's own model of the file: mass, inertia, joint limits and motors.
The largest force of a motor is measured in MuJoCo, with the largest command. A difference counts as
said if the import names the element among what it changed or dropped. The command fails if a
difference is unsaid.
"""

import argparse
import re
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np

from benchmarks.imported_models import models
from evo_cpg.creature.creature import NO_LIMIT, neutral_pose
from evo_cpg.creature.tree import Tree, build_tree
from evo_cpg.io.load import check_config
from evo_cpg.io.models.mjcf_import import Imported, read_model
from evo_cpg.io.models.refusals import ExchangeError

# Largest relative difference of equal numbers.
_ALIKE = 1e-6

# Command beyond all limits, but below 1e10, because MuJoCo ignores larger commands.
_HUGE = 1e9


class Difference(NamedTuple):
    """A number of the import that is not the file's.

    Attributes:
        element: kind and name of the element, as in the import's messages.
        words: what differs.
    """

    element: str
    words: str


class Imports:
    """A model in both programs.

    Attributes:
        model: MuJoCo's model.
        imported: result of the import.
        tree: our tree.
        turns: axes of our bodies in the neutral pose, in the world.
        leads: MuJoCo's body that carries all of each of our bodies, by our name.
    """

    def __init__(self, path: Path, imported: Imported):
        """Read the file with MuJoCo, and build the imported creature."""
        self.model: Any = mujoco.MjModel.from_xml_path(str(path))
        self.imported = imported
        creature = check_config(imported.experiment, path).creature.build()
        self.tree: Tree = build_tree(creature)
        names = [body.name for body in creature.bodies]
        self.turns = dict(zip(names, np.asarray(neutral_pose(creature)[1]), strict=True))
        owners, joints = self.model.jnt_bodyid, imported.joints
        self.leads = {name: int(owners[numbers[0]]) for name, numbers in joints.items()}
        root = self.tree.names[0]
        if root not in self.leads and self.tree.hanging is None:
            named = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_BODY, root)
            tops = [int(self.model.body_rootid[lead]) for lead in self.leads.values()]
            self.leads[root] = (tops or [named])[0]

    def name(self, kind: str, number: int) -> str:
        """Return the name of an element as in the import's messages."""
        code = getattr(mujoco.mjtObj, f"mjOBJ_{kind.upper()}")
        name = mujoco.mj_id2name(self.model, code, number)
        if name:
            return f"{kind} {name!r}"
        if kind == "joint":
            return f"unnamed joint of {self.name('body', int(self.model.jnt_bodyid[number]))}"
        return f"{kind} number {number} (unnamed)"

    def says(self, element: str) -> bool:
        """Return whether the import names an element, or counts it with others of its kind."""
        more = re.compile(rf"{element.removeprefix('unnamed ').split()[0]} .* and \d+ more:")
        said = [*self.imported.changed, *self.imported.dropped]
        return any(element in sentence or more.search(sentence) for sentence in said)


def differences(both: Imports) -> Iterator[Difference]:
    """Yield all numbers of the import that differ from the file's."""
    yield from _differing_bodies(both)
    yield from _differing_limits(both)
    yield from _differing_motors(both)


def _differing_bodies(both: Imports) -> Iterator[Difference]:
    """Compare mass, centre of mass, and inertia about it, in the axes of the world."""
    model, tree = both.model, both.tree
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    total = 0.0
    for name, lead in both.leads.items():
        members = np.flatnonzero(model.body_weldid == lead)
        weights = model.body_mass[members]
        total += weights.sum()
        centre = weights @ data.xipos[members] / weights.sum()
        expected = sum(_about(model, data, int(body), centre) for body in members)
        i = tree.names.index(name)
        turn, com = both.turns[name], np.asarray(tree.com[:, i])
        found = np.asarray(tree.inertia[:3, :3, i])
        found = (
            turn @ (found - tree.mass[i] * (com @ com * np.eye(3) - np.outer(com, com))) @ turn.T
        )
        if not np.isclose(tree.mass[i], weights.sum(), rtol=_ALIKE):
            yield Difference(both.name("body", lead), f"{weights.sum():g} kg: {tree.mass[i]:g}")
        # The import turns the world if gravity is tilted. Only the moments are then comparable.
        moments = [np.linalg.eigvalsh(tensor) for tensor in (expected, found)]
        tilted = np.any(model.opt.gravity[:2])
        pair = moments if tilted else (expected, found)
        if np.abs(pair[0] - pair[1]).max() > _ALIKE * moments[0].max():
            yield Difference(both.name("body", lead), f"inertia {moments[0]}: {moments[1]}")
    own = sum(float(tree.mass[tree.names.index(name)]) for name in both.leads)
    if not np.isclose(own, total, rtol=_ALIKE):
        yield Difference("total mass", f"{total:g} kg: {own:g}")
    leads = set(both.leads.values())
    for body in np.flatnonzero(model.body_dofnum):
        if model.body_weldid[body] == body and body not in leads:
            yield Difference(both.name("body", int(model.body_rootid[body])), "is missing")


def _about(model: Any, data: Any, body: int, centre: np.ndarray) -> np.ndarray:
    """Return the inertia of a body about a point, in the axes of the world."""
    axes, arm = data.ximat[body].reshape(3, 3), data.xipos[body] - centre
    own = axes @ np.diag(model.body_inertia[body]) @ axes.T
    return own + model.body_mass[body] * (arm @ arm * np.eye(3) - np.outer(arm, arm))


def _dofs(both: Imports) -> dict[int, int]:
    """Return our degree of freedom of each of MuJoCo's hinges and slides."""
    found = {}
    for name, joints in both.imported.joints.items():
        first = both.tree.dof_bodies.index(both.tree.names.index(name))
        if both.model.jnt_type[joints[0]] != mujoco.mjtJoint.mjJNT_BALL:
            found |= {joint: first + i for i, joint in enumerate(joints)}
    return found


def _differing_limits(both: Imports) -> Iterator[Difference]:
    """Compare the limits of hinges and slides."""
    model, tree = both.model, both.tree
    for joint, dof in _dofs(both).items():
        limits = np.array([-np.inf, np.inf])
        if model.jnt_limited[joint]:
            limits = model.jnt_range[joint] - model.qpos0[model.jnt_qposadr[joint]]
        ours = np.array([tree.lower[dof], tree.upper[dof]])
        ours = np.where(np.abs(ours) < NO_LIMIT, ours, np.sign(ours) * np.inf)
        if not np.allclose(limits, ours, rtol=_ALIKE, atol=1e-12):
            yield Difference(both.name("joint", joint), f"range {limits}: {ours}")


def _differing_motors(both: Imports) -> Iterator[Difference]:
    """Compare gear, stiffness, gain and the largest force in both directions."""
    model, tree, dofs = both.model, both.tree, _dofs(both)
    for number in range(model.nu):
        target, laws = int(model.actuator_trnid[number, 0]), tree
        on_tendon = model.actuator_trntype[number] == mujoco.mjtTrn.mjTRN_TENDON
        place = dofs.get(target) if model.actuator_trntype[number] <= 1 else None
        if on_tendon:
            name, laws = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_TENDON, target), tree.tendons
            place = laws.names.index(name) if laws and name in laws.names else None
        element = both.name("actuator", number)
        if place is None or laws is None:
            owner = both.name("tendon", target) if on_tendon else element
            yield Difference(owner, f"the motor of {element} is missing")
            continue
        gear = float(model.actuator_gear[number, 0])
        affine = model.actuator_biastype[number] == mujoco.mjtBias.mjBIAS_AFFINE
        spring, gain = (-(gear**2) * model.actuator_biasprm[number, 1:3] * affine).tolist()
        motors = laws.torque_motors
        driven = motors is not None and bool(motors.driven[place])
        own = float(motors.gear[place]) if motors is not None and driven else 0.0
        torque = 0.0 if spring or gain else gear * float(model.actuator_gainprm[number, 0])
        expected = torque, spring, gain
        found = own, float(laws.servo_stiffness[place]), float(laws.servo_gain[place])
        if not np.allclose(found, expected, rtol=_ALIKE):
            yield Difference(element, f"gear, stiffness, gain {expected}: {found}")
        limit = float(laws.torque_limit[place])
        measured = _largest_forces(model, number, bool(spring or gain))
        # A motor without limits gives what its command demands, so large forces count as equal.
        most = 0.5 * _HUGE * abs(gear * float(model.actuator_gainprm[number, 0]))
        theirs, ours = (np.minimum(np.abs(x), most) for x in (measured, limit))
        if not np.allclose(theirs, ours, rtol=_ALIKE):
            yield Difference(element, f"force limits {measured}: {limit:g}")


def _largest_forces(model: Any, number: int, servo: bool) -> np.ndarray:
    """Return the force of an actuator on its joint or tendon, with the least and largest command.

    The command of a servo is a target, whose limits are not the motor's.
    """
    data = mujoco.MjData(model)
    flag, flags = int(mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL), model.opt.disableflags
    model.opt.disableflags = flags | flag if servo else flags & ~flag
    forces = []
    for command in (-_HUGE, _HUGE):
        data.ctrl[:], data.act[:] = 0.0, 0.0
        data.ctrl[number] = command
        address = int(model.actuator_actadr[number])
        if address >= 0:
            data.act[address] = np.clip(command, *_reached(model, number, servo))
        mujoco.mj_forward(model, data)
        if model.actuator_trntype[number] == mujoco.mjtTrn.mjTRN_TENDON:
            forces.append(data.actuator_force[number] * model.actuator_gear[number, 0])
        else:
            dof = model.jnt_dofadr[model.actuator_trnid[number, 0]]
            forces.append(data.qfrc_actuator[dof])
    model.opt.disableflags = flags
    return np.array(forces)


def _reached(model: Any, number: int, servo: bool) -> np.ndarray:
    """Return the least and the largest activation that an actuator reaches in time."""
    if model.actuator_actlimited[number] and not servo:
        return model.actuator_actrange[number]
    filtered = model.actuator_dyntype[number] != mujoco.mjtDyn.mjDYN_INTEGRATOR
    if model.actuator_ctrllimited[number] and filtered and not servo:
        return model.actuator_ctrlrange[number]
    return np.array([-_HUGE, _HUGE])


def report(folders: Sequence[Path]) -> int:
    """Write a line for each file and a table. Return how many files have an unsaid difference."""
    counts: Counter[str] = Counter()
    reasons: Counter[str] = Counter()
    for path in (path for folder in folders for path in models(folder)):
        if path.suffix != ".xml":
            continue
        counts["tried"] += 1
        try:
            imported = read_model(path)
            counts["imported"] += 1
        except ExchangeError as error:
            reasons.update(
                set(re.findall(r": (it [a-z ]+[a-z]|a creature cannot have it\b)", str(error)))
            )
            counts["refused"] += 1
            try:
                imported = read_model(path, drop=True)
            except ExchangeError as vital:
                counts["refused with --drop"] += 1
                print(f"refused   {path}: {vital}")
                continue
            counts["imported with --drop"] += 1
        both = Imports(path, imported)
        found = list(differences(both))
        unsaid = [each for each in found if not both.says(each.element)]
        kind = "unsaid" if unsaid else "said" if found else "equal"
        counts[kind] += 1
        print(f"{kind:9} {path}: {len(found)} differences")
        for each in unsaid:
            print(f"          {each.element}: {each.words}")
    for word, count in (counts + reasons).items():
        print(f"{count:4} {word}")
    return counts["unsaid"]


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__)
    # MuJoCo would write its warnings to a file.
    mujoco.set_mju_user_warning(lambda _: None)
    parser.add_argument("folders", type=Path, nargs="+")
    sys.exit(report(parser.parse_args().folders) > 0)


if __name__ == "__main__":
    main()
