"""Find the pose in which a creature rests: no net forces, and stable against small pushes.

1. *Fall.* The creature moves by the steps of the simulation, strongly damped, until it is quiet.
   The simulation therefore decides where feet land, slip and stick.
2. *Balance.* The quiet pose is nearly in balance. Newton steps with the absolute eigenvalues of the
   stiffness go downhill in potential energy to the exact pose, so that the result does not depend
   on rounding. Friction has a potential only while its cones are fixed, so each round of steps
   keeps the cones of the last one.
3. *Saddles.* A negative eigenvalue of the stiffness marks a saddle, such as a square log that
   floats on a flat side. Tip the creature in that direction and balance again.
4. *Release.* Without damping, the creature has to stay in the pose for a second, except for the
   creep of contact. If it does not stay, or if there is no balance nearby, the fall continues. All
   falls together last 20 s at most, and longer for an animal that is nearly neutral in water.

A root that hangs on the world moves only by its own joint.

Motors hold the neutral angle. Passive joints and motors with a spring yield under the load. A motor
without a spring would hold any angle, so its joint stays fixed.

All is computed in float64. The caller's JAX settings do not change.
"""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from evo_cpg.creature.algebra.decisions import Undecidable, chosen, searched
from evo_cpg.creature.algebra.numerics import is_traced
from evo_cpg.creature.algebra.rotation import (
    axis_rotation,
    integrate_quaternion,
    quaternion_to_matrix,
)
from evo_cpg.creature.tree import Tree
from evo_cpg.native.jax_internals import quick_jit
from evo_cpg.physics.contact.contact import BAUMGARTE_FRACTION
from evo_cpg.physics.contact.contact_model import STIFFNESS
from evo_cpg.physics.step.statics import FrictionState, Touch, radius_of_gyration, static_forces
from evo_cpg.physics.step.step import first_warmstart, step
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree import root
from evo_cpg.physics.tree.hanging import Base
from evo_cpg.physics.tree.state import State, resting_state
from evo_cpg.physics.water.water import Current
from evo_cpg.simulation.plans import Programs, WorldPlan
from evo_cpg.simulation.situation import Situation

# Longest time of the fall, and its shortest time before the first balance, which doubles after
# each failure, s. Number of quiet steps before a balance.
_SECONDS, _PAUSE, _QUIET_STEPS = 20.0, 0.25, 30

# Least force at the start, in units of the weight, that scales the fall. A nearly neutral animal
# sinks slowly, so its fall takes longer and is damped less.
_LIGHTEST = 0.02

# Damping of the fall in units of sqrt(g / r), with the radius of gyration r. It is beyond critical,
# so that the creature is let down and not thrown.
_DAMPING = 4.0

# Speed below which a creature is quiet, in units of sqrt(g r). In addition, it may creep on a slope
# at up to ``g h / STIFFNESS`` (`evo_cpg.physics.contact.contact`).
_QUIET = 0.8e-3

# Time after the release in which the creature has to stay, s.
_RELEASE = 1.0

# Damping of a joint that stays fixed during the fall, in units of m r^2 sqrt(g / r).
_LOCK = 1e9

# Largest number of steps of a descent, which begins near the balance. Largest number of poses of
# balance that a search tries, because each may be a saddle.
_STEPS, _SADDLES = 50, 8

# Largest number of step lengths tried for one descent step.
_HALVINGS = 20

# Largest number of descents to one pose of balance. Each keeps the friction cones of the last one.
_ROUNDS = 50

# Largest displacement of the root in one step, with ground and without ground, in radii of
# gyration. Largest change of an angle in one step, rad.
_FARTHEST_ON_GROUND, _FARTHEST, _LARGEST_TURN = 0.1, 10.0, 0.2

# Largest force in the solution, in units of the weight.
_EXACT = 1e-9

# Stiffnesses in units of weight over radius of gyration. Sizes below the first count as zero. A
# direction with a stiffness below minus the second is unstable: with an animal of 1 m, a deviation
# would double in a minute.
_SOFTEST, _UNSTABLE = 1e-6, 1e-4

# Stiffness added in a descent step for horizontal place and heading, in units of the largest force.
# Among equally good steps it selects the one that keeps place and heading.
_STAY = 10.0

# Displacement from a saddle: norm of angles (rad) and lengths (radii of gyration).
_KICK = 0.02

# Largest tilt of the root, rad. An animal has fallen over at larger tilts.
_LARGEST_TILT = np.deg2rad(60.0)


class NoRestError(ValueError):
    """Raised if the creature has no valid pose of rest."""


class Rest(NamedTuple):
    """A pose in which a creature rests.

    Attributes:
        state: the pose, in float64.
        normal_force: force of the ground on every contact point, N.
        stiffness: eigenvalues of the stiffness in units of weight over radius of gyration, the
            smallest first. Angles are scaled by the radius of gyration.
        friction: state of friction in the pose.
        give: compliance in these units: inverse of the stiffness, 0 in directions without
            stiffness.
    """

    state: State
    normal_force: Float[np.ndarray, " p"]
    stiffness: Float[np.ndarray, " k"]
    friction: FrictionState
    give: Float[np.ndarray, "k k"]


class _Settled(NamedTuple):
    """Result of a search for rest.

    Attributes:
        state: the pose.
        friction: state of friction in the pose.
        give: compliance of all coordinates of the pose, in m, rad, N and N m.
        start: initial x and y (m) and heading (rad).
    """

    state: State
    friction: FrictionState
    give: Float[np.ndarray, "k k"]
    start: tuple[float, float, float]


class _Here(NamedTuple):
    """Forces and stiffness in a pose.

    Attributes:
        force: force on the free coordinates, in units of the weight.
        total: force on all coordinates, N and N m.
        touch: contact with the ground.
        stiffness: symmetric part of the negative derivative of ``force``.
    """

    force: np.ndarray
    total: np.ndarray
    touch: Touch
    stiffness: np.ndarray


class Settling:
    """Solver for the resting pose of one creature in one world, from any initial pose.

    Args:
        world: the creature and its environment.
        h: step of the simulation, s.

    Raises:
        NoRestError: nothing can carry the creature, whatever its initial pose.
    """

    def __init__(self, world: World, h: float):
        tree, water = world.tree, world.water
        # The joint of a root that hangs may carry the creature, and so may a user's force law.
        carried = tree.hanging is not None or not all(law.of_water for law in world.forces)
        if world.gravity and not carried:
            if water is None and world.contact_model is None:
                raise NoRestError("it falls, because there is neither ground nor water to carry it")
            own = float(tree.mass.sum())
            displaced = own if water is None else water.density * float(tree.volume.sum())
            weights = (
                f"its mass is {own:.6g} kg, and it displaces at most {displaced:.6g} kg of water"
            )
            if water is not None and abs(own - displaced) >= _EXACT * own:
                if own > displaced and world.contact_model is None:
                    raise NoRestError(f"it sinks, because there is no ground ({weights})")
                if own < displaced and water.surface is None:
                    raise NoRestError(f"it rises, because the water has no surface ({weights})")
        self.world, self.h = world, h
        # Coordinates y are lengths in radii of gyration, and angles in rad. Forces are in units of
        # the weight, and moments in units of the weight times the radius of gyration.
        floats = np.full(root.ROOT_DOFS, tree.hanging is None)
        self.free = np.flatnonzero(np.concatenate([floats, _is_compliant(tree)]))
        self.size = radius_of_gyration(tree)
        # If there is no gravity, forces keep their unit, N. Only springs act then, and they are at
        # rest already.
        self.weight = float(tree.mass.sum() * abs(world.gravity)) or 1.0
        self.scale = np.where(self.free < root.LENGTHS, self.size, 1.0)
        self.stay = np.where(np.isin(self.free, root.SYMMETRIES), _STAY, 0.0)
        self.farthest = _FARTHEST if world.contact_model is None else _FARTHEST_ON_GROUND
        moment = self.weight * self.size
        # Without gravity only springs move the creature. The scale of time is then arbitrary.
        gravity = abs(world.gravity) or 9.81
        frequency = np.sqrt(gravity / self.size)
        self.quiet = _QUIET * self.size * frequency + gravity * h / STIFFNESS
        self.frequency = frequency
        lock = _LOCK * tree.mass.sum() * self.size**2 * frequency
        still = world
        if water is not None:
            # A current would carry the creature away.
            water = dataclasses.replace(water, streams=(Current(),))
            still = dataclasses.replace(world, water=water)
        search, numbers = _searches.of(still, self.free, h)
        given = numbers, self.scale, moment
        self._fall = functools.partial(search.fall, numbers, (lock, self.size, self.quiet))
        self._evaluate = functools.partial(search.evaluate, given)
        self._go = functools.partial(search.go, given)

    def settle(self, situation: Situation) -> "_Settled":
        """Return the pose in which the creature rests.

        Place and heading stay as in the situation. On uneven ground they may change.

        Raises:
            NoRestError: the creature finds no rest, or falls over.
        """
        with jax.enable_x64(True):
            start = resting_state(
                self.world.tree, (), jnp.float64, situation.start_position, situation.orientation
            )
            found = self.rest(start)
            scale = np.zeros((root.ROOT_DOFS + self.world.tree.dof_count, len(self.free)))
            scale[self.free, np.arange(len(self.free))] = self.scale
            give = scale @ found.give @ scale.T / (self.weight * self.size)
            friction = jax.tree.map(np.asarray, found.friction)
            state = jax.tree.map(np.asarray, found.state)
            return _Settled(
                state, friction, give, (*situation.start_position[:2], situation.start_heading)
            )

    def rest(self, start: State) -> Rest:
        """Return the resting pose after a slow release. Call it with float64 enabled.

        Raises:
            NoRestError: the creature finds no rest, or falls over.
        """
        pull = 1.0
        if self.world.tree.hanging is None:
            here = self._at(np.zeros(len(self.free)), start, self._friction(start))
            force = np.linalg.norm(here.total[: root.LENGTHS]) / self.weight
            pull = np.sqrt(np.clip(force, _LIGHTEST, 1.0))
        slower, seconds = np.exp(-_DAMPING * pull * self.frequency * self.h), _SECONDS / pull
        state, left, pause = start, round(seconds / self.h), round(_PAUSE / self.h)
        while left > 0:
            state, taken = self._fall(state, slower, min(pause, left), left)
            left, pause = left - int(taken), 2 * pause
            if not np.isfinite(state.position).all():
                raise NoRestError(f"its fall diverges with physics steps of {self.h:.2g} s")
            self._require_upright(start, state)
            found = self._balanced(state)
            if found is None:
                continue
            # Without damping, the creature has to stay in the pose.
            steps = round(_RELEASE / self.h)
            later, _ = self._fall(found.state, 1.0, steps, steps)
            drift = np.linalg.norm(later.position - found.state.position)
            if drift < self.quiet * _RELEASE:
                self._require_upright(start, found.state)
                ground = self.world.ground
                # Without ground or on level ground, all places and headings are equivalent.
                alike = ground is None or ground.level is not None
                if self.world.tree.hanging is None and alike:
                    state, friction = _put_back(start, found.state, found.friction)
                    # Its coordinates have the world's axes, so the compliance turns, too.
                    here = self._at(np.zeros(len(self.free)), state, friction)
                    give = _compliance(here.stiffness)
                    found = found._replace(state=state, friction=friction, give=give)
                return found
        raise NoRestError(f"it slides, rolls or drifts away (no rest within {seconds:.3g} s)")

    def _balanced(self, state: State) -> Rest | None:
        """Return the stable balance near a quiet pose, or None if there is none."""
        friction = self._friction(state)
        state = dataclasses.replace(
            state, velocity=jnp.zeros_like(state.velocity), qd=jnp.zeros_like(state.qd)
        )
        for _ in range(_SADDLES):
            found = self._root(state, friction)
            if found is None:
                return None
            state, friction = found
            here = self._at(np.zeros(len(self.free)), state, friction)
            values, modes = np.linalg.eigh(here.stiffness)
            if values.min(initial=0.0) > -_UNSTABLE:
                tree, torque = self.world.tree, np.abs(here.total[root.JOINTS])
                # Motors without a spring have to hold their joints.
                for i in np.flatnonzero(~_is_compliant(tree) & (torque > tree.torque_limit)):
                    raise NoRestError(
                        f"the motor of {tree.dof_names[i]} would have to hold {torque[i]:.3g} N m, "
                        f"but its torque_limit is {tree.torque_limit[i]:.3g} N m"
                    )
                give = _compliance(here.stiffness)
                return Rest(state, np.asarray(here.touch.normal_force), values, friction, give)
            direction = modes[:, 0] * np.sign(modes[np.abs(modes[:, 0]).argmax(), 0])
            y = _KICK * direction
            touch = self._at(y, state, friction).touch
            state, friction = self._go(jnp.asarray(y), state, friction, touch)
        return None

    def _at(self, y: np.ndarray, state: State, friction: FrictionState) -> _Here:
        """Return forces and stiffness in the pose with the coordinates y."""
        derivative, (force, total, touch) = self._evaluate(jnp.asarray(y), state, friction)
        stiffness = -np.asarray(derivative + derivative.T) / 2
        return _Here(np.asarray(force), np.asarray(total), touch, stiffness)

    def _friction(self, state: State) -> FrictionState:
        """Return the friction in a quiet pose, computed from the creep of the contact points."""
        places = 0 if self.world.contact_model is None else len(self.world.contact_model.bodies)
        none, x = jnp.zeros((3, places)), np.zeros(len(self.free))
        touch = self._at(x, state, FrictionState(none, none, none, none[0])).touch
        friction = FrictionState(touch.point, touch.place, none, touch.limit)
        # The slip whose force is that of the present speed.
        later = state.moved(self.world.tree, self.h / BAUMGARTE_FRACTION)
        slip = self._at(x, later, friction).touch.slip
        return friction._replace(slip=jnp.where(touch.normal_force > 0, slip, 0.0))

    def _root(self, state: State, friction: FrictionState) -> tuple[State, FrictionState] | None:
        """Search downhill for a pose in which all forces balance, with friction within its cone."""
        for round_ in range(_ROUNDS):
            for _ in range(_STEPS):
                here = self._at(np.zeros(len(self.free)), state, friction)
                largest = np.abs(here.force).max(initial=0.0)
                if largest < _EXACT:
                    break
                if not np.isfinite(largest):
                    return None
                values, modes = np.linalg.eigh(here.stiffness)
                # Directions with little stiffness follow the force, at most by the radius of
                # gyration.
                stiff = np.maximum(np.abs(values), largest)
                stay = np.diag(largest * self.stay)
                y = np.linalg.solve((modes * stiff) @ modes.T + stay, here.force)
                far = np.abs(y) / np.where(self.free < root.LENGTHS, self.farthest, _LARGEST_TURN)
                y = y / max(1.0, far.max())
                y = y * self._step_length(y, here, state, friction)
                touch = self._at(y, state, friction).touch
                state, friction = self._go(jnp.asarray(y), state, friction, touch)
            else:
                return None
            touch = self._at(np.zeros(len(self.free)), state, friction).touch
            # Later rounds take the mean of old and new cones. Otherwise the search may alternate
            # between two poses.
            older = 0.0 if round_ < _ROUNDS // 5 else 0.5
            limit = older * friction.limit + (1 - older) * touch.limit
            friction = friction._replace(limit=limit)
            here = self._at(np.zeros(len(self.free)), state, friction)
            if np.abs(here.force).max(initial=0.0) < _EXACT:
                return state, friction
        return None

    def _step_length(
        self, y: np.ndarray, here: _Here, state: State, friction: FrictionState
    ) -> float:
        """Return the fraction of the step y at which the slope of the energy is halved.

        The slope along y is then at most half as steep, in either direction, as at the start.
        """
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

    def _require_upright(self, start: State, state: State) -> None:
        """Check that the creature has not fallen over."""
        # Angle between the vertical and the initially vertical axis of the root.
        before, after = (np.asarray(quaternion_to_matrix(s.orientation)) for s in (start, state))
        tilt = float(np.arccos(np.clip((after @ before.T)[2, 2], -1.0, 1.0)))
        if tilt > _LARGEST_TILT:
            raise NoRestError(f"it falls over (its tilt reaches {np.rad2deg(tilt):.0f} degrees)")


class _Search:
    """Steps of a search for rest, compiled for all animals of a plan.

    The arguments of the fall are numbers of the world, a scale (the damping of fixed joints, the
    radius of gyration and the quiet speed), the state, the factor by which each step slows the
    motion, and the least and largest number of steps. The fall returns the state and the number of
    its steps. The velocity in this state is the mean of the last steps, because a foot may chatter
    on an edge.

    Args:
        plan: plan of the animals.
        free: indices of the free coordinates.
        h: step of the simulation, s.
    """

    def __init__(self, plan: WorldPlan, free: Int[np.ndarray, " k"], h: float):
        def fall(
            numbers: list, scale: tuple, state: State, slower: float, least: int, most: int
        ) -> tuple[State, int | Array]:
            world, (lock, radius, quiet_speed) = plan.world(numbers), scale
            tree = world.tree
            fixed = ~np.isin(np.arange(tree.dof_count), free - root.ROOT_DOFS)
            tree = dataclasses.replace(tree, damping=jnp.where(fixed, lock, tree.damping))
            world = dataclasses.replace(world, tree=tree)

            def advance(carry: tuple) -> tuple:
                state, warmstart, mean, index, quiet = carry
                state, effort = step(world, state, jnp.zeros_like(state.q), h, warmstart)
                velocity = jnp.concatenate([state.velocity, state.qd])
                mean = mean + (velocity - mean) / _QUIET_STEPS
                is_quiet = jnp.abs(length * mean).max() < quiet_speed
                state = dataclasses.replace(
                    state, velocity=slower * state.velocity, qd=slower * state.qd
                )
                return state, effort.warmstart, mean, index + 1, jnp.where(is_quiet, quiet + 1, 0)

            def goes_on(carry: tuple) -> Array:
                state, _, _, index, quiet = carry
                moves = (quiet < _QUIET_STEPS) | (index < least)
                return (index < most) & moves & jnp.isfinite(state.position).all()

            mean = jnp.zeros(root.ROOT_DOFS + tree.dof_count)
            length = jnp.full_like(mean, radius).at[root.LENGTHS : root.ROOT_DOFS].set(1.0)
            start = state, first_warmstart(world, (), state.q.dtype), mean, 0, 0
            state, _, mean, taken, _ = jax.lax.while_loop(goes_on, advance, start)
            qd = jnp.where(fixed, 0.0, mean[root.JOINTS])
            q = jnp.where(fixed, 0.0, state.q)
            state = dataclasses.replace(state, velocity=mean[root.ROOT], q=q, qd=qd)
            return state.placed(tree), taken

        def force(
            given: tuple, y: Array, base: State, friction: FrictionState
        ) -> tuple[Array, tuple[Array, Array, Touch]]:
            numbers, length, moment = given
            world = plan.world(numbers)
            x = jnp.zeros(root.ROOT_DOFS + world.tree.dof_count).at[free].set(length * y)
            total, touch = static_forces(world, h, base, friction, x)
            scaled = total[free] * length / moment
            return scaled, (scaled, total, touch)

        def go(
            given: tuple, y: Array, base: State, friction: FrictionState, touch: Touch
        ) -> tuple[State, FrictionState]:
            numbers, length, _ = given
            world = plan.world(numbers)
            if world.contact_model is not None:
                slip = jnp.where(touch.normal_force > 0, touch.slip, 0.0)
                friction = FrictionState(touch.point, touch.place, slip, friction.limit)
            x = jnp.zeros(root.ROOT_DOFS + world.tree.dof_count).at[free].set(length * y)
            return base.displaced(world.tree, x), friction

        self.fall, self.go = quick_jit(fall), quick_jit(go)
        self.evaluate = quick_jit(jax.jacfwd(force, argnums=1, has_aux=True))


_searches = Programs(_Search)


def settled(
    settling: Callable[[], Settling], world: World, h: float, situation: Situation
) -> Situation:
    """Return the situation with the pose in which the creature rests.

    The search itself is not traced. Traced numbers get one Newton step from its result, with the
    state of friction found there (the implicit function theorem).

    Args:
        settling: solver that finds the pose, from known numbers.
        world: the creature and its environment.
        h: step of the simulation, s.
        situation: initial pose of the creature.

    Raises:
        NoRestError: the creature finds no rest, or falls over.
    """

    def known(_: Any) -> bool:
        # With a traced number the search might end in another pose.
        if is_traced((world, situation)):
            raise Undecidable("the start is searched: start_pose is 'settled'")
        return True

    found = searched(lambda: settling().settle(situation), known)
    ground = world.ground
    alike_everywhere = chosen(lambda: ground is None or ground.level is not None)
    state = found.state
    if is_traced(world, situation):
        x, y, heading = found.start
        displacement = jnp.stack([situation.start_position[0] - x, situation.start_position[1] - y])
        base, friction = jax.tree.map(
            lambda leaf: jnp.asarray(leaf, displacement.dtype), (state, found.friction)
        )
        turn = jnp.asarray(situation.start_heading - heading, displacement.dtype)
        if base.base is None:
            base, friction = _carried(base, friction, displacement, turn)
        else:
            moved = jax.tree.map(
                lambda leaf: jnp.asarray(leaf, displacement.dtype),
                Base(jnp.array(situation.start_position), jnp.array(situation.orientation)),
            )
            base = dataclasses.replace(base, base=moved).placed(world.tree)
        still = jnp.zeros(len(found.give), displacement.dtype)
        force, _ = static_forces(world, h, base, friction, still)
        state = base.displaced(world.tree, jnp.asarray(found.give, displacement.dtype) @ force)
        if alike_everywhere and world.tree.hanging is None:
            state, _ = _put_back(base, state, friction)
    position, orientation, angles = (
        tuple(values if is_traced(values) else values.tolist())
        for values in (state.position, state.orientation, state.q)
    )
    if world.tree.hanging is not None:
        return situation._replace(start_angles=angles)
    return situation._replace(
        start_position=position, start_orientation=orientation, start_angles=angles
    )


def _is_compliant(tree: Tree) -> np.ndarray:
    """Return which degrees of freedom yield to a load: joints with a spring or without a motor."""
    return (tree.stiffness > 0) | (tree.servo_stiffness > 0) | (tree.servo_gain == 0)


def _compliance(stiffness: Float[np.ndarray, "k k"]) -> Float[np.ndarray, "k k"]:
    """Return the inverse of a stiffness, 0 in directions without stiffness."""
    values, modes = np.linalg.eigh(stiffness)
    stiff = np.abs(values) > _SOFTEST
    return (modes[:, stiff] / values[stiff]) @ modes[:, stiff].T


def _put_back(start: State, state: State, friction: FrictionState) -> tuple[State, FrictionState]:
    """Move the pose back to the initial place and heading."""
    ahead = [quaternion_to_matrix(each.orientation)[:, 0] for each in (start, state)]
    before, after = (jnp.arctan2(y, x) for x, y, _ in ahead)
    turn = before - after
    return _carried(state, friction, start.position[:2] - state.position[:2], turn)


def _carried(
    state: State, friction: FrictionState, displacement: Array, turn: Array
) -> tuple[State, FrictionState]:
    """Move a pose and its state of friction on level ground.

    Args:
        state: the pose.
        friction: state of friction.
        displacement: displacement in the plane ``(2,)``, m.
        turn: turn about the vertical through the root's centre, rad.
    """
    about_z = jnp.stack([jnp.zeros_like(turn), jnp.zeros_like(turn), turn])
    rotation = axis_rotation(np.array([0.0, 0.0, 1.0]), jnp.sin(turn), jnp.cos(turn))
    position = state.position + jnp.concatenate([displacement, jnp.zeros_like(displacement[:1])])
    place = position[:, None] + rotation @ (friction.place - state.position[:, None])
    carried = dataclasses.replace(
        state, position=position, orientation=integrate_quaternion(state.orientation, about_z, 1.0)
    )
    return carried, friction._replace(place=place, slip=rotation @ friction.slip)
