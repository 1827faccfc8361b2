"""A second opinion on a champion: its trial, repeated in MuJoCo.

The exported model (`evo_cpg.io.models.mjcf_export`) starts in the champion's initial state. There
are two modes of driving it:

- The recorded commands of the champion's controller, step by step.
- The controller in the loop, with the sensor readings of MuJoCo's animal (`ControllerInLoop`). A
  controller that corrects itself needs this mode if contacts differ. Tables name it "own senses".

Both programs solve the same equations of motion. They differ in these points:

- Contacts are MuJoCo's own, without restitution. By default they are much softer than ours: they
  yield over 20 ms, and creep. Hard contacts yield within one of our steps. They need much finer
  steps of MuJoCo, because its stiff motors are inaccurate at ours.
- Joint limits are MuJoCo's own, which yield more if water or a motor presses against them.
- Buoyancy and force laws (`evo_cpg.physics.water.force_law`) are ours, applied to MuJoCo's bodies
  at every MuJoCo step. Laws with an inertia, such as added mass, act by a force on MuJoCo's degrees
  of freedom (`evo_cpg.io.models.mujoco_state`). The impact of water that a body enters is left
  out.
- Muscles are a torque motor, a spring and a damper, which follow our law in every step of MuJoCo.
- If friction differs from trial to trial, MuJoCo uses the friction of the configuration.
"""

import dataclasses
import functools
import importlib
import operator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from evo_cpg.analysis.energy import along_time
from evo_cpg.analysis.excursions import swims
from evo_cpg.control.controller import Command
from evo_cpg.creature.algebra.linear import cross, expand_dims_like, matvec
from evo_cpg.creature.algebra.numerics import Numbers
from evo_cpg.creature.creature import Creature
from evo_cpg.creature.laws import CoordinateLaws
from evo_cpg.creature.per_body import take
from evo_cpg.io.models.mjcf_export import mjcf_model, mjcf_text
from evo_cpg.io.models.mujoco_state import (
    CarriedInertia,
    dof_order,
    joint_state,
    load_state,
    motor_order,
    root_dofs,
    root_rotation,
    step_with_inertia,
)
from evo_cpg.io.models.refusals import ExchangeError
from evo_cpg.native.engine import using
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree import root
from evo_cpg.physics.tree.joint_torque import MotorCommand
from evo_cpg.physics.tree.kinematics import kinematics
from evo_cpg.physics.tree.muscle import pull_of
from evo_cpg.physics.tree.state import State, resting_state
from evo_cpg.physics.water.force_law import buoyancy_alone, in_body_axes
from evo_cpg.simulation.control_step import (
    AnimalState,
    act,
    begin_episode,
    lit,
    motor_command,
    sense,
    snapshot_of,
    with_acceleration,
)
from evo_cpg.simulation.observers import PhysicsSteps
from evo_cpg.simulation.sensors import pressure_readings
from evo_cpg.simulation.simulation import Simulation
from evo_cpg.system import command_for

# Least upward component of the root's z axis in an upright animal: the cosine of 60 degrees.
_UPRIGHT = 0.5

# Hard contacts: longest MuJoCo step (s), and stiffness of friction relative to the normal
# direction. Their time constant is one of our steps, in which an impact of ours ends.
_HARD_STEP, _IMPEDANCE_RATIO = 1 / 3840, 100.0

# Longest step (s) with explicit forces, such as water's or springs of muscles, on light limbs.
_LAW_STEP = 1 / 2000


class DivergedError(ExchangeError):
    """Raised if MuJoCo's animal diverges.

    Attributes:
        program: name of the program, see `Opinion`.
    """

    def __init__(self, program: str):
        super().__init__(f"{program}: the animal diverged")
        self.program = program


class Opinion(NamedTuple):
    """Outcome of a trial in one of the two programs, in control steps.

    Attributes:
        program: name of the program.
        path: path of the root, m, the start first.
        upright: fraction of the time in which the root's z axis is less than 60 degrees from the
            vertical.
        airborne: fraction of the time in which nothing touches the ground and no body's centre is
            under water. None without ground or with water everywhere, because it has no meaning
            then.
        joint_angle: angles, rad, and displacements, m, in our order of degrees of freedom.
        slides: whether each degree of freedom is a displacement.
    """

    program: str
    path: Float[np.ndarray, "3 t"]
    upright: float
    airborne: float | None
    joint_angle: Float[np.ndarray, "d t"]
    slides: Bool[np.ndarray, " d"]

    @property
    def displacement(self) -> float:
        """Distance from start to end over the ground, m."""
        return float(np.linalg.norm((self.path[:, -1] - self.path[:, 0])[:2]))

    @property
    def heading(self) -> float:
        """Direction from start to end over the ground, rad to the left of the world's x."""
        x, y, _ = self.path[:, -1] - self.path[:, 0]
        return float(np.arctan2(y, x))


class ControllerInLoop:
    """A champion's controller, with the senses of an animal in another simulator.

    Args:
        simulation: the trial.
        genes: genes of the champion.
        keys: raw random keys of the trial, or None without noise.
        number: number of the trial's situation, or None for a single situation.
    """

    def __init__(
        self,
        simulation: Simulation,
        genes: Float[np.ndarray, " g"],
        keys: Array | None = None,
        number: Array | None = None,
    ):
        with using(simulation.engine):
            alone = jnp.asarray(genes, jnp.float32)[:, None]
            constants, animal = begin_episode(simulation, alone, keys, number)
        contact_model = simulation.world.contact_model
        owners = np.array([] if contact_model is None else contact_model.bodies, int)
        # The force of a body is put on its first contact point. Pressure sensors and loads sum the
        # forces of all points of a body.
        self._first = {body: int(np.flatnonzero(owners == body)[0]) for body in set(owners)}
        self._points = len(owners)
        self._kept, self._before, self._count = animal, None, 0

        def think(
            state: State, before: State, kept: AnimalState, forces: Array, index: Array
        ) -> tuple[AnimalState, Command]:
            with using(simulation.engine):
                kin = kinematics(simulation.world.tree, state)
                last, mean = forces
                felt = pressure_readings(simulation.sensors, simulation.world, kin, last)
                course = kept.course
                if simulation.task.moves_light:
                    # The light moves after each control step.
                    after = snapshot_of(simulation, lit(simulation, constants, kept), state)
                    moved = simulation.task.advance_course(course, after, index - 1)
                    course = jax.tree.map(lambda x, y: jnp.where(index > 0, x, y), moved, course)
                there = kept._replace(state=state, pressure=felt, course=course)
                if there.forces is not None:
                    borne = there.forces._replace(contact_force=mean)
                    if borne.acceleration is not None:
                        borne = with_acceleration(simulation, borne, before, state)
                    there = there._replace(forces=borne)
                own = lit(simulation, constants, there)
                seen, memories = sense(simulation, own, there, index)
                nerves, command = act(simulation, own, there, seen)
                return there._replace(nerves=nerves, memories=memories), command

        self._think = jax.jit(think)

    def think(self, state: State, borne: Float[np.ndarray, "t b"]) -> MotorCommand:
        """Return the command to motors and muscles, with an axis of one individual.

        Args:
            state: state of the animal.
            borne: normal force of the ground on each body after each step of the last control step,
                N. Pressure sensors feel the last one, and limbs their mean.
        """
        forces = np.zeros((2, 3, self._points, 1), np.float32)
        for body, point in self._first.items():
            forces[:, 2, point, 0] = borne[-1, body], borne[:, body].mean()
        here = jax.tree.map(lambda x: np.asarray(x, np.float32)[..., None], state)
        before = here if self._before is None else self._before
        given = here, before, self._kept, forces, np.int32(self._count)
        self._kept, command = jax.device_get(self._think(*given))
        self._before, self._count = here, self._count + 1
        return motor_command(command).filled()


def own_opinion(simulation: Simulation, steps: PhysicsSteps) -> Opinion:
    """Return our own outcome of a trial that was simulated here."""
    each = slice(simulation.substeps - 1, None, simulation.substeps)
    start, place = steps.before.position[:, :1], steps.after.position[:, each]
    swimming = along_time(functools.partial(swims, simulation.world), steps)
    held = (np.abs(steps.contact_force).sum((0, 1)) > 0) | swimming
    path, angle = (
        np.concatenate([start, place], 1).astype(float),
        np.asarray(steps.after.q)[:, each],
    )
    turned = np.asarray(steps.after.orientation[:, each])
    return _opinion("evo_cpg", simulation.world, path, turned, held[each], angle)


def second_opinion(
    simulation: Simulation,
    creature: Creature,
    steps: PhysicsSteps,
    hard: bool = False,
    brain: ControllerInLoop | None = None,
) -> Opinion:
    """Simulate the trial in MuJoCo, and return its outcome.

    Args:
        simulation: simulation of the trial.
        creature: the animal.
        steps: physics steps of the trial, for its initial state and its commands.
        hard: whether to use contacts as hard as ours and round friction cones, in smaller steps.
        brain: controller of the animal, or None for the commands of the trial.

    Raises:
        ExchangeError: MuJoCo is missing or refuses the model, or MJCF cannot hold the world.
        DivergedError: MuJoCo's animal diverged.
    """
    program = "MuJoCo" + ", hard contacts" * hard + ", own senses" * (brain is not None)
    before = jax.tree.map(lambda x: np.asarray(x[..., 0], float), steps.before)
    try:
        mujoco = importlib.import_module("mujoco")
    except ModuleNotFoundError:
        raise ExchangeError(
            f"MuJoCo is not installed. Install it with `{command_for('mujoco')}`"
        ) from None
    world, substeps, h = simulation.world, simulation.substeps, simulation.step_length
    longest = _HARD_STEP if hard else h
    if world.water is not None or world.forces or world.tree.muscles is not None:
        longest = min(longest, _LAW_STEP)
    finer = int(np.ceil(h / longest - 1e-9))
    place: dict[str, Any] = {}
    if before.base is not None:
        w, _, _, z = before.base.orientation
        place = {"start": before.base.position, "heading": 2 * np.arctan2(z, w)}
    element = mjcf_model(
        creature, world.gravity, world.ground, time_step=h / finer, pairs=world.pair_names, **place
    )
    try:
        model = mujoco.MjModel.from_xml_string(mjcf_text(element))
    except ValueError as error:
        raise ExchangeError(f"MuJoCo refuses the exported model: {error}") from None
    if hard:
        model.opt.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
        model.opt.impratio = _IMPEDANCE_RATIO
        model.pair_solref[:] = h, 1.0
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    player = _Player(mujoco, model, world, h, before)
    # Random change of the velocities before each step, as for `State.rates`.
    rates = np.asarray(steps.before.rates, float)
    came = np.concatenate([rates[:, :1], np.asarray(steps.after.rates[:, :-1], float)], 1)
    pushes = rates - came
    recorded = steps.target_rate, steps.target_angle, steps.activation, steps.commanded_torque
    commands, active = player.commands(MotorCommand(*recorded))
    states, held, borne = [before], [], [np.zeros(len(world.tree.names))]
    for index in range(steps.torque.shape[-1]):
        player.push(pushes[:, index])
        if brain is not None and index % substeps == 0:
            own = player.commands(brain.think(player.state(), np.array(borne)))
            commands[index : index + substeps], active[index : index + substeps] = own
            borne.clear()
        time = (index // substeps) / simulation.control_rate
        player.advance(commands[index], active[index], finer, time)
        if brain is not None:
            borne.append(player.weight_borne())
        if not np.isfinite(player.data.qpos).all():
            raise DivergedError(program)
        if (index + 1) % substeps == 0:
            states.append(player.state())
            held.append(player.is_held())
    poses = jax.tree.map(lambda *each: np.stack(each, -1), *states)
    turned, angle = poses.orientation[:, 1:], poses.q[:, 1:]
    return _opinion(program, world, poses.position, turned, np.array(held), angle)


def _opinion(
    program: str,
    world: World,
    path: Float[np.ndarray, "3 t"],
    orientation: Float[np.ndarray, "4 n"],
    held: Bool[np.ndarray, " n"],
    joint_angle: Float[np.ndarray, "d n"],
) -> Opinion:
    """Return the outcome of a trial in which ground or water holds the animal at some steps."""
    _, x, y, _ = orientation
    upright = float((1.0 - 2.0 * (x * x + y * y) > _UPRIGHT).mean())
    airborne = None
    if world.contact_model is not None and world.water_level != np.inf:
        airborne = float(1.0 - held.mean())
    angle = np.asarray(joint_angle, float)
    return Opinion(program, path, upright, airborne, angle, world.tree.slides)


class _Player:
    """MuJoCo's animal, which starts in the state of ours."""

    def __init__(self, mujoco: Any, model: Any, world: World, h: float, start: State):
        self.mujoco, self.model, self.tree = mujoco, model, world.tree
        self.data = mujoco.MjData(model)
        self.dofs, self._motors = dof_order(model, world.tree), motor_order(model, world.tree)
        self._bodies = np.array([model.body(name).id for name in world.tree.names])
        self._animal = np.isin(model.geom_bodyid, self._bodies)
        self._structure = jax.tree.structure(resting_state(world.tree))
        # MuJoCo's welded bodies have centres of mass of their own.
        centres = world.tree.com
        if world.tree.centre_of_volume is not None:
            centres = np.asarray(model.body_ipos)[self._bodies].T
        self._laws = None
        if world.water is not None or world.forces:
            self._laws = jax.jit(functools.partial(_law_forces, world, h, centres))
        self._pull = None
        if world.tree.muscles is not None:
            self._pull = jax.jit(functools.partial(pull_of, world.tree.muscles))
        self._surface = world.water_level
        self._start = start
        self._placed = jax.jit(lambda state: state.placed(world.tree))
        load_state(model, self.data, world.tree, start)
        mujoco.mj_forward(model, self.data)

    def commands(
        self, command: MotorCommand
    ) -> tuple[Float[np.ndarray, "t motors"], Float[np.ndarray, "t 2 d"]]:
        """Return the commands of MuJoCo's motors for each step, and the activations of muscles.

        The commands give our motors' torques. Those of muscles change within a step, see `advance`.
        """
        tendons, driven = self.tree.tendons, _controls(self.tree, command)
        if tendons is not None:
            channels = np.maximum(tendons.channels, 0)
            own = jax.tree.map(lambda x: take(x, channels, 0), command._replace(activation=None))
            driven = np.concatenate([driven, _controls(tendons, own)])
        active = np.moveaxis(np.asarray(command.activation, float), -1, 0)
        return driven[self._motors].T, active

    def advance(
        self,
        command: Float[np.ndarray, " motors"],
        activation: Float[np.ndarray, "2 d"],
        count: int,
        time: float,
    ) -> None:
        """Take some of MuJoCo's steps with a constant command, in the water of a time (s).

        Muscles are a torque motor, with the stiffness and damping of their hinge. All three follow
        the law of muscles in every step of MuJoCo.
        """
        self.data.ctrl[:] = command
        for _ in range(count):
            carried = None
            if self._pull is not None:
                state = self.state()
                with jax.enable_x64(True):
                    pull = jax.device_get(self._pull(activation, state.q, state.qd))
                # Set strength, stiffness and damping of the muscles' hinges and motors.
                tree, model, muscles = self.tree, self.model, self.tree.muscles
                assert muscles is not None
                hinges = root_dofs(tree) + self.dofs
                model.jnt_stiffness[model.dof_jntid[hinges]] = tree.stiffness + pull.stiffness
                model.dof_damping[hinges] = tree.damping + pull.damping
                (own,) = np.nonzero(np.isin(self._motors, np.flatnonzero(muscles.driven)))
                share = pull.drive / np.where(muscles.driven, muscles.strength, 1.0)
                self.data.ctrl[own] = share[self._motors[own]]
            if self._laws is not None:
                state = self.state()
                with jax.enable_x64(True):
                    applied, carried = jax.device_get(self._laws(state, time))
                self.data.xfrc_applied[self._bodies] = applied.T
            if carried is None:
                self.mujoco.mj_step(self.model, self.data)
            else:
                step_with_inertia(self.mujoco, self.model, self.data, self._bodies, carried)

    def push(self, change: Float[np.ndarray, " v"]) -> None:
        """Change the velocities, given as for `State.rates`."""
        if self.tree.hanging is None:
            self.data.qvel[:3] += change[3 : root.ROOT_DOFS]
        self.data.qvel[root_dofs(self.tree) + self.dofs] += change[root.JOINTS]

    def is_held(self) -> bool:
        """Return whether the animal touches something other than itself, or swims.

        It swims if a body's centre is under water.
        """
        touches = any(
            self._animal[contact.geom1] != self._animal[contact.geom2]
            for contact in self.data.contact
        )
        return touches or bool((self.data.xipos[self._bodies, 2] < self._surface).any())

    def weight_borne(self) -> Float[np.ndarray, " b"]:
        """Return the normal force of the surroundings on each of our bodies, N."""
        borne, force = np.zeros(self.model.nbody), np.zeros(6)
        for index, contact in enumerate(self.data.contact):
            if self._animal[contact.geom1] != self._animal[contact.geom2]:
                self.mujoco.mj_contactForce(self.model, self.data, index, force)
                mine = contact.geom1 if self._animal[contact.geom1] else contact.geom2
                borne[self.model.geom_bodyid[mine]] += force[0]
        return borne[self._bodies]

    def state(self) -> State:
        """Return the animal's state in our form."""
        data, tree = self.data, self.tree
        joints = joint_state(self.model, tree, data.qpos, data.qvel)
        if tree.hanging is not None:
            with jax.enable_x64(True):
                moved = dataclasses.replace(self._start, q=joints[0], qd=joints[1])
                return jax.device_get(self._placed(moved))
        spin = root_rotation(data.qpos[3:7]) @ data.qvel[3:6]
        parts: tuple[Any, ...] = (
            data.qpos[:3].copy(),
            data.qpos[3:7].copy(),
            np.concatenate([spin, data.qvel[:3]]),
            *joints,
        )
        # Double precision, as in states from `jax.device_get`.
        return jax.tree.unflatten(self._structure, parts)


def _controls(laws: CoordinateLaws, command: MotorCommand) -> Float[np.ndarray, "d t"]:
    """Return MuJoCo's commands that give the force of our motors."""
    target_rate, target_angle = np.asarray(command.target_rate), np.asarray(command.target_angle)
    gain, stiffness = (
        np.asarray(x, float)[:, None] for x in (laws.servo_gain, laws.servo_stiffness)
    )
    springy = stiffness > 0
    along = gain / np.where(springy, stiffness, 1.0) * target_rate
    driven = np.where(springy, target_angle + along, target_rate)
    if laws.torque_motors is not None:
        gear = np.asarray(laws.torque_motors.gear, float)[:, None]
        share = np.asarray(command.torque) / np.where(gear == 0, 1.0, gear)
        driven = np.where(np.array(laws.torque_motors.driven)[:, None], share, driven)
    return np.asarray(driven, float)


def _law_forces(
    world: World, h: float, centres: Float[Numbers, "3 b"], state: State, time: Array
) -> tuple[Float[Array, "6 b"], CarriedInertia | None]:
    """Return the effect of laws and buoyancy on the bodies.

    Args:
        world: our world of the animal.
        h: length of our physics step, s.
        centres: MuJoCo's centres of mass of the bodies, in their working frames, m.
        state: state of the animal.
        time: time at which the water is taken, s.

    Returns:
        Force (N) and moment (N m) at body centres, without those by the accelerations of degrees of
        freedom, and the inertia of the laws, or None without such inertia.
    """
    kin = kinematics(world.tree, state)
    bodies = world.at(time).bodies(kin, h)
    parts = [law.wrench(bodies) for law in world.forces]
    if world.water is not None:
        parts.append(buoyancy_alone(bodies))
    wrench = functools.reduce(operator.add, parts, jnp.zeros_like(bodies.velocity))
    inertias = [x for law in world.forces if (x := law.inertia(bodies)) is not None]
    carried = None
    if inertias:
        inertia = functools.reduce(operator.add, inertias)
        bias = in_body_axes(kin.rotation, kin.bias_angular, kin.bias_linear)
        wrench = wrench - matvec(inertia, bias)
        carried = CarriedInertia(inertia, kin.rotation, kin.origin)
    arm = expand_dims_like(centres, wrench[3:])
    moment = wrench[:3] - cross(arm, wrench[3:])
    return jnp.concatenate([matvec(kin.rotation, x) for x in (wrench[3:], moment)]), carried
