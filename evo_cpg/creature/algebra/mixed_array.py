"""Arrays with some traced and otherwise known elements.

A parameter of a simulation changes few elements of its arrays. The other elements stay constants of
the compiled program, so zeros cost nothing. The matrices of a surface are mostly zeros.
"""

from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np


class MixedArray:
    """Array that JAX accepts as an array, with its known elements as constants.

    Attributes:
        known: the array, with arbitrary values in the places of the traced elements.
        traced: the traced elements.
        index: index of each element in ``known`` followed by ``traced``.
    """

    # With None, NumPy leaves arithmetic with this array to the methods below.
    __array_ufunc__ = None

    def __init__(self, known: np.ndarray, places: np.ndarray, traced: jax.Array):
        self.known, self.traced = known, traced
        self.index = np.arange(known.size)
        self.index[places] = known.size + np.arange(len(places))
        self.index = self.index.reshape(known.shape)

    def __jax_array__(self) -> jax.Array:
        """Return the whole array."""
        known = jnp.asarray(self.known.reshape(-1), self.traced.dtype)
        return jnp.concatenate([known, self.traced])[self.index]

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return getattr(self.__jax_array__(), name)

    def __getitem__(self, key: Any) -> jax.Array:
        return self.__jax_array__()[key]

    def __iter__(self) -> Iterator[jax.Array]:
        return iter(self.__jax_array__())

    def __len__(self) -> int:
        return len(self.known)

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the array."""
        return self.known.shape

    @property
    def dtype(self) -> Any:
        """Dtype of the traced elements, which all elements take."""
        return self.traced.dtype


def _operator(name: str) -> Any:
    def apply(self: MixedArray, *others: Any) -> Any:
        return getattr(self.__jax_array__(), name)(*(jnp.asarray(other) for other in others))

    return apply


for _name in ("add", "sub", "mul", "truediv", "pow"):
    for _side in ("", "r"):
        setattr(MixedArray, f"__{_side}{_name}__", _operator(f"__{_side}{_name}__"))
for _name in ("neg", "lt", "le", "gt", "ge"):
    setattr(MixedArray, f"__{_name}__", _operator(f"__{_name}__"))
