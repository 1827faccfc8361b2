"""Print a graph as text, with one node per line."""

from collections.abc import Iterable, Iterator, Mapping, Sequence

from evo_cpg.native.ir.graph import Block, Graph, Node, Run, resolve, runs_of, table_values


def show(graph: Graph) -> str:
    """Return a program as text.

    A line has the number of a node, its type (with ``u`` if it is uniform), its operation, and the
    numbers of its operands. The blocks of a loop are indented. Only computed nodes are shown.
    """
    runs = graph.runs or runs_of(graph)
    lines = [
        f"argument {k}: {'shared ' if each.shared else ''}{each.dtype}[{each.rows}]"
        for k, each in enumerate(graph.arguments)
    ]
    lines += _block(graph, runs, graph.top)
    lines += [f"part {k}: {_names(part.results)}" for k, part in enumerate(graph.parts)]
    for k, (buffer, nodes) in enumerate(graph.results):
        lines.append(f"result {k}: {buffer.dtype}[{buffer.rows}] = {_names(nodes)}")
    return "\n".join(lines)


def _block(graph: Graph, runs: Mapping[Block, Sequence[Run]], block: Block) -> Iterator[str]:
    for run in runs.get(block, ()):
        yield from map(_line, run.nodes)
        if run.loop is None:
            continue
        loop = run.loop.detail
        kind = "branch" if loop.once else "while" if loop.condition else f"repeat {loop.count}"
        kept = graph.kept.get(run.loop, ())
        yield f"{_name(run.loop)} = {kind}"
        yield from (
            f"  carry {_name(loop.carried[k])} from {_name(run.loop.operands[k])}" for k in kept
        )
        yield from (f"  {line}" for line in _block(graph, runs, loop.test))
        if loop.condition is not None:
            yield f"  if {_name(loop.condition)}"
        yield from (f"    {line}" for line in _block(graph, runs, loop.body))
        yield from (f"  next {_name(loop.carried[k])} = {_name(loop.following[k])}" for k in kept)
        if loop.written:
            yield f"  write {_names(loop.written)} at {_name(loop.index)}"


def _line(node: Node) -> str:
    shown = table_values(node).tolist() if node.op == "constants" else node.detail
    detail = "" if shown is None else f" {shown}"
    kind = f"{node.dtype}{' u' if node.uniform else ''}"
    return f"{_name(node)}: {kind} = {node.op} {_names(node.operands)}{detail}".rstrip()


def _name(node: Node) -> str:
    node = resolve(node)
    return str(node.value) if node.value is not None else f"%{node.number:g}"


def _names(nodes: Iterable[Node]) -> str:
    return ", ".join(map(_name, nodes))
