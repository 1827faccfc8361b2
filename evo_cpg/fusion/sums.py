"""Rewrite sums so that every product in them is added as it is made.

A processor multiplies and adds in one instruction, ``a b + c``. Written as sums of dot products,
``(a b + c d) + (e f + g h)``, four products take two plain multiplications, two such instructions
and an addition; as a chain, ``((a b + c d) + e f) + g h``, one multiplication and three of them.
Where a sum has other terms they come first: ``((x + a b) + c d)``.

Only the order in which terms are added changes, and with it the rounding.
"""

import collections

import jax

from evo_cpg.fusion.graph import Node

_SUMS = {"add", "sub"}


def chain_sums(wanted: list[Node]) -> None:
    """Turn all sums behind the wanted nodes into chains, in place, and number the nodes anew."""
    order = _operands_first(wanted)
    uses = collections.Counter(wanted)
    for node in order:
        uses.update(node.operands)
    inner = {node for node in order if node.name in _SUMS and uses[node] == 1 and not node.company}
    taken = {operand for node in order if node.name in _SUMS for operand in node.operands} & inner
    ages = {node: (node.number, 0) for node in order}
    for node in order:
        if node.name in _SUMS and node not in taken:
            chain = _chain(node, taken, uses)
            ages.update({part: (node.number - 1, i) for i, part in enumerate(chain, 1)})
    for number, node in enumerate(sorted(order, key=ages.__getitem__)):
        node.number = number


def _chain(root: Node, inner: set[Node], uses: collections.Counter) -> list[Node]:
    """One sum, with as many additions as before; returns those before the last."""
    sums, terms = [], []
    waiting = [(root, True)]
    while waiting:
        node, positive = waiting.pop()
        if node is root or node in inner:
            sums.append(node)
            first, second = node.operands
            waiting.append((second, positive == (node.name == "add")))
            waiting.append((first, positive))
        else:
            terms.append((node, positive))
    if len(sums) == 1:
        return []

    def is_product(node: Node) -> bool:
        return node.name == "mul" and uses[node] == 1

    terms.sort(key=lambda term: is_product(term[0]))
    start = next(i for i, (_, positive) in enumerate(terms) if positive)
    total = terms.pop(start)[0]
    for node, (term, positive) in zip(reversed(sums), terms, strict=True):
        node.primitive = jax.lax.add_p if positive else jax.lax.sub_p
        node.operands = (total, term)
        total = node
    return sums[:0:-1]


def _operands_first(wanted: list[Node]) -> list[Node]:
    """The wanted nodes and all behind them."""
    order: dict[Node, None] = {}
    stack = [(node, False) for node in reversed(wanted)]
    while stack:
        node, expanded = stack.pop()
        if node in order:
            continue
        if expanded:
            order[node] = None
        else:
            stack.append((node, True))
            stack.extend((operand, False) for operand in reversed(node.operands))
    return list(order)
