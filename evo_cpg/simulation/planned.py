"""Simulations of developed plans: any tree of boxes in one program.

`numbers_of` computes the numbers of one plan, once per individual. `PlanInputs.put` builds the
simulation from them inside the program of the trial. So nothing is compiled for a plan.

A plan's part is a box. Its joint lies a tenth inside the parent's surface and a tenth inside the
part (`SINK`), so that surfaces never coincide. An absent body has no mass, no surface and no
contact. An absent axis has an armature of 1 and no torque. Both change nothing, exactly.
"""

import abc
import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from typing_extensions import override

from evo_cpg.creature.algebra.decisions import recording_decisions, replaying_decisions
from evo_cpg.creature.algebra.numerics import MixedArray, xp
from evo_cpg.creature.creature import NO_LIMIT, Actuator, DegreeOfFreedom, Muscle
from evo_cpg.creature.development import Plan
from evo_cpg.creature.graph import GraphLayout
from evo_cpg.creature.laws import Muscles, laws_of
from evo_cpg.creature.self_collision import touching
from evo_cpg.creature.shapes import Box, Surface
from evo_cpg.creature.tree import LEAST_VOLUME, Group, Tree, spatial_inertia
from evo_cpg.creature.walk import TreeWalk, slot_count, walk_of
from evo_cpg.physics.contact.contact_model import STIFFNESS, ContactModel
from evo_cpg.physics.contact.pairs import KINDS, PAIR_STIFFNESS, Alike, Pairs
from evo_cpg.physics.water.fluid import Drag, make_patches
from evo_cpg.physics.water.force_law import ForceLaw
from evo_cpg.simulation.simulation import Rules, Simulation

_LAWS = ("armature", "lower", "upper", "servo_gain", "limit_stiffness", "limit_damping")
_MUSCLES = tuple(x.name for x in dataclasses.fields(Muscles) if x.name not in ("driven", "hill"))
# Random plans that show which numbers of a simulation vary, and digits to which they are equal.
_SAMPLES, _DIGITS = 3, 5

SINK = 0.9
"""Place of a joint between the centre and the surface, of the parent and of the part."""


@dataclasses.dataclass(frozen=True)
class PlanPhysics:
    """Physical settings that all plans have in common.

    Attributes:
        density: density of the parts, kg/m^3.
        motor_gain: gain of the strongest motors over the cross-section of the part and its half
            thickness, N m s/rad per m^3. A motor is as strong as the thinner of its two parts.
        muscle_area: cross-section of the strongest muscles on each side, as a fraction of that of
            the part, or None if motors move the joints.
        weakest: strength of the weakest motors or muscles, as a fraction of the strongest.
        form_resolution: see `evo_cpg.io.schema.world`.
        skin_resolution: see `evo_cpg.io.schema.world`.
        clearance: height of the lowest point at the start on ground, m.
        axes: axes (0 x, 1 y, 2 z) that any joint may have.
        meet: whether limbs must not pass through each other.
        eyes: whether only parts with an eye, and what hangs on them, sense the light.
    """

    density: float = 1000.0
    motor_gain: float = 2e4
    muscle_area: float | None = None
    weakest: float = 0.1
    form_resolution: int = 2
    skin_resolution: int = 1
    clearance: float = 0.0
    axes: tuple[int, ...] = (0, 1, 2)
    meet: bool = True
    eyes: bool = False

    def actuator(self, strength: Any, half: Any, size: Any) -> Actuator | Muscle:
        """Return the motor, or the muscles, about an axis of a joint.

        Args:
            strength: gene of the strength, 0 to 1.
            half: half extents of the part, m.
            size: cross-section times half thickness of the thinner of both parts, m^3.
        """
        strength = self.weakest + (1 - self.weakest) * strength
        if self.muscle_area is None:
            return Actuator(self.motor_gain * strength * size)
        arm = xp.minimum(half[1], half[2])
        return Muscle(self.muscle_area * strength * size / arm, arm, 2 * half[0])


def leverage(half: Any) -> Any:
    """Return the cross-sections times half thicknesses of parts, m^3, given half extents (m)."""
    return 4 * half[:, 1] * half[:, 2] * xp.minimum(half[:, 1], half[:, 2])


class PlanNumbers(NamedTuple):
    """Numbers of one plan, for ``b`` bodies with ``d`` joint axes.

    Attributes:
        half: half extents, m.
        reach: distance from the joint to the centre of each body, m.
        offset: joint in the working frame of the parent, m.
        orientation: rotation from body to parent in the neutral pose.
        mass: masses, kg.
        form: 1 for each point of form drag that no other body covers, else 0.
        skin: the same for skin friction.
        laws: numbers of the joints' laws, in the order of `_LAWS`, then of
            `_MUSCLES` if there are muscles.
        pairs: 1 for each two bodies that must not pass through each other, else 0.
        lowest: height of the lowest point in the neutral pose over the root's centre, m.
        length: largest extent in the neutral pose, m.
        sight: 1 for each body that senses the light, else 0. It is empty if all do.
        walk: parents of the bodies.
    """

    half: Float[Array, "3 b"]
    reach: Float[Array, " b"]
    offset: Float[Array, "3 b"]
    orientation: Float[Array, "3 3 b"]
    mass: Float[Array, " b"]
    form: Float[Array, "p b"]
    skin: Float[Array, "q b"]
    laws: Float[Array, "l d"]
    pairs: Float[Array, " k"]
    lowest: Float[Array, ""]
    length: Float[Array, ""]
    sight: Float[Array, " b"]
    walk: TreeWalk


class _Pose(NamedTuple):
    """Neutral pose: origins and centres ``(b, 3)``, m, and rotations ``(b, 3, 3)`` of bodies."""

    origin: Any
    centre: Any
    rotation: Any


def numbers_of(plan: Plan, physics: PlanPhysics) -> PlanNumbers:
    """Return the numbers of a developed plan.

    Args:
        plan: one plan.
        physics: settings in common.
    """
    count, present = len(plan.parent), plan.present
    parent = jnp.maximum(plan.parent, 0)
    reach = jnp.where(jnp.arange(count) > 0, SINK * plan.half[:, 0], 0.0)
    along = jnp.eye(3)[0]
    offset = SINK * plan.place + reach[parent][:, None] * along[None]
    offset = jnp.where((present & (plan.parent >= 0))[:, None], offset, 0.0)
    pose = _neutral_pose(plan, parent, offset, reach)
    mass = jnp.where(present, 8 * physics.density * plan.half.prod(1), 0.0)
    half = jnp.where(present[:, None], plan.half, 0.0)
    sign = jnp.stack([plan.mirror, jnp.ones(count), plan.mirror], 1)
    own = np.array(physics.axes)
    turns = jnp.where(plan.axes & present[:, None], sign, 0.0)[1:, own].reshape(-1)
    walk = walk_of(plan.parent, plan.slot, turns)
    inertia = _effective_inertia(pose, half, mass, walk, own)
    extent = (jnp.abs(pose.rotation) * half[:, None]).sum(-1)
    low, high = (
        jnp.where(present[:, None], side * (pose.centre + side * extent), -jnp.inf).max(0)
        for side in (-1, 1)
    )
    resolutions = physics.form_resolution, physics.skin_resolution
    form, skin = (_uncovered(half, pose, present, resolution) for resolution in resolutions)
    return PlanNumbers(
        half.T,
        reach,
        offset.T,
        jnp.moveaxis(plan.rotation, 0, -1),
        mass,
        form.T,
        skin.T,
        _laws(plan, parent, physics, inertia, walk),
        _separate(plan, half, pose) if physics.meet else half[:0, 0],
        -low[2],
        (low + high).max(),
        # A body senses the light if an eye is on it or on an ancestor.
        (walk.above * plan.eye[None]).max(1) if physics.eyes else half[:0, 0],
        walk,
    )


def _neutral_pose(
    plan: Plan, parent: Int[Array, " b"], offset: Float[Array, "b 3"], reach: Float[Array, " b"]
) -> _Pose:
    """Return the neutral pose, with the root's centre at the origin."""
    count = len(parent)

    def place(body: Array, placed: tuple[Array, Array]) -> tuple[Array, Array]:
        origin, rotation = placed
        frame = rotation[parent[body]]
        here = origin[parent[body]] + (frame * offset[body][None]).sum(1)
        turned = (frame[:, :, None] * plan.rotation[body][None]).sum(1)
        return origin.at[body].set(here), rotation.at[body].set(turned)

    start = jnp.zeros((count, 3), offset.dtype), jnp.tile(jnp.eye(3), (count, 1, 1))
    origin, rotation = jax.lax.fori_loop(1, count, place, start)
    return _Pose(origin, origin + rotation[:, :, 0] * reach[:, None], rotation)


def _effective_inertia(
    pose: _Pose,
    half: Float[Array, "b 3"],
    mass: Float[Array, " b"],
    walk: TreeWalk,
    axes: Int[np.ndarray, " k"],
) -> Float[Array, " d"]:
    """Return the effective inertia of each axis, as `evo_cpg.creature.tree` defines it."""
    body = np.repeat(np.arange(1, len(mass)), len(axes))
    axis = jnp.swapaxes(pose.rotation[1:][..., axes], 1, 2).reshape(-1, 3)
    square = half * half
    own = mass[:, None] / 3 * (square.sum(1)[:, None] - square)
    local = (axis[:, None, :, None] * pose.rotation[None]).sum(2)
    arm = jnp.cross(axis[:, None], pose.centre[None] - pose.origin[body][:, None])
    about = (local * local * own[None]).sum(-1) + mass[None] * (arm * arm).sum(-1)
    moved = walk.above.T[body] > 0
    outer, inner = jnp.where(moved, about, 0.0).sum(1), jnp.where(moved, 0.0, about).sum(1)
    return outer * inner / jnp.maximum(outer + inner, jnp.finfo(about.dtype).tiny)


def _laws(
    plan: Plan, parent: Int[Array, " b"], physics: PlanPhysics, inertia: Any, walk: TreeWalk
) -> Float[Array, "l d"]:
    """Return the laws of all axes. Strength follows the cross-section of the thinner part."""
    size = leverage(plan.half)
    size = jnp.minimum(size, size[parent])
    own, parts = np.array(physics.axes), range(1, len(size))
    motors = [physics.actuator(plan.strength[i], plan.half[i], size[i]) for i in parts]
    dofs = [
        DegreeOfFreedom(np.eye(3)[0], -limit, limit, 0.0, 0.0, 0.0, 0.0, 0.0, motor)
        for i, motor in zip(parts, motors, strict=True)
        for limit in plan.limit[i, own]
    ]
    found, here = laws_of(dofs, inertia), jnp.abs(walk.turns) > 0
    absent = {"armature": 1.0, "lower": -NO_LIMIT, "upper": NO_LIMIT, "curvature": 1.0}
    names = _LAWS
    if found["muscles"] is not None:
        names, found = _LAWS + _MUSCLES, found | vars(found["muscles"])
    return jnp.stack([jnp.where(here, found[name], absent.get(name, 0.0)) for name in names])


def _uncovered(
    half: Float[Array, "b 3"], pose: _Pose, present: Bool[Array, " b"], resolution: int
) -> Float[Array, "b p"]:
    """Return 1 for each surface point of each box that no other box covers, else 0.

    The joints lie inside both parts, so bodies shelter no other points
    (`evo_cpg.creature.surface`).
    """
    unit = Box((2.0, 2.0, 2.0)).surface(resolution)
    points = jnp.asarray(unit.points)[None] * half[:, None]
    world = pose.centre[:, None] + (pose.rotation[:, None] * points[:, :, None]).sum(-1)
    apart = world[:, :, None] - pose.centre[None, None]
    # Each point in the frame of each other body.
    local = (apart[..., None] * pose.rotation[None, None]).sum(-2)
    inside = (jnp.abs(local) <= half[None, None]).all(-1) & present[None, None]
    others = ~np.eye(len(half), dtype=bool)[:, None]
    return (~(inside & others).any(-1)).astype(half.dtype)


def _every_pair(count: int) -> Int[np.ndarray, "2 k"]:
    """Return all pairs of different bodies."""
    return np.stack(np.triu_indices(count, 1))


def _separate(plan: Plan, half: Any, pose: _Pose) -> Float[Array, " k"]:
    """Return 1 for each pair of bodies that must not pass through each other, else 0.

    The rule is that of a drawn animal (`evo_cpg.creature.self_collision`): bodies at a joint pass,
    and so do bodies that touch in the neutral pose.
    """
    first, second = every = _every_pair(len(half))
    joined = (plan.parent[second] == first) | (plan.parent[first] == second)
    ruled = plan.present[first] & plan.present[second] & ~joined
    passing = touching((pose.centre, pose.rotation, half), 0.0, every, ruled)
    return (ruled & ~passing).astype(half.dtype)


class PlanBuilder(abc.ABC):
    """Builder of the simulations of plans from their genes.

    Attributes:
        sizes: numbers of bodies of the programs, in increasing order.
        joins_vectors: whether a plan has the same result, to the last bit, in larger programs.
    """

    layout: GraphLayout
    sizes: tuple[int, ...]
    joins_vectors: bool

    @abc.abstractmethod
    def random(self, key: Array, batch: tuple[int, ...], dtype: Any) -> Float[Array, "g *n"]:
        """Return genes of random plans."""

    @abc.abstractmethod
    def inputs(self, size: int) -> "PlanInputs":
        """Return the inputs, and the common simulation, of the program for some bodies."""

    @abc.abstractmethod
    def developed(self, genes: Float[np.ndarray, "g n"]) -> tuple[Any, ...]:
        """Return arrays for `given`, the numbers of bodies ``(n,)`` first.

        Those of a plan do not depend on the other plans, to the last bit.
        """

    @abc.abstractmethod
    def given(
        self, found: tuple[Any, ...], individuals: Int[np.ndarray, " k"], size: int
    ) -> tuple[Float[np.ndarray, "c k"], Float[np.ndarray, "v k"]]:
        """Return the controller's genes and the inputs of some individuals, for one program."""

    @abc.abstractmethod
    def pulled_back(
        self, genes: Float[np.ndarray, "g n"], slopes: tuple[Any, ...]
    ) -> Float[np.ndarray, "g n"]:
        """Return derivatives by the genes, given those by the arrays of `developed` but the first.

        See `evo_cpg.creature.development`.
        """

    @abc.abstractmethod
    def own(self, genes: Float[np.ndarray, " g"]) -> Simulation:
        """Return the simulation of a plan's own creature, with all numbers known."""

    @abc.abstractmethod
    def frames_of(self, own: Simulation, frames: dict[str, Any]) -> dict[str, Any]:
        """Return recorded arrays of a plan in the layout of its own creature."""


class TreeInputs(abc.ABC):
    """Inputs of a program whose individuals have trees of their own, in place of `Inputs`.

    Attributes:
        common: a star whose parts may hang on any earlier part.
    """

    common: Simulation
    _like: Any
    _varying: "_Varying"

    def put(self, common: Simulation, values: list[Array]) -> Simulation:
        """Return the simulation of an individual. The values are its numbers, as one array."""
        return dataclasses.replace(common, **self._mixed(common, self._numbers(values)))

    @abc.abstractmethod
    def _parts(self, common: Simulation, numbers: Any) -> dict[str, Any]:
        """Return the parts of the simulation of an individual that differ from those of others."""

    def _numbers(self, values: list[Array]) -> Any:
        """Return the numbers of an individual, given as one array."""
        (flat,), (leaves, structure) = values, jax.tree.flatten(self._like)
        ends = np.cumsum([leaf.size for leaf in leaves])[:-1].tolist()
        parts = zip(jnp.split(flat, ends), leaves, strict=True)
        return structure.unflatten([x.reshape(leaf.shape) for x, leaf in parts])

    def _mixed(self, common: Simulation, numbers: Any) -> dict[str, Any]:
        """Return `_parts` with all elements known that never differ."""
        built, structure = jax.tree.flatten(self._parts(common, numbers))
        varying = self._varying
        flat = jnp.concatenate([jnp.ravel(built[place]) for place in varying.places])
        traced, start = flat[varying.first], 0
        for place, known in zip(varying.places, varying.known, strict=True):
            rows = slice(start, start := start + known.size)
            own = np.flatnonzero(varying.source[rows] >= 0)
            given = varying.source[rows][own], varying.sign[rows][own]
            built[place] = MixedArray(known, own, traced, *given)
        return jax.tree.unflatten(structure, built)

    def _find_varying(self) -> "_Varying":
        """Find which elements of a simulation differ between individuals, by some random numbers.

        Elements that are always equal, up to their sign, are computed once, because many surface
        points of a box have equal coordinates.
        """
        draw, places = np.random.default_rng(0), []

        def note_places(numbers: Any) -> None:
            leaves = jax.tree.leaves(self._parts(self.common, numbers))
            traced = (i for i, x in enumerate(leaves) if isinstance(x, jax.Array) and x.size)
            places.extend(traced)

        jax.eval_shape(note_places, self._like)
        found = []
        for _ in range(_SAMPLES):
            sample = jax.tree.map(lambda leaf: draw.uniform(0.5, 1.5, leaf.shape), self._like)
            found.append(jax.tree.leaves(self._parts(self.common, sample)))
        rows = np.stack([np.concatenate([np.ravel(x[i]) for i in places]) for x in found], -1)
        source, sign, first = _alike(rows)
        known = tuple(np.asarray(found[0][i], float) for i in places)
        return _Varying(tuple(places), known, source, sign, first)


class PlanInputs(TreeInputs):
    """Inputs of a program whose individuals are plans.

    Args:
        star: simulation of a root with ``b - 1`` parts on it, all boxes with the axes of the
            physics.
        physics: settings of the plans.
        rules: rules that disqualify a plan, as a function of its length (m), mass (kg) and pairs.
    """

    def __init__(
        self,
        star: Simulation,
        physics: PlanPhysics,
        rules: Callable[[Any, Any, Pairs | None], Rules],
    ):
        bodies = star.world.tree.body_count
        tree = with_walk(star.world.tree)
        self.physics, self._rules = physics, rules
        world = dataclasses.replace(star.world, tree=tree)
        self._pairs = _all_pairs(tree) if physics.meet else None
        if world.contact_model is not None:
            world = dataclasses.replace(world, pairs=self._pairs)
        self.common = dataclasses.replace(star, world=world)
        self._like = jax.eval_shape(lambda plan: numbers_of(plan, physics), _no_plan(bodies))
        known = jax.tree.map(lambda leaf: np.ones(leaf.shape), self._like)
        with recording_decisions() as self._decisions:
            self._forces(self.common, tree, known)
        self._varying = self._find_varying()

    @override
    def put(self, common: Simulation, values: list[Array]) -> Simulation:
        numbers = self._numbers(values)
        parts = self._mixed(common, numbers)
        rules, world = common.rules, parts["world"]
        task = common.task.of_length(numbers.length)
        if rules is not None:
            pairs = _pairs(self._pairs, world.tree, numbers)
            rules = self._rules(numbers.length, numbers.mass.sum(), pairs)
        return dataclasses.replace(common, rules=rules, task=task, **parts)

    @override
    def _parts(self, common: Simulation, numbers: PlanNumbers) -> dict[str, Any]:
        tree = _tree(common.world.tree, numbers)
        with replaying_decisions(self._decisions):
            forces = self._forces(common, tree, numbers)
        world = dataclasses.replace(common.world, tree=tree, forces=forces)
        situations = common.situations
        if world.contact_model is not None:
            contact = _contact_model(world.contact_model, tree, numbers)
            world = dataclasses.replace(
                world, contact_model=contact, pairs=_pairs(world.pairs, tree, numbers)
            )
            height = self.physics.clearance - numbers.lowest
            situations = tuple(
                each._replace(start_position=(*each.start_position[:2], height))
                for each in situations
            )
        seeing = {"sight": numbers.sight} if self.physics.eyes else {}
        controller = dataclasses.replace(common.controller, tree=tree, **seeing)
        return {"world": world, "controller": controller, "situations": situations}

    def _forces(self, common: Simulation, tree: Tree, numbers: PlanNumbers) -> tuple[ForceLaw, ...]:
        """Return the forces of the water on a plan."""
        found = []
        for law in common.world.forces:
            assert isinstance(law, Drag)
            form = _surfaces(tree, numbers.half, numbers.form, self.physics.form_resolution)
            skin = _surfaces(tree, numbers.half, numbers.skin, self.physics.skin_resolution)
            patches = make_patches(tree, form, skin, law.law, False, "complete")
            found.append(dataclasses.replace(law, patches=patches))
        return tuple(found)


class _Varying(NamedTuple):
    """Elements of a simulation that differ between individuals.

    Attributes:
        places: leaves with such elements.
        known: these leaves. Their other elements are known.
        source: number of the distinct element that each element of these leaves equals, in turn,
            or -1 for a known element.
        sign: sign of each element relative to the distinct element.
        first: an element that equals each distinct element.
    """

    places: tuple[int, ...]
    known: tuple[np.ndarray, ...]
    source: np.ndarray
    sign: np.ndarray
    first: np.ndarray


def _alike(rows: Float[np.ndarray, "e s"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return `_Varying.source`, ``sign`` and ``first`` of elements in some samples."""
    sign = np.where(rows[:, 0] < 0, -1, 1)
    unit = 10.0 ** np.floor(np.log10(np.maximum(np.abs(rows), np.finfo(np.float32).tiny)))
    size = sign[:, None] * np.round(rows / unit, _DIGITS) * unit
    constant = (size == size[:, :1]).all(1)
    varying = np.flatnonzero(~constant)
    _, first, inverse = np.unique(size[varying], axis=0, return_index=True, return_inverse=True)
    first, source = varying[first], np.full(len(rows), -1)
    source[varying] = inverse.ravel()
    return source, sign * sign[first[source]], first


def _no_plan(bodies: int) -> Plan:
    """Return a plan without bodies, for the shapes of its arrays."""
    none, flags, numbers = (jnp.zeros(bodies, kind) for kind in (float, bool, int))
    three = jnp.zeros((bodies, 3))
    return Plan(
        present=flags, parent=numbers, half=three, place=three, rotation=jnp.zeros((bodies, 3, 3)),
        mirror=none, axes=jnp.zeros((bodies, 3), bool), limit=three, strength=none, label=numbers,
        copy=numbers, eye=flags, control=jnp.zeros((bodies, 3, 1)), slot=numbers,
    )  # fmt: skip


def with_walk(tree: Tree) -> Tree:
    """Return a star in which each part may hang on any earlier part."""
    groups = [
        Group(slice(i, i + 1), slice(k * i - k, k * i), k, (0,), "some turns", group.kinds)
        for group in tree.groups
        for k in (group.axes,)
        for i in range(group.bodies.start, group.bodies.stop)
    ]
    count = tree.body_count
    slots, nobody = np.zeros((slot_count(count), count)), np.zeros(count)
    walk = TreeWalk(nobody, slots, slots, np.eye(count), np.zeros(tree.dof_count))
    return dataclasses.replace(tree, groups=tuple(groups), walk=walk)


def _tree(common: Tree, numbers: PlanNumbers) -> Tree:
    """Return the tree of a plan."""
    size, none = 2 * numbers.half, xp.zeros_like(numbers.reach)
    com: Any = xp.stack([numbers.reach, none, none])
    each = range(common.body_count)
    inertias = [
        spatial_inertia(mass, com[:, i], Box(tuple(size[:, i])).inertia(mass))
        for i, mass in zip(each, numbers.mass, strict=True)
    ]
    volume = xp.maximum(size.prod(0), LEAST_VOLUME)
    muscles, (laws, active) = common.muscles, xp.split(numbers.laws, [len(_LAWS)])
    if muscles is not None:
        muscles = dataclasses.replace(muscles, **dict(zip(_MUSCLES, active, strict=True)))
    return dataclasses.replace(
        common,
        muscles=muscles,
        joint_offset=numbers.offset,
        joint_orientation=numbers.orientation,
        mass=numbers.mass,
        volume=volume,
        com=com,
        inertia=xp.stack(inertias, -1),
        walk=numbers.walk,
        **dict(zip(_LAWS, laws, strict=True)),
    )


def _contact_model(model: ContactModel, tree: Tree, numbers: PlanNumbers) -> ContactModel:
    """Return the contact points of a plan. Those of absent bodies have no stiffness."""
    stiffness = STIFFNESS * _root(tree.mass.sum() * tree.mass[np.array(model.bodies)])
    return model._replace(boxes=numbers.half, centre=tree.com, stiffness=stiffness)


def _all_pairs(tree: Tree) -> Pairs:
    """Return all pairs of bodies, as boxes."""
    first, second = _every_pair(tree.body_count).tolist()
    plain, none = (0, 1, 2), np.zeros((3, tree.body_count))
    run = Alike("boxes", (plain, plain), len(first))
    stiffness = np.zeros(len(first) * KINDS[run.kind][1])
    return Pairs(tuple(first), tuple(second), (run,), none, none, none[0], stiffness)


def _pairs(common: Pairs | None, tree: Tree, numbers: PlanNumbers) -> Pairs | None:
    """Return the pairs of a plan. Those that may pass have no stiffness."""
    if common is None:
        return None
    one, two = (tree.mass[np.array(each)] for each in _every_pair(tree.body_count))
    stiffness = PAIR_STIFFNESS * _root(one * two) * numbers.pairs
    points = len(common.stiffness) // len(common.first)
    return dataclasses.replace(
        common, centre=tree.com, half_extents=numbers.half, stiffness=xp.tile(stiffness, points)
    )


def _root(squares: Any) -> Any:
    """Return square roots, with the derivative 0 at 0."""
    positive = squares > 0
    return xp.where(positive, xp.sqrt(xp.where(positive, squares, 1.0)), 0.0)


def _surfaces(
    tree: Tree, half: Float[Any, "3 b"], uncovered: Float[Any, "p b"], resolution: int
) -> dict[str, Surface]:
    """Return the uncovered surface of each body by name, with no area where it is covered."""
    found = {}
    for i, name in enumerate(tree.names):
        whole = Box(tuple(2 * half[:, i])).surface(resolution)
        found[name] = whole._replace(areas=whole.areas * uncovered[:, i])
    return found
