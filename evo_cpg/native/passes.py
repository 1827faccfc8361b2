"""Passes: functions from a graph to a new one. `PASSES` lists them in order."""

import collections
import dataclasses
import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import NamedTuple

from evo_cpg.native import machine_constants
from evo_cpg.native.ir import Graph, GraphPart, Node, Unsupported, resolve, runs_of

Pass = Callable[[Graph], Graph]


class Replacement(NamedTuple):
    """The replacement of a node. The new node has the type and the block of the old one.

    Attributes:
        op: new operation.
        operands: new operands, nodes of the old graph.
        number: new place in the order.
    """

    op: str
    operands: tuple[Node, ...]
    number: float


class WrongOrder(ValueError):
    """Raised if a pass could do nothing, because of the pass before it."""


def rewrite(
    graph: Graph, changes: Mapping[Node, Replacement], inserted: Sequence[Node] = ()
) -> Graph:
    """Return a graph in which some nodes and all uses of them are replaced.

    Replacements and new nodes may use ``inserted`` nodes, whose numbers give their places among the
    old nodes.

    Raises:
        WrongOrder: if the graph is scheduled, because its runs would keep the old nodes.
    """
    if graph.runs:
        raise WrongOrder("a scheduled graph cannot be rewritten. Schedule after the other passes")
    if not changes and not inserted:
        return graph
    new: dict[Node, Node] = {}

    def mapped(nodes: Iterable[Node]) -> tuple[Node, ...]:
        return tuple([new.get(node, node) for node in nodes])

    every = [*graph.nodes, *inserted]
    nodes = sorted(every, key=lambda node: changes.get(node, node).number)
    for i, node in enumerate(nodes):
        change = changes.get(node)
        op, operands, number = (node.op, node.operands, node.number) if change is None else change
        detail, changed = node.detail, change is not None
        for operand in operands:
            if operand in new:
                operands, changed = mapped(operands), True
                break
        if op == "loop":
            lists = "carried", "following", "written"
            detail, changed = (
                detail._replace(
                    condition=new.get(detail.condition, detail.condition),
                    index=new.get(detail.index, detail.index),
                    **{name: mapped(getattr(detail, name)) for name in lists},
                ),
                True,
            )
        if changed:
            nodes[i] = new[node] = Node(
                op, operands, node.dtype, node.block, node.uniform, number, None, detail, node.part
            )
    return dataclasses.replace(
        graph,
        results=tuple((buffer, mapped(rows)) for buffer, rows in graph.results),
        nodes=nodes,
        loops=dict(zip(graph.loops, mapped(graph.loops.values()), strict=True)),
        parts=tuple(
            part._replace(arguments=mapped(part.arguments), results=mapped(part.results))
            for part in graph.parts
        ),
        kept=dict(zip(mapped(graph.kept), graph.kept.values(), strict=True)),
    )


def contract_multiply_adds(graph: Graph) -> Graph:
    """Return the program with the sums of each part as chains of multiply-adds.

    A processor computes ``a b + c`` in one instruction, a multiply-add, and rounds once. The sum of
    dot products ``(a b + c d) + (e f + g h)`` takes two multiplications, two multiply-adds and an
    addition. The chain ``((a b + c d) + e f) + g h`` takes one multiplication and three
    multiply-adds. Other terms of a sum come first: ``((x + a b) + c d)``.

    LLVM fuses no other products, so the results are equal for vectors of any width. Each part is
    rewritten independently, so it has the same results alone and within a larger program.

    | operation | meaning |
    |---|---|
    | ``fma`` | a b + c |
    | ``fms`` | a b - c |
    | ``fnma`` | c - a b |

    Raises:
        WrongOrder: if the parts are not known, because another pass has removed dead code.
    """
    if not graph.parts:
        raise WrongOrder("sums are contracted part by part, before dead code is eliminated")
    changes: dict[Node, Replacement] = {}
    reached: set[Node] = set()

    def reach(nodes: Iterable[Node]) -> None:
        reached.update(nodes)
        reached.update([node.operands[0] for node in nodes if node.op == "opaque"])

    reach(_uses_in_part(graph, graph.result_nodes))
    # Inner parts come before the parts that contain them. A constant does not show that a part is
    # needed, because all parts share it.
    for part in reversed(graph.parts):
        if any(node in reached and node.value is None for node in part.results):
            uses = _uses_in_part(graph, part.results)
            changes |= _contraction(part, uses)
            reach(uses)
    # Nodes of a rewritten sum may have other users that no result needs.
    nodes = [node for node in graph.nodes if node in reached]
    return rewrite(dataclasses.replace(graph, nodes=nodes), changes)


def _uses_in_part(graph: Graph, result_nodes: Iterable[Node]) -> dict[Node, Sequence[Node]]:
    """Return all nodes of a part that its results depend on, each with the nodes that it uses."""
    found: dict[Node, Sequence[Node]] = {}
    entered: set[int | None] = {None}
    waiting = list(result_nodes)
    while waiting:
        node = waiting.pop()
        if node in found:
            continue
        uses: Sequence[Node] = node.operands
        if node.op == "opaque":
            # A result of an inner part depends on its arguments. An argument of this part depends
            # on no node of the part.
            fresh = node.detail not in entered
            uses = graph.parts[node.detail].arguments if fresh else ()
            entered.add(node.detail)
        elif node.op == "write":
            uses = (*node.operands, *graph.around(node))
        elif node.op == "loop":
            loop = node.detail
            single = [each for each in (loop.condition, loop.index) if each is not None]
            uses = (*node.operands, *single, *loop.following, *loop.written)
        found[node] = uses
        waiting.extend(uses)
    return found


def _contraction(part: GraphPart, uses: Mapping[Node, Sequence[Node]]) -> dict[Node, Replacement]:
    """Return the new sums of a part. Sums that are arguments of other parts stay as they are."""
    counts = collections.Counter(itertools.chain(part.results, *uses.values()))
    sums = [node for node in uses if node.op in ("add", "sub") and node.dtype.kind == "f"]
    # Sums that become links of the chain of their only user.
    taken = {
        operand
        for node in sums
        for operand in node.operands
        if part.reorder and operand.op in ("add", "sub") and counts[operand] == 1
        if _goes_with(operand, node)
    }

    def is_product(node: Node, into: Node) -> bool:
        return node.op == "mul" and counts[node] == 1 and _goes_with(node, into)

    changes: dict[Node, Replacement] = {}
    for node in sums:
        if node not in taken:
            changes |= _chain(node, taken, is_product)
    for node in sums:
        old = Replacement(node.op, node.operands, node.number)
        op, (first, second), number = changes.get(node, old)
        if is_product(second, node):
            fused = "fma" if op == "add" else "fnma"
            changes[node] = Replacement(fused, (*second.operands, first), number)
        elif is_product(first, node):
            fused = "fma" if op == "add" else "fms"
            changes[node] = Replacement(fused, (*first.operands, second), number)
    return changes


def _chain(
    root: Node, taken: set[Node], is_product: Callable[[Node, Node], bool]
) -> dict[Node, Replacement]:
    """Rewrite nested sums as one chain with the same number of additions and subtractions."""
    sums, terms = [], []
    waiting = [(root, True)]
    while waiting:
        node, positive = waiting.pop()
        if node is root or (node in taken and _goes_with(node, root)):
            sums.append(node)
            first, second = node.operands
            waiting.append((second, positive == (node.op == "add")))
            waiting.append((first, positive))
        else:
            terms.append((node, positive))
    if len(sums) == 1:
        return {}
    terms.sort(key=lambda term: is_product(term[0], root))
    start = next(i for i, (_, positive) in enumerate(terms) if positive)
    total, changes = terms.pop(start)[0], {}
    # The root is the last link and keeps its number. The others come shortly before it.
    for i, (node, (term, positive)) in enumerate(zip(reversed(sums), terms, strict=True)):
        after = len(sums) - 1 - i
        number = root.number - after / len(sums) if after else root.number
        changes[node] = Replacement("add" if positive else "sub", (total, term), number)
        total = node
    return changes


def _goes_with(operand: Node, node: Node) -> bool:
    """Return whether two nodes are in one block and are both uniform or both not."""
    return operand.block is node.block and operand.uniform == node.uniform


def eliminate_dead_code(graph: Graph) -> Graph:
    """Return the program with only the nodes and carried values that its results need.

    Raises:
        WrongOrder: if the graph is scheduled, because its runs would keep the dead code.
    """
    if graph.runs:
        raise WrongOrder("dead code is eliminated before the schedule")
    needed: dict[Node, None] = {}
    kept: dict[Node, list[int]] = {}
    places: dict[Node, tuple[Node, int]] = {}

    def open_loop(node: Node) -> None:
        if node not in kept:
            kept[node] = []
            places.update((one, (node, k)) for k, one in enumerate(node.detail.carried))

    waiting = list(graph.result_nodes)
    while waiting:
        node = waiting.pop()
        if node in needed:
            continue
        needed[node] = None
        if node.op == "loop":
            if node.detail.condition is not None:
                waiting.append(node.detail.condition)
        elif node.op in ("result", "carried"):
            loop, k = (node.operands[0], node.detail) if node.op == "result" else places[node]
            open_loop(loop)
            if k not in kept[loop]:
                kept[loop].append(k)
                waiting += [loop, loop.operands[k], loop.detail.following[k]]
        elif node.op == "list":
            (loop,) = node.operands
            open_loop(loop)
            waiting += [loop, loop.detail.written[node.detail], loop.detail.index]
        else:
            waiting += node.operands
            if node.op == "write":
                # The loops around it must run even if they carry no needed value.
                for loop in graph.around(node):
                    open_loop(loop)
                    waiting.append(loop)
    return dataclasses.replace(
        graph,
        nodes=[node for node in graph.nodes if node in needed],
        parts=(),
        loops={block: loop for block, loop in graph.loops.items() if loop in needed},
        kept={loop: tuple(sorted(each)) for loop, each in kept.items()},
    )


def check_size(graph: Graph) -> Graph:
    """Return the graph if it is small enough.

    Raises:
        Unsupported: if there are more operations than `MOST_OPERATIONS`.
    """
    if len(graph.nodes) > machine_constants.MOST_OPERATIONS:
        most = machine_constants.MOST_OPERATIONS
        raise Unsupported(f"the program has more than {most} operations")
    return graph


def schedule(graph: Graph) -> Graph:
    """Return the program with its operations in an order in which few values wait for a later use.

    A waiting value takes a register, or is stored and loaded again. If the operations stay in the
    order of the traced program, these stores and loads are a quarter of all instructions.
    """
    return dataclasses.replace(graph, runs=runs_of(graph, ordered))


def ordered(run: Sequence[Node]) -> list[Node]:
    """Return the operations of a run in order.

    An operation comes shortly before its first use. Operands of an operation are computed in
    reverse order of their numbers. An operation whose operands are all computed comes at once if it
    is the last user of some value.
    """
    inside = set(run)
    operands: dict[Node, list[Node]] = {}
    users: dict[Node, list[Node]] = {node: [] for node in run}
    for node in run:
        own = [x for x in dict.fromkeys(map(resolve, node.operands)) if x in inside]
        operands[node] = sorted(own, key=lambda x: x.number)
        for operand in operands[node]:
            users[operand].append(node)
    # Number of operands of each node still to compute, and number of its remaining uses.
    missing = {node: len(each) for node, each in operands.items()}
    left = {node: len(each) for node, each in users.items()}
    done: dict[Node, None] = {}

    def frees(node: Node) -> bool:
        ready = node not in done and not missing[node]
        return ready and any(left[operand] == 1 for operand in operands[node])

    def put(node: Node) -> None:
        """Append a node and ready nodes that free at least as many registers as they take."""
        stack = [node]
        while stack:
            node = stack.pop()
            if node in done:
                continue
            done[node] = None
            for operand in operands[node]:
                left[operand] -= 1
            for user in users[node]:
                missing[user] -= 1
            # These may have become ready, or the last user of some value.
            stack.extend(filter(frees, users[node]))
            for operand in operands[node]:
                if left[operand] == 1:
                    stack.extend(filter(frees, users[operand]))

    for root in reversed(run):
        started, stack = set(), [] if users[root] else [(root, False)]
        while stack:
            node, ready = stack.pop()
            if ready:
                put(node)
            elif node not in done and node not in started:
                started.add(node)
                stack.append((node, True))
                stack.extend((operand, False) for operand in operands[node])
    return list(done)


PASSES: tuple[Pass, ...] = (contract_multiply_adds, eliminate_dead_code, check_size, schedule)
"""Passes from graph to graph, in order."""
