"""The controller of Iwadate 2010: a brain (ANN) that drives a spinal cord (CPG).

Once per control step the brain reads the senses of Table 2. It sets the tonic input u and the
adaptation gain b of the oscillators, which set the amplitude and the period of the rhythm. For an
output sigma of the brain, between 0 and 1:

    u = u_max sigma,    b = b_min + (b_max - b_min) sigma,    d = d_max (2 sigma - 1),
    u_e = u (1 + d),    u_f = u (1 - d),
    target = G g (y_e - y_f) - k_c q,    within plus and minus max_rate,
    ML = min(1, y_e / u_max),    MR = min(1, y_f / u_max),
    torque = gear (ML - MR),    angle = A (ML - MR), within the joint's limits.

u_e and u_f are the tonic inputs of the extensor and flexor neuron. The target rate drives motors.
The paper describes it only as "angular-velocity control". The activations ML and MR drive muscles
(`evo_cpg.physics.tree.muscle`), which ignore the target rate. So do torque motors, which take the
torque of muscles without length and speed. ``gear`` is
`evo_cpg.creature.creature.TorqueMotor.gear`. A motor with a spring follows the angle, at a target
rate of 0, if A is more than 0.

| symbol | name |
|---|---|
| u, u_max | ``tonic_input``, ``max_tonic_input`` |
| b, b_min, b_max | ``adaptation_gain``, ``min_adaptation_gain``, ``max_adaptation_gain`` |
| d, d_max | ``steering``, ``steering_range`` |
| G | ``rate_gain`` (rad/s) |
| g | ``AxisSettings.gain`` |
| k_c | ``centring`` (1/s) |
| A | ``angle_range_deg`` |
| q | ``joint_angle`` (rad) |

Differs from Iwadate 2010: steering and centring are additions. An animal needs a difference between
u_e and u_f to turn by bending to one side. That difference, and the initial transient, would leave
the joints off centre without centring, at worst at their stops.

One `BrainCpg.act` of the default swimmer (27 oscillators, 94 inputs, 100 individuals) takes about
36 us on one core in float32.
"""

import dataclasses
from collections.abc import Mapping
from typing import Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from typing_extensions import override

from evo_cpg.control import matsuoka
from evo_cpg.control.brain import Brain, BrainSettings, Weights, decode_weights, think
from evo_cpg.control.controller import Command, Controller, Observation, Origin
from evo_cpg.control.couplings import UnfitError, axis_names, matching_bodies
from evo_cpg.control.feedback import Feedback, Memory, build_feedback, feel, first_memory
from evo_cpg.control.matsuoka import (
    CpgSettings,
    MatsuokaNetwork,
    MatsuokaState,
    Oscillators,
    build_network,
)
from evo_cpg.creature.algebra.decisions import chosen
from evo_cpg.creature.algebra.linear import expand_dims_like
from evo_cpg.creature.algebra.numerics import Number, Numbers, xp
from evo_cpg.creature.creature import NO_LIMIT
from evo_cpg.creature.tree import Tree
from evo_cpg.errors import nearest

# Bias that drives an output of the brain to 0.
_SILENT = -60.0

CONTROL_STEP = 1 / 60  # s: Iwadate 2010, 2000 steps in 33.3 s.


class _InRange:
    """Settings whose steering and centring are checked. None is always allowed."""

    steering_range: float | None
    centring: float | None

    def __post_init__(self):
        if self.steering_range is not None and not 0 <= self.steering_range <= 1:
            raise ValueError(f"steering_range must be from 0 to 1, got {self.steering_range}")
        if self.centring is not None and not self.centring >= 0:
            raise ValueError(f"centring must not be negative, got {self.centring}")


@dataclasses.dataclass(frozen=True)
class AxisSettings(_InRange):
    """Settings for the joints about one named axis.

    Attributes:
        gain: factor on ``rate_gain``.
        centring: rate at which the joints of the axis return to their neutral angle, 1/s, or None
            for the setting of the whole animal.
        steering_range: largest relative difference between extensor and flexor drive, 0 to 1, or
            None for the setting of the whole animal.

    Raises:
        ValueError: a value is outside its range.
    """

    gain: float = 1.0
    centring: float | None = None
    steering_range: float | None = None


@dataclasses.dataclass(frozen=True)
class BrainCpgSettings(_InRange):
    """Settings of the whole controller.

    Attributes:
        cpg: the oscillators.
        brain: the network that sets them.
        drive: variables that the brain sets. ``shared``: u and steering d for each axis (of each
            group), and one b for the whole animal. ``per_joint``: u, d and b for each joint.
            ``per_dof``: u, d and b for each degree of freedom.
        groups: bodies of each named group, as names or patterns such as ``*_arm``. The joints of a
            group have separate axes, named ``group/axis``. Axes of all other bodies have the plain
            name.
        steering_range: largest relative difference between extensor and flexor drive, 0 to 1.
        rate_gain: G, joint rate per unit of output, rad/s. Muscles and torque motors ignore it.
        centring: k_c, rate at which a joint returns to its neutral angle, 1/s, at least 0. The
            value 0 is the paper's angular-velocity control. Muscles and torque motors ignore it.
        max_rate: largest commanded rate of a motor, rad/s, more than 0.
        axes: special settings of named axes, such as ``x`` or ``limbs/y``.
        joint_rates: True to give the joint rates to the brain. The paper's text lists them as
            inputs, but its Table 2 does not.
        senses_joints: False to give the brain neither joints nor outputs of the oscillators.
        angle_range_deg: A, angle that full output commands to a motor with ``stiffness``, degrees
            (of a slide, 0.0175 m for 1). With 0 such a motor pulls to the neutral pose.

    Raises:
        ValueError: a value is outside its range.
    """

    cpg: CpgSettings = CpgSettings()
    brain: BrainSettings = BrainSettings()
    drive: Literal["shared", "per_joint", "per_dof"] = "shared"
    groups: Mapping[str, tuple[str, ...]] = dataclasses.field(default_factory=dict, hash=False)
    steering_range: float = 0.3
    rate_gain: float = 5.0
    centring: float = 1.0
    max_rate: float = 5.0
    axes: Mapping[str, AxisSettings] = dataclasses.field(default_factory=dict, hash=False)
    joint_rates: bool = False
    senses_joints: bool = True
    angle_range_deg: float = 0.0

    def __post_init__(self):
        super().__post_init__()
        if not self.angle_range_deg >= 0:
            raise ValueError(f"angle_range_deg must not be negative, got {self.angle_range_deg}")
        if not self.max_rate > 0:
            raise ValueError(f"max_rate must be positive, got {self.max_rate}")


class Decoded(NamedTuple):
    """Genes of the controller.

    Attributes:
        brain: weights of the brain.
        feedback: genes of the feedback, or None if no weight of the feedback evolves.
    """

    brain: Weights
    feedback: Float[Array, "g *n"] | None = None


class FeelingState(MatsuokaState):
    """State of a spinal cord with feedback.

    Attributes:
        memory: former samples of the senses.
    """

    memory: Memory


class AngleRange(eqx.Module):
    """Angles that motors with a spring can be sent to.

    Attributes:
        full: angle (or length of a tendon) at full output of each command, 0 without a spring.
        lower: lower limit of what each command acts on, rad.
        upper: upper limit of what each command acts on, rad.
    """

    full: Float[Numbers, " d"]
    lower: Float[Numbers, " d"]
    upper: Float[Numbers, " d"]


class BrainCpg(Controller):
    """Brain and spinal cord of one creature.

    The state is the state of the spinal cord's neurons, and the memory of its senses if there is
    feedback.

    Attributes:
        gene_count: number of the brain's weights and of the feedback's weights that evolve.
        brain: network from inputs to outputs. The outputs are tonic inputs, steerings, and
            adaptation gains, each in the order of the axis names, joints or degrees of freedom.
        network: the oscillators, one per degree of freedom.
        origin: settings of the controller.
        joint_rates: True if the brain senses the joint rates.
        substeps: Runge-Kutta steps in a control step.
        max_tonic_input: u_max.
        min_adaptation_gain: b_min.
        max_adaptation_gain: b_max.
        max_rate: largest commanded rate, rad/s.
        max_amplitude: A_max, see `max_amplitude`.
        source: index of each oscillator's tonic input among the tonic inputs that the brain sets.
            It is also the index of its steering.
        gain_source: index of each oscillator's adaptation gain among the gains that the brain sets.
        steering_range: d_max of each degree of freedom.
        rate_gain: G g of each degree of freedom, rad/s, 0 for muscles and torque motors.
        centring: k_c of each degree of freedom, 1/s, 0 for muscles and torque motors.
        control_step: length of a control step, s.
        feedback: feedback of the senses into the oscillators, or None.
        muscles: True if the creature has muscles.
        gear: torque of each degree of freedom at full output, N m, or None without torque motors.
        angles: commanded angles of motors with a spring, or None without them.
        sensed: degrees of freedom that the brain senses, or None for all. It does not sense slides
            of a root that hangs on the world: they are a place in the world.
        unit: coordinate of each degree of freedom that counts as 1 rad, or None without slides.
    """

    gene_count: int = eqx.field(static=True)
    brain: Brain
    network: MatsuokaNetwork
    origin: Origin = eqx.field(static=True)
    joint_rates: bool = eqx.field(static=True)
    substeps: int = eqx.field(static=True)
    max_tonic_input: Number
    min_adaptation_gain: Number
    max_adaptation_gain: Number
    max_rate: Number
    max_amplitude: Number
    source: tuple[int, ...] = eqx.field(static=True)
    gain_source: tuple[int, ...] = eqx.field(static=True)
    steering_range: Float[Numbers, " d"]
    rate_gain: Float[Numbers, " d"]
    centring: Float[Numbers, " d"]
    control_step: float = eqx.field(static=True)
    muscles: bool = eqx.field(static=True)
    feedback: Feedback | None = None
    gear: Float[Numbers, " d"] | None = None
    angles: AngleRange | None = None
    unit: Float[Numbers, " d"] | None = None
    sensed: tuple[int, ...] | None = eqx.field(static=True, default=None)

    signal_label = "CPG output (no unit)"

    @property
    @override
    def uses_load(self) -> bool:
        return self.feedback is not None and bool(self.feedback.load)

    @property
    def rhythm_generator(self) -> Oscillators:
        """Spinal cord of the controller."""
        return Oscillators(self.origin.settings.cpg, self.network, self.rate_gain)

    def random_genes(
        self, key: Array, batch: tuple[int, ...], dtype: jnp.dtype | type
    ) -> Float[Array, "g *n"]:
        """Return uniform weights (see `evo_cpg.control.controller.Controller.random_genes`)."""
        largest = self.origin.settings.brain.init_range
        return jax.random.uniform(key, (self.gene_count, *batch), dtype, -largest, largest)

    def initial_state(self, batch: tuple[int, ...], dtype: jnp.dtype | type) -> MatsuokaState:
        """Return neurons at the network's initial potentials, without adaptation."""
        state = matsuoka.initial_state(self.network, batch, dtype)
        if self.feedback is None:
            return state
        memory = first_memory(self.feedback, self.network.oscillator_count, batch, dtype)
        return FeelingState(state.potential, state.adaptation, memory)

    def decode(self, genes: Float[Array, "g *n"]) -> Decoded:
        """Return the brain's weights, and the genes of the feedback behind them."""
        if self.feedback is None or not self.feedback.gene_count:
            return Decoded(decode_weights(self.brain, genes))
        brain, feedback = jnp.split(genes, [self.brain.gene_count])
        return Decoded(decode_weights(self.brain, brain), feedback)

    def act(
        self, decoded: Decoded, state: MatsuokaState, observation: Observation
    ) -> tuple[MatsuokaState, Command]:
        """Sense, think, advance the rhythm by one control step, command the motors.

        Raises:
            ValueError: the senses do not fit the brain.
        """
        tonic_input, adaptation_gain = self.descending(decoded, state, observation)
        inputs = tonic_input, adaptation_gain
        state = self.cord(state, *inputs, observation, decoded.feedback)
        return state, self.command(state, observation)

    def descending(
        self, decoded: Decoded, state: MatsuokaState, observation: Observation
    ) -> tuple[Float[Array, "2 d *n"], Float[Array, "d *n"]]:
        """Return what the brain sends to the spinal cord.

        Returns:
            Tonic input of each neuron, extensors first, and adaptation gain of each oscillator.

        Raises:
            ValueError: the senses do not fit the brain.
        """
        outputs = think(self.brain, decoded.brain, self.brain_inputs(state, observation))
        return self.cpg_inputs(outputs)

    def cord(
        self,
        state: MatsuokaState,
        tonic_input: Float[Array, "2 d *n"],
        adaptation_gain: Float[Array, "d *n"],
        observation: Observation,
        genes: Float[Array, "g *n"] | None = None,
    ) -> MatsuokaState:
        """Return the state of the spinal cord after one control step with constant inputs.

        Args:
            state: state at the start of the step.
            tonic_input: tonic input of each neuron, extensors first.
            adaptation_gain: adaptation gain of each oscillator.
            observation: senses at the start of the step.
            genes: genes of the feedback, or None if no weight of the feedback evolves.
        """
        neurons, memory = MatsuokaState(state.potential, state.adaptation), None
        if self.feedback is not None:
            assert isinstance(state, FeelingState)
            angle, rate = map(self._as_angle, (observation.joint_angle, observation.joint_rate))
            senses = angle, rate, observation.load
            felt, memory = feel(self.feedback, genes, state.memory, *senses)
            tonic_input = tonic_input + felt
        inputs, steps = (tonic_input, adaptation_gain), (self.control_step, self.substeps)
        neurons = matsuoka.advance(self.network, neurons, *inputs, *steps)
        if memory is None:
            return neurons
        return FeelingState(neurons.potential, neurons.adaptation, memory)

    def command(self, state: MatsuokaState, observation: Observation) -> Command:
        """Return the command of the neurons to motors and muscles.

        A muscle is activated by its own neuron, ``min(1, y / u_max)``. The extensor's muscle pulls
        to positive angles. A torque motor gets its gear times the difference of both activations.
        """
        signal = matsuoka.output(state)
        rate_gain, centring = (expand_dims_like(x, signal) for x in (self.rate_gain, self.centring))
        rate = rate_gain * signal - centring * self._as_angle(observation.joint_angle)
        limit, activation, torque, angle = self.max_rate, None, None, None
        if self.muscles or self.gear is not None or self.angles is not None:
            output = jnp.maximum(state.potential, 0.0)
            activation = jnp.minimum(output * (1.0 / self.max_tonic_input), 1.0)
        if self.gear is not None:
            assert activation is not None
            torque = expand_dims_like(self.gear, signal) * (activation[0] - activation[1])
        if self.angles is not None:
            assert activation is not None
            full, lower, upper = (
                expand_dims_like(x, signal)
                for x in (self.angles.full, self.angles.lower, self.angles.upper)
            )
            free = self._from_angle(full * (activation[0] - activation[1]))
            angle = jnp.clip(free, lower, upper)
        active = activation if self.muscles else None
        rate = self._from_angle(jnp.clip(rate, -limit, limit))
        return Command(rate, signal, angle, active, torque)

    def _as_angle(self, q: Float[Array, "d *n"]) -> Float[Array, "d *n"]:
        """Return coordinates or rates as angles: a slide's in its `units_of`."""
        return q if self.unit is None else q / expand_dims_like(self.unit, q)

    def _from_angle(self, angle: Float[Array, "d *n"]) -> Float[Array, "d *n"]:
        """Return the coordinates or rates of angles, the inverse of `_as_angle`."""
        return angle if self.unit is None else angle * expand_dims_like(self.unit, angle)

    def brain_inputs(self, state: MatsuokaState, observation: Observation) -> Float[Array, "i *n"]:
        """Return the inputs of the brain: Table 2 of Iwadate 2010, every value from -1 to 1.

        The order is: light, pressure, cosine and sine to the vertical. Then: cosine of each joint
        angle, sine of each joint angle, amplitude abs(y_e - y_f) / A_max of each oscillator after
        the last step. Then, if ``joint_rates`` is True: each joint rate in units of ``max_rate``,
        clipped to -1 and 1. Last, not in Table 2: readings of depth gauges and of extra sensors.
        Slides of a root that hangs on the world are left out.
        """
        angle = self._as_angle(observation.joint_angle)
        rate = self._as_angle(observation.joint_rate)
        output = matsuoka.output(state)
        if self.sensed is not None:
            own = np.array(self.sensed, int)
            angle, rate, output = angle[own], rate[own], output[own]
        values = [
            observation.light,
            observation.pressure,
            observation.vertical_cosine,
            observation.vertical_sine,
            jnp.cos(angle),
            jnp.sin(angle),
            jnp.abs(output) / self.max_amplitude,
        ]
        if self.joint_rates:
            values.append(jnp.clip(rate / self.max_rate, -1.0, 1.0))
        values.append(observation.depth)
        if observation.custom is not None:
            values.append(observation.custom)
        return jnp.concatenate(values)

    def cpg_inputs(
        self, outputs: Float[Array, "s *n"]
    ) -> tuple[Float[Array, "2 d *n"], Float[Array, "d *n"]]:
        """Return tonic inputs of the neurons (extensors first) and adaptation gains."""
        count, source = max(self.source) + 1, np.array(self.source)
        tonic = self.max_tonic_input * outputs[:count][source]
        turn = (2 * outputs[count : 2 * count] - 1)[source]
        steering = expand_dims_like(self.steering_range, turn) * turn
        sides = jnp.stack([tonic * (1 + steering), tonic * (1 - steering)])
        span = self.max_adaptation_gain - self.min_adaptation_gain
        adaptation_gain = self.min_adaptation_gain + span * outputs[2 * count :]
        return sides, adaptation_gain[np.array(self.gain_source)]


# Least displacement that a brain senses as 1 rad, m.
_LEAST_UNIT = 1e-6


def build_brain_cpg(
    tree: Tree,
    light_count: int,
    pressure_count: int,
    settings: BrainCpgSettings | None = None,
    control_step: float = CONTROL_STEP,
    depth_count: int = 0,
    custom_count: int = 0,
) -> BrainCpg:
    """Build the controller for a creature's tree.

    Args:
        tree: the creature. Every degree of freedom gets an oscillator.
        light_count: number of light sensors, which also sense their angle to the vertical.
        pressure_count: number of pressure sensors.
        settings: settings, or None for the defaults.
        control_step: time between two calls of `BrainCpg.act`, s.
        depth_count: number of depth gauges.
        custom_count: number of readings of the creature's `sensors`.

    Raises:
        ValueError: the creature has no joint.
        UnfitError: the creature lacks a body or an axis that the settings name.
    """
    settings = settings or BrainCpgSettings()
    if not tree.dof_count:
        raise ValueError("the controller needs a creature with at least one joint")
    axes = _grouped_axes(tree, settings.groups)
    kinds = sorted(set(axes))
    for axis in settings.axes:
        if axis not in kinds:
            problem = f"no joint turns about {axis!r} ({nearest(axis, kinds)})"
            raise UnfitError(problem, ("axes", axis), unknown_name=True)
    joints = sorted(set(tree.dof_bodies))
    per_joint = tuple(joints.index(body) for body in tree.dof_bodies)
    per_dof = tuple(range(tree.dof_count))
    source, gain_source = {
        "shared": (tuple(kinds.index(axis) for axis in axes), (0,) * tree.dof_count),
        "per_joint": (per_joint, per_joint),
        "per_dof": (per_dof, per_dof),
    }[settings.drive]
    senses_per_joint = 4 if settings.joint_rates else 3
    input_count = 3 * light_count + pressure_count + depth_count + custom_count
    felt = range(tree.dof_count * settings.senses_joints)
    sensed = tuple(i for i in felt if i not in tree.root_slides)
    input_count += senses_per_joint * len(sensed)
    output_count = 2 * (max(source) + 1) + max(gain_source) + 1
    own = [settings.axes.get(axis, AxisSettings()) for axis in axes]
    steering_range = [
        settings.steering_range if x.steering_range is None else x.steering_range for x in own
    ]
    centring = [settings.centring if x.centring is None else x.centring for x in own]
    sizes = (input_count, *settings.brain.hidden, output_count)
    brain = Brain(sizes, settings.brain.temperature)
    network, cpg = build_network(tree, settings.cpg), settings.cpg
    feedback = None
    if cpg.feedback is not None:
        feedback = build_feedback(tree, cpg.feedback, cpg.max_tonic_input, control_step)
    none = (False,) * tree.dof_count
    muscular = tree.muscles.driven if tree.muscles else none
    follows = _follows_angles(tree, settings)
    angles = None
    if any(follows):
        full = xp.where(np.array(follows), xp.deg2rad(settings.angle_range_deg), 0.0)
        angles = AngleRange(full, tree.of_commands("lower"), tree.of_commands("upper"))
    rateless = [any(kinds) for kinds in zip(muscular, tree.torque_driven, follows, strict=True)]
    return BrainCpg(
        gene_count=brain.gene_count + (feedback.gene_count if feedback else 0),
        brain=brain,
        network=network,
        origin=Origin(settings),
        joint_rates=settings.joint_rates,
        substeps=network.substeps(control_step),
        max_tonic_input=cpg.max_tonic_input,
        min_adaptation_gain=cpg.min_adaptation_gain,
        max_adaptation_gain=cpg.max_adaptation_gain,
        max_rate=settings.max_rate,
        max_amplitude=max_amplitude(settings),
        source=source,
        gain_source=gain_source,
        steering_range=xp.array(steering_range),
        rate_gain=xp.array(
            [0.0 if m else settings.rate_gain * x.gain for x, m in zip(own, rateless, strict=True)]
        ),
        centring=xp.array([0.0 if m else x for x, m in zip(centring, rateless, strict=True)]),
        control_step=control_step,
        feedback=feedback,
        muscles=tree.muscles is not None,
        gear=tree.gears,
        angles=angles,
        sensed=sensed if len(sensed) < tree.dof_count else None,
        unit=units_of(tree),
    )


def units_of(tree: Tree) -> Float[Numbers, " d"] | None:
    """Return the coordinate that a brain senses and commands as 1 rad, or None without slides.

    A slide's is its farther limit, or without limits the radius of gyration of its body, m. Cosine
    and sine then tell its positions apart, and animals of any size have equal brains.
    """
    slides = tree.slides
    if not slides.any():
        return None
    body = np.array(tree.dof_bodies)
    own = xp.trace(tree.inertia[:3, :3])[body] / 2
    away = (tree.com * tree.com).sum(0)[body]
    radius = xp.sqrt(xp.maximum(own / tree.mass[body] - away, _LEAST_UNIT**2))
    farther = xp.maximum(xp.abs(tree.lower), xp.abs(tree.upper))
    return xp.where(slides, xp.where(farther < NO_LIMIT, farther, radius), 1.0)


def _follows_angles(tree: Tree, settings: BrainCpgSettings) -> tuple[bool, ...]:
    """Return which commands go to a motor with a spring, of a joint or a tendon."""
    size = settings.angle_range_deg
    if not chosen(lambda: bool(size > 0), lambda made: (size > 0) == made):
        return (False,) * tree.dof_count
    springs = tree.of_commands("servo_stiffness")
    return chosen(
        lambda: tuple((np.asarray(springs) > 0).tolist()),
        lambda made: ((springs > 0) == np.array(made)).all(),
    )


def silent_genes(controller: Controller) -> Float[np.ndarray, " g"]:
    """Return genes that set all outputs of the brain to 0, so that the joints get no drive."""
    assert isinstance(controller, BrainCpg)
    *_, hidden, outputs = controller.brain.sizes
    genes = np.zeros(controller.gene_count, np.float32)
    # Biases of the last layer. Each follows its weights.
    brain = genes[: controller.brain.gene_count]
    brain[-outputs * (hidden + 1) :].reshape(outputs, -1)[:, -1] = _SILENT
    return genes


def max_amplitude(settings: BrainCpgSettings) -> Number:
    """Return A_max, the largest size of any oscillator's output, in the unit of the tonic input."""
    cpg = settings.cpg
    ranges = [axis.steering_range for axis in settings.axes.values()]
    every = [settings.steering_range, *(x for x in ranges if x is not None)]
    # This choice is static: derivatives are taken by the first of the largest ranges.
    steering = every[chosen(lambda: int(np.argmax(every)))]
    limit = 0.0 if cpg.feedback is None else cpg.feedback.limit
    return cpg.max_tonic_input * (1 + steering + limit) + xp.maximum(cpg.constant_input, 0.0)


def _grouped_axes(tree: Tree, groups: Mapping[str, tuple[str, ...]]) -> list[str]:
    """Return the axis name of each degree of freedom, as ``group/axis`` if its body has a group."""
    group_of: dict[int, str] = {}
    for group, patterns in groups.items():
        found = matching_bodies(tree, patterns, ("groups", group))
        if not found & set(tree.dof_bodies):
            names = [tree.names[body] for body in sorted(set(tree.dof_bodies))]
            problem = f"names no body with a joint (bodies with one: {', '.join(names)})"
            raise UnfitError(problem, ("groups", group))
        for body in found:
            if group_of.setdefault(body, group) != group:
                problem = f"groups {group_of[body]} and {group} both name {tree.names[body]!r}"
                raise UnfitError(problem, ("groups", group))
    names = [group_of.get(body) for body in tree.dof_bodies]
    axes = axis_names(tree)
    return [
        f"{group}/{axis}" if group is not None else axis
        for group, axis in zip(names, axes, strict=True)
    ]
