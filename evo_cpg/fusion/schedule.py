"""Order a graph of scalars and cut it into kernels.

A value that is used in the kernel that computes it stays in a register; any other is stored and
read again. The order therefore brings values and their uses together, and the cuts are where the
fewest values cross.
"""

import collections
from collections.abc import Iterator
from typing import Any

import numpy as np

from evo_cpg.fusion.graph import Call, Node

# Most instructions in one kernel: operations, numbers read and results stored. LLVM inlines a
# function with one caller up to some 3000 instructions (a cost of 15,000, five for each); one that
# is larger is called, once for each of its results, and nothing is vectorised: a kernel of 3779
# took 26 ms instead of 10 microseconds. What is computed again later comes on top.
KERNEL_SIZE = 2400

# Most arrays that a kernel reads and writes: LLVM's alias analysis gives up beyond 250 of them, and
# the loop is then not vectorised.
KERNEL_ARRAYS = 240

# Cuts are considered every so many operations, too few to touch KERNEL_ARRAYS; starting a kernel
# costs as much as so many arrays.
_CUT_STRIDE = 20
_KERNEL_COST = 60


# A kernel computes again, instead of reading it, what takes no more than so many operations from
# other values that it has. To store and read a number takes as long as ten to twenty operations.
_RECOMPUTED = 4


def cut(wanted: list[Node]) -> list[tuple[list[Node], list[Node]]]:
    """Order the operations behind the wanted nodes and cut them into pieces.

    Returns:
        For each piece its operations, and those of them that are needed outside. The costly
        functions of one kind whose operands are ready together make a piece of their own.
    """
    order = _depth_first(wanted)
    uses = collections.Counter(wanted)
    for node in order:
        uses.update(set(node.operands))
    stage = _stages(order)
    pieces: list[list[Node]] = []
    for level in range(max(stage.values(), default=-1) + 1):
        kinds: dict[Any, list[Node]] = {}
        for node in order:
            if stage[node] == level:
                kinds.setdefault(_kind(node), []).append(node)
        for nodes in sorted(
            kinds.values(), key=lambda nodes: (nodes[0].costly, nodes[0].precision is not None)
        ):
            pieces.extend([nodes] if nodes[0].costly else _chunks(nodes, uses))
    owner = {node: i for i, piece in enumerate(pieces) for node in piece}
    pieces = [
        piece if piece[0].costly else _recomputing(_with_conditions(piece)) for piece in pieces
    ]
    needed = set(wanted)
    for piece in pieces:
        inside = set(piece)
        needed.update(o for node in piece for o in node.operands if o not in inside)
    return [
        (piece, [node for node in piece if node in needed and owner[node] == i])
        for i, piece in enumerate(pieces)
    ]


def _with_conditions(piece: list[Node]) -> list[Node]:
    """The piece with the conditions that it needs from others computed again.

    A kernel that reads or writes truth values is not vectorised.
    """
    again: set[Node] = set()
    inside, waiting = set(piece), list(piece)
    while waiting:
        for operand in waiting.pop().operands:
            condition = operand.is_operation and operand.dtype == bool and not operand.costly
            if condition and operand not in inside:
                inside.add(operand)
                again.add(operand)
                waiting.append(operand)
    return [*sorted(again, key=lambda node: node.number), *piece]


def _recomputing(piece: list[Node]) -> list[Node]:
    """The piece with what it reads computed again where that takes few operations.

    Nothing else is read for that.
    """
    reads = read_by(piece)
    known = set(reads)
    again: list[Node] = []
    # From the latest on, so that a value may be computed from one that is itself computed again.
    for value in sorted(reads, key=lambda node: -node.number):
        steps = _steps_from(known - {value}, value)
        if steps is not None:
            again += [node for node in steps if node not in again]
            known.update(steps)
    return [*sorted(again, key=lambda node: node.number), *piece]


def _steps_from(known: set[Node], value: Node) -> list[Node] | None:
    """The operations from known values to another; None if they are too many or impossible."""
    steps: list[Node] = []
    waiting = [value]
    while waiting:
        node = waiting.pop()
        if node in known or node.value is not None or node in steps:
            continue
        if not node.is_operation or node.costly or len(steps) == _RECOMPUTED:
            return None
        steps.append(node)
        waiting.extend(node.operands)
    return steps


def _kind(node: Node) -> Any:
    """Nodes of a kind can share a kernel."""
    if isinstance(node.primitive, Call):
        return node.primitive
    if node.costly:
        operand_types = tuple(operand.dtype for operand in node.operands)
        lanes = node.lanes, max((operand.lanes for operand in node.operands), default=1)
        return node.primitive, repr(sorted(node.params.items())), operand_types, lanes
    return node.precision, node.lanes


def _stages(order: list[Node]) -> dict[Node, int]:
    """For each node, before which costly functions it has to be computed: as late as possible."""
    last = max((node.level for node in order), default=0)
    stage = dict.fromkeys(order, last)
    for node in reversed(order):
        if node.costly:
            stage[node] = node.level
        for operand in node.operands:
            if operand in stage:
                stage[operand] = min(stage[operand], stage[node])
    return stage


def _depth_first(wanted: list[Node]) -> list[Node]:
    """Operations in an order in which a value is computed shortly before it is used."""
    needed = set(_ancestors(wanted))
    done: set[Node] = set()
    order: list[Node] = []
    for root in _nearest_first(wanted):
        stack = [(root, False)]
        while stack:
            node, expanded = stack.pop()
            if node in done or not node.is_operation:
                continue
            if expanded:
                done.add(node)
                order.append(node)
            else:
                if node.company:
                    company, node.company = node.company, ()
                    stack.append((node, False))
                    stack.extend((other, False) for other in reversed(company) if other in needed)
                    continue
                stack.append((node, True))
                latest_last = sorted(node.operands, key=lambda operand: operand.number)
                stack.extend((operand, False) for operand in latest_last)
    return order


def _nearest_first(wanted: list[Node]) -> list[Node]:
    """The wanted operations, each followed by the one that then takes the fewest operations."""
    behind: dict[Node, int] = {}  # Bit sets of all operations behind each, by number.
    for node in _ancestors(wanted):
        behind[node] = 1 << node.number
        for operand in node.operands:
            behind[node] |= behind.get(operand, 0)
    left = dict.fromkeys(node for node in wanted if node.is_operation)
    done, order = 0, []
    while left:
        nearest = min(left, key=lambda node: (behind[node] & ~done).bit_count())
        del left[nearest]
        done |= behind[nearest]
        order.append(nearest)
    return order


def _ancestors(wanted: list[Node]) -> list[Node]:
    """All operations behind the wanted nodes, operands before their users."""
    found: set[Node] = set()
    waiting = [node for node in wanted if node.is_operation]
    while waiting:
        node = waiting.pop()
        if node not in found:
            found.add(node)
            waiting.extend(operand for operand in node.operands if operand.is_operation)
    return sorted(found, key=lambda node: node.number)


def _chunks(order: list[Node], uses: dict[Node, int]) -> list[list[Node]]:
    """Cut a sequence of operations where the fewest values have to be stored and read again.

    Dynamic programming over the places of possible cuts, one every `_CUT_STRIDE` operations.
    """
    numbers = {node: i for i, node in enumerate(order)}
    reads = [
        [
            numbers.setdefault(operand, len(numbers))
            for operand in dict.fromkeys(node.operands)
            if operand.value is None
        ]
        for node in order
    ]
    wanted = [uses[node] for node in order]
    cuts = [*range(0, len(order), _CUT_STRIDE), len(order)]
    cost = dict.fromkeys(cuts, np.inf)
    previous: dict[int, int] = {}
    cost[0] = 0
    last_reader = [-1] * len(numbers)
    for start in cuts[:-1]:
        for stop, arrays in _extensions(reads, wanted, start, last_reader):
            if cost[start] + arrays + _KERNEL_COST < cost[stop]:
                cost[stop] = cost[start] + arrays + _KERNEL_COST
                previous[stop] = start
    chunks, stop = [], len(order)
    while stop:
        chunks.append(order[previous[stop] : stop])
        stop = previous[stop]
    return chunks[::-1]


def _extensions(
    reads: list[list[int]], uses: list[int], start: int, last_reader: list[int]
) -> Iterator[tuple[int, int]]:
    """Places up to which one kernel can go from a start, and how many arrays it then touches.

    Args:
        reads: numbers of the values that each operation reads; an operation's own number is its
            place.
        uses: of each operation's result.
        start: place of the kernel's first operation.
        last_reader: for each value, from which start it was last found to be read from outside.
    """
    places = range(start, min(start + KERNEL_SIZE, len(reads)))
    pending = [uses[place] for place in places]
    inputs = results = 0
    for place in places:
        for value in reads[place]:
            if start <= value < place:
                pending[value - start] -= 1
                results -= not pending[value - start]
            elif last_reader[value] != start:
                last_reader[value] = start
                inputs += 1
        results += 1
        stop = place + 1
        if 2 * inputs > KERNEL_ARRAYS or stop - start + inputs > KERNEL_SIZE:
            return
        # A reduction reads as many arrays as it writes.
        fits = 2 * results <= KERNEL_ARRAYS and stop - start + inputs + results <= KERNEL_SIZE
        if fits and (stop % _CUT_STRIDE == 0 or stop == len(reads)):
            yield stop, inputs + max(inputs, results)


def read_by(piece: list[Node]) -> list[Node]:
    """What a piece reads, constants apart, in a fixed order."""
    inside = set(piece)
    outside = {
        operand: None
        for node in piece
        for operand in node.operands
        if operand not in inside and operand.value is None
    }
    return list(outside)
