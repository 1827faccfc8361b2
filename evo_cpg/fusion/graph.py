"""A program on scalars as a graph in which equal things are one thing.

Each node is one scalar operation. Building it folds constants, drops what multiplies by zero or
one, and reuses nodes that are already there, so a creature's zeros (a centre of mass on the joint,
a principal axis) cost nothing in the end. These simplifications are exact, with two exceptions: the
sign of a zero, and that 0 x stays 0 where x is not finite.

Scalars with the same history (the same quantity of each of four legs) can be the *lanes* of one
node: one operation then does for all of them, over arrays that are four times as long. `Graph.pack`
makes lanes of scalars and `Graph.lane` takes one out again; each undoes the other, so values that
stay in lanes are never moved.
"""

import functools
from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import Primitive

# Evaluated in NumPy when all operands are constants; anything else is left to XLA.
_FOLDABLE: dict[str, Callable] = {
    "add": np.add,
    "sub": np.subtract,
    "mul": np.multiply,
    "div": np.divide,
    "neg": np.negative,
    "abs": np.abs,
    "max": np.maximum,
    "min": np.minimum,
    "floor": np.floor,
    "sqrt": np.sqrt,
    "sign": np.sign,
    "eq": np.equal,
    "ne": np.not_equal,
    "lt": np.less,
    "le": np.less_equal,
    "gt": np.greater,
    "ge": np.greater_equal,
    "and": np.bitwise_and,
    "or": np.bitwise_or,
    "not": np.invert,
}

_COMMUTATIVE = {"add", "mul", "max", "min", "and", "or", "eq", "ne"}

# Functions that XLA:CPU computes several times faster in kernels of their own, over whole arrays.
_COSTLY = {
    "acos",
    "asin",
    "atan",
    "atan2",
    "cos",
    "erf",
    "exp",
    "expm1",
    "log",
    "log1p",
    "logistic",
    "pow",
    "sin",
    "tan",
    "tanh",
}


# Scalars to lanes, a lane to a scalar, and the sum of the lanes: done with whole arrays, outside of
# the kernels.
pack_p, lane_p, lane_sum_p = (Primitive(name) for name in ("pack", "lane", "lane_sum"))

# The same scalar, but what is computed from it is not taken for what is there already.
again_p = Primitive("again")
_MOVES = {"pack", "lane", "lane_sum"}


class Call:
    """A function of whole arrays that is evaluated for all individuals as it stands.

    Attributes:
        function: of arrays with trailing batch axes; returns a tuple of arrays.
        inputs: arrays of nodes.
        outputs: arrays of nodes, each of which has this call and all inputs as operands.
    """

    def __init__(self, function: Callable[..., tuple], inputs: list[np.ndarray]):
        self.function = function
        self.inputs = inputs
        self.outputs: list[np.ndarray] = []


class Node:
    """One scalar: a constant, an input, an operation, or an element of a call's results.

    Attributes:
        primitive: None for constants and inputs; a `Call` for its elements.
        params: of the primitive.
        operands: nodes.
        dtype: of the value.
        value: of a constant, else None.
        number: nodes are numbered as they are made; operands come before their users.
        precision: the floating-point type that it, or else what it comes from, has, if any.
        level: how many costly functions precede it on the longest path.
        company: the nodes that are wanted at the same time, itself among them; see `together`.
        lanes: how many scalars it stands for.
        source: of one lane of another node, that node and the lane's number.
    """

    __slots__ = (
        "company",
        "dtype",
        "lanes",
        "level",
        "number",
        "operands",
        "params",
        "precision",
        "primitive",
        "source",
        "value",
    )

    def __init__(
        self,
        number: int,
        dtype: np.dtype,
        primitive: "Primitive | Call | None" = None,
        params: Mapping[str, Any] | None = None,
        operands: "tuple[Node, ...]" = (),
        value: Any = None,
        lanes: int = 1,
        source: "tuple[Node, int] | None" = None,
    ):
        self.number = number
        self.dtype = dtype
        self.primitive = primitive
        self.params = params or {}
        self.operands = operands
        self.value = value
        types = [dtype] if jnp.issubdtype(dtype, jnp.floating) else []
        types += [node.precision for node in operands if node.precision is not None]
        self.precision = types[0] if types else None
        self.company: tuple[Node, ...] = ()
        self.lanes = lanes
        self.source = source
        self.level = max((node.level + node.costly for node in operands), default=0)

    @property
    def name(self) -> str:
        """Of the primitive, or nothing."""
        return self.primitive.name if isinstance(self.primitive, Primitive) else ""

    def evaluate(self, *operands: jax.Array | np.generic) -> Any:
        """The operation on given operands."""
        assert isinstance(self.primitive, Primitive)
        if self.primitive is again_p:
            return operands[0]
        return self.primitive.bind(*operands, **self.params)

    @property
    def costly(self) -> bool:
        """Whether it gets a kernel of its own."""
        special = _COSTLY | _MOVES
        return isinstance(self.primitive, Call) or self.name in special or self._changes_precision

    @property
    def uniform(self) -> bool:
        """Whether it is made of lanes that are all one scalar."""
        return self.primitive is pack_p and self.operands == (self.operands[0],) * self.lanes

    @property
    def _changes_precision(self) -> bool:
        """Whether it converts one floating-point type to another, which no kernel may mix."""
        return (
            self.name == "convert_element_type"
            and jnp.issubdtype(self.dtype, jnp.floating)
            and jnp.issubdtype(self.operands[0].dtype, jnp.floating)
        )

    @property
    def is_operation(self) -> bool:
        """Neither a constant nor an input."""
        return self.primitive is not None


class Graph:
    """Makes nodes, and hands out the one that is there already.

    Attributes:
        lane_constants: values ``(lanes,)`` of the inputs that are constants, one for each lane.
    """

    def __init__(self):
        self._nodes: dict[Any, Node] = {}
        self.lane_constants: dict[Node, np.ndarray] = {}

    def input(self, key: Any, dtype: np.dtype) -> Node:
        """The input with this key."""
        return self._unique(("input", key), dtype)

    def constant(self, value: Any, dtype: np.dtype) -> Node:
        """A constant of the given type."""
        value = np.asarray(value, dtype)[()]
        return self._unique(("constant", dtype, value.tobytes()), dtype, value=value)

    def apply(self, primitive: Primitive, params: dict, operands: tuple[Node, ...]) -> Node:
        """The result of an elementwise primitive on scalars."""
        lanes = max(node.lanes for node in operands)
        if lanes > 1 and all(n.value is not None or n in self.lane_constants for n in operands):
            each = (tuple(self.lane(n, i) for n in operands) for i in range(lanes))
            return self.pack(tuple(self.apply(primitive, params, one) for one in each))
        name = primitive.name
        dtype = operands[-1].dtype
        if name in {"square", "integer_pow"}:
            return self._power(operands[0], params.get("y", 2))
        if name in {"eq", "ne", "lt", "le", "gt", "ge", "is_finite"}:
            dtype = np.dtype(bool)
        elif name == "convert_element_type":
            dtype = np.dtype(params["new_dtype"])
            if dtype == operands[0].dtype:
                return operands[0]
            if operands[0].value is not None:
                return self.constant(operands[0].value, dtype)
        if name in _FOLDABLE and all(node.value is not None for node in operands):
            with np.errstate(all="ignore"):
                return self.constant(_FOLDABLE[name](*(n.value for n in operands)), dtype)
        simpler = self._simplify(name, operands)
        if simpler is not None:
            return simpler
        if name in _COMMUTATIVE:
            operands = tuple(sorted(operands, key=lambda node: node.number))
        key = (name, repr(sorted(params.items())), *(node.number for node in operands))
        return self._unique(
            key, dtype, primitive=primitive, params=params, operands=operands, lanes=lanes
        )

    def pack(self, scalars: tuple[Node, ...]) -> Node:
        """A node whose lanes are the given scalars; a constant stays one if all are the same."""
        first, lanes = scalars[0], len(scalars)
        if lanes == 1 or (first.value is not None and scalars == (first,) * lanes):
            return first
        if first.source is not None:
            whole = first.source[0]
            if whole.lanes == lanes and all(
                node.source == (whole, i) for i, node in enumerate(scalars)
            ):
                return whole
        if all(node.value is not None for node in scalars):
            values = np.array([node.value for node in scalars], first.dtype)
            node = self._unique(("lanes", first.dtype, values.tobytes()), first.dtype, lanes=lanes)
            self.lane_constants[node] = values
            return node
        key = ("pack", *(node.number for node in scalars))
        return self._unique(key, first.dtype, primitive=pack_p, operands=scalars, lanes=lanes)

    def lane(self, node: Node, number: int) -> Node:
        """One of a node's lanes; a scalar has the same in all."""
        if node.lanes == 1:
            return node
        if node in self.lane_constants:
            return self.constant(self.lane_constants[node][number], node.dtype)
        key = ("lane", node.number, number)
        source = (node, number)
        return self._unique(key, node.dtype, primitive=lane_p, operands=(node,), source=source)

    def again(self, node: Node) -> Node:
        """The same number as a node of its own, so that its users are nodes of their own."""
        if node.value is not None or node in self.lane_constants:
            return node
        key = ("again", len(self._nodes))
        return self._unique(key, node.dtype, primitive=again_p, operands=(node,), lanes=node.lanes)

    def lane_sum(self, node: Node) -> Node:
        """The sum of a node's lanes."""
        if node in self.lane_constants:
            return functools.reduce(self.add, (self.lane(node, i) for i in range(node.lanes)))
        key = ("lane_sum", node.number)
        return self._unique(key, node.dtype, primitive=lane_sum_p, operands=(node,))

    def call(
        self,
        function: Callable[..., tuple],
        inputs: list[np.ndarray],
        shapes: list[tuple[tuple[int, ...], np.dtype]],
    ) -> list[np.ndarray]:
        """Arrays of nodes for the results of a function of whole arrays.

        Args:
            function: see `Call`.
            inputs: arrays of nodes.
            shapes: shape and type of each result, for one individual.
        """
        call = Call(function, inputs)
        operands = tuple(node for array in inputs for node in array.flat)
        for k, (shape, dtype) in enumerate(shapes):
            array = np.empty(shape, object)
            for index in np.ndindex(shape):
                key = (id(call), k, index)
                array[index] = self._unique(key, dtype, primitive=call, operands=operands)
            call.outputs.append(array)
        return call.outputs

    def add(self, a: Node, b: Node) -> Node:
        """The sum a + b."""
        return self.apply(jax.lax.add_p, {}, (a, b))

    def subtract(self, a: Node, b: Node) -> Node:
        """The difference a - b."""
        return self.apply(jax.lax.sub_p, {}, (a, b))

    def multiply(self, a: Node, b: Node) -> Node:
        """The product a b."""
        return self.apply(jax.lax.mul_p, {}, (a, b))

    def negate(self, a: Node) -> Node:
        """The negative of a."""
        return self.apply(jax.lax.neg_p, {}, (a,))

    def _power(self, base: Node, exponent: int) -> Node:
        if exponent < 0:
            one = self.constant(1, base.dtype)
            return self.apply(jax.lax.div_p, {}, (one, self._power(base, -exponent)))
        if exponent == 0:
            return self.constant(1, base.dtype)
        half = self._power(base, exponent // 2)
        square = self.multiply(half, half) if exponent > 1 else half
        return self.multiply(square, base) if exponent % 2 else square

    def _simplify(self, name: str, operands: tuple[Node, ...]) -> Node | None:
        """An equal node that costs less, if there is one."""
        if name == "select_n" and operands[0].value is not None:
            return operands[1 + int(operands[0].value)]
        if not jnp.issubdtype(operands[0].dtype, jnp.floating):
            return None
        if name == "neg" and operands[0].name == "neg":
            return operands[0].operands[0]
        if name == "mul":
            return self._simplify_product(*operands) or self._simplify_product(*operands[::-1])
        if name == "add":
            return self._simplify_sum(*operands) or self._simplify_sum(*operands[::-1])
        if name == "sub":
            a, b = operands
            if b.value == 0:
                return a
            if a.value == 0:
                return self.negate(b)
            if b.name == "neg":
                return self.add(a, b.operands[0])
        if name == "div":
            a, b = operands
            if a.value == 0 or b.value == 1:
                return a
        return None

    def _simplify_product(self, factor: Node, other: Node) -> Node | None:
        if factor.value is None:
            return None
        if factor.value == 0:
            return factor
        if factor.value == 1:
            return other
        # Minus signs move outward, where sums absorb them and equal products meet.
        if factor.value < 0:
            return self.negate(self.multiply(self.constant(-factor.value, factor.dtype), other))
        return None

    def _simplify_sum(self, term: Node, other: Node) -> Node | None:
        if term.value is not None and term.value == 0:
            return other
        return self.subtract(other, term.operands[0]) if term.name == "neg" else None

    def _unique(self, key: Any, dtype: np.dtype, **parts) -> Node:
        node = self._nodes.get(key)
        if node is None:
            node = self._nodes[key] = Node(len(self._nodes), dtype, **parts)
        return node
