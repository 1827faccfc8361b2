"""The brain: a feed-forward network of sigmoid units (Iwadate 2010, eqs. 2-3).

    u_i = sum_j w_ji v_j        (2)
    v_i = 1 / (1 + exp(-u_i / T))    (3)

| symbol | name |
|---|---|
| w_ji | ``genes`` |
| T | ``temperature`` |

Differs from Iwadate 2010: each unit has a bias (the weight of a unit that is always 1), and T is
a separate setting. The paper prints T_r, the CPG's rise time, but calls it a temperature.

The genes of a layer are its weights ``(out, in + 1)`` row by row, the bias last. All weights of a
unit are adjacent, so that one-point crossover tends to keep them together.
"""

import dataclasses
import itertools

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from evo_cpg.creature.algebra.linear import matvec
from evo_cpg.creature.algebra.numerics import Number

# XLA:CPU splits a sum over more than 32 terms into two passes and stores all products in between.
# Sums over blocks of this many terms take one pass each. The difference is 20 % of the time of a
# control step.
SUM_BLOCK = 32

# For each layer: the weights ``(out, in, *n)``, cut into blocks of at most `SUM_BLOCK` inputs, then
# the biases ``(out, *n)``.
Weights = tuple[tuple[Array, ...], ...]


@dataclasses.dataclass(frozen=True)
class BrainSettings:
    """Shape of the brain and range of its initial weights.

    Attributes:
        hidden: units in each hidden layer, at least 1. An empty list connects the inputs directly
            to the outputs.
        temperature: T of eq. 3, more than 0. If T is small, the output of a unit jumps from 0 to 1.
        init_range: largest magnitude of the uniform random genes of the first generation, more
            than 0.

    Raises:
        ValueError: a value is outside its range.
    """

    hidden: tuple[int, ...] = (16,)
    temperature: float = 1.0
    init_range: float = 2.0

    def __post_init__(self):
        if any(units < 1 for units in self.hidden):
            raise ValueError(f"hidden layers need at least one unit each, got {self.hidden}")
        for name in ("temperature", "init_range"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} must be positive, got {getattr(self, name)}")


class Brain(eqx.Module):
    """Structure of the network. Its weights are the genes.

    Attributes:
        sizes: number of inputs, units of each hidden layer, number of outputs.
        temperature: T of eq. 3.
    """

    sizes: tuple[int, ...] = eqx.field(static=True)
    temperature: Number

    @property
    def gene_count(self) -> int:
        """Number of weights, biases included."""
        return sum(
            (inputs + 1) * units
            for inputs, units in zip(self.sizes[:-1], self.sizes[1:], strict=True)
        )


def decode_weights(brain: Brain, genes: Float[Array, "g *n"]) -> Weights:
    """Return the weights for `think` from genes, layer by layer.

    Raises:
        ValueError: the number of genes does not fit the brain.
    """
    if genes.shape[0] != brain.gene_count:
        raise ValueError(f"the brain has {brain.gene_count} genes, but was given {genes.shape[0]}")
    sizes = list(itertools.pairwise(brain.sizes))
    # Use `jnp.split`, whose gradient is one concatenation. Gradients of slices are padded and
    # added.
    layers = jnp.split(genes, list(itertools.accumulate((i + 1) * o for i, o in sizes))[:-1])
    weights = []
    for (count, units), layer in zip(sizes, layers, strict=True):
        table = layer.reshape(units, count + 1, *genes.shape[1:])
        cuts = range(SUM_BLOCK, count, SUM_BLOCK)
        *blocks, bias = jnp.split(table, [*cuts, count], axis=1)
        weights.append((*blocks, bias[:, 0]))
    return tuple(weights)


def think(brain: Brain, weights: Weights, inputs: Float[Array, "i *n"]) -> Float[Array, "o *n"]:
    """Return the outputs of the brain, each between 0 and 1, with weights of `decode_weights`.

    Raises:
        ValueError: the number of inputs does not fit the brain.
    """
    if inputs.shape[0] != brain.sizes[0]:
        raise ValueError(
            f"the brain has {brain.sizes[0]} inputs, but was given {inputs.shape[0]} values. "
            "Build it for the sensors and joints of the creature"
        )
    values = inputs
    for *blocks, activation in weights:
        parts = jnp.split(values, list(range(SUM_BLOCK, values.shape[0], SUM_BLOCK)))
        for block, part in zip(blocks, parts, strict=True):
            activation = activation + matvec(block, part)
        values = jax.nn.sigmoid(activation / brain.temperature)
    return values
