"""The controller of Fukui 2003: a few postures that an animal takes in turn, repeatedly.

A posture is one angle for every joint. The motors are springs that pull each joint to its angle
(sections 2.5 to 2.7 of the thesis). There is no sensing: posture k = 0, 1, ... is held while

    k T <= t < (k + 1) T,

and the first follows the last. The angles evolve as bits (section 3.2). Each joint has B bits b_1
... b_B in each posture:

    theta = theta_0 + step sum_i 2^(B - i) b_i,    q = theta - theta_n.

The thesis counts theta from straight up, so that 180 degrees is straight down, and allows 110, 130,
... 250 degrees. T is 1/3 s in its chapter 2 and 0.3 s in chapter 5. The thesis does not state the
order of the bits and the reference of a lower leg's angle. Here the genome goes posture by posture,
joint by joint, most significant bit first, and q is the angle from the parent body.

| symbol | name |
|---|---|
| T | ``period`` (s) |
| theta_0, step | ``lowest_angle``, ``angle_step`` (degrees) |
| theta_n | ``neutral_angle`` (degrees) |
| B | ``bits_per_joint`` |
| q | ``target_angle`` (rad) |
| r | ``steps_per_posture`` (control steps, a rational number) |
"""

import dataclasses
import math
from fractions import Fraction

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from evo_cpg.control.controller import Command, Controller, Observation, Origin
from evo_cpg.creature.algebra.decisions import chosen
from evo_cpg.creature.algebra.linear import expand_dims_like
from evo_cpg.creature.algebra.numerics import Number, Numbers, xp
from evo_cpg.creature.tree import Tree

# Number of periods whose switches are at exactly the right control step. If this many periods are a
# whole number of control steps, all later switches are exact too. A trial of the thesis, 20 s, has
# 60 periods.
EXACT_PERIODS = 500

# Largest fraction of a control step by which a switch may be early. So 20 control steps of 1/60 s
# are 1/3 s for any rounding of the floating-point numbers.
TOLERANCE = 1e-6

# Largest excess of an angle over a limit, rad: both are rounded from degrees.
_ANGLE_TOLERANCE = 1e-6

# Longest period of a posture, control steps. The largest product in `PostureController.posture`,
# EXACT_PERIODS^2 times this, is below 2^31.
LONGEST_PERIOD = 8000


@dataclasses.dataclass(frozen=True)
class PostureSettings:
    """Settings of the postures, with the defaults of Fukui 2003.

    Attributes:
        postures: number of postures, 1 to 1000.
        period: time for which each posture is held, s, more than 0.
        lowest_angle: angle of a joint whose bits are all 0, degrees.
        angle_step: difference between neighbouring angles, degrees, more than 0.
        bits_per_joint: B, bits for each joint of each posture, 1 to 16. They encode 2^B angles.
        neutral_angle: angle of a joint in the neutral pose, degrees.
        graded: True to use genes as numbers from 0 to 1 instead of rounding them to bits. Angles
            then change smoothly and have derivatives. Genomes of bits mean the same in both cases.

    Raises:
        ValueError: a value is outside its range.
    """

    postures: int = 8
    period: float = 1 / 3
    lowest_angle: float = 110.0
    angle_step: float = 20.0
    bits_per_joint: int = 3
    neutral_angle: float = 180.0
    graded: bool = False

    def __post_init__(self):
        for name, most in (("postures", 1000), ("bits_per_joint", 16)):
            if not 1 <= getattr(self, name) <= most:
                raise ValueError(f"{name} must be from 1 to {most}, got {getattr(self, name)}")
        for name in ("period", "angle_step"):
            if not 0 < getattr(self, name) < math.inf:
                raise ValueError(f"{name} must be positive, got {getattr(self, name)}")
        for name in ("lowest_angle", "neutral_angle"):
            if not math.isfinite(getattr(self, name)):
                raise ValueError(f"{name} must be a finite angle, got {getattr(self, name)}")


class PostureController(Controller):
    """The postures of one creature, with the number of completed control steps as its state.

    Attributes:
        gene_count: number of genes, one for each bit of each angle.
        dof_count: degrees of freedom, each of which has an angle in every posture.
        origin: settings of the controller.
        postures: number of postures.
        bits_per_joint: B.
        binary: True if genes are bits, False if they are numbers between 0 and 1.
        lowest_angle: theta_0 - theta_n, degrees.
        angle_step: difference between neighbouring angles, degrees.
        steps_per_posture: r, such that the k-th switch is at control step ceil(k r).
    """

    gene_count: int = eqx.field(static=True)
    dof_count: int = eqx.field(static=True)
    origin: Origin = eqx.field(static=True)
    postures: int = eqx.field(static=True)
    bits_per_joint: int = eqx.field(static=True)
    binary: bool = eqx.field(static=True)
    lowest_angle: Number
    angle_step: Number
    steps_per_posture: Fraction = eqx.field(static=True)

    uses_senses = False
    signal_label = "angle of the posture (rad)"

    def random_genes(
        self, key: Array, batch: tuple[int, ...], dtype: jnp.dtype | type
    ) -> Float[Array, "g *n"]:
        """Return random bits, 0 or 1 with equal chances."""
        return jax.random.bernoulli(key, 0.5, (self.gene_count, *batch)).astype(dtype)

    def initial_state(self, batch: tuple[int, ...], dtype: jnp.dtype | type) -> Int[Array, "*n"]:
        """Return the number of completed steps, 0, as an integer for any floating-point type."""
        return jnp.zeros(batch, jnp.int32)

    def act(
        self, decoded: Float[Array, "p d *n"], state: Int[Array, "*n"], observation: Observation
    ) -> tuple[Int[Array, "*n"], Command]:
        """Command the posture of the present time."""
        numbers = expand_dims_like(np.arange(self.postures), state, 1 + state.ndim)
        present = (numbers == self.posture(state)[None])[:, None]
        angle = jnp.where(present, decoded, 0.0).sum(0)
        return state + 1, Command(
            target_rate=jnp.zeros_like(angle), signal=angle, target_angle=angle
        )

    def decode(self, genes: Float[Array, "g *n"]) -> Float[Array, "p d *n"]:
        """Return joint angles of every posture, rad. Genes that are bits round to 0 or 1."""
        fractions = (genes >= 0.5).astype(genes.dtype) if self.binary else jnp.clip(genes, 0, 1)
        shape = self.postures, self.dof_count, self.bits_per_joint
        bits = fractions.reshape(*shape, *genes.shape[1:])
        weights = 2.0 ** np.arange(self.bits_per_joint)[::-1]
        number = (expand_dims_like(weights[None, None], bits) * bits).sum(2)
        return jnp.deg2rad(self.lowest_angle + self.angle_step * number)

    def posture(self, step: Int[Array, "*n"]) -> Int[Array, "*n"]:
        """Return the number of the posture at a control step, both from 0: floor(step / r)."""
        steps, periods = self.steps_per_posture.as_integer_ratio()
        # Whole rounds of steps first, because step times periods would overflow.
        switches = step // steps * periods + step % steps * periods // steps
        return switches % self.postures


def build_posture_controller(
    tree: Tree, settings: PostureSettings, control_step: float
) -> PostureController:
    """Build the controller for a creature.

    Args:
        tree: the creature. Every degree of freedom gets an angle in every posture.
        settings: the postures and their angles.
        control_step: time between two calls of `PostureController.act`, s.

    Raises:
        ValueError: the creature has no joint, or has muscles or torque motors. A motor would pull
            its joint beyond a limit, or has a spring along a slide. The period is shorter than a
            control step, which would skip postures, or too long to count.
    """
    if not tree.dof_count:
        raise ValueError("the controller needs a creature with at least one joint")
    if tree.muscles is not None:
        driven = tree.dof_names[tree.muscles.driven.index(True)]
        raise ValueError(
            "postures command angles of motors, but muscles take activations: joint "
            f"{driven} has muscles. Give its actuator a gain and a stiffness, or choose brain_cpg"
        )
    if any(tree.torque_driven):
        driven = tree.dof_names[tree.torque_driven.index(True)]
        raise ValueError(
            f"postures command angles of motors, but the motor of joint {driven} takes torques. "
            "Give its actuator a gain and a stiffness in place of the type, or choose brain_cpg"
        )
    chosen(lambda: _check_limits(tree, settings), lambda _: ~_beyond(tree, settings)[0].any())
    ratio = settings.period / control_step
    if not chosen(lambda: 1 - TOLERANCE <= ratio <= LONGEST_PERIOD):
        raise ValueError(
            f"period must be from 1 to {LONGEST_PERIOD} control steps of {control_step:g} s, "
            f"got {settings.period:g} s"
        )
    # The fraction r for which ceil(k r) is ceil(k ratio), k up to `EXACT_PERIODS`, because r is the
    # smallest of all ceil(k ratio) / k. So k r <= ceil(k ratio), and r >= ratio gives the other
    # side.
    slack, periods = TOLERANCE / EXACT_PERIODS, range(1, EXACT_PERIODS + 1)
    return PostureController(
        gene_count=settings.postures * tree.dof_count * settings.bits_per_joint,
        dof_count=tree.dof_count,
        origin=Origin(settings),
        postures=settings.postures,
        bits_per_joint=settings.bits_per_joint,
        binary=not settings.graded,
        lowest_angle=settings.lowest_angle - settings.neutral_angle,
        angle_step=settings.angle_step,
        steps_per_posture=chosen(
            lambda: min(Fraction(math.ceil(k * ratio - slack), k) for k in periods)
        ),
    )


def one_posture(controller: Controller, angle: float) -> Float[np.ndarray, " g"]:
    """Return genes that turn all joints to one angle (theta, degrees) in every posture."""
    assert isinstance(controller, PostureController)
    settings = controller.origin.settings
    number = round((angle - settings.lowest_angle) / settings.angle_step)
    bits = [number >> place & 1 for place in reversed(range(settings.bits_per_joint))]
    return np.tile(np.array(bits, np.float32), controller.gene_count // settings.bits_per_joint)


def _beyond(
    tree: Tree, settings: PostureSettings
) -> tuple[Bool[Numbers, " d"], tuple[Number, Number]]:
    """Return the joints whose motors cannot take the postures, and the range of angles, degrees.

    These are the slides, and joints that would be pulled beyond a limit.
    """
    lowest = settings.lowest_angle - settings.neutral_angle
    highest = lowest + settings.angle_step * (2**settings.bits_per_joint - 1)
    least, most = xp.deg2rad(xp.array([lowest, highest]))
    beyond = (least < tree.lower - _ANGLE_TOLERANCE) | (most > tree.upper + _ANGLE_TOLERANCE)
    # An angle is no command for a slide.
    beyond = beyond | tree.slides
    # A motor without a spring has no commanded angle.
    return beyond & (tree.servo_stiffness > 0), (lowest, highest)


def _check_limits(tree: Tree, settings: PostureSettings) -> None:
    beyond, (lowest, highest) = _beyond(tree, settings)
    for i in np.flatnonzero(beyond):
        if tree.slides[i]:
            raise ValueError(
                f"postures command angles, but joint {tree.dof_names[i]} slides. Set the stiffness "
                "of its actuator to 0, or choose brain_cpg"
            )
        lower, upper = np.rad2deg([tree.lower[i], tree.upper[i]])
        raise ValueError(
            f"the postures turn joint {tree.dof_names[i]} from {lowest:g} to {highest:g} degrees "
            f"(neutral pose: 0), but its limits_deg allow {lower:g} to {upper:g}"
        )
