"""The pose in which a creature rests: all forces on it vanish, and small pushes die away.

From the pose that it is given the creature goes downhill in its potential energy, as one would that
moves so slowly that its inertia does not matter, and whose feet do not slip while friction can hold
them. Each step is Newton's with the absolute values of the eigenvalues of the stiffness, so that it
goes down where the energy is curved downwards, too, and is halved until the energy has not begun to
rise again. `optimistix.fixed_point`, with the stiffness found
last, makes the last digits exact (the chord method). Where the stiffness has a negative
eigenvalue what was found is a saddle, such as a log of square section that floats on a flat
side: it is tipped a little that way, and goes on.

Motors hold the neutral angle. Those with a spring, and passive joints, give way under the load;
a motor without a spring would hold any angle, so its joint is kept where it is.

All is done in float64, and nothing of that is left behind.
"""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optimistix
from jaxtyping import Array, Float, Int

from evo_cpg.creature.tree import Tree
from evo_cpg.fusion.jax_internals import quick_jit
from evo_cpg.physics import root
from evo_cpg.physics.state import State, resting_state
from evo_cpg.physics.statics import (
    FrictionState,
    Touch,
    next_friction,
    radius_of_gyration,
    static_forces,
)
from evo_cpg.physics.world import World
from evo_cpg.simulation.plans import Programs, WorldPlan
from evo_cpg.simulation.situation import Situation
from evo_cpg.spatial.decisions import Undecidable, chosen, searched
from evo_cpg.spatial.numerics import is_traced
from evo_cpg.spatial.rotation import axis_rotation, integrate_quaternion, quaternion_to_matrix

# Steps downhill, and saddles that are left, before it is given up.
_STEPS, _SADDLES = 1000, 8

# Tries to find how far a step goes, and steps that make the last digits exact.
_HALVINGS, _CHORDS = 60, 100

# Times that the root is looked for anew because a foot has begun or ceased to slide.
_ROUNDS = 20

# Farthest step: of the root over ground and without, in radii of gyration; of angles, rad.
_FARTHEST_ON_GROUND, _FARTHEST, _LARGEST_TURN = 0.1, 10.0, 0.2

# Forces in units of the weight at which the search hands over, and which the root may leave.
_NEARLY, _EXACT = 1e-6, 1e-9

# Stiffnesses in units of weight over radius of gyration: a smaller one counts as none in a step,
# and a direction that is softer than minus the second one is unstable (it would double in a
# minute, for an animal of a metre).
_SOFTEST, _UNSTABLE = 1e-6, 1e-4

# Added to the stiffness of a step for the place in the plane and the heading, times the largest
# force: of all ways down it takes one that leads straight down.
_STAY = 10.0

# By which it is tipped at a saddle, rad.
_KICK = 0.02

# Of the root at most, rad: beyond it, an animal has fallen over and not settled.
_LARGEST_TILT = np.deg2rad(60.0)


class NoRestError(ValueError):
    """The creature does not come to rest."""


class Rest(NamedTuple):
    """A pose at rest.

    Attributes:
        state: the pose, in float64.
        normal_force: of the ground on every contact point, N.
        stiffness: eigenvalues of the stiffness in units of weight over radius of gyration, the
            smallest first; angles count by the radius of gyration.
        friction: what friction remembers there.
        give: how it gives way to forces in these units: the inverse of the stiffness, but for where
            there is none.
    """

    state: State
    normal_force: Float[np.ndarray, " p"]
    stiffness: Float[np.ndarray, " k"]
    friction: FrictionState
    give: Float[np.ndarray, "k k"]


class _Settled(NamedTuple):
    """Where a search for rest has ended.

    Attributes:
        state: the pose.
        friction: what friction remembers there.
        give: how all coordinates of the pose give way to forces on them, in m, rad, N and N m.
        start: x and y (m) and heading (rad) with which it was let down.
    """

    state: State
    friction: FrictionState
    give: Float[np.ndarray, "k k"]
    start: tuple[float, float, float]


class _Here(NamedTuple):
    """What holds in a pose.

    Attributes:
        force: on the coordinates that are searched, in units of the weight.
        total: on all, N and N m.
        touch: what the ground does.
        stiffness: the slope of ``force``, symmetric.
    """

    force: np.ndarray
    total: np.ndarray
    touch: Touch
    stiffness: np.ndarray


class Settling:
    """Finds the rest of one creature in one world; what it compiles serves all its starts.

    Args:
        world: the creature and its surroundings.
        h: step of the simulation, s.

    Raises:
        NoRestError: nothing can carry the creature, wherever it starts.
    """

    def __init__(self, world: World, h: float):
        _require_support(world)
        tree = world.tree
        self.world, self.h = world, h
        # Coordinates are scaled to lengths, forces to the creature's weight.
        self.free = np.flatnonzero(
            np.concatenate([np.ones(root.ROOT_DOFS, bool), _is_compliant(tree)])
        )
        self.size = radius_of_gyration(tree)
        # Without gravity nothing acts but springs that are at rest already.
        self.weight = float(tree.mass.sum() * abs(world.gravity)) or 1.0
        self.scale = np.where(self.free < root.LENGTHS, self.size, 1.0)
        self.stay = np.where(np.isin(self.free, root.SYMMETRIES), _STAY, 0.0)
        self.farthest = _FARTHEST if world.contact_model is None else _FARTHEST_ON_GROUND
        moment = self.weight * self.size
        search, numbers = _searches.of(world, self.free, h)
        given = numbers, self.scale, moment
        self._evaluate = functools.partial(search.evaluate, given)
        self._go = functools.partial(search.go, given)
        self._chord = functools.partial(search.chord, given)

    def settle(self, situation: Situation) -> "_Settled":
        """The pose in which the creature rests.

        Place and heading are kept, but for what an animal on uneven ground gives way.

        Args:
            situation: where it starts.

        Raises:
            NoRestError: it does not come to rest, or not as it stands.
        """
        with jax.enable_x64(True):
            start = resting_state(
                self.world.tree, (), jnp.float64, situation.start_position, situation.orientation
            )
            found = self.rest(start)
            scale = np.zeros((root.size_of(self.world.tree.dof_count), len(self.free)))
            scale[self.free, np.arange(len(self.free))] = self.scale
            give = scale @ found.give @ scale.T / (self.weight * self.size)
            friction = jax.tree.map(np.asarray, found.friction)
            state = jax.tree.map(np.asarray, found.state)
            return _Settled(
                state, friction, give, (*situation.start_position[:2], situation.start_heading)
            )

    def rest(self, start: State) -> Rest:
        """Where the creature comes to rest when it is let down slowly; under float64.

        Args:
            start: the pose that it begins with.

        Raises:
            NoRestError: it does not come to rest, or not as it stands.
        """
        state, friction = start, self._first_friction(start)
        for _ in range(_SADDLES):
            state, friction = self._root(state, friction)
            here = self._at(np.zeros(len(self.free)), state, friction)
            values, modes = np.linalg.eigh(here.stiffness)
            if values[0] > -_UNSTABLE:
                break
            direction = modes[:, 0] * np.sign(modes[np.abs(modes[:, 0]).argmax(), 0])
            state, friction = self._move(_KICK * direction, state, friction)
        else:
            raise NoRestError(f"it is balanced {_SADDLES} times, but never in a stable pose")
        self._require_hold(here.total)
        stiff = np.abs(values) > _SOFTEST
        give = (modes[:, stiff] / values[stiff]) @ modes[:, stiff].T
        if _is_alike_everywhere(self.world):
            state, friction = _put_back(start, state, friction)
        tilt = _tilt(start, state)
        if tilt > _LARGEST_TILT:
            raise NoRestError(
                f"it falls over: it would come to rest turned by {np.rad2deg(tilt):.0f} degrees"
            )
        return Rest(state, np.asarray(here.touch.normal_force), values, friction, give)

    def _at(self, y: np.ndarray, state: State, friction: FrictionState) -> _Here:
        """All about the pose with the coordinates y."""
        derivative, (force, total, touch) = self._evaluate(jnp.asarray(y), state, friction)
        derivative = np.asarray(derivative)
        return _Here(np.asarray(force), np.asarray(total), touch, -(derivative + derivative.T) / 2)

    def _first_friction(self, start: State) -> FrictionState:
        """Of an animal none of whose places has touched anything yet."""
        places = 0 if self.world.contact_model is None else len(self.world.contact_model.bodies)
        none, nothing = jnp.zeros((3, places)), jnp.zeros(places)
        touch = self._at(
            np.zeros(len(self.free)), start, FrictionState(none, none, none, nothing, none)
        ).touch
        return FrictionState(touch.point, touch.place, none, jnp.ones(places), none)

    def _move(
        self, y: np.ndarray, state: State, friction: FrictionState
    ) -> tuple[State, FrictionState]:
        """The pose with the coordinates y, and what friction remembers there."""
        return self._go(jnp.asarray(y), state, friction, self._at(y, state, friction).touch)

    def _root(self, state: State, friction: FrictionState) -> tuple[State, FrictionState]:
        """A pose without forces, downhill."""
        for _ in range(_ROUNDS):
            state, friction = self._polish(*self._descend(state, friction))
            here = self._at(np.zeros(len(self.free)), state, friction)
            if np.abs(here.force).max() < _EXACT:
                return state, friction
        raise NoRestError("its feet keep sliding: the forces do not come to balance")

    def _descend(self, state: State, friction: FrictionState) -> tuple[State, FrictionState]:
        """Downhill until hardly any force is left."""
        for _ in range(_STEPS):
            here = self._at(np.zeros(len(self.free)), state, friction)
            if not np.isfinite(here.force).all():
                break
            if np.abs(here.force).max() < _NEARLY:
                return state, friction
            values, modes = np.linalg.eigh(here.stiffness)
            # What is soft follows the force, no farther than the size of the creature.
            largest = np.abs(here.force).max()
            stiff = np.maximum(np.abs(values), largest)
            stay = np.diag(largest * self.stay)
            y = np.linalg.solve((modes * stiff) @ modes.T + stay, here.force)
            far = np.abs(y) / np.where(self.free < root.LENGTHS, self.farthest, _LARGEST_TURN)
            y = y / max(1.0, far.max())
            y = y * self._step_length(y, here, state, friction)
            state, friction = self._move(y, state, friction)
        raise NoRestError(f"it slides, rolls or drifts away: no rest within {_STEPS} steps")

    def _step_length(
        self, y: np.ndarray, here: _Here, state: State, friction: FrictionState
    ) -> float:
        """Of a step, at which the energy changes at most half as steeply as at first."""
        low, high, fraction, steepest = 0.0, 1.0, 1.0, 0.5 * float(here.force @ y)
        for _ in range(_HALVINGS):
            ahead = float(self._at(fraction * y, state, friction).force @ y)
            if ahead < -steepest:
                high = fraction
            elif ahead > steepest and fraction < 1.0:
                low = fraction
            else:
                break
            fraction = (low + high) / 2
        return fraction

    def _polish(self, state: State, friction: FrictionState) -> tuple[State, FrictionState]:
        """The root near by, as exactly as the numbers allow."""
        stiffness = self._at(np.zeros(len(self.free)), state, friction).stiffness
        values, modes = np.linalg.eigh(stiffness)
        values = np.where(values < 0, -1.0, 1.0) * np.maximum(np.abs(values), _SOFTEST)
        y = self._chord(state, friction, jnp.asarray((modes / values) @ modes.T))
        return self._move(np.asarray(y), state, friction)

    def _require_hold(self, total: np.ndarray) -> None:
        """Check that motors without a spring can hold their joints."""
        tree = self.world.tree
        torque = np.abs(total[root.JOINTS])
        for i in np.flatnonzero(~_is_compliant(tree) & (torque > tree.torque_limit)):
            raise NoRestError(
                f"the motor of {tree.dof_names[i]} would have to hold {torque[i]:.3g} N m, and its "
                f"torque_limit is {tree.torque_limit[i]:.3g} N m"
            )


class _Search:
    """The steps of a search for rest, compiled for all animals of a plan.

    Args:
        plan: of the animals.
        free: the coordinates that are searched.
        h: step of the simulation, s.
    """

    def __init__(self, plan: WorldPlan, free: Int[np.ndarray, " k"], h: float):
        def force(
            y: Array, given: tuple, base: State, friction: FrictionState
        ) -> tuple[Array, tuple[Array, Array, Touch]]:
            numbers, length, moment = given
            world = plan.world(numbers)
            x = jnp.zeros(root.size_of(world.tree.dof_count)).at[free].set(length * y)
            total, touch = static_forces(world, h, base, friction, x)
            scaled = total[free] * length / moment
            return scaled, (scaled, total, touch)

        def evaluate(given: tuple, y: Array, base: State, friction: FrictionState) -> tuple:
            return jax.jacfwd(force, has_aux=True)(y, given, base, friction)

        def go(
            given: tuple, y: Array, base: State, friction: FrictionState, touch: Touch
        ) -> tuple[State, FrictionState]:
            numbers, length, _ = given
            world = plan.world(numbers)
            if world.contact_model is not None:
                friction = next_friction(world.contact_model, h, friction, touch)
            x = jnp.zeros(root.size_of(world.tree.dof_count)).at[free].set(length * y)
            return base.displaced(x), friction

        def chord(given: tuple, base: State, friction: FrictionState, give: Array) -> Array:
            return optimistix.fixed_point(
                lambda y, _: y + give @ force(y, given, base, friction)[0],
                optimistix.FixedPointIteration(rtol=1e-13, atol=1e-13),
                jnp.zeros(len(free)),
                max_steps=_CHORDS,
                throw=False,
            ).value

        self.evaluate, self.go, self.chord = quick_jit(evaluate), quick_jit(go), quick_jit(chord)


_searches = Programs(_Search)


def settled(
    settling: Callable[[], Settling], world: World, h: float, situation: Situation
) -> Situation:
    """The same situation with the pose in which the creature rests.

    Where numbers are traced the search for the pose is not; from where it ended a step of Newton's
    follows them, with what friction remembers there (the implicit function theorem).

    Args:
        settling: finds the pose, from known numbers.
        world: the creature and its surroundings.
        h: step of the simulation, s.
        situation: where it starts.

    Raises:
        NoRestError: it does not come to rest, or not as it stands.
    """
    found = searched(lambda: settling().settle(situation), lambda _: _is_known(world, situation))
    alike_everywhere = chosen(lambda: _is_alike_everywhere(world))
    state = found.state
    if is_traced(world, situation):
        x, y, heading = found.start
        displacement = jnp.stack([situation.start_position[0] - x, situation.start_position[1] - y])
        base, friction = jax.tree.map(
            lambda leaf: jnp.asarray(leaf, displacement.dtype), (state, found.friction)
        )
        turn = jnp.asarray(situation.start_heading - heading, displacement.dtype)
        base, friction = _carried(base, friction, displacement, turn)
        still = jnp.zeros(len(found.give), displacement.dtype)
        force, _ = static_forces(world, h, base, friction, still)
        state = base.displaced(jnp.asarray(found.give, displacement.dtype) @ force)
        if alike_everywhere:
            state, _ = _put_back(base, state, friction)
    position, orientation, angles = (
        tuple(values if is_traced(values) else values.tolist())
        for values in (state.position, state.orientation, state.q)
    )
    return situation._replace(
        start_position=position, start_orientation=orientation, start_angles=angles
    )


def _is_known(*values: Any) -> bool:
    """Whether no number is traced: a step from another rest may end where no search would.

    Raises:
        Undecidable: one is.
    """
    if is_traced(values):
        raise Undecidable("the start is searched: start_pose is 'settled'")
    return True


def _is_compliant(tree: Tree) -> np.ndarray:
    """Degrees of freedom that have an angle of rest under a load."""
    return (tree.stiffness > 0) | (tree.servo_stiffness > 0) | (tree.servo_gain == 0)


def _require_support(world: World) -> None:
    """Check that something can carry the creature.

    Raises:
        NoRestError: nothing can.
    """
    tree, water = world.tree, world.water
    if not world.gravity or not all(law.of_water for law in world.forces):
        # A force law of the user's own may carry it.
        return
    if water is None:
        if world.contact_model is None:
            raise NoRestError("it falls: there is neither ground nor water to carry it")
        return
    own, displaced = float(tree.mass.sum()), water.density * float(tree.volume.sum())
    if abs(own - displaced) < _EXACT * own:
        return
    weights = f"its mass is {own:.6g} kg, and it displaces {displaced:.6g} kg of water at most"
    if own > displaced and world.contact_model is None:
        raise NoRestError(f"it sinks: {weights}, with no ground below")
    if own < displaced and water.surface is None:
        raise NoRestError(f"it rises for ever: {weights}, which has no surface")


def _is_alike_everywhere(world: World) -> bool:
    """Whether no place or heading is different from another one."""
    return world.ground is None or world.ground.level is not None


def _put_back(start: State, state: State, friction: FrictionState) -> tuple[State, FrictionState]:
    """To the place and heading of the start."""
    turn = _heading(start) - _heading(state)
    return _carried(state, friction, start.position[:2] - state.position[:2], turn)


def _carried(
    state: State, friction: FrictionState, displacement: Array, turn: Array
) -> tuple[State, FrictionState]:
    """A pose, and what friction remembers, elsewhere on level ground.

    Args:
        state: the pose.
        friction: what friction remembers.
        displacement: displacement in the plane ``(2,)``, m.
        turn: about the upright axis through the root's centre, rad.
    """
    about_z = jnp.stack([jnp.zeros_like(turn), jnp.zeros_like(turn), turn])
    rotation = axis_rotation(np.array([0.0, 0.0, 1.0]), jnp.sin(turn), jnp.cos(turn))
    position = state.position + jnp.concatenate([displacement, jnp.zeros_like(displacement[:1])])
    place = position[:, None] + rotation @ (friction.place - state.position[:, None])
    carried = dataclasses.replace(
        state,
        position=position,
        orientation=integrate_quaternion(state.orientation, about_z, 1.0),
    )
    turned = {name: rotation @ getattr(friction, name) for name in ("slip", "drag")}
    return carried, friction._replace(place=place, **turned)


def _heading(state: State) -> Array:
    """Of the root's x axis, rad."""
    ahead = quaternion_to_matrix(state.orientation)[:, 0]
    return jnp.arctan2(ahead[1], ahead[0])


def _tilt(start: State, state: State) -> float:
    """By which what was up at the start has turned away from it, rad."""
    before, after = (np.asarray(quaternion_to_matrix(s.orientation)) for s in (start, state))
    return float(np.arccos(np.clip((after @ before.T)[2, 2], -1.0, 1.0)))
