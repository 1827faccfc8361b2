"""The random numbers of JAX: threefry-2x32 of Salmon et al. 2011, 20 rounds.

Two words of a key encrypt two words of a counter by additions, rotations and exclusive ors. Every
four rounds another pair of key words is added. The third key word is the exclusive or of the other
two and a constant.
"""

import jax
import numpy as np

_ROTATIONS = ((13, 15, 26, 6), (17, 29, 16, 24))
_PARITY = np.uint32(0x1BD11BDA)
_BITS = 32


def threefry2x32(
    key_0: jax.Array, key_1: jax.Array, count_0: jax.Array, count_1: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Return two random words for each pair of counter words.

    Args:
        key_0: first word of the key, uint32.
        key_1: second word of the key, uint32.
        count_0: first word of the counter, uint32.
        count_1: second word of the counter, uint32.
    """
    keys = key_0, key_1, key_0 ^ key_1 ^ _PARITY
    x, y = count_0 + key_0, count_1 + key_1
    for group in range(5):
        for turn in _ROTATIONS[group % 2]:
            x = x + y
            y = jax.lax.shift_left(y, np.uint32(turn)) | jax.lax.shift_right_logical(
                y, np.uint32(_BITS - turn)
            )
            y = y ^ x
        x = x + keys[(group + 1) % 3]
        y = y + keys[(group + 2) % 3] + np.uint32(group + 1)
    return x, y
