"""A drawn animal as a body plan, from which a search can start.

Each body becomes a box of its extents. Its long axis is the principal axis nearest to the direction
from its joint to its centre. The joint moves to the parent's surface. If the limb leaves that face
at more than 60 degrees, the joint moves to the face that the limb points away from. Joint axes
become the nearest allowed kind of joint. Two limbs that are mirror images become one part with
reflection, and equal limbs become one part.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from evo_cpg.creature.creature import Body, Creature, neutral_pose
from evo_cpg.creature.development import LEAST_TURN, PlanBounds, developed
from evo_cpg.creature.graph import JOINT_AXES, GraphLayout, PlanGraph
from evo_cpg.io.errors import KeyProblem

# Largest gene of a fraction, and of a signed fraction, in steps.
_MOST, _SIGNED = 255, 127
_KEY = ("creature",)


class _Part(NamedTuple):
    """A node, with the parts that grow on it. Genes are whole numbers of steps."""

    size: tuple[int, ...]
    kind: int
    limits: tuple[int, ...]
    links: "tuple[_Link, ...]"


class _Link(NamedTuple):
    """A connection. Genes are whole numbers of steps."""

    place: tuple[int, ...]
    turn: tuple[int, ...]
    part: _Part
    reflect: int = 0

    @property
    def image(self) -> "_Link":
        """Mirror image at the plane y = 0 of the parent."""
        (x, y, z), (yaw, pitch, roll) = self.place, self.turn
        images = tuple(link if link.reflect else link.image for link in self.part.links)
        part = self.part._replace(links=tuple(sorted(images)))
        return _Link((x, -y, z), (-yaw, pitch, -roll), part, self.reflect)


class _Frame(NamedTuple):
    """A body as a box: half extents (m), and axes in the body's frame and in the world."""

    half: np.ndarray
    own: np.ndarray
    axes: np.ndarray


def graph_of_creature(creature: Creature, layout: GraphLayout, bounds: PlanBounds) -> PlanGraph:
    """Return the plan of a creature. Its oscillators are those of genes 0.

    Args:
        creature: creature of bodies on joints that turn.
        layout: sizes of the graph.
        bounds: limits of all plans. Sizes and angles beyond them are cut.

    Raises:
        KeyProblem: the creature has a body that a plan cannot have, too many parts, or parts that
            would overlap.
    """
    for i, body in enumerate(creature.bodies):
        if problem := _problem(body):
            raise KeyProblem((*_KEY, "bodies", i), f"{body.name!r} {problem}, so it is no plan")
    root = creature.bodies[creature.root_index]
    parts = _listed(_part(creature, root, _frames(creature), layout, bounds))
    most = max(len(part.links) for part in parts)
    limits = ("parts", len(parts), layout.nodes), ("connections", most, layout.connections)
    for name, needed, allowed in limits:
        if needed > allowed:
            raise KeyProblem(
                _KEY, f"needs {needed} {name} as a plan. evolution.plan.{name} allows {allowed}"
            )
    graph = _graph(parts, layout)
    grown = int(jax.jit(lambda x: developed(x, layout, bounds).present.sum())(graph))
    if grown != len(creature.bodies):
        raise KeyProblem(
            _KEY,
            f"has {len(creature.bodies)} bodies, but its plan grows {grown}: the boxes around its "
            "bodies overlap, or evolution.plan.bodies is too small",
        )
    return graph


def _problem(body: Body) -> str:
    """Return why a plan cannot have a body, or nothing."""
    if not body.shape.exists:
        return "has no shape"
    if body.joint is not None and body.joint.kind not in ("turns", "ball"):
        return "has a joint that does not only turn"
    return ""


def _frames(creature: Creature) -> dict[str, _Frame]:
    """Return all bodies as boxes, with their long axis first."""
    found = {}
    for body, rotation in zip(creature.bodies, neutral_pose(creature)[1], strict=True):
        half = np.array([float(body.shape.support(axis)[i]) for i, axis in enumerate(np.eye(3))])
        axes = np.eye(3)
        if body.joint is not None:
            reach = -np.array(body.joint.child_anchor, float)
            along = int(np.argmax(np.abs(reach) if reach.any() else half))
            ahead = np.eye(3)[along] * (np.sign(reach[along]) or 1.0)
            _, y, z = np.eye(3)
            own = [ahead, y, np.cross(ahead, y)] if along == 2 else [ahead, np.cross(z, ahead), z]
            axes = np.stack(own, 1)
        turned = np.asarray(rotation, float) @ axes
        found[body.name] = _Frame(np.abs(axes.T) @ half, axes, turned)
    return found


def _part(
    creature: Creature,
    body: Body,
    frames: dict[str, _Frame],
    layout: GraphLayout,
    bounds: PlanBounds,
) -> _Part:
    """Return the part of a body, with all that grows on it."""
    own = frames[body.name]
    low, high = bounds.half
    sizes = np.round(256 * np.log(own.half / low) / math.log(high / low))
    links = []
    for child in creature.bodies:
        if child.joint is not None and child.joint.parent == body.name:
            part = _part(creature, child, frames, layout, bounds)
            links.append(_Link(*_joint(child, own, frames[child.name], bounds), part))
    kind, limits = _turns(body, own, layout, bounds)
    return _Part(_cut(sizes, 0, _MOST), kind, limits, _paired(links))


def _cut(steps: np.ndarray, low: int, high: int) -> tuple[int, ...]:
    return tuple(int(x) for x in np.clip(steps, low, high))


def _joint(
    child: Body, parent: _Frame, own: _Frame, bounds: PlanBounds
) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Return the place and the turns of a child on its parent."""
    assert child.joint is not None
    place = parent.own.T @ np.array(child.joint.parent_anchor, float) / parent.half
    place = place / (np.abs(place).max() or 1.0)
    relative = parent.axes.T @ own.axes
    face, away = int(np.abs(place).argmax()), relative[:, 0]
    if away[face] * np.sign(place[face]) < math.cos(bounds.turns[0]) - 1e-6:
        face = int(np.abs(away).argmax())
        place = np.clip(place, -(_SIGNED - 1) / 128, (_SIGNED - 1) / 128)
        place[face] = np.sign(away[face])
    x, y, z = np.where(np.arange(3) == face, np.sign(place), 0)
    frame = np.array([[x, -y, -z], [y, x + abs(z), 0], [z, 0, 1 - abs(z)]])
    turned = frame.T @ relative
    yaw, pitch = math.atan2(turned[1, 0], turned[0, 0]), -math.asin(np.clip(turned[2, 0], -1, 1))
    turns = np.array([yaw, pitch, math.atan2(turned[2, 1], turned[2, 2])]) / bounds.turns
    here, turn = (_cut(np.round(x * 128), -_SIGNED, _SIGNED) for x in (place, turns))
    return here, turn


def _turns(
    body: Body, own: _Frame, layout: GraphLayout, bounds: PlanBounds
) -> tuple[int, tuple[int, ...]]:
    """Return the kind of joint that shares most axes with a body's joint, and its limits."""
    turning, limits = np.zeros(3, bool), np.zeros(3)
    for dof in body.joint.dofs if body.joint else ():
        axis = int(np.abs(own.own.T @ np.array(dof.axis, float)).argmax())
        turning[axis] = True
        limits[axis] = max(abs(float(dof.lower)), abs(float(dof.upper)))
    kinds = np.array(layout.kinds)
    wrong = (JOINT_AXES[kinds] & ~turning).sum(1) + 2 * (~JOINT_AXES[kinds] & turning).sum(1)
    least = (limits / bounds.angles - LEAST_TURN) / (1 - LEAST_TURN)
    return int(kinds[wrong.argmin()]), _cut(np.round(256 * least), 0, _MOST)


def _paired(links: list[_Link]) -> tuple[_Link, ...]:
    """Return links in which mirror images are one link that reflects."""
    found, left = [], sorted(links, key=lambda link: -link.place[1])
    while left:
        link = left.pop(0)
        if link.place[1] > 0 and link.image in left:
            left.remove(link.image)
            link = link._replace(reflect=1)
        found.append(link)
    return tuple(sorted(found))


def _listed(root: _Part) -> list[_Part]:
    """Return all different parts, the root first."""
    found = [root]
    for part in found:
        found += [link.part for link in part.links if link.part not in found]
    return list(dict.fromkeys(found))


def _graph(parts: list[_Part], layout: GraphLayout) -> PlanGraph:
    """Return the graph of some parts, of which the first is the root."""
    genes = {name: np.zeros(shape) for name, shape in layout.shapes.items()}
    for i, part in enumerate(parts):
        genes["used"][i] = genes["recursion"][i] = 1
        genes["label"][i], genes["kind"][i], genes["strength"][i] = i + 1, part.kind, 0.5
        genes["size"][i], genes["limits"][i] = np.divide((part.size, part.limits), 256)
        for k, link in enumerate(part.links):
            genes["on"][i, k], genes["to"][i, k] = 1, parts.index(link.part)
            genes["place"][i, k], genes["turn"][i, k] = np.divide((link.place, link.turn), 128)
            genes["reflect"][i, k] = link.reflect
    return PlanGraph(**{name: jnp.asarray(value, float) for name, value in genes.items()})
