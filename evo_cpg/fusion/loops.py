"""Loops and branches of a JAX program, as loops of the graph.

A branch that depends on the individual becomes both, of which one is chosen, as under `jax.vmap`.
"""

import functools
from collections.abc import Callable, Sequence

import numpy as np

from evo_cpg.fusion import jax_internals as internals
from evo_cpg.fusion import machine_constants
from evo_cpg.fusion.graph import Block, Graph, Loop, Node
from evo_cpg.fusion.unsupported import Unsupported

Trace = Callable[..., list[np.ndarray]]


def _scan(graph: Graph, operands: list[np.ndarray], params: dict, trace: Trace) -> list[np.ndarray]:
    """A counted loop; what it reads one by one lies in tables, what it stacks in lists."""
    constant_count, carry_count = internals.scan_counts(params)
    length, closed = params["length"], params["jaxpr"]
    consts = operands[:constant_count]
    start = operands[constant_count : constant_count + carry_count]
    read = operands[constant_count + carry_count :]
    stacked = closed.out_avals[carry_count:]
    if length == 0:
        return [*start, *(np.empty((0, *aval.shape), object) for aval in stacked)]
    if length * sum(aval.size for aval in stacked) > machine_constants.LONGEST_LISTS:
        raise Unsupported(f"a loop of {length} rounds stacks more than native code keeps")

    def one_round(place: Node, carried: list[np.ndarray]) -> list[np.ndarray]:
        row = [_row(graph, x, place) for x in read]
        return trace(graph, closed, [*consts, *carried, *row])

    if length == 1:
        results = one_round(graph.constant(0, np.int32), start)
        return [*results[:carry_count], *(x[None] for x in results[carry_count:])]
    test = Block(graph.block)
    body = Block(test)
    counter = graph.placeholder("counter", np.int32, body, uniform=True)
    carried = [_placeholders(graph, x, body) for x in start]
    with graph.within(body):
        place = counter
        if params["reverse"]:
            place = graph.subtract(graph.constant(length - 1, np.int32), counter)
        results = one_round(place, carried)
    loop = Loop(
        length, test, body, counter, _flat(start), _flat(carried), _flat(results[:carry_count]),
        None, place, _flat(results[carry_count:]),
    )  # fmt: skip
    ends, lists = graph.loop(loop)
    return [*_like(ends, start), *_stacks(graph, lists, stacked, length)]


def _while(
    graph: Graph, operands: list[np.ndarray], params: dict, trace: Trace
) -> list[np.ndarray]:
    """A loop that ends when no individual wants another round; the others stay as they are."""
    of_test, of_body = params["cond_nconsts"], params["body_nconsts"]
    test_consts, body_consts = operands[:of_test], operands[of_test : of_test + of_body]
    start = operands[of_test + of_body :]
    test = Block(graph.block)
    body = Block(test)
    carried = [_placeholders(graph, x, test) for x in start]
    with graph.within(test):
        (condition,) = trace(graph, params["cond_jaxpr"], [*test_consts, *carried])
        condition, around = condition.item(), graph.block.active
        if around is not None and not condition.uniform:
            # A loop in another one does not wait for individuals that are done there.
            condition = graph.apply("and", condition, around)
    if not condition.uniform:
        body.active = condition
    # What the test computes of them is computed before it is known whether there is a round.
    inside = np.frompyfunc(lambda node: graph.opaque(node, body), 1, 1)
    again = [np.asarray(inside(x), object) for x in carried]
    with graph.within(body):
        results = trace(graph, params["body_jaxpr"], [*body_consts, *again])
    counter = graph.placeholder("counter", np.int32, body, uniform=True)
    loop = Loop(
        None, test, body, counter, _flat(start), _flat(carried), _flat(results),
        condition, counter, [],
    )  # fmt: skip
    ends, _ = graph.loop(loop)
    return _like(ends, start)


def _cond(graph: Graph, operands: list[np.ndarray], params: dict, trace: Trace) -> list[np.ndarray]:
    which, *given = operands
    number, branches = which.item(), params["branches"]
    if number.value is not None:
        place = int(np.clip(int(number.value), 0, len(branches) - 1))
        return trace(graph, branches[place], given)
    results = [trace(graph, branch, given) for branch in branches]
    chosen = results[-1]
    for k in range(len(branches) - 2, -1, -1):
        here = graph.apply("le", graph.convert(number, np.int32), graph.constant(k, np.int32))
        choose = np.frompyfunc(functools.partial(graph.select, here), 2, 1)
        chosen = [np.asarray(choose(a, b), object) for a, b in zip(results[k], chosen, strict=True)]
    return chosen


LOOPS: dict[str, Callable[[Graph, list[np.ndarray], dict, Trace], list[np.ndarray]]] = {
    "cond": _cond,
    "scan": _scan,
    "while": _while,
}


def _row(graph: Graph, x: np.ndarray, place: Node) -> np.ndarray:
    """One of the rows of an array, at a computed place."""
    columns = x.reshape(len(x), -1).T
    row = np.empty(len(columns), object)
    row[:] = [graph.lookup(graph.table(list(column)), place) for column in columns]
    return row.reshape(x.shape[1:])


def _placeholders(graph: Graph, like: np.ndarray, block: Block) -> np.ndarray:
    result = np.empty(like.size, object)
    result[:] = [graph.placeholder("carried", node.dtype, block) for node in like.flat]
    return result.reshape(like.shape)


def _flat(arrays: Sequence[np.ndarray]) -> list[Node]:
    return [node for array in arrays for node in array.flat]


def _like(nodes: list[Node], arrays: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Nodes one after the other, in arrays of the same shapes as others."""
    given = iter(nodes)
    result = []
    for array in arrays:
        part = np.empty(array.size, object)
        part[:] = [next(given) for _ in range(array.size)]
        result.append(part.reshape(array.shape))
    return result


def _stacks(graph: Graph, lists: list[Node], avals: Sequence, length: int) -> list[np.ndarray]:
    """What a loop has stacked, from the lists of its scalars."""
    given = iter(lists)
    result = []
    for aval in avals:
        rows = np.empty((length, aval.size), object)
        for column in range(aval.size):
            one = next(given)
            rows[:, column] = [
                graph.lookup(one, graph.constant(place, np.int32)) for place in range(length)
            ]
        result.append(rows.reshape(length, *aval.shape))
    return result
