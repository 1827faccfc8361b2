"""The operations of the graph, with the types of their operands and results.

A signature lists the types of the operands and, after the arrow, the type of the result. Equal
letters are equal types.

| letter | type |
|---|---|
| f, i, n | a float, an integer, a float or an integer |
| b | a truth value |
| k | an int32, an index into memory |
| a | any type |
| * | any type, independent of other letters |
| ... | any number of operands of the type before it |
"""

from types import UnionType
from typing import NamedTuple

from evo_cpg.native.ir.graph import Loop


class Operation(NamedTuple):
    """A kind of node.

    Attributes:
        signature: types of its operands and of its result.
        detail: type of its other data, or None if there is none.
    """

    signature: str
    detail: "type | UnionType | None" = None


def _each(names: str, signature: str) -> dict[str, Operation]:
    return dict.fromkeys(names.split(), Operation(signature))


ARITHMETIC: dict[str, Operation] = {
    **_each("add sub mul div rem max min", "n n -> n"),
    **_each("eq ne lt le gt ge", "a a -> b"),
    **_each("and or xor", "a a -> a"),
    **_each("shift_left shift_right_arithmetic shift_right_logical", "i i -> i"),
    **_each("abs neg sign", "n -> n"),
    **_each("ceil floor round sqrt", "f -> f"),
    **_each("is_finite", "f -> b"),
    **_each("not", "a -> a"),
    **_each("select", "b a a -> a"),
    **_each("convert bitcast", "a -> *"),
}
"""Operations that compute one scalar from others. Most have the names of JAX's primitives."""

LIBRARY: dict[str, Operation] = {
    **_each(
        "acos acosh asin asinh atan atanh cbrt cos cosh erf erfc exp exp2 expm1 lgamma log log1p"
        " sin sinh tan tanh",
        "f -> f",
    ),
    **_each("atan2 pow", "f f -> f"),
}
"""Functions of the C library, by the names of JAX's primitives."""

OPERATIONS: dict[str, Operation] = {
    **ARITHMETIC,
    **LIBRARY,
    # Multiply-adds: x y + z, x y - z, z - x y.
    **_each("fma fms fnma", "f f f -> f"),
    # Inputs of a block.
    "constant": Operation("-> *"),
    "input": Operation("-> *", tuple),
    "carried": Operation("-> *"),
    "counter": Operation("-> k"),
    # Other names of a number, for use in another part or block.
    "opaque": Operation("a -> a", int | None),
    "inside": Operation("a -> a"),
    # Tables in memory, and the numbers in them.
    "constants": Operation("-> *", bytes),
    "rows": Operation("a... -> a"),
    "solve": Operation("f... -> f", int),
    "sums": Operation("n... -> n"),
    "totals": Operation("n... -> n"),
    "accumulate": Operation("k n n -> n"),
    "lookup": Operation("a k -> a"),
    # Loops. A list holds the values that each round has written.
    "loop": Operation("*... -> b", Loop),
    "result": Operation("b -> *", int),
    "list": Operation("b -> *", int),
}

COMMUTATIVE = {"add", "mul", "max", "min", "and", "or", "xor", "eq", "ne"}
PREDICATES = {op for op, each in ARITHMETIC.items() if each.signature.endswith("-> b")}
"""Operations whose result is a truth value."""
