"""A brain that fits any body: one small network gives every joint axis its character.

Each joint axis has an oscillator, coupled along the limbs (`evo_cpg.control.limb_oscillators`). The
network knows an axis only by its *place* (`evo_cpg.control.places`): numbers that exist in any
body. So one brain drives any number of limbs, and a limb that has just grown moves at once. The
network runs once per trial, because places do not change. It returns the *character* of each axis,
eleven numbers (`CHARACTER`), of which genes change a part for each axis.

Each axis senses the light by its own part. Its *lure* l, from -1 to 1, is how straight the part
moves to the light when the axis turns to positive angles. Its *wish* is ``g = tanh(e^s l)``. With
the swing r of the oscillator, from -1 to 1, and the angle p as a fraction of its range,

    q = A e^(k (|l| - 1/2)) r + (o + f a) g,    m = tanh(e^K (q - p)),    v = m (1 - c m g),

where a is 1 if the part points at the light, and v times a constant is the commanded rate. So a
part moves fast away from the light and slowly back (c > 0). Drag grows with the square of the
speed, and the body is pushed to the light, whatever its attitude. No limb has to know the others.

All equations are odd but for the start of the oscillator: an axis that is turned the other way
round commands the opposite rate. So the two limbs of a pair mirror each other.
"""

import dataclasses
import importlib.resources
from typing import Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from typing_extensions import override

from evo_cpg.control.controller import Command, Controller, Observation
from evo_cpg.control.couplings import UnfitError
from evo_cpg.control.limb_oscillators import (
    LimbOscillators,
    LimbOscillatorSettings,
    LimbRhythm,
    LimbState,
    build_limb_oscillators,
)
from evo_cpg.control.matsuoka import output
from evo_cpg.control.places import PLACE, directions, places
from evo_cpg.creature.algebra.linear import expand_dims_like, matmul
from evo_cpg.creature.algebra.numerics import Number, Numbers
from evo_cpg.creature.tree import Tree
from evo_cpg.errors import nearest

CHARACTER = {
    "adaptation": (0.0, 3.0),
    "coupling": (0.0, 1.0),
    "start": (0.0, 3.0),
    "amplitude": (1.4, 1.0),
    "stiffness": (0.8, 1.0),
    "contrast": (1.0, 1.0),
    "sharpness": (0.8, 1.0),
    "lean": (0.2, 0.5),
    "steering": (0.3, 1.0),
    "fold": (0.0, 0.5),
    "gate": (0.3, 1.0),
}
"""Numbers of an axis: of a brain without weights, and the largest change by a gene.

They are, in the symbols above: b, w and the first x of the oscillator before they are limited, A,
K, c before tanh, s, o, steering of the oscillator by g before tanh, f and k.
"""

HIDDEN = 8
"""Units in the hidden layer of the network."""

WEIGHTS = (HIDDEN * (len(PLACE) + 1), len(CHARACTER) * (HIDDEN + 1))
"""Numbers of weights of both layers, biases included."""

# Slope of the swing over the oscillator's output, as a fraction of the largest tonic input, and
# the largest potential at the start, as such a fraction.
_SLOPE, _START = 5.0, 0.3
# Largest change of the tonic inputs by steering.
_STEERING = 0.5


@dataclasses.dataclass(frozen=True)
class BodyBrainSettings:
    """Settings of the brain that fits any body.

    Attributes:
        brain: ``newborn``, the shipped brain, or ``untrained``, without weights.
        time_scale: factor on the time constants of the oscillators, more than 0.
        max_rate: largest commanded rate of a motor, rad/s, more than 0.
        spread: largest change by the first genes, as a fraction of all changes, 0 to 1.
        eyes: names of bodies with eyes, or None if each part senses the light. A part senses it if
            it has an eye or hangs on a part that senses it.

    Raises:
        ValueError: a value is outside its range.
    """

    brain: Literal["newborn", "untrained"] = "newborn"
    time_scale: float = 0.4
    max_rate: float = 30.0
    spread: float = 0.1
    eyes: tuple[str, ...] | None = None

    def __post_init__(self):
        for name in ("time_scale", "max_rate"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} must be positive, got {getattr(self, name)}")
        if not 0 <= self.spread <= 1:
            raise ValueError(f"spread must be from 0 to 1, got {self.spread}")


class Character(NamedTuple):
    """Decoded genes of the axes.

    Attributes:
        rhythm: numbers of the oscillators.
        numbers: the other numbers of `CHARACTER`, from the amplitude on.
    """

    rhythm: LimbRhythm
    numbers: Float[Array, "8 d *n"]


class BodyBrain(Controller):
    """The brain of one creature.

    The genome has one gene from 0 to 1 for each number of each axis, in the order of `CHARACTER`.
    The gene 1/2 keeps the network's number.

    Attributes:
        oscillators: the oscillators.
        tree: the creature.
        weights: weights of the network, layer by layer, row by row, biases last.
        spread: largest change by the first genes, as a fraction of all changes.
        sight: factor on the direction of the light for each body, or one for all: 0 is blind.
    """

    oscillators: LimbOscillators
    tree: Tree
    weights: Float[Numbers, " w"]
    gene_count: int = eqx.field(static=True)
    spread: float = eqx.field(static=True)
    sight: Float[Numbers, " b"] | Number = 1.0

    uses_bearing = True
    signal_label = "CPG output (no unit)"

    @override
    def random_genes(
        self, key: Array, batch: tuple[int, ...], dtype: jnp.dtype | type
    ) -> Float[Array, "g *n"]:
        shape = (self.gene_count, *batch)
        return 0.5 + self.spread * (jax.random.uniform(key, shape, dtype) - 0.5)

    @override
    def initial_state(self, batch: tuple[int, ...], dtype: jnp.dtype | type) -> LimbState:
        return self.oscillators.initial_state(batch, dtype)

    @override
    def decode(self, genes: Float[Array, "g *n"]) -> Character:
        changes = 2.0 * jnp.clip(genes, 0.0, 1.0).reshape(len(CHARACTER), -1, *genes.shape[1:]) - 1
        first, largest = (expand_dims_like(x, changes) for x in np.array([*CHARACTER.values()]).T)
        numbers = first + self._network(changes) + largest * changes
        adaptation, coupling, start = numbers[0], numbers[1], jax.nn.sigmoid(numbers[2])
        own = self.oscillators.settings
        tonic, span = own.max_tonic_input, own.max_adaptation_gain - own.min_adaptation_gain
        rhythm = LimbRhythm(
            tonic * jnp.ones((2, *start.shape), start.dtype),
            own.min_adaptation_gain + span * jax.nn.sigmoid(adaptation),
            own.max_coupling * jnp.tanh(coupling),
            _START * tonic * jnp.stack([start, 1.0 - start]),
        )
        return Character(rhythm, numbers[3:])

    def _network(self, like: Float[Array, "c d *n"]) -> Float[Array, "c d *n"]:
        """Return the network's output for all axes."""
        inner, outer = jnp.split(jnp.asarray(self.weights, like.dtype), [WEIGHTS[0]])
        # Without limits the network extrapolates badly to animals of other sizes than in training.
        place = expand_dims_like(jnp.clip(places(self.tree), -1.0, 1.0), like)
        values = jnp.broadcast_to(place, (len(place), *like.shape[1:]))
        for layer in (inner.reshape(HIDDEN, -1), outer.reshape(len(CHARACTER), -1)):
            weights = expand_dims_like(layer, like)
            values = matmul(weights, jnp.concatenate([values, jnp.ones_like(values[:1])]))
            values = jnp.tanh(values) if len(layer) == HIDDEN else values
        return values

    @override
    def act(
        self, decoded: Character, state: LimbState, observation: Observation
    ) -> tuple[LimbState, Command]:
        """Advance the oscillators by one control step, and command motors and muscles."""
        amplitude, stiffness, contrast, sharpness, lean, steering, fold, gate = decoded.numbers
        lure, ahead, angle = self._senses(observation)
        wish = jnp.tanh(jnp.exp(sharpness) * lure)
        moved, swing = self._swung(decoded, state, _STEERING * jnp.tanh(steering) * wish)
        goal = amplitude * jnp.exp(gate * (jnp.abs(lure) - 0.5)) * swing
        goal = goal + (lean + fold * ahead) * wish
        move = jnp.tanh(jnp.exp(stiffness) * (goal - angle))
        slower = jnp.tanh(contrast)
        drive = move * (1.0 - slower * move * wish) / (1.0 + jnp.abs(slower))
        active = None
        if self.tree.muscles is not None:
            active = jnp.stack([jnp.maximum(drive, 0.0), jnp.maximum(-drive, 0.0)])
        rate = self.oscillators.settings.max_rate * drive
        return moved, Command(rate, output(moved), None, active)

    def _senses(self, observation: Observation) -> tuple[Array, Array, Array]:
        """Return lure, direction along the part, and angle of each axis, all from -1 to 1."""
        assert observation.bearing is not None
        own, angle = directions(self.tree), observation.joint_angle
        sight = jnp.broadcast_to(jnp.asarray(self.sight, angle.dtype), (self.tree.body_count,))
        bearing = jnp.stack([sight[i] * observation.bearing[:, i] for i in self.tree.dof_bodies], 1)
        sweep, along = (expand_dims_like(x, bearing) for x in (own.sweep, own.along))
        middle, half = (expand_dims_like(x, angle) for x in (own.middle, own.half))
        return (sweep * bearing).sum(0), (along * bearing).sum(0), (angle - middle) / half

    def _swung(
        self, decoded: Character, state: LimbState, turn: Float[Array, "d *n"]
    ) -> tuple[LimbState, Float[Array, "d *n"]]:
        """Return the neurons after a control step, and the swing of each axis."""
        tonic = decoded.rhythm.tonic_input * jnp.stack([1.0 + turn, 1.0 - turn])
        start = jnp.where(state.started, state.potential, decoded.rhythm.start)
        # The tree may be a plan's own.
        oscillators = dataclasses.replace(self.oscillators, tree=self.tree)
        moved = oscillators.advanced(
            decoded.rhythm._replace(tonic_input=tonic), dataclasses.replace(state, potential=start)
        )
        return moved, jnp.tanh(_SLOPE / oscillators.settings.max_tonic_input * output(moved))


def build_body_brain(tree: Tree, settings: BodyBrainSettings, control_step: float) -> BodyBrain:
    """Build the controller for a creature's tree.

    Raises:
        ValueError: the creature has no joint.
        UnfitError: the creature lacks a body with an eye.
    """
    own = LimbOscillatorSettings(time_scale=settings.time_scale, max_rate=settings.max_rate)
    weights = np.zeros(sum(WEIGHTS)) if settings.brain == "untrained" else newborn_weights()
    return BodyBrain(
        oscillators=build_limb_oscillators(tree, own, control_step),
        tree=tree,
        weights=weights,
        gene_count=len(CHARACTER) * tree.dof_count,
        spread=settings.spread,
        sight=1.0 if settings.eyes is None else _sight(tree, settings.eyes),
    )


def _sight(tree: Tree, eyes: tuple[str, ...]) -> Float[np.ndarray, " b"]:
    """Return 1 for each body with an eye on it or on an ancestor, otherwise 0."""
    for i, name in enumerate(eyes):
        if name not in tree.names:
            problem = f"unknown body {name!r}: {nearest(name, tree.names)}"
            raise UnfitError(problem, ("eyes", i), unknown_name=True)
    own = np.isin(tree.names, eyes)
    for body, parent in enumerate(tree.parents):
        own[body] |= parent >= 0 and own[parent]
    return own.astype(float)


def newborn_weights() -> Float[np.ndarray, " w"]:
    """Return the weights of the shipped brain (`evo_cpg.studies.newborns`)."""
    file = importlib.resources.files("evo_cpg.control") / "newborn.txt"
    return np.array(file.read_text().split(), float)
