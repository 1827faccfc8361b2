"""The brain equals eqs. 2-3, written out unit by unit."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from evo_cpg.control.brain import Brain, decode_weights, think


def written_out(sizes, temperature, genes, inputs):
    """Return the outputs of eqs. 2-3, unit by unit, with a last input of 1 to each layer."""
    genes = iter(genes)
    values = list(inputs)
    for units in sizes[1:]:
        layer = []
        for _ in range(units):
            total = sum(next(genes) * value for value in [*values, 1.0])
            layer.append(1 / (1 + np.exp(-total / temperature)))
        values = layer
    assert next(genes, None) is None
    return values


@pytest.mark.parametrize("hidden", [(), (4,), (5, 3), (40,)])
@pytest.mark.parametrize("temperature", [1.0, 0.3])
def test_brain_equals_its_equations_written_out(hidden, temperature):
    rng = np.random.default_rng(0)
    brain = Brain((70, *hidden, 6), temperature)
    genes = rng.uniform(-0.5, 0.5, brain.gene_count)
    inputs = rng.uniform(-1, 1, 70)
    expected = written_out((70, *hidden, 6), temperature, genes, inputs)
    found = jax.jit(lambda g, v: think(brain, decode_weights(brain, g), v))(
        jnp.asarray(genes), jnp.asarray(inputs)
    )
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-13)


@pytest.mark.parametrize(
    ("genes", "inputs", "words"),
    [
        (1639, 93, "the brain has 94 inputs, but was given 93 values"),
        (1640, 94, "the brain has 1639 genes, but was given 1640"),
    ],
)
def test_wrong_number_of_inputs_or_genes_is_refused(genes, inputs, words):
    brain = Brain((94, 16, 7), 1.0)
    with pytest.raises(ValueError, match=words):
        think(brain, decode_weights(brain, jnp.zeros(genes)), jnp.zeros(inputs))
