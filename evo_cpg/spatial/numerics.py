"""NumPy's functions for building models, which are JAX's where a number is traced.

A model is built from the numbers of a configuration. Of known numbers NumPy makes constants, in
float64 and without compiling anything; of traced ones the same lines make a JAX program, by which
the building can be differentiated, mapped and compiled. So builders call ``xp.sqrt`` and the like,
never write into arrays, and take what is no number from `evo_cpg.spatial.decisions`.
"""

from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np

from evo_cpg.spatial.mixed_array import MixedArray

# A float, or a traced scalar where a model is built of traced numbers.
Number = Any

# Coordinates.
Triple = tuple[Number, Number, Number]

# Names of arrays that are looked up by computed places: there is no derivative by them.
TABLES = ("heights", "meshes", "triangles")


def is_traced(*values: Any) -> bool:
    """Whether any number in some values, nested or not, is one of JAX's."""
    return any(isinstance(x, (jax.Array, MixedArray)) for x in jax.tree.leaves(values))


def _whole(value: Any) -> Any:
    """JAX's functions of jit refuse arrays that are but like its own."""
    return jnp.asarray(value) if isinstance(value, MixedArray) else value


class _Namespace:
    """A module of NumPy's, with JAX's functions of the same names for traced arguments."""

    def __init__(self, known: Any, traced: Any):
        self._known, self._traced = known, traced

    def __getattr__(self, name: str) -> Any:
        known = getattr(self._known, name)
        if isinstance(known, type(np)):
            found = _Namespace(known, getattr(self._traced, name))
        elif callable(known):
            found = self._either(name, known)
        else:
            found = known
        setattr(self, name, found)
        return found

    def _either(self, name: str, known: Any) -> Any:
        def call(*args: Any, **options: Any) -> Any:
            if is_traced(args, options):
                args, options = jax.tree.map(_whole, (args, options))
                return getattr(self._traced, name)(*args, **options)
            result = known(*args, **options)
            # A scalar of Python's leaves the precision to what it meets.
            return float(result) if isinstance(result, np.floating) else result

        return call

    def array(self, values: Any, dtype: Any = None) -> Any:
        """NumPy's; a nested sequence with few traced numbers is no long program."""
        leaves, structure = jax.tree.flatten(values)
        traced = [x for x in leaves if is_traced(x)]
        if not traced:
            return np.array(values, dtype)
        if any(np.ndim(x) for x in leaves):
            return jnp.array(values, dtype)
        known = [x for x in leaves if not is_traced(x)]
        every = jnp.stack(traced)
        if known:
            every = jnp.concatenate([every, np.array(known, every.dtype)])
        # Numbered as they stand there: the traced ones first.
        order = np.argsort([not is_traced(x) for x in leaves], kind="stable")
        numbers = np.empty(len(leaves), int)
        numbers[order] = np.arange(len(leaves))
        return every[np.array(jax.tree.unflatten(structure, numbers.tolist()))]


# Static types are NumPy's: what is traced has the same methods.
if TYPE_CHECKING:
    import numpy as xp

    Numbers = np.ndarray
else:
    xp = _Namespace(np, jnp)
    # An array of such numbers.
    Numbers = np.ndarray | jax.Array


def is_number(leaf: Any) -> bool:
    """Whether a leaf of a model is a known real number, or an array of them."""
    real = isinstance(leaf, np.ndarray) and np.issubdtype(leaf.dtype, np.floating)
    return real or isinstance(leaf, float)


def as_vector(values: Numbers) -> Triple:
    """Three numbers as a tuple, of floats where they are known."""
    x, y, z = values if is_traced(values) else values.tolist()
    return x, y, z
