"""Test native code: ``python -m evo_cpg.native.self_test avx2`` exits with 0 on success."""

import functools
import sys
import warnings

import jax
import jax.numpy as jnp
import numpy as np

from evo_cpg.native import engine
from evo_cpg.native.fuse import fuse


def main(instructions: str) -> None:
    """Compare a small program in native code with JAX, for one individual and for many.

    Raises:
        ArithmeticError: the results differ.
    """

    def program(x: jax.Array) -> tuple[jax.Array, jax.Array]:
        def turn(carry: jax.Array, i: jax.Array) -> tuple[jax.Array, None]:
            return jnp.sin(carry) + x[1] * i.astype(x.dtype), None

        return jax.lax.scan(turn, x[0], jnp.arange(3))[0], (x > 0).any(0)

    values = np.linspace(-2, 2, 120, dtype=np.float32).reshape(2, 60)
    own = engine.Engine("native", instructions, tested=False)  # pyright: ignore
    with engine.using(own), warnings.catch_warnings():
        # A fallback to JAX must fail the test.
        warnings.simplefilter("error", engine.EngineWarning)
        for count in (1, 3, 60):
            x = jnp.asarray(values[:, :count])
            found = jax.jit(functools.partial(fuse, program, batch_ndim=1))(x)
            for got, expected in zip(found, program(x), strict=True):
                if not np.allclose(got, expected, rtol=1e-5, atol=1e-6):
                    raise ArithmeticError(f"native code and JAX differ for {count} individuals")


if __name__ == "__main__":
    main(sys.argv[1])
