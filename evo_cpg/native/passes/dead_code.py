"""Eliminate nodes and carried values that no result needs."""

import dataclasses

from evo_cpg.native.ir.graph import Graph, Node


def eliminate_dead_code(graph: Graph) -> Graph:
    """Return the program with only the nodes and carried values that its results need."""
    needed: dict[Node, None] = {}
    kept: dict[Node, list[int]] = {}
    places: dict[Node, tuple[Node, int]] = {}

    def open_loop(node: Node) -> None:
        if node not in kept:
            kept[node] = []
            places.update((one, (node, k)) for k, one in enumerate(node.detail.carried))

    def keep(node: Node, k: int) -> list[Node]:
        """Return the nodes that are needed if a loop carries one more value."""
        open_loop(node)
        if k in kept[node]:
            return []
        kept[node].append(k)
        return [node, node.operands[k], node.detail.following[k]]

    waiting = list(graph.result_nodes)
    while waiting:
        node = waiting.pop()
        if node in needed:
            continue
        needed[node] = None
        if node.op == "loop":
            if node.detail.condition is not None:
                waiting.append(node.detail.condition)
        elif node.op == "result":
            waiting += keep(node.operands[0], node.detail)
        elif node.op == "list":
            (loop,) = node.operands
            open_loop(loop)
            waiting += [loop, loop.detail.written[node.detail], loop.detail.index]
        elif node.op == "carried":
            waiting += keep(*places[node])
        else:
            waiting += node.operands
            if node.op == "accumulate":
                # The loops around it must run even if they carry no needed value.
                around = graph.around(node)
                for loop in around:
                    open_loop(loop)
                waiting += around
    return dataclasses.replace(
        graph,
        nodes=[node for node in graph.nodes if node in needed],
        parts=(),
        loops={block: loop for block, loop in graph.loops.items() if loop in needed},
        kept={loop: tuple(sorted(each)) for loop, each in kept.items()},
    )
