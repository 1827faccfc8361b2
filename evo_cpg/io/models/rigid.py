"""Rigid bodies of a compiled model: MuJoCo's bodies that are welded together are one.

| in MJCF | becomes |
|---|---|
| a body with joints, and everything welded to it | a body |
| the only moving body on the world | the root: free, or with a joint on the world |
| several moving bodies on the world or on fixed bodies | bodies on a fixed root |
| fixed bodies that carry moving ones | the fixed root |
| all other fixed bodies | scenery, which is left out |

A free body beside other moving bodies is refused. The tree with the most motors stays, if the user
accepts the loss of the others.
"""

from typing import Any, NamedTuple

import numpy as np

from evo_cpg.io.models.compiled import WORLD, Compiled


class Rigid(NamedTuple):
    """Bodies of the file that form one body of the creature.

    Attributes:
        lead: MuJoCo's number of the body with the joints, or of the fixed root's first body.
            `WORLD` stands for a fixed root without a body of its own.
        members: MuJoCo's numbers of all its bodies.
        parent: lead of the body that carries it, or None for the root.
        joints: MuJoCo's numbers of its joints, without a free one.
        free: whether it is a root that moves freely.
    """

    lead: int
    members: tuple[int, ...]
    parent: int | None
    joints: tuple[int, ...]
    free: bool = False


def rigid_bodies(compiled: Compiled) -> list[Rigid]:
    """Return the rigid bodies of the animal, parents first.

    Raises:
        RefusedError: nothing moves.
    """
    model, welds = compiled.model, _welds(compiled.model)
    above = welds[model.body_parentid]
    welded: dict[int, list[int]] = {}
    for body in range(1, model.nbody):
        welded.setdefault(int(welds[body]), []).append(body)
    leads = [lead for lead in welded if lead != WORLD and model.body_dofnum[welded[lead]].sum()]
    if not leads:
        if model.nbody == 1:
            problem, allowed, body = "the worldbody holds no body", "at least one", WORLD
        else:
            words = "; ".join(each for each in compiled.refusals.changed if "-> fixed" in each)
            problem = "no body of the file moves" + (f" ({words})" if words else "")
            allowed, body = "joints, or the option --free", 1
        raise compiled.item("body", body).refusal(problem, allowed, vital=True)
    tops = [lead for lead in leads if above[lead] == WORLD]
    kept = _kept_trees(compiled, tops, leads)
    leads = [lead for lead in leads if _top(above, lead) in kept]
    carriers = {_trunk(model, int(model.body_parentid[top])) for top in kept}
    fixed: tuple[int, ...] = ()
    if carriers != {WORLD}:
        still = np.flatnonzero(welds == WORLD)[1:].tolist()
        fixed = tuple(body for body in still if _trunk(model, body) in carriers - {WORLD})
    bodies = []
    root: int | None = None
    if len(kept) > 1 or fixed:
        root = min(fixed) if fixed and len(carriers) == 1 else WORLD
        bodies.append(Rigid(root, fixed, None, ()))
    for lead in leads:
        parent = int(above[lead])
        free = is_free(compiled, lead)
        first, count = int(model.body_jntadr[lead]), int(model.body_jntnum[lead])
        joints = () if free else tuple(range(first, first + count))
        ball = compiled.mujoco.mjtJoint.mjJNT_BALL
        balls = [joint for joint in joints if int(model.jnt_type[joint]) == ball]
        if count > 1 and balls:
            for joint in balls:
                compiled.item("joint", joint).refuse(
                    "it shares its body with other joints", "a ball joint alone in its body"
                )
            joints = tuple(joint for joint in joints if joint not in balls)
        carrier = root if parent == WORLD else parent
        bodies.append(Rigid(lead, tuple(welded[lead]), carrier, joints, free))
    return bodies


def is_free(compiled: Compiled, body: int) -> bool:
    """Return whether a body moves freely."""
    model = compiled.model
    first = int(model.body_jntadr[body])
    return first >= 0 and int(model.jnt_type[first]) == compiled.mujoco.mjtJoint.mjJNT_FREE


def scenery(compiled: Compiled, bodies: list[Rigid]) -> list[int]:
    """Return the numbers of the fixed geoms that are not part of the animal."""
    model = compiled.model
    own = {member for body in bodies for member in body.members}
    owners, welds = np.asarray(model.geom_bodyid), _welds(model)
    return [
        geom
        for geom in range(model.ngeom)
        if is_flat(compiled, geom) or (owners[geom] not in own and welds[owners[geom]] == WORLD)
    ]


def is_flat(compiled: Compiled, geom: int) -> bool:
    """Return whether a geom is a plane or a height field, which only fixed bodies have."""
    kinds = compiled.mujoco.mjtGeom
    return int(compiled.model.geom_type[geom]) in (kinds.mjGEOM_PLANE, kinds.mjGEOM_HFIELD)


def _welds(model: Any) -> np.ndarray:
    """Return the body that each body is welded to. A mocap body, refused elsewhere, is fixed."""
    welds = np.array(model.body_weldid)
    return np.where(np.asarray(model.body_mocapid)[welds] >= 0, WORLD, welds)


def _kept_trees(compiled: Compiled, tops: list[int], leads: list[int]) -> list[int]:
    """Return the tops of the trees that become the animal. Refuse trees beside a free one."""
    model, welds = compiled.model, _welds(compiled.model)
    free = [top for top in tops if is_free(compiled, top)]
    if len(tops) == 1 or not free:
        return tops
    above = welds[model.body_parentid]
    motors = dict.fromkeys(tops, 0)
    kinds, wraps = compiled.mujoco.mjtTrn, compiled.mujoco.mjtWrap
    for kind, (target, _) in zip(model.actuator_trntype, model.actuator_trnid, strict=True):
        joint = None
        # MuJoCo's enumerations equal integers of Python only.
        if int(kind) in (kinds.mjTRN_JOINT, kinds.mjTRN_JOINTINPARENT):
            joint = target
        elif int(kind) == kinds.mjTRN_TENDON:
            first = model.tendon_adr[target]
            if int(model.wrap_type[first]) == wraps.mjWRAP_JOINT:
                joint = model.wrap_objid[first]
        if joint is not None:
            motors[_top(above, int(welds[model.jnt_bodyid[joint]]))] += 1
    sizes = {top: sum(_top(above, lead) == top for lead in leads) for top in tops}
    best = max(tops, key=lambda top: (motors[top], sizes[top]))
    kept = [best] if best in free else [top for top in tops if top not in free]
    for top in tops:
        if top not in kept:
            problem = f"it moves beside {compiled.item('body', best)}"
            allowed = "one tree of bodies, or several that all hang on the world by joints"
            compiled.item("body", top).refuse(problem, allowed)
    return kept


def _top(above: np.ndarray, lead: int) -> int:
    """Return the lead of the tree of a moving body, given the lead ``above`` each body."""
    while above[lead] != WORLD:
        lead = int(above[lead])
    return lead


def _trunk(model: Any, body: int) -> int:
    """Return the ancestor of a fixed body that is in the worldbody."""
    while body != WORLD and model.body_parentid[body] != WORLD:
        body = int(model.body_parentid[body])
    return body
