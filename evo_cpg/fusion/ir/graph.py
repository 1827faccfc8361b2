"""A program on scalars as a graph in which equal things are one thing.

Each node is one operation on one scalar. Making it folds constants, drops what multiplies by zero
or one, and hands out the node that is there already, so a creature's zeros (a centre of mass on the
joint, a principal axis) cost nothing in the end. These simplifications are exact, with two
exceptions: the sign of a zero, and that 0 x stays 0 where x is not finite.

A node lies in the *block* of the innermost loop that any of its operands lies in, so what does not
change in a loop is computed before it. A node is *uniform* if it is the same for all individuals:
a number that they share, the counter of a loop, and what is computed from these.
"""

import contextlib
import functools
import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

# Evaluated by NumPy where all operands are constants.
_FOLDED: dict[str, Callable] = {
    "abs": np.abs,
    "add": np.add,
    "and": np.bitwise_and,
    "ceil": np.ceil,
    "div": lambda a, b: np.divide(a, b) if a.dtype.kind == "f" else _whole_quotient(a, b),
    "eq": np.equal,
    "floor": np.floor,
    "ge": np.greater_equal,
    "gt": np.greater,
    "is_finite": np.isfinite,
    "le": np.less_equal,
    "lt": np.less,
    "max": np.maximum,
    "min": np.minimum,
    "mul": np.multiply,
    "ne": np.not_equal,
    "neg": np.negative,
    "not": np.invert,
    "or": np.bitwise_or,
    "round": np.rint,
    "shift_left": np.left_shift,
    "sign": np.sign,
    "sqrt": np.sqrt,
    "sub": np.subtract,
    "xor": np.bitwise_xor,
}
_COMMUTATIVE = {"add", "mul", "max", "min", "and", "or", "xor", "eq", "ne"}
_PREDICATES = {"eq", "ne", "lt", "le", "gt", "ge", "is_finite"}


class Block:
    """A stretch of code: the whole program, or what a loop repeats.

    Attributes:
        parent: the block around it; None for the program.
        depth: number of blocks around it.
        active: whether an individual takes part, where some do not; else None.
        owner: the loop that the block belongs to; None for the program.
    """

    def __init__(self, parent: "Block | None" = None):
        self.parent = parent
        self.owner: Node | None = None
        self.depth: int = parent.depth + 1 if parent else 0
        self.active: Node | None = parent.active if parent else None


class Node:
    """One scalar, or something in memory that other nodes read.

    Attributes:
        op: name of the operation; "constant", "input", "carried", "counter", or a JAX primitive's.
        operands: nodes.
        dtype: of the value.
        value: of a constant, else None.
        detail: what else the operation needs (a `Loop`, the key of an input, an index).
        block: where it is computed.
        uniform: whether it is the same for all individuals.
        number: nodes are numbered as they are made; operands come before their users.
    """

    __slots__ = ("block", "detail", "dtype", "number", "op", "operands", "uniform", "value")

    def __init__(
        self,
        op: str,
        operands: "tuple[Node, ...]",
        dtype: np.dtype,
        block: Block,
        uniform: bool,
        number: float,
        value: Any = None,
        detail: Any = None,
    ):
        self.op = op
        self.operands = operands
        self.dtype = dtype
        self.value = value
        self.detail = detail
        self.block = block
        self.uniform = uniform
        self.number = number

    def __repr__(self) -> str:
        inside = self.value if self.value is not None else [o.number for o in self.operands]
        return f"{self.number}: {self.op} {inside}"


class Loop(NamedTuple):
    """A loop over a block.

    Attributes:
        count: how often it runs; None while its condition holds for any individual. Those for
            which it does not hold stay as they are.
        test: the block in which the condition is computed and what is carried is known.
        body: the block that is repeated, within ``test``.
        counter: the number of the round, from 0.
        start: what is carried at first.
        carried: what is carried into a round.
        following: what is carried out of it.
        condition: None for a counted loop.
        place: where a round's values go in the lists.
        written: what each round adds to lists.
        once: a branch: the condition is asked once, and the block runs once at most.
    """

    count: int | None
    test: Block
    body: Block
    counter: Node
    start: list[Node]
    carried: list[Node]
    following: list[Node]
    condition: Node | None
    place: Node
    written: list[Node]
    once: bool = False


class Sums:
    """Numbers in memory to which the rounds of a loop add at computed places.

    It stands for an array that a loop carries and only adds to.

    Attributes:
        shape: of the array.
        memory: the node of its memory.
        added: the nodes that add to it.
    """

    def __init__(self, shape: tuple[int, ...], memory: Node):
        self.shape, self.memory = shape, memory
        self.added: list[Node] = []

    @property
    def size(self) -> int:
        """How many numbers there are."""
        return int(np.prod(self.shape, dtype=int))


def loops_around(node: Node) -> list[Node]:
    """The loops around a node that adds to sums, up to where these begin."""
    found, block = [], node.block
    while block is not node.detail.memory.block:
        assert block.owner is not None and block.parent is not None
        found.append(block.owner)
        block = block.parent
    return found


def row_count(table: Node) -> int:
    """How many numbers a table in memory has."""
    if table.op == "list":
        return table.operands[0].detail.count or 1
    if table.op == "totals":
        return table.detail.size
    return table.detail if table.op == "solve" else len(table.operands)


class _Bytes:
    """Values of a table, equal where they are the same to the last bit."""

    def __init__(self, values: np.ndarray):
        self.values = values
        self._key = values.tobytes()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Bytes) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)


class Graph:
    """Makes nodes, and hands out the one that is there already.

    Attributes:
        top: the block of the whole program.
        block: in which loops are made at present.
    """

    def __init__(self):
        self.top = self.block = Block()
        self._nodes: dict[Any, Node] = {}
        self._constants: dict[Any, Node] = {}
        self._count = 0

    def input(self, key: Any, dtype: Any, uniform: bool = False) -> Node:
        """An input; the key says which."""
        return self._new("input", (), np.dtype(dtype), self.top, uniform, detail=key)

    def constant(self, value: Any, dtype: Any) -> Node:
        """A constant of the given type."""
        value = np.asarray(value, dtype)[()]
        key = (value.dtype.char, value.tobytes())
        node = self._constants.get(key)
        if node is None:
            node = self._new("constant", (), value.dtype, self.top, True, value=value)
            self._constants[key] = node
        return node

    def placeholder(self, op: str, dtype: Any, block: Block, uniform: bool = False) -> Node:
        """What a loop gives to its rounds: something carried, or the counter."""
        return self._new(op, (), np.dtype(dtype), block, uniform)

    def opaque(self, node: Node, block: Block | None = None, given: Node | None = None) -> Node:
        """The same number as a node of which nothing is known but its type.

        Args:
            node: which.
            block: where it is seen; None for its own.
            given: what the program was given (`given`) whose result it is.
        """
        if node.value is not None:
            return node
        block = block or node.block
        return self._new("opaque", (node,), node.dtype, block, node.uniform, detail=given)

    def inside(self, node: Node, block: Block) -> Node:
        """A node as a block sees it, so that what is computed from it is computed in the block."""
        if node.value is not None:
            return node
        return self._new("inside", (node,), node.dtype, block, node.uniform)

    def given(self, arrays: Sequence[np.ndarray]) -> Node:
        """What a program within the program is given, for those who must know what it uses."""
        nodes = tuple(node for array in arrays for node in array.flat)
        return self._new("given", nodes, np.dtype(bool), self.top, False)

    def make(self, op: str, operands: Sequence[Node], dtype: Any, detail: Any = None) -> Node:
        """A node as it stands, without simplification; the one that is there already, if any.

        Args:
            op: its name.
            operands: nodes.
            dtype: of the value.
            detail: hashable.
        """
        operands = tuple(operands)
        dtype = np.dtype(dtype)
        key = (op, dtype.char, detail, *[node.number for node in operands])
        node = self._nodes.get(key)
        if node is None:
            block, uniform = self.top, True
            for operand in operands:
                if operand.block.depth > block.depth:
                    block = operand.block
                uniform = uniform and operand.uniform
            node = self._new(op, operands, dtype, block, uniform, detail=detail)
            self._nodes[key] = node
        return node

    def table(self, column: Sequence[Node]) -> Node:
        """Numbers in a row, from which one can be taken at a computed place."""
        dtype, first = column[0].dtype, column[0]
        if first.op == "lookup" and first.operands[0].op in ("list", "totals"):
            # All of a list, read one by one, are that list.
            whole = first.operands[0]
            of_it = all(node.op == "lookup" and node.operands[0] is whole for node in column)
            places = [node.operands[1].value for node in column] if of_it else []
            if places == list(range(row_count(whole))):
                return whole
        if all([node.value is not None for node in column]):
            values = np.array([node.value for node in column], dtype)
            return self.make("constants", (), dtype, _Bytes(values))
        return self.make("rows", column, dtype)

    def lookup(self, table: Node, place: Node) -> Node:
        """The number at a place (int32) within a table or list."""
        if place.value is not None and table.op == "rows":
            return table.operands[int(place.value)]
        if place.value is not None and table.op == "constants":
            return self.constant(table.detail.values[int(place.value)], table.dtype)
        return self.make("lookup", (table, place), table.dtype)

    def solve(self, triangle: np.ndarray, b: np.ndarray) -> np.ndarray:
        """The answers to symmetric equations, by a function that loops.

        Args:
            triangle: the lower triangle of the matrix, row by row.
            b: the other side.
        """
        table = self.make("solve", (*triangle, *b), b[0].dtype, len(b))
        answers = np.empty(len(b), object)
        answers[:] = [self.lookup(table, self.constant(place, np.int32)) for place in range(len(b))]
        return answers

    def sums(self, start: np.ndarray) -> Sums:
        """Memory for sums that begin with the given nodes, all of one type."""
        nodes = tuple(start.flat)
        memory = self._new("sums", nodes, nodes[0].dtype, self.block, False)
        return Sums(start.shape, memory)

    def accumulate(self, sums: Sums, place: Node, value: Node) -> None:
        """Add a number to the one at a place (int32, the same for all individuals)."""
        active = self.block.active
        if active is not None and not active.uniform:
            value = self.select(active, value, self.constant(0, value.dtype))
        given = place, value
        node = self._new("accumulate", given, value.dtype, self.block, False, detail=sums)
        sums.added.append(node)

    def totals(self, sums: Sums) -> np.ndarray:
        """What sums have come to after the loop that was made last."""
        table = self._new("totals", (), sums.memory.dtype, self.block, False, detail=sums)
        places = [self.constant(place, np.int32) for place in range(sums.size)]
        nodes = np.empty(sums.size, object)
        nodes[:] = [self.lookup(table, place) for place in places]
        return nodes.reshape(sums.shape)

    def loop(self, loop: Loop) -> tuple[list[Node], list[Node]]:
        """Put a loop into the current block.

        Returns:
            What it carries out in the end, and its lists.
        """
        block, flag = self.block, np.dtype(bool)
        node = self._new("loop", tuple(loop.start), flag, block, False, detail=loop)
        loop.test.owner = loop.body.owner = node
        results = [
            self._new("result", (node,), one.dtype, block, False, detail=k)
            for k, one in enumerate(loop.carried)
        ]
        lists = [
            self._new("list", (node,), one.dtype, block, False, detail=k)
            for k, one in enumerate(loop.written)
        ]
        return results, lists

    @contextlib.contextmanager
    def within(self, block: Block) -> Iterator[None]:
        """Loops that are made now stand in the given block."""
        outer, self.block = self.block, block
        try:
            yield
        finally:
            self.block = outer

    def apply(self, op: str, *operands: Node, dtype: Any = None) -> Node:
        """The result of an operation on scalars, in its simplest form.

        Args:
            op: name of JAX's primitive.
            operands: its arguments.
            dtype: of the result of a conversion.
        """
        if op in ("convert", "bitcast"):
            return self._convert(op, operands[0], np.dtype(dtype))
        kind = operands[-1].dtype
        if op in _PREDICATES:
            kind = np.dtype(bool)
        if op in _FOLDED and all([node.value is not None for node in operands]):
            with np.errstate(all="ignore"):
                return self.constant(_FOLDED[op](*[node.value for node in operands]), kind)
        simplify = _SIMPLER.get(op)
        if simplify is not None:
            simpler = simplify(self, *operands)
            if simpler is not None:
                return simpler
        if op in _COMMUTATIVE and _comes_later(*operands):
            operands = operands[::-1]
        return self.make(op, operands, kind)

    def forget(self) -> None:
        """Make anew what is asked for again; constants stay."""
        self._nodes.clear()

    def add(self, a: Node, b: Node) -> Node:
        """The sum a + b."""
        return self.apply("add", a, b)

    def subtract(self, a: Node, b: Node) -> Node:
        """The difference a - b."""
        return self.apply("sub", a, b)

    def multiply(self, a: Node, b: Node) -> Node:
        """The product a b."""
        return self.apply("mul", a, b)

    def negate(self, a: Node) -> Node:
        """The negative of a."""
        return self.apply("neg", a)

    def select(self, condition: Node, yes: Node, no: Node) -> Node:
        """One or the other."""
        return self.apply("select", condition, yes, no)

    def convert(self, a: Node, dtype: Any) -> Node:
        """The number in another type."""
        return self.apply("convert", a, dtype=dtype)

    def power(self, base: Node, exponent: int) -> Node:
        """A whole power by repeated squaring."""
        if exponent < 0:
            return self.apply("div", self.constant(1, base.dtype), self.power(base, -exponent))
        if exponent == 0:
            return self.constant(1, base.dtype)
        half = self.power(base, exponent // 2)
        square = self.multiply(half, half) if exponent > 1 else half
        return self.multiply(square, base) if exponent % 2 else square

    def _convert(self, op: str, operand: Node, dtype: np.dtype) -> Node:
        if dtype == operand.dtype:
            return operand
        if operand.value is not None and op == "bitcast":
            return self.constant(operand.value.view(dtype), dtype)
        if operand.value is not None and not _saturates(operand, dtype):
            with np.errstate(all="ignore"):
                return self.constant(operand.value.astype(dtype), dtype)
        return self.make(op, (operand,), dtype)

    def _new(
        self,
        op: str,
        operands: tuple[Node, ...],
        dtype: np.dtype,
        block: Block,
        uniform: bool,
        value: Any = None,
        detail: Any = None,
    ) -> Node:
        self._count += 1
        return Node(op, operands, dtype, block, uniform, self._count, value, detail)


def _whole_quotient(a: np.integer, b: np.integer) -> Any:
    """Towards zero; -1 (all bits) where the divisor is zero, as in XLA."""
    size = abs(int(a)) // abs(int(b)) if b else -1
    bits = (-size if b and (a < 0) != (b < 0) else size) % (1 << 8 * a.dtype.itemsize)
    return np.asarray(bits, f"u{a.dtype.itemsize}").view(a.dtype)[()]


def _saturates(operand: Node, dtype: np.dtype) -> bool:
    """Whether a constant has no counterpart among whole numbers: the processor knows what to do."""
    if not _is_float(operand) or dtype.kind not in "iu":
        return False
    ends = np.iinfo(dtype)
    return not ends.min <= float(operand.value) <= ends.max


def _comes_later(a: Node, b: Node) -> bool:
    """Whether b is to be named before a: constants come last, whenever they were made."""
    if a.value is not None or b.value is not None:
        return a.value is not None
    return a.number > b.number


def _is_float(node: Node) -> bool:
    return node.dtype.kind == "f"


def _simpler_select(graph: Graph, condition: Node, yes: Node, no: Node) -> Node | None:
    if condition.value is not None:
        return yes if condition.value else no
    if yes is no:
        return yes
    if yes.dtype.kind == "b" and yes.value is not None and no.value is not None:
        return condition if yes.value else graph.apply("not", condition)
    return None


def _simpler_negative(graph: Graph, a: Node) -> Node | None:
    return a.operands[0] if a.op == "neg" else None


def _simpler_not(graph: Graph, a: Node) -> Node | None:
    return a.operands[0] if a.op == "not" else None


def _simpler_product(graph: Graph, a: Node, b: Node) -> Node | None:
    factor, other = (a, b) if a.value is not None else (b, a)
    if factor.value is None:
        return None
    if factor.value == 0:
        return factor
    if factor.value == 1:
        return other
    if factor.value < 0 and _is_float(factor):
        # Minus signs move outward, where sums absorb them and equal products meet.
        return graph.negate(graph.multiply(graph.constant(-factor.value, factor.dtype), other))
    return None


def _simpler_sum(graph: Graph, a: Node, b: Node) -> Node | None:
    for term, other in ((a, b), (b, a)):
        if term.value is not None and term.value == 0:
            return other
        if term.op == "neg" and _is_float(term):
            return graph.subtract(other, term.operands[0])
    return None


def _simpler_difference(graph: Graph, a: Node, b: Node) -> Node | None:
    if b.value is not None and b.value == 0:
        return a
    if not _is_float(a):
        return None
    if a.value is not None and a.value == 0:
        return graph.negate(b)
    if b.op == "neg":
        return graph.add(a, b.operands[0])
    return None


def _simpler_quotient(graph: Graph, a: Node, b: Node) -> Node | None:
    if b.value is not None and _is_float(b):
        if b.value == 1:
            return a
        # Exact where the reciprocal of a power of two is not subnormal.
        mantissa, exponent = math.frexp(float(b.value))
        if abs(mantissa) == 0.5 and abs(exponent) < 100:
            return graph.multiply(a, graph.constant(1.0 / float(b.value), b.dtype))
    return None


def _simpler_choice(decisive: bool, graph: Graph, a: Node, b: Node) -> Node | None:
    """Of "and" or "or", which one operand with the decisive value settles."""
    if a.dtype != bool:
        return None
    for one, other in ((a, b), (b, a)):
        if one.value is not None:
            return one if one.value == decisive else other
    return a if a is b else None


# An equal node that costs less, if there is one, by operation.
_SIMPLER: dict[str, Callable[..., Node | None]] = {
    "add": _simpler_sum,
    "and": functools.partial(_simpler_choice, False),
    "div": _simpler_quotient,
    "mul": _simpler_product,
    "neg": _simpler_negative,
    "not": _simpler_not,
    "or": functools.partial(_simpler_choice, True),
    "select": _simpler_select,
    "sub": _simpler_difference,
}
