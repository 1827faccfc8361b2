"""NumPy functions for building models, replaced by JAX functions for traced numbers.

A model is built from the numbers of a configuration. NumPy turns known numbers into constants, in
float64 and without compilation. With traced numbers the same lines make a JAX program. So the
building can be differentiated, mapped and compiled. Builders call ``xp.sqrt`` and similar
functions, and never write into arrays. Choices other than numbers go through
`evo_cpg.creature.algebra.decisions`.
"""

from collections.abc import Iterator
from functools import partialmethod
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np


class MixedArray:
    """Array that JAX accepts as an array, with its known elements as constants.

    Attributes:
        known: the array, with arbitrary values in the places of the traced elements.
        traced: the traced elements. Several arrays may have elements in one such vector.
        index: index of each element in ``known`` followed by ``traced``.
        signs: factor of each element, or None if all are 1.
        shape: shape of the array.
        dtype: dtype of the traced elements, which all elements take.
    """

    # With None, NumPy leaves arithmetic with this array to the methods below.
    __array_ufunc__ = None

    def __init__(
        self,
        known: np.ndarray,
        places: np.ndarray,
        traced: jax.Array,
        sources: np.ndarray | None = None,
        signs: np.ndarray | None = None,
    ):
        """Make an array of known and traced elements.

        Args:
            known: the array.
            places: indices of the traced elements in the flattened array.
            traced: vector of traced numbers.
            sources: index of each traced element in the vector, or None for all in order.
            signs: 1 or -1 for each traced element, or None for 1.
        """
        self.known, self.traced = known, traced
        self.index = np.arange(known.size)
        self.index[places] = known.size + (np.arange(len(places)) if sources is None else sources)
        self.index = self.index.reshape(known.shape)
        self.signs = None
        if signs is not None and (signs < 0).any():
            self.signs = np.ones(known.size)
            self.signs[places] = signs
            self.signs = self.signs.reshape(known.shape)
        self.shape, self.dtype = known.shape, traced.dtype

    def __jax_array__(self) -> jax.Array:
        """Return the whole array."""
        size = self.known.size
        if (self.index >= size).all():
            array = self.traced[self.index - size]
        else:
            known = jnp.asarray(self.known.reshape(-1), self.traced.dtype)
            array = jnp.concatenate([known, self.traced])[self.index]
        return array if self.signs is None else array * jnp.asarray(self.signs, array.dtype)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return getattr(self.__jax_array__(), name)

    def __getitem__(self, key: Any) -> jax.Array:
        if any(isinstance(x, jax.Array) for x in jax.tree.leaves(key)):
            return self.__jax_array__()[key]
        known, index, size = np.asarray(self.known[key]), self.index[key], self.known.size
        places = np.flatnonzero(index >= size)
        if not places.size:
            return jnp.asarray(known, self.dtype)
        signs = None if self.signs is None else self.signs[key].reshape(-1)[places]
        sources = index.reshape(-1)[places] - size
        return MixedArray(known, places, self.traced, sources, signs).__jax_array__()

    def __iter__(self) -> Iterator[jax.Array]:
        return iter(self.__jax_array__())

    def __len__(self) -> int:
        return len(self.known)

    def _operate(self, name: str, *others: Any) -> Any:
        return getattr(self.__jax_array__(), name)(*(jnp.asarray(other) for other in others))


_BOTH_SIDES = [
    f"{side}{name}" for name in ("add", "sub", "mul", "truediv", "pow") for side in ("", "r")
]
for _name in (*_BOTH_SIDES, "neg", "lt", "le", "gt", "ge"):
    setattr(MixedArray, f"__{_name}__", partialmethod(MixedArray._operate, f"__{_name}__"))


# A float, or a traced scalar while a model is built from traced numbers.
Number = Any

# Three coordinates.
Triple = tuple[Number, Number, Number]

# Names of model fields with tables, whose elements are read at computed indices. A simulation has
# no derivative by these elements.
TABLES = ("heights", "meshes", "triangles")


# Types of values that contain no JAX array.
_PLAIN = frozenset({np.ndarray, np.float64, float, int, bool, str, type(None)})


def is_traced(*values: Any) -> bool:
    """Return whether any number in the values, nested or not, is a JAX array or a mixed array."""
    for x in values:
        # Most values are plain, and a model asks a hundred thousand times.
        if type(x) in _PLAIN:
            continue
        if type(x) in (list, tuple):
            found = is_traced(*x)
        else:
            found = any(isinstance(y, (jax.Array, MixedArray)) for y in jax.tree.leaves(x))
        if found:
            return True
    return False


class _Namespace:
    """NumPy module that calls the JAX functions of the same names for traced arguments."""

    def __init__(self, known: Any, traced: Any):
        self._known, self._traced = known, traced

    def __getattr__(self, name: str) -> Any:
        known = getattr(self._known, name)

        def call(*args: Any, **options: Any) -> Any:
            if is_traced(*args, *options.values()):
                # Jitted JAX functions refuse a `MixedArray`.
                args, options = jax.tree.map(
                    lambda x: jnp.asarray(x) if isinstance(x, MixedArray) else x, (args, options)
                )
                return getattr(self._traced, name)(*args, **options)
            result = known(*args, **options)
            # A Python scalar takes the precision of the array it is combined with.
            return float(result) if isinstance(result, np.floating) else result

        if isinstance(known, type(np)):
            found = _Namespace(known, getattr(self._traced, name))
        else:
            found = call if callable(known) else known
        setattr(self, name, found)
        return found

    def array(self, values: Any, dtype: Any = None) -> Any:
        """Return an array. A nested sequence with few traced numbers gives a short program."""
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
        # Number the leaves as in ``every``: traced numbers first.
        order = np.argsort([not is_traced(x) for x in leaves], kind="stable")
        numbers = np.empty(len(leaves), int)
        numbers[order] = np.arange(len(leaves))
        return every[np.array(jax.tree.unflatten(structure, numbers.tolist()))]


# Static types are NumPy types: traced arrays have the same methods.
if TYPE_CHECKING:
    import numpy as xp

    Numbers = np.ndarray
else:
    xp = _Namespace(np, jnp)
    # An array of known or traced numbers.
    Numbers = np.ndarray | jax.Array


def smooth_step(x: Number) -> Number:
    """Return 0 for x up to 0, 1 for x from 1 on, and the cubic x^2 (3 - 2 x) in between."""
    x = xp.clip(x, 0.0, 1.0)
    return x * x * (3.0 - 2.0 * x)


def is_number(leaf: Any) -> bool:
    """Return whether a leaf of a model is a known real number or an array of real numbers."""
    real = isinstance(leaf, np.ndarray) and np.issubdtype(leaf.dtype, np.floating)
    return real or isinstance(leaf, float)


def as_vector(values: Numbers) -> Triple:
    """Return three numbers as a tuple. Known numbers become floats."""
    x, y, z = values if is_traced(values) else values.tolist()
    return x, y, z
